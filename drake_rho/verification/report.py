"""What `verify` found: a check for each vehicle and constraint, and the report of all of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from drake_rho.motion.plan import Sighting
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Quantity, Scenario

AT_KNOTS, AT_ALL_TIMES = "at knots", "at all times"
"""The instants at which a constraint is judged, as the parts of checks say it."""

UNITS: dict[Quantity, str] = {
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s²",
    "jerk": "m/s³",
}
"""SI units of what a box can bound."""

PRECISION = 0.01
"""Part of a tolerance to which the worst instants between the knots are found."""

_LONGEST = 12
"""Violations, or obstacles, that a printed report shows."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Check(metaclass=Described):
    """How one vehicle keeps one constraint, at the instant where it does so worst."""

    vehicle: str
    """name"""
    constraint: str
    """name: dynamics, goal, position box, velocity box, acceleration box, jerk box, maximum speed,
    maximum acceleration, maximum thrust, maximum tilt, waypoint 1, …, obstacle 1,
    obstacle 2 (intruder), …,
    separation"""
    part: str = ""
    """which side of a box, or which quantity of dynamics and goal; empty if there is but one"""
    time: float
    """on the scenario's clock [s]"""
    value: float
    """what the plan does, in `unit`; of an obstacle the signed distance, negative inside"""
    limit: float
    """what the constraint allows, in `unit`, less what errors take; of an obstacle the vehicle's
    radius, how far the obstacle may be from its track, and what errors take"""
    excess: float
    """by how much the value is beyond the limit, in `unit`; negative on the right side of it"""
    tolerance: float
    """excess that is put down to rounding, in `unit`: `TOLERANCE` of the constraint's scale"""
    errors: float = 0.0
    """how much of the limit is for errors: how far the vehicle, or each of a pair, may be off its
    plan, both together, in `unit`; 0 where nothing disturbs it"""
    unit: str
    """SI unit of the numbers"""
    asked: bool = True
    """whether the scenario asks for it; what it does not ask for is told, not judged"""

    @property
    def what(self) -> str:
        """Constraint and part, in words."""
        return f"{self.constraint} {self.part}".rstrip()

    @property
    def holds(self) -> bool:
        """Whether the constraint is met; never with a value that is not a number."""
        return self.excess <= self.tolerance


@dataclasses.dataclass(frozen=True, kw_only=True)
class Column:
    """One check of every vehicle: what `Check` has, as arrays of shape (N,)."""

    kind: str  # of the requirement that is checked, one of `KINDS`
    constraint: str
    parts: Sequence[str]
    times: FloatArray
    values: FloatArray
    limits: FloatArray
    excess: FloatArray
    tolerances: FloatArray
    unit: str
    asked: bool = True
    always: bool = False  # whether it is about every instant, where there is one about knots too
    partners: IntArray | None = None  # index of the other vehicle, where it is about two
    errors: FloatArray | None = None  # None for none
    due: BoolArray | None = None  # which vehicles have this constraint; None for all

    @property
    def holds(self) -> bool:
        """Whether all vehicles keep it that have it, or it is not asked for."""
        kept = self.excess <= self.tolerances
        if self.due is not None:
            kept = kept | ~self.due
        return not self.asked or bool(kept.all())

    def checks(self, names: Sequence[str]) -> Iterator[Check | None]:
        """The check of each vehicle; None where it does not have the constraint."""
        errors = np.zeros(len(names)) if self.errors is None else self.errors
        numbers = (self.times, self.values, self.limits, self.excess, self.tolerances, errors)
        rows = zip(*(each.tolist() for each in numbers), strict=True)
        due = [True] * len(names) if self.due is None else self.due.tolist()
        for has_it, name, part, (time, value, limit, excess, tolerance, off) in zip(
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
                errors=off,
                unit=self.unit,
                asked=self.asked,
            )


@dataclasses.dataclass(frozen=True)
class Printed:
    """What a printed report consists of."""

    title: str
    """what holds"""
    rows: tuple[Check, ...]
    """those that are shown"""
    below: tuple[str, ...]
    """further lines"""


