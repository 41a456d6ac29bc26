"""Drake's graphs of convex sets: `GcsTrajectoryOptimization` through regions grown by IRIS.

The regions are polyhedra free of the shapes grown by the vehicle's radius. The graph gives the
shortest path through them; then the curve of least index in the regions of that path is sought, a
piece for each, which lasts as long as the path is long in it.
"""

from __future__ import annotations

import dataclasses
import logging
from math import comb

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
from pydrake.solvers import ClarabelSolver, MathematicalProgram, MathematicalProgramResult
from scipy.interpolate import BPoly

import drake_rho as rho
from benchmarks.field import Field, field_of
from drake_rho.scenario.fields import FloatArray

ORDER = 5
"""Of the Bézier curve of every piece."""

REGIONS = 15, 30
"""As many at least; and at most, if start and goal are not connected through fewer."""

SEED_RADIUS = 0.2
"""Of the ball that IRIS begins with [m]. Clarabel fails with its default, which is much smaller."""

INSET = 1e-3
"""Of the way to the middle of the room by which seeds of the ends are moved off the walls."""

ROUNDED = 5
"""Paths that are tried after the relaxation."""

LEAST_SHARES = (0.02, 0.05, 0.1)
"""Of the path's length that each piece counts as at least, for the time it lasts: one after another
is tried, and the curve of the least index kept."""


@dataclasses.dataclass(frozen=True)
class Curve:
    """A piecewise polynomial motion."""

    durations: FloatArray
    """of the pieces [s], shape (P,)"""
    points: FloatArray
    """control points of the pieces [m], shape (P, ORDER + 1, 3)"""

    def at(self, times: FloatArray, derivative: int = 0) -> FloatArray:
        """Positions [m] or a derivative of them by time, shape (M, 3)."""
        ends = np.concatenate([[0.0], np.cumsum(self.durations)])
        curve = BPoly(np.moveaxis(self.points, 1, 0), ends)
        found: FloatArray = (curve.derivative(derivative) if derivative else curve)(times)
        return found

    def cost(self, step: float) -> float:
        """The integral of the squared acceleration over `step` [s]: the index f [m²/s⁴]."""
        pieces = zip(self.points, self.durations, strict=True)
        bends = [(_derivation(2) @ points, duration) for points, duration in pieces]
        squares = [np.sum(bend * (_gram() @ bend)) / duration**3 for bend, duration in bends]
        return float(sum(squares)) / step


def solve(scenario: rho.Scenario, rng: np.random.Generator) -> Curve | None:
    """A curve for a scenario of one vehicle, from rest to rest, among spheres and boxes at rest.

    Its limits are kept where there is such a curve in the regions of the path, else not.

    Args:
        scenario: what is asked.
        rng: for the seeds of the regions.

    Returns:
        None if no path was found.
    """
    logging.getLogger("drake").setLevel(logging.WARNING)  # it tells of every path it rounds
    field = field_of(scenario)
    found = _path(field, regions(field, rng))
    if found is None:
        return None
    through, lengths = found
    for limits in ((field.velocity, field.acceleration), (None, None)):
        curves = [
            _curve(field, through, _durations(field, lengths, share), limits)
            for share in LEAST_SHARES
        ]
        kept = [curve for curve in curves if curve is not None]
        if kept:
            return min(kept, key=lambda curve: curve.cost(field.step))
    return None


def _durations(field: Field, lengths: FloatArray, share: float) -> FloatArray:
    """How long the pieces last, together as long as the flight [s], shape (P,)."""
    at_least = np.maximum(lengths, share * lengths.sum())
    durations: FloatArray = at_least * field.duration / at_least.sum()
    return durations


def regions(field: Field, rng: np.random.Generator) -> list[HPolyhedron]:
    """Polyhedra free of the grown shapes, around the ends and around points that are not in any."""
    room, ends = field.room, [field.start, field.goal]
    domain = HPolyhedron.MakeBox(room.lower, room.upper)
    shapes = [_grown(shape, field.radius) for shape in field.shapes]
    seeds = [end + INSET * (room.center - end) for end in ends]
    found: list[HPolyhedron] = []
    least, most = REGIONS
    for _ in range(100 * most):
        seed = seeds.pop() if seeds else rng.uniform(room.lower, room.upper)
        if any(each.PointInSet(seed) for each in (*shapes, *found[2:])):
            continue
        options = IrisOptions()
        options.require_sample_point_is_contained = True
        options.starting_ellipse = Hyperellipsoid.MakeHypersphere(SEED_RADIUS, seed)
        try:
            found.append(Iris(shapes, seed, domain, options).ReduceInequalities())
        except RuntimeError:  # where Clarabel fails
            continue
        if len(found) >= most or (len(found) >= least and _connected(found, ends)):
            break
    return found


