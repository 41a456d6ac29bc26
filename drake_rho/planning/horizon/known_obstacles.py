"""Obstacles as they are known now, told in flight.

What is known of the flight so far stays. An obstacle that appears is known from now on, one that
vanishes is active until now. One that moves otherwise was seen again: as it was known it is active
until now, and a new one, whose errors start anew, is active from now on. Windows, reports and files
treat all of them like any other obstacle.

The true position is in the uncertainty sets of the former and of the new sighting, neither of which
need contain the other. A new plan keeps clear of the new set. The rest of the previous plan keeps
clear of the former one, which suffices as well, so a window that continues it keeps the former
sighting too. A sighting outside of the former set proves that set wrong and always replaces it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from drake_rho.planning.horizon.map_changes import NewerMap
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.shapes.base import Solid

_JUST_BEFORE = 1e-6
"""Time before the present at which what no longer holds stops being active, in steps."""

_LONGEST = 50
"""Largest number of characters of a name in the names of what it was before."""

_ROUNDING = 1e-9
"""Tolerance of a sighting within the former uncertainty set, in sizes of the obstacle."""

Named = TypeVar("Named", Obstacle, KeepIn)

Change = Callable[[], None]
"""Change of a flight's obstacles that may be made or not."""

Numbers = tuple[tuple[int, ...], ...]
"""Numbers, from 1, of a flight's obstacles that each obstacle told consists of."""


def partners(before: Sequence[Named], now: Sequence[Named]) -> list[int | None]:
    """Return the index of what each item was before; None for what is new.

    Items are matched by name. Those without one are the same only if they are equal.
    """
    left = dict(enumerate(before))
    found = list[int | None]()
    for each in now:
        index = next((i for i, other in left.items() if _is_same(each, other)), None)
        if index is not None:
            del left[index]
        found.append(index)
    return found


def _with_only_map(
    which: list[int | None], before: Sequence[Obstacle], now: Sequence[Obstacle]
) -> list[int | None]:
    """Return the result of `partners`, with the only map at rest that has no name as one."""
    earlier = [i for i, each in enumerate(before) if _is_unnamed_map(each) and i not in which]
    later = [i for i, each in enumerate(now) if _is_unnamed_map(each) and which[i] is None]
    if len(earlier) == len(later) == 1:
        which[later[0]] = earlier[0]
    return which


def _is_unnamed_map(body: Obstacle) -> bool:
    return isinstance(body.shape, Map) and body.name is None and not body.moves


def _is_same(one: Named, other: Named) -> bool:
    """Return whether two items are the same thing, possibly changed."""
    if one.name is not None or other.name is not None:
        return one.name == other.name
    return one == other


def just_before(time: float, grid: Grid) -> float:
    """Return a time that is before another on the scenario's clock [s].

    So is the middle between both, which tells the windows on the two sides of it apart.
    """
    return time - max(_JUST_BEFORE * grid.step, 2.0 * grid.clock.tick)


def until(
    active: tuple[float, float] | None, time: float, grid: Grid
) -> tuple[float, float] | None:
    """Return an interval as it was until a time on the scenario's clock [s].

    What would have been active only later never was: its interval is before the flight.
    """
    first, last = active or (grid.start - grid.step, grid.end + grid.step)
    if not grid.clock.after(last, time):
        return active
    before = just_before(time, grid)
    if not grid.clock.before(first, before):
        return grid.start - 2.0 * grid.step, grid.start - grid.step
    return first, before


def since(active: tuple[float, float] | None, time: float, grid: Grid) -> tuple[float, float]:
    """Return an interval as it is from a time on the scenario's clock on [s]."""
    first, last = active or (grid.start - grid.step, grid.end + grid.step)
    return max(first, time), last


def until_name(name: str | None, time: float) -> str | None:
    """Return the name of what something was until a time [s]."""
    return name and f"{name[:_LONGEST]} until {clock_time(time)}"


