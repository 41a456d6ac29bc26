"""Fast verification of a plan, for every window of a receding horizon.

The verdict equals that of `verify`, with the information available when the plan begins. What the
quick conditions (`drake_rho.verification.quick_bounds`) do not decide is verified in full.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.verification.averages import averaged
from drake_rho.verification.check import Check, Column
from drake_rho.verification.checkers import Checker, checkers, obstacle_checker, refuse_unknown
from drake_rho.verification.quick_bounds import QuickBounds
from drake_rho.verification.rest import check_rest
from drake_rho.verification.states import check_planned
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import Tubes


def first_violation(plan: Plan, obstacles: Iterable[int] | None = None) -> Check | None:
    """Return the worst violation of the first violated constraint; None if the plan is feasible.

    Args:
        plan: plan to verify with its error tube and the obstacles known when it begins.
        obstacles: numbers of obstacles; if given, only these are verified.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # values that overflow become NaN or inf
        refuse_unknown(plan.scenario)
        motion = Motion.from_starts(
            plan.scenario.fleet, plan.accelerations, plan.scenario.grid.step
        )
        stepwise = PiecewiseTrajectory.of(plan.scenario, motion, Tubes.of(plan))
        trajectory = averaged(stepwise)
        bounds = QuickBounds.of(trajectory)
        for each in _checkers(plan, stepwise, obstacles):
            if trajectory.is_smooth or not each.surely_holds(bounds):
                for column in each.check(trajectory):
                    if not column.holds:
                        return _worst(column, plan.scenario)
    return None


def _checkers(
    plan: Plan, stepwise: PiecewiseTrajectory, obstacles: Iterable[int] | None
) -> list[Checker]:
    """Return the checkers of a plan, or only those of the given obstacles.

    Args:
        plan: the plan.
        stepwise: its trajectory before any smoothing.
        obstacles: numbers of obstacles, if only these are verified.

    Returns:
        Checkers, with those of obstacles last: they take the longest.
    """
    if obstacles is not None:
        return [obstacle_checker(number) for number in obstacles]
    states = Checker(
        ("dynamics", "goals"),
        lambda _: check_planned(plan, stepwise),
        lambda bounds: _states_are_right(plan, bounds.trajectory),
    )
    holding = Checker(
        ("holding",),
        lambda trajectory: check_rest(
            trajectory.scenario, trajectory.positions[:, -1], near_only=True
        ),
    )
    known = checkers(number for number, _ in plan.scenario.known)
    return [states, *sorted([*known, holding], key=_is_of_obstacle)]


def _is_of_obstacle(checker: Checker) -> bool:
    return checker.kinds == ("obstacles",)


def _worst(column: Column, scenario: Scenario) -> Check:
    """Return the violated check with the largest excess."""
    names = [vehicle.name for vehicle in scenario.vehicles]
    checks = [each for each in column.checks(names) if each is not None and not each.holds]
    return max(checks, key=lambda each: np.nan_to_num(each.excess, nan=np.inf))


def _states_are_right(plan: Plan, trajectory: PiecewiseTrajectory) -> bool:
    """Return whether the plan's states certainly obey the dynamics and end at the goals."""
    fleet = trajectory.scenario.fleet
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", plan.positions, trajectory.positions),
        ("velocity", plan.velocities, trajectory.velocities),
    )
    for quantity, own, flown in pairs:
        missed = np.abs(fleet.missed(quantity, flown[:, -1])).max(axis=1)
        off = np.maximum(np.abs(own - flown).max(axis=(1, 2)), missed)
        if not (off <= TOLERANCE / np.sqrt(3.0) * fleet.scale(quantity)).all():
            return False
    return True
