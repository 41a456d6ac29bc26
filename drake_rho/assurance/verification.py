"""`verify`: every constraint of a scenario, judged from initial states and accelerations alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from drake_rho.motion.clearance import closest_approach, turning_points
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.pairs import nearest
from drake_rho.motion.plan import Flight, Plan
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import TOLERANCE, Quantity, Scenario

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
    of the plan are only compared with them ("dynamics"). Obstacles, separation and position boxes
    are examined at the knots and, exactly, at every instant; a scenario that asks for the knots
    only (`between_knots`) is judged by these, and the other is told beside it.

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
    scenario, fleet = plan.scenario, plan.scenario.fleet
    motion = Motion.from_starts(fleet, plan.accelerations, scenario.grid.step)
    columns = [
        *_check_dynamics(plan, motion),
        *_check_goal(scenario, motion),
        *_check_boxes(scenario, motion),
        *_check_obstacles(scenario, motion),
        *_check_separation(scenario, motion),
    ]
    names = [vehicle.name for vehicle in scenario.vehicles]
    by_vehicle = zip(*(column.checks(names) for column in columns), strict=True)
    checks = (check for checks in by_vehicle for check in checks if check is not None)
    return Report(scenario, tuple(checks))


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Column:
    """One check of every vehicle: what `Check` has, as arrays of shape (N,)."""

    constraint: str
    parts: Sequence[str]
    times: FloatArray
    values: FloatArray
    limits: FloatArray
    excess: FloatArray
    tolerances: FloatArray
    unit: str
    asked: bool = True
    due: BoolArray | None = None  # which vehicles have this constraint; None for all

    def checks(self, names: Sequence[str]) -> Iterator[Check | None]:
        """The check of each vehicle; None where it does not have the constraint."""
        numbers = (self.times, self.values, self.limits, self.excess, self.tolerances)
        rows = zip(*(each.tolist() for each in numbers), strict=True)
        due = [True] * len(names) if self.due is None else self.due.tolist()
        for has_it, name, part, (time, value, limit, excess, tolerance) in zip(
            due, names, self.parts, rows, strict=True
        ):
            if not has_it:
                yield None
                continue
            yield Check(
                vehicle=name,
                constraint=self.constraint,
                part=part,
                time=time,
                value=value,
                limit=limit,
                excess=excess,
                tolerance=tolerance,
                unit=self.unit,
                asked=self.asked,
            )


def _check_dynamics(plan: Plan, motion: Motion) -> Iterator[_Column]:
    """(1)-(2): the plan's own positions and velocities are those that are flown."""
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", plan.positions, motion.positions),
        ("velocity", plan.velocities, motion.velocities),
    )
    for quantity, own, flown in pairs:
        differences = np.linalg.norm(own - flown, axis=2)
        k = np.argmax(differences, axis=1)
        largest = _pick(differences, k)
        yield _difference(plan.scenario, "dynamics", quantity, plan.times[k], largest)


def _check_goal(scenario: Scenario, motion: Motion) -> Iterator[_Column]:
    """(3): the last knot is the goal. The first is the start by construction."""
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", motion.positions[:, -1], scenario.fleet.goal_positions),
        ("velocity", motion.velocities[:, -1], scenario.fleet.goal_velocities),
    )
    for quantity, reached, wanted in pairs:
        missed = np.linalg.norm(reached - wanted, axis=1)
        times = np.full(len(missed), scenario.grid.duration)
        yield _difference(scenario, "goal", quantity, times, missed)


def _difference(
    scenario: Scenario, constraint: str, quantity: Quantity, times: FloatArray, values: FloatArray
) -> _Column:
    """Checks of something that should be zero."""
    return _Column(
        constraint=constraint,
        parts=[quantity] * len(values),
        times=times,
        values=values,
        limits=np.zeros(len(values)),
        excess=values,
        tolerances=TOLERANCE * scenario.fleet.scale(quantity),
        unit=_UNITS[quantity],
    )


def _check_boxes(scenario: Scenario, motion: Motion) -> Iterator[_Column]:
    """(4) to (7)."""
    times = scenario.grid.times
    values: dict[Quantity, FloatArray] = {
        "position": motion.positions,
        "velocity": motion.velocities,
        "acceleration": motion.accelerations,
        "jerk": motion.jerks(),
    }
    for quantity, flown in values.items():
        yield from _check_box(scenario, quantity, AT_KNOTS, times[: flown.shape[1]], flown)
    turns, positions = turning_points(motion)
    every = np.concatenate([motion.positions, positions], axis=1)
    knots = np.broadcast_to(times[:, None], motion.positions.shape)
    when = np.concatenate([knots, turns], axis=1)
    yield from _check_box(scenario, "position", AT_ALL_TIMES, when, every)