class ChangingObstacles:
    """A flight's obstacles, to which what is told is added.

    Args:
        bodies: obstacles of the flight so far.
        numbers: those of which each obstacle told before consists.
        time: from which on the news hold, on the scenario's clock [s].
        grid: of the whole flight.

    Attributes:
        bodies: obstacles of the flight.
        numbers: those of which each obstacle told now consists.
    """

    def __init__(
        self, bodies: Sequence[Obstacle], numbers: Numbers, time: float, grid: Grid
    ) -> None:
        self.bodies, self.numbers = list(bodies), list[tuple[int, ...]]()
        self._before, self._time, self._grid = numbers, time, grid

    def tell(
        self, before: Sequence[Obstacle], now: Sequence[Obstacle], ago: float
    ) -> tuple[tuple[Obstacle, ...], Numbers]:
        """Tell obstacles as they are known now.

        Args:
            before: as they were told last.
            now: as they are now.
            ago: time since those that move otherwise were seen, unless they say it [s].

        Returns:
            The obstacles of the flight without sightings within former errors, and the numbers of
            those of which each obstacle told then consists.
        """
        which, later = _with_only_map(partners(before, now), before, now), list[Change]()
        for gone in set(range(len(before))) - set(which):
            for number in self._before[gone]:
                self._end(number)
        for position, (index, each) in enumerate(zip(which, now, strict=True)):
            self.numbers.append(() if index is None else self._before[index])
            if self._is_over(each):
                for number in self.numbers[-1]:
                    self._end(number)
            elif index is None or not self.numbers[-1]:  # what was over before is new
                self.numbers[-1] = (self._added(each),)
            elif each != before[index]:
                change = self._change(position, before[index], each, ago)
                if change is not None:
                    later.append(change)
        necessary = tuple(self.bodies), tuple(self.numbers)
        for change in later:
            change()
        return necessary

    def _change(self, position: int, before: Obstacle, now: Obstacle, ago: float) -> Change | None:
        """Change an obstacle, or return how to change it if this is not necessary."""
        own = self.numbers[position]
        if _is_newer_map(before, now):
            self.numbers[position] = self._with_newer_map(own, now)
            return None

        def replaced() -> None:
            for number in own:
                self._end(number)
            self.numbers[position] = (self._seen(now, ago),)

        alike = _without_motion(before) == _without_motion(now)
        if alike and not self._contradicts(self.bodies[own[0] - 1], now, ago):
            return replaced
        replaced()
        return None

    def _is_over(self, body: Obstacle) -> bool:
        """Return whether an obstacle is not active any more."""
        return body.active is not None and not self._grid.clock.after(body.active[1], self._time)

    def _end(self, number: int) -> None:
        """Let an obstacle be active until now."""
        body, time = self.bodies[number - 1], self._time
        active = until(body.active, time, self._grid)
        if active == body.active:
            return
        known = body.known_by(0.0) if body.known_from > time else body
        self.bodies[number - 1] = unchecked(known, active=active, name=until_name(body.name, time))

    def _added(self, body: Obstacle, **changes: object) -> int:
        """Add an obstacle that is known from now on, or later, and return its number."""
        seen_at = body.errors_from if body.velocity_error > 0.0 else body.seen_at
        # known_from counts from 0 on, and 0 stands for the start
        later = max(self._time, body.known_from) if body.known_from > 0.0 else self._time
        known: dict[str, object] = {"known_from": later, "seen_at": seen_at}
        if later <= 0.0 and self._grid.clock.after(later, self._grid.start):
            known |= {"known_from": 0.0, "active": since(body.active, later, self._grid)}
        self.bodies.append(unchecked(body, **(known | changes)))
        return len(self.bodies)

    def _seen(self, body: Obstacle, ago: float) -> int:
        """Add an obstacle that is elsewhere than it was, and return its number."""
        seen_at = self._time - ago if body.seen_at is None else body.seen_at
        active = since(body.active, self._time, self._grid)
        return self._added(body, active=active, seen_at=seen_at, known_from=self._time)

    def _contradicts(self, former: Obstacle, now: Obstacle, ago: float) -> bool:
        """Return whether a sighting is outside of where an obstacle may be as known before.

        One that was not known was not avoided: every sighting contradicts it.
        """
        then = np.array([self._time - ago if now.seen_at is None else now.seen_at])
        away = float(np.linalg.norm(now.centers(then)[0] - former.centers(then)[0]))
        errors = former.deviation + float(former.uncertainty(then)[0]) + now.position_error
        return former.known_from > self._time or away > errors + _ROUNDING * now.shape.size

    def _with_newer_map(self, own: tuple[int, ...], now: Obstacle) -> tuple[int, ...]:
        """Replace the cells of a map that changed, and return the numbers of its parts."""
        assert isinstance(now.shape, Map)  # noqa: S101  # callers check this
        newer, parts = NewerMap(now.shape), list[int]()
        name = (now.name or "map")[:_LONGEST]
        for number in own:
            body = self.bodies[number - 1]
            common, removed = newer.compared(body.shape)
            if common is not None:
                parts.append(number)
            if removed is not None:
                self._remove_cells(
                    number, common, removed, f"{name} until {clock_time(self._time)}"
                )
        if newer.added is not None:
            called = f"{name} from {clock_time(self._time)}"
            parts.append(self._added(unchecked(now, shape=newer.added, name=called)))
        return tuple(parts)

    def _remove_cells(self, number: int, common: Solid | None, removed: Solid, name: str) -> None:
        """Let cells of a map be active until now, as if known from the start."""
        body, begin = self.bodies[number - 1], self._grid.start - self._grid.step
        if body.known_from > 0.0:
            begin = body.known_from
        active, known = (begin, just_before(self._time, self._grid)), body.known_by(0.0)
        former = unchecked(known, shape=removed, active=active, name=name)
        if common is None:
            self.bodies[number - 1] = unchecked(former, name=body.name)
        else:
            self.bodies[number - 1] = unchecked(body, shape=common)
            self.bodies.append(former)


def _is_newer_map(before: Obstacle, now: Obstacle) -> bool:
    """Return whether an obstacle is a map at rest, of which only the cells changed."""
    if not (isinstance(before.shape, Map) and isinstance(now.shape, Map)) or now.moves:
        return False
    return unchecked(before, shape=now.shape) == now


def _without_motion(body: Obstacle) -> Obstacle:
    return unchecked(body, velocity=None, track=None, seen_at=None, known_from=0.0)
