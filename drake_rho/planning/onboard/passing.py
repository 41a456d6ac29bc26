"""Planner of windows among vehicles in motion: the cheapest of a few sides on which to pass.

A window is one convex program around a motion, which decides on the side of every obstacle. A
program each is solved around the motion without obstacles, around that motion bent to the right and
to the left, and around the plan in force. Vehicles that meet head-on all bend to their right.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.programs.backend import Solver
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

_BENDS = (1.0, -1.0)
"""Sides to which a motion is bent: right, then left."""

_GOOD = 1.5
"""Largest cost of a plan for which no other side is tried, in that without obstacles."""

_AMPLITUDES = 2.0
"""Largest displacement of a bent motion, in the required distance from the widest obstacle."""

_WIDEST = 10.0
"""Largest such distance that counts, in lengths of the window's motion."""


def plan_past(scenario: Scenario, *, reference: Plan | None, solver: Solver | None) -> Plan:
    """Return the cheapest plan of a window that is found around a few motions.

    Args:
        scenario: of one vehicle.
        reference: rest of the plan in force, if any.
        solver: of the programs.

    Raises:
        InfeasibleError: none is found.
        OutOfTimeError: the time was over before any was found.
        SolverError: the solvers fail numerically, whatever the motion.
    """
    free = plan_convex(scenario.derived(obstacles=(), fleet=scenario.fleet), solver=solver)
    found, spent, failure = list[Plan](), free.statistics, None
    for each in _references(scenario, free, reference):
        try:
            plan = plan_convex(scenario, reference=each, solver=solver)
        except (InfeasibleError, SolverError) as error:
            spent, failure = spent + error.statistics, failure or error
            continue
        except OutOfTimeError:
            if found:
                break
            raise
        found.append(plan)
        spent += plan.statistics
        if plan.cost <= _GOOD * free.cost:
            break
    if not found:
        assert failure is not None  # noqa: S101  # there is always a motion
        raise failure.replaced(statistics=spent)
    return min(found, key=lambda plan: plan.cost).with_statistics(spent)


def _references(scenario: Scenario, free: Plan, remaining: Plan | None) -> Iterator[Plan]:
    """Yield the motions around which a window is planned."""
    yield free
    side = _right(free)
    required = [float(np.max(body.shape.extent)) for _, body in scenario.avoided]
    widest = max((each for each in required if np.isfinite(each)), default=0.0)
    size = _AMPLITUDES * min(widest + float(scenario.fleet.radii[0]), _WIDEST)
    for bend in _BENDS:
        yield _bent(scenario, free, bend * size * side)
    if remaining is not None:
        yield remaining


def _right(plan: Plan) -> FloatArray:
    """Return the horizontal direction to the right of a motion, shape (3,)."""
    along = plan.positions[0, -1] - plan.positions[0, 0]
    across = np.array([along[1], -along[0], 0.0])
    length = float(np.linalg.norm(across))
    return across / length if length > 1e-9 * float(np.linalg.norm(along)) else np.eye(3)[0]


def _bent(scenario: Scenario, plan: Plan, by: FloatArray) -> Plan:
    """Return a motion displaced in its middle by a vector (3,) [m], with the same ends.

    The displacement is sin²(pi t / T): it begins and ends at rest.
    """
    steps, duration = plan.accelerations.shape[1], scenario.grid.duration
    phase = 2.0 * np.pi * (np.arange(steps) + 0.5) / steps
    more = 2.0 * (np.pi / duration) ** 2 * np.cos(phase)[:, None] * by
    return Plan.from_accelerations(scenario, plan.accelerations + more)
