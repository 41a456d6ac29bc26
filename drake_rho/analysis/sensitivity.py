"""Record of the sensitivity of the least time to limits, with its printed form."""

from __future__ import annotations

import dataclasses

from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.system.html import html_table

_HEADS = "limit", "change", "vehicles", "less time"
_SHOWN, _NAMED = 12, 3
"""Largest numbers of limits in a printed table, and of names of vehicles in one of its cells."""

_CUT = "time was up before every limit was tried"


@dataclasses.dataclass(frozen=True)
class LimitEffect(metaclass=Described):
    """Sensitivity of the least time to one limit."""

    limit: str
    """name of the limit: a field of `Limits`, a waypoint, an obstacle, a requirement, ..."""
    change: str
    """change of the limit to which `less_time` refers, such as '1 % more' or '0.01 m nearer'"""
    less_time: float
    """part of the final time saved by this change, to first order"""
    vehicles: tuple[str, ...]
    """names of the vehicles whose limit has this effect"""

    @property
    def rounded(self) -> float:
        """`less_time` to two digits: the least time is no more precise."""
        return float(f"{self.less_time:.2g}")


@dataclasses.dataclass(frozen=True)
class TimeSensitivity(metaclass=Described):
    """Sensitivity of the least time to each limit; prints as a table.

    Small changes of several limits save the sum of their savings.
    """

    scenario: Scenario
    """scenario of the plan, without its waypoints"""
    duration: float
    """final time of the plan, counted from the first knot [s]"""
    limits: tuple[LimitEffect, ...]
    """limits with an effect, the largest first"""
    cut: bool = False
    """whether time was up before every limit was tried"""

    def __str__(self) -> str:
        cells = [_HEADS, *self._rows()]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = (
            "  ".join([*(f"{a:<{n}}" for a, n in zip(row[:-1], widths, strict=False)), row[-1]])
            for row in ((*each[:-1], each[-1].rjust(widths[-1])) for each in cells)
        )
        return "\n".join([self._title(), *lines, *self._below()])

    def _repr_html_(self) -> str:
        """Return the printed table for a notebook."""
        return html_table(self._title(), _HEADS, self._rows(), self._below(), left=3)

    def _title(self) -> str:
        known = "what makes it so long" if self.limits else "no limit that was tried has an effect"
        return f"{self.scenario.name}: {self.duration:.5g} s; {known}"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        return [
            (each.limit, each.change, _named(each.vehicles), f"{100.0 * each.rounded:.2g} %")
            for each in self.limits[:_SHOWN]
        ]

    def _below(self) -> list[str]:
        more = len(self.limits) - _SHOWN
        below = [f"… and {more} more, with smaller effects"] if more > 0 else []
        return [*below, *([_CUT] if self.cut else [])]


def _named(vehicles: tuple[str, ...]) -> str:
    """Return the names of vehicles, or the first few of many."""
    more = len(vehicles) - _NAMED
    return ", ".join(vehicles[:_NAMED]) + (f" and {more} more" if more > 0 else "")
