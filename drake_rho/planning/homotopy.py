"""Ways round the obstacles for a vehicle whose first linearisation (15) has no solution.

A reference that runs through a sphere asks for one side of it at one knot and for the opposite
side at the next. Here each sphere gets one side instead, a direction across the vehicle's way, and
wherever the vehicle is inside the sphere it has to be beyond the tangent plane on that side. What
comes out is outside every sphere, so it is a reference around which (15) has a solution. The sides
are candidates for homotopy classes: each choice passes the obstacles in another way.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.cutting_planes import CuttingPlanes
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.keep_out import across, sides_of
from drake_rho.planning.options import DEFAULTS
from drake_rho.planning.subproblem import convex_constraints, plan_around
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario

TURNS = np.radians([0.0, 90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0])
"""Sides to try, as turns around the vehicle's way from the side on which it passes anyway."""

SIZES = (1.5, 3.0, 0.75)
"""How far the free way is bent aside, in radii of the obstacle, where no side of it has a plan."""

Turns = tuple[int, ...]


def way_round(
    scenario: Scenario,
    free: Plan,
    solver: SolverInterface | None = None,
    *,
    most: int = DEFAULTS.max_ways,
) -> Plan:
    """A plan of one vehicle that goes round the obstacles.

    The sides nearest to the free way come first; then those of the obstacles that were in the way
    are turned; and at last the free way is bent aside as a whole.

    Args:
        scenario: of one vehicle.
        free: its plan without the obstacles.
        solver: a Drake solver; Clarabel if not given.
        most: bound on the combinations of sides that are tried.

    Returns:
        A plan that meets every constraint of the scenario.

    Raises:
        InfeasibleError: none of the combinations that were tried has a plan.
        SolverError: the solvers fail numerically on all of them.
    """
    times = scenario.grid.times
    sides = [_sides(each, free.positions[0] - each.centers(times)) for _, each in scenario.known]
    spent = Statistics()
    met: set[int] = set()  # numbers of the obstacles that some path came up against
    failure: InfeasibleError | SolverError | None = None
    trials = Trials(len(sides), most)
    for turns in trials:
        try:
            chosen = [each[turn] for each, turn in zip(sides, turns, strict=True)]
            plan = _on_sides(scenario, free, chosen, solver)
        except SolverError as error:
            failure = failure or error
        except InfeasibleError as error:
            failure = failure if isinstance(failure, InfeasibleError) else error
            spent += error.statistics
            touched = frozenset[int]().union(*error.obstacles.values())
            trials.turn(turns, touched)
            met |= touched
        else:
            return plan.with_statistics(spent + plan.statistics)
    for reference in _bent(scenario, free, sides, sorted(met)):
        try:
            plan = plan_around(scenario, reference, solver)
        except SolverError:  # so near to having none that the solvers cannot tell: try the next
            continue
        except InfeasibleError as error:
            spent += error.statistics
        else:
            return plan.with_statistics(spent + plan.statistics)
    assert failure is not None  # noqa: S101  # at least one trial was made
    if isinstance(failure, InfeasibleError):
        failure.statistics = spent
    raise failure


class Trials:
    """Combinations of turns, the smallest turns first; each failure suggests the next.

    Args:
        obstacles: how many there are.
        most: bound on the combinations.
    """

    def __init__(self, obstacles: int, most: int) -> None:
        self._waiting: list[Turns] = [(0,) * obstacles]
        self._seen, self._left = set(self._waiting), most

    def __iter__(self) -> Iterator[Turns]:
        """One after the other."""
        while self._waiting and self._left > 0:
            self._left -= 1
            yield self._waiting.pop(0)

    def turn(self, turns: Turns, obstacles: frozenset[int]) -> None:
        """One more turn for each of some obstacles, by their numbers from 1."""
        following = {
            tuple(turn + (index == changed) for index, turn in enumerate(turns))
            for changed in range(len(turns))
            if changed + 1 in obstacles and turns[changed] + 1 < len(TURNS)
        }
        new = sorted(following - self._seen, reverse=True)  # the first obstacle's turn first
        self._seen.update(new)
        self._waiting = sorted([*self._waiting, *new], key=sum)


def _on_sides(
    scenario: Scenario, free: Plan, sides: list[FloatArray], solver: SolverInterface | None
) -> Plan:
    """The plan of least cost that passes each obstacle on a given side."""
    planes = CuttingPlanes(scenario, solver)
    planes.keep_to(convex_constraints(scenario) + sides_of(scenario, free.motion(), sides))
    return planes.plan()


def _bent(
    scenario: Scenario, free: Plan, sides: Sequence[FloatArray], in_the_way: list[int]
) -> Iterator[Plan]:
    """The free way with a smooth bend towards each side of each obstacle that was in the way.

    As references they ask for no one side along the whole of an obstacle, so they can lead
    between obstacles where planes cannot. Full thrust aside for a quarter of the time, back for
    half of it and aside again ends where it began.
    """
    steps = scenario.grid.knots - 1
    quarters = 4 * np.arange(steps) // steps
    thrust = np.where((quarters == 0) | (quarters == 3), 1.0, -1.0)
    for size, number in product(SIZES, in_the_way):
        reach = size * scenario.bodies[number - 1].shape.size
        strength = reach / (scenario.grid.duration / 4.0) ** 2
        for side in sides[number - 1]:
            bend = strength * thrust[:, None] * side
            yield Plan.from_accelerations(scenario, free.accelerations + bend)


def _sides(obstacle: Obstacle, offsets: FloatArray) -> FloatArray:
    """Directions from an obstacle's middle orthogonal to the way past it, shape (len(TURNS), 3).

    Args:
        obstacle: what is passed.
        offsets: positions at the knots from its middle [m], shape (K, 3).
    """
    nearest = int(np.argmin(np.linalg.norm(offsets, axis=1)))
    ahead = offsets[min(nearest + 1, len(offsets) - 1)] - offsets[max(nearest - 1, 0)]
    length = float(np.linalg.norm(ahead))
    ahead = ahead / length if length else np.array([1.0, 0.0, 0.0])
    first = offsets[nearest] - (offsets[nearest] @ ahead) * ahead
    distance = float(np.linalg.norm(first))
    first = first / distance if distance > obstacle.shape.tolerance else across(ahead)
    second = np.cross(ahead, first)
    sides: FloatArray = np.cos(TURNS)[:, None] * first + np.sin(TURNS)[:, None] * second
    return sides
