"""`verify`: every constraint of a scenario, judged from initial states and accelerations alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.motion.clearance import closest_approach, turning_points
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Flight, Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import TOLERANCE, Quantity, Scenario, Vehicle

_UNITS: dict[Quantity, str] = {
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s²",
    "jerk": "m/s³",
}
_LONGEST = 12
"""Violations that a printed report shows."""
AT_KNOTS, AT_ALL_TIMES = "at knots", "at all times"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Check:
    """How one vehicle stands to one constraint, at the instant where it does so worst."""

    vehicle: str
    """name"""
    constraint: str
    """name: dynamics, goal, position box, velocity box, acceleration box, jerk box, obstacle 1 …"""
    part: str = ""
    """which side of a box, or which quantity of dynamics and goal"""
    time: float
    """since the first knot [s]"""
    value: float
    """what the plan does, in `unit`"""
    limit: float
    """what the constraint allows, in `unit`"""
    excess: float
    """by how much the value is beyond the limit, in `unit`; negative on the right side of it"""
    tolerance: float
    """excess that is put down to rounding, in `unit`: `TOLERANCE` of the constraint's scale"""
    unit: str
    """SI unit of the numbers"""
    asked: bool = True
    """whether the scenario asks for it; what it does not ask for is told, not judged"""

    @property
    def holds(self) -> bool:
        """Whether the constraint is met; never with a value that is not a number."""
        return self.excess <= self.tolerance


@dataclasses.dataclass(frozen=True)
class Report:
    """What `verify` found; prints as a short table."""

    scenario: Scenario
    """what was asked"""
    checks: tuple[Check, ...]
    """the worst of each constraint for each vehicle"""

    @property
    def ok(self) -> bool:
        """Whether every constraint holds."""
        return all(check.holds for check in self.checks if check.asked)

    @property
    def violations(self) -> tuple[Check, ...]:
        """The checks that do not hold, the worst first (by excess over tolerance)."""
        broken = (check for check in self.checks if check.asked and not check.holds)
        return tuple(sorted(broken, key=_badness, reverse=True))

    def __str__(self) -> str:
        name, violations = self.scenario.name, self.violations
        if not violations:
            kinds = dict.fromkeys(_kind(check) for check in self.checks)
            tightest = [
                max((one for one in self.checks if _kind(one) == kind), key=_badness)
                for kind in kinds
            ]
            several = len(self.scenario.vehicles) > 1
            which = "; for each, the vehicle closest to it" if several else ""
            return _table(f"{name}: all constraints hold{which}", tightest)
        title = f"{name}: {len(violations)} of {len(self.checks)} checks broken"
        more = len(violations) - _LONGEST
        rest = f"\n… and {more} more" if more > 0 else ""
        return _table(title, list(violations[:_LONGEST])) + rest


def verify(flown: Plan | Flight) -> Report:
    """Judge every constraint of the scenario that was planned for.

    Positions and velocities are flown anew from the initial states and the accelerations; those
    of the plan are only compared with them ("dynamics"). Obstacles and position boxes are examined
    at the knots and, exactly, at every instant; a scenario that asks for the knots only
    (`between_knots`) is judged by these, and the other is told beside it.

    The arithmetic is that of double precision. A position at the knots is a sum of 2K terms, none
    larger than the largest of the motion's coordinates and its length scale, so with the unit
    roundoff u = 1.1e-16 it is within 4 K u of that; an instant adds a few roundings more. For the
    paper's data that is below 1e-9 m, a millionth of the least tolerance.

    Args:
        flown: a plan, or a flight, of which the whole as flown is judged.

    Returns:
        A report; `report.ok` says whether all holds.
    """
    plan = flown.plan if isinstance(flown, Flight) else flown
    checks: list[Check] = []
    for index, vehicle in enumerate(plan.scenario.vehicles):
        step = plan.scenario.grid.step
        motion = Motion.from_start(vehicle.start, plan.accelerations[index], step)
        checks += _check_dynamics(plan, index, motion)
        checks += _check_goal(plan.scenario, vehicle, motion)
        checks += _check_boxes(plan.scenario, vehicle, motion)
        checks += _check_obstacles(plan.scenario, vehicle, motion)
    return Report(plan.scenario, tuple(checks))


def _check_dynamics(plan: Plan, index: int, motion: Motion) -> Iterator[Check]:
    """(1)-(2): the plan's own positions and velocities are those that are flown."""
    vehicle = plan.scenario.vehicles[index]
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", plan.positions[index], motion.positions),
        ("velocity", plan.velocities[index], motion.velocities),
    )
    for quantity, own, flown in pairs:
        differences = np.linalg.norm(own - flown, axis=1)
        k = int(np.argmax(differences))
        yield _difference(
            plan.scenario, vehicle, "dynamics", quantity, plan.times[k], differences[k]
        )