def _check_box(
    scenario: Scenario, quantity: Quantity, when: str, times: FloatArray, values: FloatArray
) -> Iterator[_Column]:
    """One box: the side that is most exceeded, or closest to it, of each vehicle.

    Args:
        scenario: what is asked.
        quantity: what the box bounds.
        when: the instants that are looked at, in words.
        times: these instants [s], shape (M,) or, each value its own, (N, M, 3).
        values: of every vehicle, shape (N, M, 3).
    """
    bounds = scenario.fleet.bounds(quantity)
    if bounds is None:
        return
    excess = np.stack([bounds.lower[:, None] - values, values - bounds.upper[:, None]], axis=1)
    due = np.isfinite(bounds.lower[:, 0])
    if quantity == "jerk":  # no limit on the first, where no acceleration is given before it
        free = np.isnan(scenario.fleet.accelerations_before[:, 0])
        excess[free, :, 0] = -np.inf
        due &= ~free | (values.shape[1] > 1)
    badness = np.where(np.isnan(excess), np.inf, excess / bounds.tolerances[:, None, None])
    worst = np.argmax(badness.reshape(len(values), -1), axis=1)
    side, k, axis = np.unravel_index(worst, excess.shape[1:])
    i = np.arange(len(values))
    yield _Column(
        constraint=f"{quantity} box",
        parts=[
            f"{'xyz'[x]} {('lower', 'upper')[s]}{' ' + when if quantity == 'position' else ''}"
            for s, x in zip(side, axis, strict=True)
        ],
        times=times[i, k, axis] if times.ndim == 3 else times[k],
        values=values[i, k, axis],
        limits=np.where(side == 0, bounds.lower[i, axis], bounds.upper[i, axis]),
        excess=excess[i, side, k, axis],
        tolerances=bounds.tolerances[i, axis],
        unit=_UNITS[quantity],
        asked=when == AT_KNOTS or scenario.between_knots,
        due=due,
    )


def _check_obstacles(scenario: Scenario, motion: Motion) -> Iterator[_Column]:
    """(8), at the knots and at every instant."""
    for number, sphere in enumerate(scenario.obstacles, start=1):
        distances = np.linalg.norm(motion.positions - sphere.center, axis=2)
        k = np.argmin(distances, axis=1)
        knots = (scenario.grid.times[k], _pick(distances, k))
        nearest = closest_approach(motion, sphere.center).nearest()
        for part, (times, values) in ((AT_KNOTS, knots), (AT_ALL_TIMES, nearest)):
            yield _Column(
                constraint=f"obstacle {number}",
                parts=[part] * len(values),
                times=times,
                values=values,
                limits=np.full(len(values), sphere.radius),
                excess=sphere.radius - values,
                tolerances=np.full(len(values), sphere.tolerance),
                unit="m",
                asked=part == AT_KNOTS or scenario.between_knots,
            )


def _check_separation(scenario: Scenario, motion: Motion) -> Iterator[_Column]:
    """Every vehicle's distance from the one that comes closest, at the knots and at every instant.

    The distance is that of the separation, with z divided by its downwash.
    """
    separation = scenario.separation
    if separation is None or len(scenario.vehicles) < 2:
        return
    for part, every_instant in ((AT_KNOTS, False), (AT_ALL_TIMES, True)):
        found = nearest(motion, separation, every_instant=every_instant)
        names = [scenario.vehicles[partner].name for partner in found.partners]
        yield _Column(
            constraint="separation",
            parts=[f"from {name} {part}" for name in names],
            times=found.times,
            values=found.distances,
            limits=np.full(len(names), separation.distance),
            excess=separation.distance - found.distances,
            tolerances=np.full(len(names), separation.tolerance),
            unit="m",
            asked=part == AT_KNOTS or scenario.between_knots,
        )


def _pick(values: FloatArray, k: IntArray) -> FloatArray:
    """The k[i]-th of each row i."""
    picked: FloatArray = np.take_along_axis(values, k[:, None], axis=1)[:, 0]
    return picked


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
