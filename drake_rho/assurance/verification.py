"""`verify`: every constraint of a scenario, judged from initial states and accelerations alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import TOLERANCE, Box, Scenario, Vehicle


@dataclasses.dataclass(frozen=True)
class Check:
    """How one vehicle stands to one constraint, at the instant where it does so worst."""

    vehicle: str
    """name"""
    constraint: str
    """name, with the axis and side for a box"""
    time: float
    """since the first knot [s]"""
    value: float
    """what the plan does, in `unit`"""
    limit: float
    """what the constraint allows, in `unit`"""
    excess: float
    """by how much the value is beyond the limit, in `unit`; negative on the right side of it"""
    slack: float
    """excess that is put down to rounding, in `unit`: `TOLERANCE` of the constraint's scale"""
    unit: str
    """SI unit of the numbers"""

    @property
    def holds(self) -> bool:
        """Whether the constraint is met; never with a value that is not a number."""
        return self.excess <= self.slack

    @property
    def kind(self) -> str:
        """The constraint's name without axis and side."""
        return self.constraint.split(",")[0]


@dataclasses.dataclass(frozen=True)
class Report:
    """What `verify` found; prints as a short table."""

    scenario: Scenario
    """what was asked"""
    checks: tuple[Check, ...]
    """one for each vehicle and constraint"""

    @property
    def ok(self) -> bool:
        """Whether every constraint holds."""
        return all(check.holds for check in self.checks)

    @property
    def violations(self) -> tuple[Check, ...]:
        """The checks that do not hold, the worst first (by excess over slack)."""
        broken = (check for check in self.checks if not check.holds)
        return tuple(sorted(broken, key=_badness, reverse=True))

    def __str__(self) -> str:
        name, vehicles = self.scenario.name, len(self.scenario.vehicles)
        if self.ok:
            kinds = dict.fromkeys(check.kind for check in self.checks)
            rows = [
                max((check for check in self.checks if check.kind == kind), key=_badness)
                for kind in kinds
            ]
            title = f"{name}: all constraints hold; the tightest of {vehicles} vehicles for each"
            return _table(title, rows)
        violations = self.violations
        title = f"{name}: {len(violations)} of {len(self.checks)} checks broken"
        more = len(violations) - _LONGEST
        rest = f"\n… and {more} more" if more > 0 else ""
        return _table(title, list(violations[:_LONGEST])) + rest


_LONGEST = 12
"""Violations that a printed report shows."""


def verify(plan: Plan) -> Report:
    """Judge every constraint of the plan's scenario.

    Positions and velocities are flown anew from the initial states and the accelerations; those
    of the plan are only compared with them ("dynamics"). Constraints are judged at the knots.

    Args:
        plan: a plan, or what was flown (`flight.plan`).

    Returns:
        A report; `report.ok` says whether all holds.
    """
    checks: list[Check] = []
    for index, vehicle in enumerate(plan.scenario.vehicles):
        a = plan.accelerations[index]
        motion = Motion.from_start(vehicle.start, a, plan.scenario.grid.step)
        checks += _check_dynamics(plan, index, motion)
        checks += _check_goal(plan.scenario, vehicle, motion)
        checks += _check_boxes(plan.scenario, vehicle, motion)
        checks += _check_obstacles(plan.scenario, vehicle, motion)
    return Report(plan.scenario, tuple(checks))


def _check_dynamics(plan: Plan, index: int, motion: Motion) -> Iterator[Check]:
    """(1)-(2): the plan's own positions and velocities are those that are flown."""
    vehicle, T = plan.scenario.vehicles[index], plan.scenario.grid.duration
    reach = vehicle.reach(T)
    for quantity, mine, flown, slack, unit in (
        ("position", plan.positions[index], motion.positions, TOLERANCE * reach, "m"),
        ("velocity", plan.velocities[index], motion.velocities, TOLERANCE * reach / T, "m/s"),
    ):
        differences = np.linalg.norm(mine - flown, axis=1)
        k = int(np.argmax(differences))
        value = float(differences[k])
        when = float(plan.times[k])
        yield Check(vehicle.name, f"dynamics, {quantity}", when, value, 0.0, value, slack, unit)


def _check_goal(scenario: Scenario, vehicle: Vehicle, motion: Motion) -> Iterator[Check]:
    """(3): the last knot is the goal. The first is the start by construction."""
    T = scenario.grid.duration
    reach = vehicle.reach(T)
    for quantity, reached, wanted, slack, unit in (
        ("position", motion.positions[-1], vehicle.goal.position, TOLERANCE * reach, "m"),
        ("velocity", motion.velocities[-1], vehicle.goal.velocity, TOLERANCE * reach / T, "m/s"),
    ):
        value = float(np.linalg.norm(reached - wanted))
        yield Check(vehicle.name, f"goal, {quantity}", T, value, 0.0, value, slack, unit)


def _check_boxes(scenario: Scenario, vehicle: Vehicle, motion: Motion) -> Iterator[Check]:
    """(4) to (7)."""
    limits, times = scenario.limits_of(vehicle), scenario.grid.times
    jerk = motion.at("jerk", times[:-1])
    for quantity, box, values, unit in (
        ("position", limits.position, motion.positions, "m"),
        ("velocity", limits.velocity, motion.velocities, "m/s"),
        ("acceleration", limits.acceleration, motion.accelerations, "m/s²"),
        ("jerk", limits.jerk, jerk, "m/s³"),
    ):
        if box is not None:
            yield _check_box(vehicle.name, f"{quantity} box", box, values, times, unit)


def _check_box(
    vehicle: str, name: str, box: Box, values: FloatArray, times: FloatArray, unit: str
) -> Check:
    excess = np.stack([box.lower - values, values - box.upper])
    side, k, axis = np.unravel_index(np.argmax(excess), excess.shape)
    return Check(
        vehicle,
        f"{name}, {'xyz'[axis]} {('lower', 'upper')[side]}",
        float(times[k]),
        float(values[k, axis]),
        float((box.lower, box.upper)[side][axis]),
        float(excess[side, k, axis]),
        box.slack,
        unit,
    )


def _check_obstacles(scenario: Scenario, vehicle: Vehicle, motion: Motion) -> Iterator[Check]:
    """(8) at the knots."""
    for number, sphere in enumerate(scenario.obstacles, start=1):
        distances = np.linalg.norm(motion.positions - sphere.center, axis=1)
        k = int(np.argmin(distances))
        distance = float(distances[k])
        yield Check(
            vehicle.name,
            f"obstacle {number}",
            float(scenario.grid.times[k]),
            distance,
            sphere.radius,
            sphere.radius - distance,
            sphere.slack,
            "m",
        )


def _badness(check: Check) -> float:
    """For sorting: how many slacks beyond the limit; a value that is no number comes first."""
    return np.inf if np.isnan(check.excess) else check.excess / check.slack


def _table(title: str, rows: list[Check]) -> str:
    form = "{:<12} {:<24} {:>9} {:>12} {:>12} {:>11} {}"
    lines = [
        title,
        form.format("vehicle", "constraint", "time [s]", "value", "limit", "excess", ""),
    ]
    lines += [
        form.format(
            check.vehicle,
            check.constraint,
            f"{check.time:.6g}",
            f"{check.value:.6g}",
            f"{check.limit:.6g}",
            f"{check.excess:+.2e}",
            check.unit,
        )
        for check in rows
    ]
    return "\n".join(line.rstrip() for line in lines)
