"""Result of `verify`: a check for each vehicle and constraint, and the report of all checks."""

from __future__ import annotations

import dataclasses
import math

from drake_rho.motion.flight import Sighting
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.system.html import html_table
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, Check
from drake_rho.verification.printed import (
    LONGEST,
    TEXTS,
    Printed,
    closest,
    facts,
    full_table,
    in_words,
    is_equality,
    short_table,
)
from drake_rho.verification.summary import Summary

_LEFT = "left: distance of the vehicle from the limit; of several, the closest is shown"
_LEFT_VIOLATED = "left: distance from the limit; negative where it is violated"
"""Explanations of a column, printed below the table."""


@dataclasses.dataclass(frozen=True)
class Report(metaclass=Described):
    """Result of `verify`; prints the key figures, then a table of margins."""

    scenario: Scenario
    """scenario whose constraints were verified"""
    checks: tuple[Check, ...]
    """worst check of each constraint for each vehicle"""
    summary: Summary
    """top speed, time and cost"""
    sightings: tuple[Sighting, ...] = ()
    """obstacles that became known during a flight, and whether they were avoided"""
    notes: tuple[str, ...] = ()
    """further remarks, one line each: the disturbance allowed for, the windows and errors of a
    simulation, tracks that end before the flight"""

    @property
    def ok(self) -> bool:
        """True if every required constraint holds."""
        return not self._unmet

    @property
    def violations(self) -> tuple[Check, ...]:
        """Checks that do not hold, the worst first; without those that are undecided.

        Their units differ, so they are ordered by excess over tolerance, which is dimensionless.
        """
        return tuple(each for each in self._unmet if not each.is_undecided)

    @property
    def undecided(self) -> tuple[Check, ...]:
        """Checks that samples neither show to hold nor to be violated, the furthest first.

        Each has the number of samples a second that would decide (`Check.deciding_rate`). There are
        none for plans, flights, simulations and polynomials.
        """
        return tuple(each for each in self._unmet if each.is_undecided)

    @property
    def _unmet(self) -> list[Check]:
        """Required checks that do not hold, by their excess over the tolerance."""
        unmet = [check for check in self.checks if check.asked and not check.holds]
        return sorted(unmet, key=_relative_excess, reverse=True)

    @property
    def exceeded(self) -> tuple[Check, ...]:
        """Checks of soft limits that are exceeded, the most expensive first."""
        return tuple(sorted((each for each in self.checks if each.price), key=_price, reverse=True))

    @property
    def price(self) -> float:
        """Price of all soft limits [m²/s⁴], to be added to the cost of accelerations."""
        return sum(map(_price, self.exceeded))

    @property
    def tightest(self) -> tuple[Check, ...]:
        """Check with the smallest margin, for each constraint."""
        tightest: dict[tuple[str, str, bool, bool], Check] = {}
        for check in self.checks:
            before = tightest.get(_kind(check))
            if before is None or check.badness > before.badness:
                tightest[_kind(check)] = check
        return tuple(tightest.values())

    @property
    def clearance(self) -> Check | None:
        """Check of the vehicle that is closest to an obstacle; None if no clearance is required.

        It is that of the motion, not of measured samples.
        """
        return closest(self.checks, "obstacles")

    @property
    def separation(self) -> Check | None:
        """Check of the two vehicles that are closest; None if no separation is required.

        It is that of the motion, not of measured samples.
        """
        return closest(self.checks, "separation")

    def __str__(self) -> str:
        return str(self.printed())

    def _repr_html_(self) -> str:
        """Return the printed report as a table for a notebook."""
        printed = self.printed()
        above = [f"{name}: {words}" for name, words in printed.facts]
        return html_table(
            printed.title, printed.heads, printed.rows, printed.below, left=TEXTS, above=above
        )

    def printed(self, *, every_row: bool = False) -> Printed:
        """Return the contents of a printed report, which `print` shows.

        Args:
            every_row: whether to list every row, with values and limits: also equalities, the
                furthest obstacles, and the knots where every instant is verified.
        """
        violations, undecided = self.violations, self.undecided
        unmet = [*violations, *undecided]
        lines = tuple(facts(self.summary, self.checks, self.scenario.grid.duration, gap=self.ok))
        name, below = self.scenario.name, list[str]()
        title = f"{name}: all constraints hold"
        if self.exceeded:
            title += ", but for soft limits"
        rows = list(self.tightest)
        if unmet:
            counts = {"violated": len(violations), "undecided": len(undecided)}
            words = [f"{count} {word}" for word, count in counts.items() if count]
            title = f"{name}: of {len(self.checks)} checks {' and '.join(words)}"
        if violations and not undecided:
            title = f"{name}: {len(violations)} of {len(self.checks)} checks violated"
        if every_row:
            others = [row for row in rows if row.holds or not row.asked]
            heads, cells = full_table([*unmet, *others])
            return Printed(title, lines, heads, cells, (_LEFT_VIOLATED, *self._notes()))
        if unmet:
            rows, more = unmet[:LONGEST], len(unmet) - LONGEST
            below += [f"… and {more} more"] if more > 0 else []
        else:
            rows, more = self._without_far_obstacles([row for row in rows if self._is_short(row)])
            below += [f"… and {more} more obstacles, further away"] if more > 0 else []
        heads, cells = short_table(rows)
        below += [_LEFT_VIOLATED if unmet else _LEFT] if rows else []
        return Printed(title, lines, heads, cells, (*below, *self._notes()))

    def _is_short(self, row: Check) -> bool:
        """Return whether a row is in the short table: no equality, and not covered by another."""
        at_all_times_too = self.scenario.between_knots and row.part.endswith(AT_KNOTS)
        return not is_equality(row) and not at_all_times_too

    def _without_far_obstacles(self, rows: list[Check]) -> tuple[list[Check], int]:
        """Return the rows without the furthest obstacles, and the number of rows omitted."""
        nearest: dict[str, float] = {}
        for check in rows:
            if check.kind == "obstacles":
                before = nearest.get(check.constraint, check.badness)
                nearest[check.constraint] = max(before, check.badness)
        far = sorted(nearest, key=lambda name: nearest[name])[: max(0, len(nearest) - LONGEST)]
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
        paid = self.exceeded
        notes += map(in_words, paid[:LONGEST])
        if len(paid) > LONGEST:
            notes.append(f"{len(paid) - LONGEST} more soft limits are exceeded")
        return [*notes, *self._deciding(), *self.notes]

    def _deciding(self) -> list[str]:
        """Return a note on the rate of samples that would decide what is undecided."""
        rates = [each.deciding_rate for each in self.undecided if each.deciding_rate is not None]
        if not rates:
            return []
        if math.isinf(most := max(rates)):
            open_ = next(each for each in self.undecided if each.deciding_rate == most)
            return [f"undecided at any rate of samples: {open_.what} (of {open_.vehicle})"]
        return [f"undecided: about {most:.3g} samples a second would decide"]


def _outcome(sighting: Sighting) -> str:
    """Return the outcome of a sighting, as the end of a sentence."""
    if not sighting.planned_for:
        outcome = "the flight avoids it nevertheless" if sighting.avoided else "not avoided"
        return f", after the last window began, so that no plan takes it into account: {outcome}"
    if sighting.avoided:
        return " and was avoided"
    return " and was not avoided: no plan was found in time"


def _kind(check: Check) -> tuple[str, str, bool, bool]:
    """Return the kind of a check: one row of a table, whose excesses have one unit."""
    return check.constraint, check.unit, check.part.endswith(AT_ALL_TIMES), check.is_measured


def _price(check: Check) -> float:
    """Return the price of a soft limit [m²/s⁴]; 0 of any other."""
    return check.price or 0.0


def _relative_excess(check: Check) -> float:
    """Return the excess over the tolerance, for comparing checks of any kind."""
    return check.badness / check.tolerance
