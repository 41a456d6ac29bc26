"""Result of `verify`: a check for each vehicle and constraint, and the report of all checks."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from drake_rho.motion.flight import Sighting
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.system.html import html_table

AT_KNOTS, AT_ALL_TIMES = "at knots", "at all times"
"""Instants at which a constraint is verified, as named in `Check.part`."""

PRECISION = 0.01
"""Precision of the worst values between the knots, as a fraction of a constraint's tolerance."""

_LONGEST = 12
"""Largest number of violations, or of obstacles, that a printed report shows."""

_EXCESS = "excess: how far a value is beyond its limit; negative if it is within"
"""Explanation of a column, printed below the table."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Check(metaclass=Described):
    """Check of one constraint of one vehicle, at the instant where it is worst."""

    vehicle: str
    """name of the vehicle"""
    kind: str
    """kind of requirement: dynamics, goals, a limit's field, waypoints, obstacles or separation"""
    constraint: str
    """name of the constraint: dynamics, goal, position box, velocity box, acceleration box,
    jerk box, maximum speed, maximum acceleration, maximum thrust, maximum tilt, waypoint 1, …,
    obstacle 1, obstacle 2 (intruder), …, separation"""
    part: str = ""
    """side of a box, quantity of dynamics and goal, or partner and instants; empty if the
    constraint has one part only"""
    time: float
    """time on the scenario's clock [s]"""
    value: float
    """value of the plan, in `unit`; for an obstacle the signed distance, negative inside"""
    limit: float
    """bound on the value, in `unit`, tightened by the error radius; for an obstacle the sum of the
    vehicle's radius, the deviation of the obstacle's track, and the error radius"""
    excess: float
    """amount by which the value is beyond the limit, in `unit`; negative where the constraint holds
    with a margin"""
    tolerance: float
    """excess that is attributed to rounding, in `unit`: `TOLERANCE` times the constraint's scale"""
    errors: float = 0.0
    """part of the limit that is reserved for errors, in `unit`: how far the vehicle may be from its
    plan, or the sum for both vehicles of a pair; 0 without a disturbance"""
    unit: str
    """SI unit of value, limit, excess, tolerance and errors"""
    asked: bool = True
    """whether the scenario requires the constraint; others are reported but do not count"""

    @property
    def what(self) -> str:
        """Constraint and part, in words."""
        return f"{self.constraint} {self.part}".rstrip()

    @property
    def holds(self) -> bool:
        """True if the excess is within the tolerance; False if it is NaN."""
        return self.excess <= self.tolerance


@dataclasses.dataclass(frozen=True, kw_only=True)
class Column:
    """One check of every vehicle: the fields of `Check` as arrays of shape (N,)."""

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
    always: bool = False  # whether it covers every instant, if another column covers the knots
    partners: IntArray | None = None  # index of the other vehicle of each pair
    errors: FloatArray | None = None  # None without errors
    due: BoolArray | None = None  # which vehicles have this constraint; None for all

    @property
    def holds(self) -> bool:
        """True if no vehicle violates the constraint, or if the scenario does not require it."""
        met = self.excess <= self.tolerances
        if self.due is not None:
            met = met | ~self.due
        return not self.asked or bool(met.all())

    def checks(self, names: Sequence[str]) -> Iterator[Check | None]:
        """Yield the check of each vehicle; None for a vehicle without this constraint."""
        errors = np.zeros(len(names)) if self.errors is None else self.errors
        numbers = (self.times, self.values, self.limits, self.excess, self.tolerances, errors)
        rows = zip(*(each.tolist() for each in numbers), strict=True)
        due = [True] * len(names) if self.due is None else self.due.tolist()
        for has_it, name, part, (time, value, limit, excess, tolerance, error) in zip(
            due, names, self.parts, rows, strict=True
        ):
            if not has_it:
                yield None
                continue
            yield Check(
                vehicle=name,
                kind=self.kind,
                constraint=self.constraint,
                part=part,
                time=time,
                value=value,
                limit=limit,
                excess=excess,
                tolerance=tolerance,
                errors=error,
                unit=self.unit,
                asked=self.asked,
            )


@dataclasses.dataclass(frozen=True)
class Printed:
    """Contents of a printed report."""

    title: str
    """first line: the scenario's name and the verdict"""
    rows: tuple[Check, ...]
    """checks shown as rows of the table"""
    below: tuple[str, ...]
    """lines below the table"""


