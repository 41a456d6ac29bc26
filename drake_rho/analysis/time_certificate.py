"""Record of a lower bound on the final time of every plan, and of a plan's gap to it."""

from __future__ import annotations

import dataclasses

from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.system.html import html_table
from drake_rho.system.numbers import percent

GLOBAL_TIME_GAP = 1e-4
"""Relative gap up to which a final time counts as the least; searches converge to about a tenth of
this."""

_MAX_ROWS = 20
"""Largest number of vehicles that a printed certificate shows: those with the largest bounds."""

_HEADS = ("vehicle", "lower bound", "gap")
"""Heads of a printed certificate's columns."""


@dataclasses.dataclass(frozen=True)
class VehicleTimeBound(metaclass=Described):
    """Lower bound on the final time of one vehicle alone."""

    vehicle: str
    """name of the vehicle"""
    bound: float
    """lower bound [s], at most the plan's final time"""


@dataclasses.dataclass(frozen=True)
class TimeCertificate(metaclass=Described):
    """Lower bound on the final time of every plan, with a plan's gap to it; prints as a table."""

    scenario: Scenario
    """scenario of the plan"""
    vehicles: tuple[VehicleTimeBound, ...]
    """bound of each vehicle alone"""
    holds: bool
    """whether the plan satisfies its constraints; one that does not may take less than the bound"""
    left_out: tuple[str, ...] = ()
    """constraints that the bound leaves out; they may account for a part of the gap"""
    relaxations: int = 0
    """number of convex programs that were solved"""
    cut: bool = False
    """whether a limit on time or programs ended the search before the wanted gap was reached"""

    @property
    def duration(self) -> float:
        """Final time of the plan [s]."""
        return self.scenario.grid.duration

    @property
    def bound(self) -> float:
        """Lower bound on the final time of every plan [s]: the largest bound of a vehicle."""
        return max(each.bound for each in self.vehicles)

    @property
    def gap(self) -> float:
        """Relative gap (duration - bound) / duration."""
        return (self.duration - self.bound) / self.duration

    @property
    def is_globally_optimal(self) -> bool:
        """True if the plan satisfies its constraints and its gap is at most `GLOBAL_TIME_GAP`."""
        return self.holds and self.gap <= GLOBAL_TIME_GAP

    @property
    def premise(self) -> str:
        """Plans for which the bound holds."""
        words = [f"plans on {self.scenario.grid.knots} knots"]
        if any(each.waypoints for each in self.scenario.vehicles):
            words.append("with waypoints at any times, in the order of this plan")
        if self.scenario.smoothing is not None:
            words.append("that meet the constraints before they are averaged too")
        return ", ".join(words)

    def __str__(self) -> str:
        form = "{:<12} {:>14} {:>9}"
        rows = (form.format(*each) for each in (_HEADS, *self._rows()))
        return "\n".join([self._title(), *rows, *self._below()])

    def _repr_html_(self) -> str:
        """Return the printed certificate as a table for a notebook."""
        return html_table(self._title(), _HEADS, self._rows(), self._below(), left=1)

    def _title(self) -> str:
        verdict = "the least time" if self.is_globally_optimal else "not proved to be the least"
        verdict = verdict if self.holds else "violates its constraints"
        verdict += (
            " (the search was cut short)" if self.cut and not self.is_globally_optimal else ""
        )
        return (
            f"{self.scenario.name}: {verdict}; final time {self.duration:.6g} s, "
            f"lower bound {self.bound:.6g} s; gap {percent(max(self.gap, 0.0))}"
        )

    def _rows(self) -> list[tuple[str, ...]]:
        """Return the cells of the vehicles with the largest bounds."""
        shown = sorted(self.vehicles, key=lambda each: -each.bound)[:_MAX_ROWS]
        return [
            (each.vehicle, f"{each.bound:.6g} s", percent(1.0 - each.bound / self.duration))
            for each in shown
        ]

    def _below(self) -> list[str]:
        more = len(self.vehicles) - _MAX_ROWS
        lines = [f"… and {more} more, with smaller bounds"] if more > 0 else []
        lines.append(f"the bound holds for {self.premise}")
        if self.left_out:
            lines.append(f"it leaves out {', '.join(self.left_out)}")
        return lines