def _grown(shape: rho.Sphere | rho.Box, radius: float) -> ConvexSet:
    """Where the vehicle's middle may not be."""
    if isinstance(shape, rho.Sphere):
        return Hyperellipsoid.MakeHypersphere(shape.radius + radius, shape.center)
    ball = Hyperellipsoid.MakeHypersphere(radius, np.zeros(3))
    return MinkowskiSum(Hyperrectangle(shape.lower, shape.upper), ball)


def _connected(sets: list[HPolyhedron], ends: list[FloatArray]) -> bool:
    """Whether a chain of overlapping sets leads from one end to the other."""
    reached = [index for index, each in enumerate(sets) if each.PointInSet(ends[0], 1e-9)]
    rest = [index for index in range(len(sets)) if index not in reached]
    for index in reached:  # which grows
        near = [other for other in rest if sets[index].IntersectsWith(sets[other])]
        reached += near
        rest = [other for other in rest if other not in near]
    return any(sets[index].PointInSet(ends[1], 1e-9) for index in reached)


def _path(field: Field, sets: list[HPolyhedron]) -> tuple[list[HPolyhedron], FloatArray] | None:
    """The regions of the shortest path, in their order, and its lengths in them [m], shape (P,)."""
    problem = GcsTrajectoryOptimization(3)
    inner = problem.AddRegions(sets, 1, h_min=0.0, h_max=1.0)
    start = problem.AddRegions([Point(field.start)], 0)
    goal = problem.AddRegions([Point(field.goal)], 0)
    problem.AddEdges(start, inner)
    problem.AddEdges(inner, goal)
    problem.AddPathLengthCost()
    options = GraphOfConvexSetsOptions()
    options.convex_relaxation = True
    options.max_rounded_paths = ROUNDED
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


def _curve(
    field: Field,
    through: list[HPolyhedron],
    durations: FloatArray,
    limits: tuple[rho.Box | None, rho.Box | None],
) -> Curve | None:
    """The curve of least index that is in the regions, one after another, and keeps the limits."""
    program, count = MathematicalProgram(), ORDER + 1
    points = [program.NewContinuousVariables(count, 3) for _ in through]
    for piece, region, duration in zip(points, through, durations, strict=True):
        for point in piece:
            below = np.full(len(region.b()), -np.inf)
            program.AddLinearConstraint(region.A(), below, region.b(), point)
        for order, box in enumerate(limits, start=1):
            if box is not None:
                _keep_in(program, piece, order, duration, box)
        bend = _derivation(2)
        weight = 2.0 / (duration**3 * field.step) * bend.T @ _gram() @ bend
        for axis in piece.T:
            program.AddQuadraticCost(weight, np.zeros(count), axis, is_convex=True)
    _join(program, points, durations)
    for piece, end in ((points[0][:2], field.start), (points[-1][-2:], field.goal)):
        for point in piece:  # two equal control points: at rest
            program.AddLinearEqualityConstraint(np.eye(3), end, point)
    result = ClarabelSolver().Solve(program)
    if not result.is_success():
        return None
    return Curve(durations, np.array([result.GetSolution(piece) for piece in points]))


def _keep_in(
    program: MathematicalProgram, piece: np.ndarray, order: int, duration: float, box: rho.Box
) -> None:
    """The control points of a derivative of a piece in a box, and so all of it."""
    derived = _derivation(order) / duration**order
    ones = np.ones(len(derived))
    for axis, least, most in zip(piece.T, box.lower, box.upper, strict=True):
        program.AddLinearConstraint(derived, least * ones, most * ones, axis)


def _join(program: MathematicalProgram, points: list[np.ndarray], durations: FloatArray) -> None:
    """Position and velocity of each piece go on in the next."""
    for i in range(len(points) - 1):
        first, second = 1.0 / durations[i], 1.0 / durations[i + 1]
        rows = np.array([[0.0, 1.0, -1.0, 0.0], [-first, first, second, -second]])
        for axis in range(3):
            joined = np.concatenate([points[i][-2:, axis], points[i + 1][:2, axis]])
            program.AddLinearEqualityConstraint(rows, np.zeros(2), joined)


def _derivation(order: int) -> FloatArray:
    """From control points of a piece that lasts 1 s to those of its derivative."""
    matrix = np.eye(ORDER + 1)
    for degree in range(ORDER, ORDER - order, -1):
        matrix = degree * np.diff(matrix, axis=0)
    return matrix


def _gram() -> FloatArray:
    """Integrals over [0, 1] of the products of the Bernstein polynomials of degree ORDER - 2."""
    n = ORDER - 2
    return np.array(
        [
            [comb(n, i) * comb(n, j) / (comb(2 * n, i + j) * (2 * n + 1)) for j in range(n + 1)]
            for i in range(n + 1)
        ]
    )