@dataclasses.dataclass(frozen=True)
class Report(metaclass=Described):
    """Result of `verify`; prints as a short table."""

    scenario: Scenario
    """scenario whose constraints were verified"""
    checks: tuple[Check, ...]
    """worst check of each constraint for each vehicle"""
    sightings: tuple[Sighting, ...] = ()
    """obstacles that became known during a flight, and whether they were avoided"""
    notes: tuple[str, ...] = ()
    """further remarks, one line each: the disturbance allowed for, the windows and errors of a
    simulation, tracks that end before the flight"""

    @property
    def ok(self) -> bool:
        """True if every required constraint holds."""
        return all(check.holds for check in self.checks if check.asked)

    @property
    def violations(self) -> tuple[Check, ...]:
        """Checks that do not hold, the worst first.

        Their units differ, so they are ordered by excess over tolerance, which is dimensionless.
        """
        violated = (check for check in self.checks if check.asked and not check.holds)
        return tuple(sorted(violated, key=_relative_excess, reverse=True))

    @property
    def tightest(self) -> tuple[Check, ...]:
        """Check of the vehicle that is closest to violating it, for each constraint."""
        tightest: dict[tuple[str, str, bool], Check] = {}
        for check in self.checks:
            before = tightest.get(_kind(check))
            if before is None or _excess(check) > _excess(before):
                tightest[_kind(check)] = check
        return tuple(tightest.values())

    def __str__(self) -> str:
        printed = self.printed()
        return "\n".join([_table(printed.title, printed.rows), *printed.below])

    def _repr_html_(self) -> str:
        """Return the printed report as a table for a notebook."""
        printed = self.printed()
        heads, *rows = _cells(printed.rows)
        return html_table(printed.title, heads, rows, printed.below, left=2)

    def printed(self) -> Printed:
        """Return the contents of a printed report."""
        name, violations = self.scenario.name, self.violations
        if not violations:
            several = len(self.scenario.vehicles) > 1
            which = "; for each, the vehicle closest to it" if several else ""
            rows, more = self._without_far_obstacles(list(self.tightest))
            rest = [f"… and {more} more obstacles, further away"] if more > 0 else []
            title = f"{name}: all constraints hold{which}"
            return Printed(title, tuple(rows), (*rest, _EXCESS, *self._notes()))
        title = f"{name}: {len(violations)} of {len(self.checks)} checks violated"
        more = len(violations) - _LONGEST
        rest = [f"… and {more} more"] if more > 0 else []
        return Printed(title, violations[:_LONGEST], (*rest, _EXCESS, *self._notes()))

    def _without_far_obstacles(self, rows: list[Check]) -> tuple[list[Check], int]:
        """Return the rows without those of the furthest obstacles, and how many were left out."""
        closest: dict[str, float] = {}
        for check in rows:
            if check.kind == "obstacles":
                before = closest.get(check.constraint, -np.inf)
                closest[check.constraint] = max(before, _excess(check))
        far = sorted(closest, key=lambda name: closest[name])[: max(0, len(closest) - _LONGEST)]
        return [check for check in rows if check.constraint not in far], len(far)

    def _notes(self) -> list[str]:
        """Return lines on obstacles that became known late or whose deviation is estimated."""
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
                f"estimated from samples: the deviation from the track of {', '.join(estimated)}"
            )
        return [*notes, *self.notes]


def _outcome(sighting: Sighting) -> str:
    """Return the outcome of a sighting, as the end of a sentence."""
    if not sighting.planned_for:
        outcome = "the flight avoids it nevertheless" if sighting.avoided else "not avoided"
        return f", after the last window began, so that no plan takes it into account: {outcome}"
    if sighting.avoided:
        return " and was avoided"
    return " and was not avoided: no plan was found in time"


def _kind(check: Check) -> tuple[str, str, bool]:
    """Return the kind of a check: one row of a table, whose excesses have one unit."""
    return check.constraint, check.unit, check.part.endswith(AT_ALL_TIMES)


def _excess(check: Check) -> float:
    """Return the excess, for comparing checks of one kind; NaN is the worst."""
    return np.inf if np.isnan(check.excess) else check.excess


def _relative_excess(check: Check) -> float:
    """Return the excess over the tolerance, for comparing checks of any kind."""
    return _excess(check) / check.tolerance


def verdict(check: Check) -> str:
    """Return in a word or two whether a check holds."""
    if not check.asked:
        return "not required"
    return "holds" if check.holds else "VIOLATED"


_HEADS = ("vehicle", "constraint", "time [s]", "value", "limit", "for errors", "excess", "", "")
"""Heads of a report's columns."""

_ERRORS = _HEADS.index("for errors")
"""Index of the column that a report without errors leaves out."""


def _cells(rows: Sequence[Check]) -> list[tuple[str, ...]]:
    """Return the heads and the cells of each row, with errors if any is positive."""
    cells = [
        (
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
        for check in rows
    ]
    if any(check.errors > 0.0 for check in rows):
        return [_HEADS, *cells]
    return [each[:_ERRORS] + each[_ERRORS + 1 :] for each in (_HEADS, *cells)]


def _table(title: str, rows: Sequence[Check]) -> str:
    """Return rows under a title."""
    cells = _cells(rows)
    width = max([35, *(len(check.what) for check in rows)])
    form = f"{{:<12}} {{:<{width}}} {{:>9}} {{:>12}} {{:>12}} "
    form += ("{:>11} " if len(cells[0]) == len(_HEADS) else "") + "{:>11} {:<4}  {}"
    return "\n".join([title, *(form.format(*each).rstrip() for each in cells)])