@dataclasses.dataclass(frozen=True)
class Report(metaclass=Described):
    """What `verify` found; prints as a short table."""

    scenario: Scenario
    """what was asked"""
    checks: tuple[Check, ...]
    """the worst of each constraint for each vehicle"""
    sightings: tuple[Sighting, ...] = ()
    """of a flight: the obstacles that became known under way, and whether they were avoided"""
    notes: tuple[str, ...] = ()
    """what else is to be known: what disturbance is borne, and what was judged in its place"""

    @property
    def ok(self) -> bool:
        """Whether every constraint holds."""
        return all(check.holds for check in self.checks if check.asked)

    @property
    def violations(self) -> tuple[Check, ...]:
        """The checks that do not hold, the worst first.

        Their units differ, so they are ordered by excess over tolerance, which has none.
        """
        broken = (check for check in self.checks if check.asked and not check.holds)
        return tuple(sorted(broken, key=_tolerances_beyond, reverse=True))

    @property
    def tightest(self) -> tuple[Check, ...]:
        """Of each constraint the check of the vehicle that is closest to breaking it."""
        tightest: dict[tuple[str, str, bool], Check] = {}
        for check in self.checks:
            before = tightest.get(_kind(check))
            if before is None or _excess(check) > _excess(before):
                tightest[_kind(check)] = check
        return tuple(tightest.values())

    def __str__(self) -> str:
        printed = self.printed()
        return "\n".join([_table(printed.title, printed.rows), *printed.below])

    def printed(self) -> Printed:
        """What a printed report consists of."""
        name, violations = self.scenario.name, self.violations
        if not violations:
            several = len(self.scenario.vehicles) > 1
            which = "; for each, the vehicle closest to it" if several else ""
            rows, more = self._without_far_obstacles(list(self.tightest))
            rest = [f"… and {more} more obstacles, further away"] if more > 0 else []
            title = f"{name}: all constraints hold{which}"
            return Printed(title, tuple(rows), (*rest, *self._notes()))
        title = f"{name}: {len(violations)} of {len(self.checks)} checks broken"
        more = len(violations) - _LONGEST
        rest = [f"… and {more} more"] if more > 0 else []
        return Printed(title, violations[:_LONGEST], (*rest, *self._notes()))

    def _without_far_obstacles(self, rows: list[Check]) -> tuple[list[Check], int]:
        """The rows but for those of the furthest obstacles, and how many these are."""
        numbers = range(1, len(self.scenario.obstacles) + 1)
        closest = {self.scenario.obstacle_name(number): -np.inf for number in numbers}
        for check in rows:
            if check.constraint in closest:
                closest[check.constraint] = max(closest[check.constraint], _excess(check))
        far = sorted(closest, key=lambda name: closest[name])[: max(0, len(closest) - _LONGEST)]
        return [check for check in rows if check.constraint not in far], len(far)

    def _notes(self) -> list[str]:
        """Lines on what was seen late, and on what is judged with an estimate."""
        notes = [
            f"{each.obstacle} became known at {clock_time(each.time)}{_outcome(each)}"
            for each in self.sightings
        ]
        estimated = [
            self.scenario.obstacle_name(number)
            for number, obstacle in enumerate(self.scenario.bodies, start=1)
            if obstacle.track is not None and obstacle.track.deviation_is_estimated
        ]
        if estimated:
            notes.append(
                f"estimated from samples: how far from its track is {', '.join(estimated)}"
            )
        return [*notes, *self.notes]


def _outcome(sighting: Sighting) -> str:
    """Return what came of a sighting, as the end of a sentence."""
    if not sighting.planned_for:
        kept = "all the same what was flown keeps out of it" if sighting.avoided else "not avoided"
        return f", after the last window began, so that no plan knew of it: {kept}"
    if sighting.avoided:
        return " and was avoided"
    return " and was not avoided: too late for any plan that was found"


def _kind(check: Check) -> tuple[str, str, bool]:
    """What is told in one line of a table; the excess of all checks of a kind has one unit."""
    return check.constraint, check.unit, check.part.endswith(AT_ALL_TIMES)


def _excess(check: Check) -> float:
    """For comparing checks of one kind; what is no number is worst."""
    return np.inf if np.isnan(check.excess) else check.excess


def _tolerances_beyond(check: Check) -> float:
    """For comparing checks of any kind."""
    return _excess(check) / check.tolerance


def verdict(check: Check) -> str:
    """Whether a check holds, in a word or a few."""
    if not check.asked:
        return "not asked for"
    return "holds" if check.holds else "BROKEN"


def _table(title: str, rows: Sequence[Check]) -> str:
    """Rows under a title; with a column of what is for errors where something is."""
    wide = max([35, *(len(check.what) for check in rows)])
    errors = any(check.errors > 0.0 for check in rows)
    form = f"{{:<12}} {{:<{wide}}} {{:>9}} {{:>12}} {{:>12}} "
    form += ("{:>11} " if errors else "") + "{:>11} {:<4}  {}"
    heads = ("vehicle", "constraint", "time [s]", "value", "limit", "for errors", "excess", "", "")
    lines = [title, form.format(*_without_errors(heads, errors))]
    for check in rows:
        cells = (
            check.vehicle,
            check.what,
            clock_number(check.time),
            f"{check.value:.6g}",
            f"{check.limit:.6g}",
            f"{check.errors:.4g}" if check.errors > 0.0 else "",
            f"{check.excess:+.2e}",
            check.unit,
            verdict(check),
        )
        lines.append(form.format(*_without_errors(cells, errors)))
    return "\n".join(line.rstrip() for line in lines)


def _without_errors(cells: tuple[str, ...], kept: bool) -> tuple[str, ...]:
    return cells if kept else cells[:5] + cells[6:]
