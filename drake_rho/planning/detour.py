"""Ways round the obstacles for a vehicle whose first linearisation (15) has no solution.

A reference that runs through a sphere asks for one side of it at one knot and for the opposite
side at the next. Here each sphere gets one side instead, a direction across the vehicle's way, and
wherever the vehicle is inside the sphere it has to be beyond the tangent plane on that side. What
comes out is outside every sphere, so it is a reference around which (15) has a solution.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.constraints import Constraint, across, boxes_of, sides_of
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.loop import plan_around, plan_with
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario, Sphere

TURNS = np.radians([0.0, 90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0])
"""Sides to try, as turns around the vehicle's way from the side on which it passes anyway."""

MOST_TRIALS = 40
"""Bound on the combinations of sides that are tried for one vehicle."""

SIZES = (1.5, 3.0, 0.75)
"""How far the free way is bent aside, in radii of the obstacle, where no side of it has a plan."""

Turns = tuple[int, ...]


def detour(scenario: Scenario, free: Plan, solver: SolverInterface | None = None) -> Plan:
    """A plan of one vehicle that goes round the obstacles.

    The sides nearest to the free way come first; then those of the obstacles that were in the way
    are turned; and at last the free way is bent aside as a whole.

    Args:
        scenario: of one vehicle.
        free: its plan without the obstacles.
        solver: a Drake solver; Clarabel if not given.

    Returns:
        A plan that meets every constraint of the scenario.

    Raises:
        InfeasibleError: none of the combinations that were tried has a plan.
        SolverError: the solvers fail numerically.
    """
    sides = [_sides(sphere, free.positions[0]) for sphere in scenario.obstacles]
    waiting: list[Turns] = [(0,) * len(sides)]
    seen = set(waiting)
    spent = Statistics()
    failures: list[InfeasibleError] = []
    while waiting and len(failures) < MOST_TRIALS:
        turns = waiting.pop(0)
        try:
            plan = plan_with(scenario, _constraints(scenario, sides, turns), solver)
        except InfeasibleError as error:
            failures.append(error)
            spent += error.statistics
            following = _following(turns, error, seen)
            seen.update(following)
            waiting = sorted([*waiting, *following], key=sum)
        else:
            return plan.with_statistics(spent + plan.statistics)
    first = failures[0]
    for reference in _bent(scenario, free, sides, first):
        try:
            plan = plan_around(scenario, reference, solver)
        except SolverError:  # so near to having none that the solvers cannot tell: try the next
            continue
        except InfeasibleError as error:
            spent += error.statistics
        else:
            return plan.with_statistics(spent + plan.statistics)
    raise InfeasibleError(first.conflicts, statistics=spent, obstacles=first.obstacles)


def _bent(
    scenario: Scenario, free: Plan, sides: Sequence[FloatArray], failure: InfeasibleError
) -> Iterator[Plan]:
    """The free way with a smooth bend towards each side of each obstacle that was in the way.

    As references they ask for no one side along the whole of an obstacle, so they can lead
    between obstacles where planes cannot. Full thrust aside for a quarter of the time, back for
    half of it and aside again ends where it began.
    """
    steps = scenario.grid.knots - 1
    quarters = 4 * np.arange(steps) // steps
    thrust = np.where((quarters == 0) | (quarters == 3), 1.0, -1.0)
    in_the_way = {int(name.split()[1]) for names in failure.obstacles.values() for name in names}
    for size, number in product(SIZES, sorted(in_the_way)):
        reach = size * scenario.obstacles[number - 1].radius
        strength = reach / (scenario.grid.duration / 4.0) ** 2
        for side in sides[number - 1]:
            bend = strength * thrust[:, None] * side
            yield Plan.from_accelerations(scenario, free.accelerations + bend)


def _sides(sphere: Sphere, way: FloatArray) -> FloatArray:
    """Directions from a sphere's centre square to the way past it, shape (len(TURNS), 3).

    Args:
        sphere: the obstacle.
        way: positions at the knots [m], shape (K, 3).
    """
    offsets = way - sphere.center
    nearest = int(np.argmin(np.linalg.norm(offsets, axis=1)))
    ahead = way[min(nearest + 1, len(way) - 1)] - way[max(nearest - 1, 0)]
    length = float(np.linalg.norm(ahead))
    ahead = ahead / length if length else np.array([1.0, 0.0, 0.0])
    first = offsets[nearest] - (offsets[nearest] @ ahead) * ahead
    distance = float(np.linalg.norm(first))
    first = first / distance if distance > sphere.tolerance else across(ahead)
    second = np.cross(ahead, first)
    sides: FloatArray = np.cos(TURNS)[:, None] * first + np.sin(TURNS)[:, None] * second
    return sides


def _constraints(scenario: Scenario, sides: Sequence[FloatArray], turns: Turns) -> list[Constraint]:
    chosen = [each[turn] for each, turn in zip(sides, turns, strict=True)]
    return boxes_of(scenario) + sides_of(scenario, chosen)


def _following(turns: Turns, error: InfeasibleError, seen: set[Turns]) -> list[Turns]:
    """One more turn for each of the obstacles that the path came up against."""
    named = {name.split()[1] for names in error.obstacles.values() for name in names}
    following = [
        tuple(turn + (index == changed) for index, turn in enumerate(turns))
        for changed in range(len(turns))
        if str(changed + 1) in named and turns[changed] + 1 < len(TURNS)
    ]
    return [each for each in following if each not in seen]
