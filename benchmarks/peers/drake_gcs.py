"""Drake's graphs of convex sets: `GcsTrajectoryOptimization` through regions grown by IRIS.

The regions are polyhedra free of the shapes grown by the vehicle's radius. The graph gives the
shortest path through them; then the curve of least index through the regions of that path is
computed, with one piece for each, together with the durations of the pieces.
"""

from __future__ import annotations

import logging

import numpy as np
from pydrake.geometry.optimization import (
    ConvexSet,
    GraphOfConvexSetsOptions,
    HPolyhedron,
    Hyperellipsoid,
    Hyperrectangle,
    Iris,
    IrisOptions,
    MinkowskiSum,
    Point,
)
from pydrake.planning import GcsTrajectoryOptimization
from pydrake.solvers import ClarabelSolver, MathematicalProgramResult

import drake_rho as rho
from benchmarks.field import Field, field_of
from benchmarks.peers.bezier import Curve, curve, durations_by, retimed
from drake_rho.scenario.fields import FloatArray

REGIONS = 15, 30
"""Least number of regions; and the largest, if start and goal are not connected through fewer."""

SEED_RADII = (0.2, 0.05, 0.5)
"""Radii of IRIS's initial ball [m]; the next is used where Clarabel fails with one, as it often
does with the much smaller default."""

INSET = 1e-3
"""Fraction of the distance to the room's centre by which seeds of the ends move off the walls."""

ON_THE_LINE = 9
"""Seeds on the straight line from start to goal, after those of the ends and before random ones."""

ROUNDED, ROUNDINGS = 20, 200
"""Number of paths tried after the relaxation, and of draws for them."""

SHARES = (0.02, 0.05, 0.1)
"""Least length of a piece over the path's, in the durations that are tried first, which are
proportional to the path's lengths in the pieces."""


def solve(scenario: rho.Scenario, rng: np.random.Generator) -> Curve | None:
    """Return a curve for one vehicle, from rest to rest, among spheres and boxes at rest.

    The limits are satisfied if there is such a curve in the regions of the path, otherwise not.

    Args:
        scenario: the scenario of one vehicle.
        rng: draws seeds of the regions.

    Returns:
        None if no path was found.
    """
    logging.getLogger("drake").setLevel(logging.WARNING)  # it logs every path that it rounds
    field = field_of(scenario)
    found = _path(field, regions(field, rng))
    if found is None:
        return None
    through, lengths = found
    timings = [durations_by(field, np.maximum(lengths, share * lengths.sum())) for share in SHARES]
    for limits in ((field.velocity, field.acceleration), (None, None)):
        curves = [curve(field, through, durations, limits) for durations in timings]
        kept = [each for each in curves if each is not None]
        if kept:
            first = min(kept, key=lambda each: each.cost(field.step))
            return retimed(field, through, first, limits)
    return None


def regions(field: Field, rng: np.random.Generator) -> list[HPolyhedron]:
    """Return polyhedra free of the grown shapes, around the ends and around uncovered points."""
    room, ends = field.room, [field.start, field.goal]
    domain = HPolyhedron.MakeBox(room.lower, room.upper)
    shapes = [_grown(shape, field.radius) for shape in field.shapes]
    between = np.linspace(field.start, field.goal, ON_THE_LINE + 2)[1:-1]
    seeds = [*between, *(end + INSET * (room.center - end) for end in ends)]
    found: list[HPolyhedron] = []
    least, most = REGIONS
    for _ in range(100 * most):
        seed = seeds.pop() if seeds else rng.uniform(room.lower, room.upper)
        others = found if len(found) >= len(ends) else []  # each end has a region of its own
        if any(each.PointInSet(seed) for each in (*shapes, *others)):
            continue
        grown = _around(seed, shapes, domain)
        if grown is not None:
            found.append(grown)
        if len(found) >= most or (len(found) >= least and _connected(found, ends)):
            break
    return found


def _around(seed: FloatArray, shapes: list[ConvexSet], domain: HPolyhedron) -> HPolyhedron | None:
    """Return a polyhedron around a point; None where Clarabel fails."""
    options = IrisOptions()
    options.require_sample_point_is_contained = True
    for radius in SEED_RADII:
        options.starting_ellipse = Hyperellipsoid.MakeHypersphere(radius, seed)
        try:
            return Iris(shapes, seed, domain, options).ReduceInequalities()
        except RuntimeError:
            continue
    return None


def _grown(shape: rho.Sphere | rho.Box, radius: float) -> ConvexSet:
    """Return the set where the vehicle's centre must not be."""
    if isinstance(shape, rho.Sphere):
        return Hyperellipsoid.MakeHypersphere(shape.radius + radius, shape.center)
    ball = Hyperellipsoid.MakeHypersphere(radius, np.zeros(3))
    return MinkowskiSum(Hyperrectangle(shape.lower, shape.upper), ball)


def _connected(sets: list[HPolyhedron], ends: list[FloatArray]) -> bool:
    """Return whether a chain of overlapping sets leads from one end to the other."""
    reached = [index for index, each in enumerate(sets) if each.PointInSet(ends[0], 1e-9)]
    rest = [index for index in range(len(sets)) if index not in reached]
    for index in reached:  # `reached` grows
        near = [other for other in rest if sets[index].IntersectsWith(sets[other])]
        reached += near
        rest = [other for other in rest if other not in near]
    return any(sets[index].PointInSet(ends[1], 1e-9) for index in reached)


def _path(field: Field, sets: list[HPolyhedron]) -> tuple[list[HPolyhedron], FloatArray] | None:
    """Return the regions of the shortest path in order, and its lengths in them [m], shape (P,)."""
    problem = GcsTrajectoryOptimization(3)
    inner = problem.AddRegions(sets, 1, h_min=0.0, h_max=1.0)
    start = problem.AddRegions([Point(field.start)], 0)
    goal = problem.AddRegions([Point(field.goal)], 0)
    problem.AddEdges(start, inner)
    problem.AddEdges(inner, goal)
    problem.AddPathLengthCost()
    options = GraphOfConvexSetsOptions()
    options.convex_relaxation = True
    options.max_rounded_paths, options.max_rounding_trials = ROUNDED, ROUNDINGS
    options.preprocessing = False  # takes longer than it saves
    options.solver = ClarabelSolver()
    try:
        _, result = problem.SolvePath(start, goal, options)
    except RuntimeError:  # as where an end is in no region
        return None
    if not result.is_success():
        return None
    edges = problem.graph_of_convex_sets().GetSolutionPath(
        start.Vertices()[0], goal.Vertices()[0], result
    )
    numbers = {vertex.id(): index for index, vertex in enumerate(inner.Vertices())}
    through = [numbers[edge.v().id()] for edge in edges[:-1]]
    lengths = [_length(inner, index, result) for index in through]
    return [sets[index] for index in through], np.array(lengths)


def _length(
    inner: GcsTrajectoryOptimization.Subgraph, index: int, result: MathematicalProgramResult
) -> float:
    first, last = inner.Vertices()[index].GetSolution(result)[:6].reshape(2, 3)
    return float(np.linalg.norm(last - first))