def _check_goal(scenario: Scenario, vehicle: Vehicle, motion: Motion) -> Iterator[Check]:
    """(3): the last knot is the goal. The first is the start by construction."""
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", motion.positions[-1], vehicle.goal.position),
        ("velocity", motion.velocities[-1], vehicle.goal.velocity),
    )
    for quantity, reached, wanted in pairs:
        missed = np.linalg.norm(reached - wanted)
        yield _difference(scenario, vehicle, "goal", quantity, scenario.grid.duration, missed)


def _difference(
    scenario: Scenario,
    vehicle: Vehicle,
    constraint: str,
    quantity: Quantity,
    time: float,
    value: np.floating,
) -> Check:
    """A check of something that should be zero."""
    return Check(
        vehicle=vehicle.name,
        constraint=constraint,
        part=quantity,
        time=float(time),
        value=float(value),
        limit=0.0,
        excess=float(value),
        tolerance=TOLERANCE * scenario.scale(vehicle, quantity),
        unit=_UNITS[quantity],
    )


def _check_boxes(scenario: Scenario, vehicle: Vehicle, motion: Motion) -> Iterator[Check]:
    """(4) to (7)."""
    times = scenario.grid.times
    values: dict[Quantity, FloatArray] = {
        "position": motion.positions,
        "velocity": motion.velocities,
        "acceleration": motion.accelerations,
        "jerk": motion.at("jerk", times[:-1]),
    }
    first = {"jerk": 1 if vehicle.start.acceleration is None else 0}  # free of a jerk limit
    for quantity, flown in values.items():
        skipped = first.get(quantity, 0)
        yield from _check_box(
            scenario, vehicle, quantity, AT_KNOTS, times[skipped:], flown[skipped:]
        )
    turns, positions = turning_points(motion)
    every = np.concatenate([motion.positions, positions])
    instants = np.concatenate([np.repeat(times[:, None], 3, axis=1), turns])
    yield from _check_box(scenario, vehicle, "position", AT_ALL_TIMES, instants, every)


def _check_box(
    scenario: Scenario,
    vehicle: Vehicle,
    quantity: Quantity,
    when: str,
    times: FloatArray,
    values: FloatArray,
) -> Iterator[Check]:
    """One box, if the vehicle has it; times of shape (M,) or, for each axis its own, (M, 3)."""
    box = getattr(scenario.limits_of(vehicle), quantity)
    if box is None or len(values) == 0:
        return
    tolerances = box.tolerance(scenario.scale(vehicle, quantity))
    excess = np.stack([box.lower - values, values - box.upper])
    side, k, axis = np.unravel_index(np.argmax(excess / tolerances), excess.shape)
    where = f"{'xyz'[axis]} {('lower', 'upper')[side]}"
    yield Check(
        vehicle=vehicle.name,
        constraint=f"{quantity} box",
        part=f"{where}{' ' + when if quantity == 'position' else ''}",
        time=float(times[k, axis] if times.ndim == 2 else times[k]),
        value=float(values[k, axis]),
        limit=float((box.lower, box.upper)[side][axis]),
        excess=float(excess[side, k, axis]),
        tolerance=float(tolerances[axis]),
        unit=_UNITS[quantity],
        asked=when == AT_KNOTS or scenario.between_knots,
    )


def _check_obstacles(scenario: Scenario, vehicle: Vehicle, motion: Motion) -> Iterator[Check]:
    """(8), at the knots and at every instant."""
    for number, sphere in enumerate(scenario.obstacles, start=1):
        distances = np.linalg.norm(motion.positions - sphere.center, axis=1)
        k = int(np.argmin(distances))
        knot = (scenario.grid.times[k], distances[k])
        nearest = closest_approach(motion, sphere.center).nearest()
        for part, (time, distance) in ((AT_KNOTS, knot), (AT_ALL_TIMES, nearest)):
            yield Check(
                vehicle=vehicle.name,
                constraint=f"obstacle {number}",
                part=part,
                time=float(time),
                value=float(distance),
                limit=sphere.radius,
                excess=sphere.radius - float(distance),
                tolerance=sphere.tolerance,
                unit="m",
                asked=part == AT_KNOTS or scenario.between_knots,
            )


def _kind(check: Check) -> tuple[str, bool]:
    """What is told in one line of a table: a constraint, at the knots or at every instant."""
    return check.constraint, check.part.endswith(AT_ALL_TIMES)


def _badness(check: Check) -> float:
    """For sorting: how many tolerances beyond the limit; what is no number comes first."""
    return np.inf if np.isnan(check.excess) else check.excess / check.tolerance


def _table(title: str, rows: list[Check]) -> str:
    form = "{:<12} {:<35} {:>9} {:>12} {:>12} {:>11} {}"
    lines = [
        title,
        form.format("vehicle", "constraint", "time [s]", "value", "limit", "excess", ""),
    ]
    lines += [
        form.format(
            check.vehicle,
            f"{check.constraint} {check.part}",
            f"{check.time:.6g}",
            f"{check.value:.6g}",
            f"{check.limit:.6g}",
            f"{check.excess:+.2e}",
            check.unit if check.asked else f"{check.unit}, not asked for",
        )
        for check in rows
    ]
    return "\n".join(line.rstrip() for line in lines)
