"""Requirements of positions over time: their margins, and the scale of their colours.

The margin is the distance from the boundary of the set, positive inside, minus the largest
deviation of a moving point from its track.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.minima import Minima
from drake_rho.display.common.names import brief
from drake_rho.display.common.obstacle_snapshots import active_in_words
from drake_rho.display.common.style import dense_times
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.sets import is_own
from drake_rho.scenario.shapes.base import Shape

_PLENTY = 0.5
"""Margin from which on nothing reddens, over the greatest possible one."""
_SAME = 1e-10
"""Relative rounding error: of values that differ by less, the first counts as least."""
_FEW = 6
"""Largest number of vehicles named in texts."""
_ZOOMS, _PARTS = 6, 16
"""Number of refinements of the time around a minimum, and number of parts in each."""


@dataclasses.dataclass(frozen=True, eq=False)
class RequiredPositions:
    """A requirement of positions during a flight."""

    requirement: KeepIn
    """requirement on the scenario's clock"""
    number: int
    """number of the requirement, from 1"""
    members: IntArray
    """indices of the vehicles concerned, shape (M,)"""
    partner: int | None
    """index of the vehicle that positions are relative to; None if none"""
    interval: tuple[float, float]
    """part of the flight in which it is active, on the scenario's clock [s]"""

    @property
    def label(self) -> str:
        """Name or number, short enough for a label."""
        name = self.requirement.name
        return self.requirement.label or (
            f"requirement {self.number}" if name is None else brief(name)
        )

    @property
    def is_link(self) -> bool:
        """Whether it is relative to another vehicle or to a moving point."""
        return self.requirement.relative_to is not None

    def in_words(self, names: Sequence[str]) -> str:
        """Describe its set, its vehicles, and its active interval."""
        required = self.requirement
        other = "a moving point" if self.partner is None else names[self.partner]
        few = [brief(names[member]) for member in self.members[:_FEW]]
        more = [f"{len(self.members) - _FEW} more"] if len(self.members) > _FEW else []
        words = [
            ", ".join(few + more) + (f" relative to {other}" if self.is_link else ""),
            "in a set of its own functions" if is_own(required.set) else f"in {required.set}",
            active_in_words(required.active),
        ]
        return f"{required.called(self.number)}: {'; '.join(filter(None, words))}"

    def origins(self, shown: Drawn, times: FloatArray) -> FloatArray:
        """Return the reference positions at times since the first knot [s], (T, 3).

        They are those of the other vehicle or the moving point; zero if there is none.
        """
        if self.partner is not None:
            whose = np.full(len(times), self.partner)
            return shown.motion().each_at("position", whose, times)
        return self.requirement.offset(shown.scenario.grid.start + times)

    def is_active(self, shown: Drawn, times: FloatArray) -> BoolArray:
        """Return whether it is active at times since the first knot [s], of any shape."""
        grid = shown.scenario.grid
        return grid.clock.within(grid.start + times, self.interval)

    def margins(self, shown: Drawn, times: FloatArray) -> FloatArray:
        """Return the margins of the vehicles concerned [m], infinite while not active, (M, T).

        Args:
            shown: motion of all vehicles.
            times: times since the first knot [s], shape (T,).
        """
        return self._margins(shown, shown.motion().at("position", times)[self.members], times)

    def _margins(self, shown: Drawn, positions: FloatArray, times: FloatArray) -> FloatArray:
        """Return margins at positions (..., T, 3) and times (T,) [m], shape (..., T)."""
        values = positions - self.origins(shown, times)
        margins = -np.asarray(self.requirement.set.signed_distance(values))
        return np.where(self.is_active(shown, times), margins - self.requirement.deviation, np.inf)

    def times(self, shown: Drawn) -> FloatArray:
        """Return the times since the first knot at which it is drawn [s], corners included."""
        start = shown.scenario.grid.start
        corners = np.append(self.requirement.corners, self.interval) - start
        times = np.union1d(dense_times(shown), corners)
        first, last = (time - start for time in self.interval)
        return times[(times >= first) & (times <= last)]

    def minima(self, shown: Drawn) -> Minima:
        """Return each vehicle's smallest margin [m], at a time refined between samples."""
        times, count = self.times(shown), len(self.members)
        margins = self.margins(shown, times)
        largest = np.abs(margins).max(axis=1, initial=0.0, where=np.isfinite(margins))
        tolerance = _SAME * (1.0 + largest)
        k = np.argmax(margins <= margins.min(axis=1, keepdims=True) + tolerance[:, None], axis=1)
        best, least = times[k], margins[np.arange(count), k]
        begins, ends = times[np.maximum(k - 1, 0)], times[np.minimum(k + 1, len(times) - 1)]
        for _ in range(_ZOOMS):
            near = begins + np.linspace(0.0, 1.0, _PARTS + 1)[:, None] * (ends - begins)
            near = np.concatenate([best[None], near])  # the time found so far stays if least
            who = np.tile(self.members, len(near))
            positions = shown.motion().each_at("position", who, near.ravel())
            each = self._margins(shown, positions, near.ravel()).reshape(near.shape)
            m = np.argmin(each - tolerance * (np.arange(len(near)) == 0)[:, None], axis=0)
            best, least = near[m, np.arange(count)], each[m, np.arange(count)]
            width = (ends - begins) / _PARTS
            begins, ends = np.maximum(best - width, begins), np.minimum(best + width, ends)
        return Minima(self.members, best, least)

    def plenty(self, shown: Drawn) -> float:
        """Return the margin from which on nothing reddens [m].

        It is a part of the greatest possible margin or, if that is unbounded, of the greatest in
        the flight.
        """
        if isinstance(self.requirement.set, Shape):
            most = float(self.requirement.set.extent.min())
        else:
            most = float(self.margins(shown, self.times(shown)).max())
        return _PLENTY * max(most, np.finfo(float).tiny)


def tightest(required: Sequence[RequiredPositions], shown: Drawn) -> tuple[int, Minima]:
    """Return the index of the requirement with the smallest margin, and its minima."""
    minima = [each.minima(shown) for each in required]
    index = int(np.argmin([each.values.min() for each in minima]))
    return index, minima[index]


def required_positions(scenario: Scenario) -> Iterator[RequiredPositions]:
    """Yield the requirements of positions that are active in the flight, goals last."""
    for number, each in enumerate(scenario.required, start=1):
        interval = each.interval(scenario.grid)
        members = each.members(scenario.names)
        if each.of == "position" and interval is not None and len(members) > 0:
            yield RequiredPositions(each, number, members, each.partner(scenario.names), interval)
