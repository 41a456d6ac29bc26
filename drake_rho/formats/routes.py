"""Routes: what the items of a mission mean for the motion of a vehicle."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.formats.mission_items import (
    AMSL,
    ARC,
    CHANGE_SPEED,
    DELAY,
    FASTEST,
    LAND,
    LOITER_TIME,
    LOITER_TO_ALTITUDE,
    LOITER_TURNS,
    LOITER_UNLIMITED,
    PAYLOAD_PLACE,
    RELATIVE,
    RETURN,
    SLOWEST,
    SPLINE,
    TAKEOFF,
    VTOL_LAND,
    VTOL_TAKEOFF,
    WAYPOINT,
    Item,
    MissionFile,
)
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.frame import Frame

SAME_PLACE = 1e-3
"""Distance up to which two places in a row are one [m]."""
_FARTHEST, _HIGHEST = 1e5, 1e4
"""Largest distance of a place from home [m], beyond which local metres mean little, and largest
altitude above it [m], beyond which it may be in another unit."""
_LONGEST = 1e5
"""Longest time at rest [s]."""
_PARTS = {LOITER_TURNS: "turns", ARC: "arc", PAYLOAD_PLACE: "descent"}
"""Parts of motions that are left out where a place is passed."""
_PASSED = WAYPOINT, SPLINE, LOITER_TIME, LOITER_TO_ALTITUDE, *_PARTS
_HOLDING = WAYPOINT, SPLINE, LOITER_TIME
"""Commands whose first parameter is a time at rest [s]."""
_TAKEOFFS = TAKEOFF, VTOL_TAKEOFF
PLACED = (*_PASSED, *_TAKEOFFS, LAND, VTOL_LAND, LOITER_UNLIMITED)
"""Commands whose places are flown to."""
_BELOW = 1.0
"""Depth below home from which a place is told, and a take-off refused [m]: homes are given to
about a metre."""
GROUND, ROOM = "ground", 1.0
"""Name of the floor of a landing's last leg, and distance of floors below the lowest place [m]:
room for the tube of a flight in wind."""
LEVEL = 0.1
"""Height above the start up to which a place is on its ground [m]."""
_LONGEST_LIST = 48
"""Characters of items that fit in an error's line beside its other words."""
_OVER_GROUND = 0.0, 1.0
"""Kinds of speeds that an item changes: in the air and over ground, not of climbs."""
_SAME_SPEED, _OWN_SPEED = -1.0, -2.0
"""Speeds of MAVLink that stand for no change and for the speed before all changes."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stop:
    """Place of a route."""

    name: str
    """name of its item"""
    position: FloatArray
    """east, north and up of the scenario's origin [m], shape (3,)"""
    speed: float | None = None
    """largest speed on the leg to it, if the file gives one [m/s]"""
    dwell: float = 0.0
    """least time at rest [s]"""
    rest: bool = False
    """whether it is passed at rest: above a landing"""


@dataclasses.dataclass(frozen=True, eq=False)
class Route:
    """Places of a vehicle in their order."""

    start: FloatArray
    """place of the launch [m], shape (3,)"""
    stops: tuple[Stop, ...]
    """places after it; the last one is the goal"""
    notes: dict[str, list[str]]
    """items to tell of, by what is told of them"""
    lands: bool = False
    """whether it ends with a landing"""


def route_of(mission: MissionFile, home: Frame, origin: Frame) -> Route:
    """Return the route of a mission.

    Args:
        mission: content of its file.
        home: place of the launch, and level of relative altitudes.
        origin: origin of the local positions.

    Raises:
        ScenarioError: an item is no place in this scenario, it is flown after a landing, or there
            is no place.
    """
    walk = _Walk(home, origin, mission.speed)
    for number, item in enumerate(mission.items):
        if walk.ended is not None:
            walk.skipped += [f"{each} after {walk.ended}" for each in mission.items[number:]]
            break
        walk.take(item)
    if not walk.stops:
        raise no_place([*mission.skipped, *walk.skipped])
    notes = {
        "not in the scenario": [*mission.skipped, *walk.skipped],
        "not in the file, so that the present one is kept": walk.missing,
        "below home, and perhaps below the ground": walk.below,
        "at home's level, where ArduPilot would keep the present altitude": walk.level,
        f"more than {_HIGHEST:g} m above home, perhaps in another unit": walk.above,
    }
    return Route(walk.start, tuple(walk.stops), notes, bool(walk.landed))


def no_place(left_out: Sequence[str]) -> ScenarioError:
    """Return the error for a mission without a place to fly to.

    Args:
        left_out: what it has instead.
    """
    words = f" (left out: {_fitting(left_out)})" if left_out else ""
    expected = "a waypoint, a take-off or a landing away from home"
    return ScenarioError("items", Description(f"no place to fly to{words}"), expected)


def _fitting(items: Sequence[str]) -> str:
    """Return as many items as an error's line has room for, and the number of the others."""
    for count in range(min(len(items), 4), 0, -1):
        more = f" and {len(items) - count} more" if len(items) > count else ""
        if len(words := f"{', '.join(items[:count])}{more}") <= _LONGEST_LIST:
            return words
    return f"{len(items)} items"


class _Walk:
    """Places so far, and what holds from the last one on."""

    def __init__(self, home: Frame, origin: Frame, speed: float | None) -> None:
        self.home, self.origin, self.speed = home, origin, speed
        self.own_speed, self.landed = speed, ""
        self.place = self.launch = np.array([home.latitude, home.longitude, home.altitude])
        self.start = origin.local(*self.launch)
        self.stops: list[Stop] = []
        self.skipped: list[str] = []
        self.below: list[str] = []
        self.level: list[str] = []
        self.above: list[str] = []
        self.missing: list[str] = []
        self.ended: str | None = None

    def take(self, item: Item) -> None:
        """Go on by an item.

        Raises:
            ScenarioError: it is flown after a landing, or its values are out of range.
        """
        if self.landed and item.command in (*PLACED, RETURN):
            expected = f"the last item that is flown, not before {item}: split the mission there"
            raise ScenarioError(self.landed, Description("a landing"), expected)
        match item.command:
            case command if command in _TAKEOFFS:
                self._take_off(item)
            case command if command in _PASSED:
                self._pass(item)
            case command if command in (LAND, VTOL_LAND):
                self._descend(item, self._ground(item))
                self.landed = str(item)
            case command if command == RETURN:
                self._descend(item, self.launch)
                self.ended = str(item)
            case command if command == LOITER_UNLIMITED:
                self._go(item.name, self._in_air(item))
                self.ended = str(item)
            case command if command == DELAY and item.params[0] > 0.0 and self.stops:
                self._wait(item.params[0])
            case command if command == CHANGE_SPEED and item.params[0] in _OVER_GROUND:
                self._change_speed(item)
            case _:
                self.skipped.append(str(item))

    def _change_speed(self, item: Item) -> None:
        """Change the speed of the legs that follow.

        Raises:
            ScenarioError: it is no speed of a vehicle.
        """
        speed = item.params[1]
        if speed == _OWN_SPEED:
            self.speed = self.own_speed
        elif speed > 0.0:
            if not SLOWEST <= speed <= FASTEST:
                expected = f"a speed from {SLOWEST:g} to {FASTEST:g} m/s"
                raise ScenarioError(str(item), speed, expected)
            self.speed = speed
        elif speed != _SAME_SPEED:
            self.skipped.append(f"the speed of {item}, {speed:g} m/s")

    def _placed(self, item: Item) -> FloatArray:
        """Return the place of an item, and note a height far from home's or what is not given."""
        place = item.geodetic(self.home, self.place)
        if np.isnan(item.params[6]) and item.command not in _TAKEOFFS:
            self.missing.append(f"{item}, altitude")
        if not (item.is_placed or item.command in (*_TAKEOFFS, LAND, VTOL_LAND)):
            self.missing.append(f"{item}, latitude and longitude")
        if (depth := self.home.altitude - place[2]) > _BELOW:
            self.below.append(f"{item} by {depth:.4g} m")
        if -depth > _HIGHEST:
            self.above.append(f"{item} at {-depth:.0f} m")
        return place

    def _in_air(self, item: Item) -> FloatArray:
        """Return the place of an item that is no landing, and note a height of zero above home."""
        place = self._placed(item)
        if item.command == PAYLOAD_PLACE:  # flown to, as a landing, at the present altitude
            place[2] = self.place[2]
        elif item.params[6] == 0.0 and item.frame in RELATIVE and self.place[2] > place[2]:
            self.level.append(str(item))
        return place

    def _ground(self, item: Item) -> FloatArray:
        """Return the place of a landing.

        Raises:
            ScenarioError: its altitude is 0 above mean sea level, far below home: autopilots land
                wherever the ground is, and files have this where nobody gave its altitude.
        """
        place = self._placed(item)
        depth = self.home.altitude - place[2]
        if item.frame in AMSL and item.params[6] == 0.0 and depth > _BELOW:
            got = Description(f"0 m above mean sea level, {depth:.4g} m below home")
            raise ScenarioError(str(item), got, "the altitude of its ground")
        return place

    def _take_off(self, item: Item) -> None:
        """Go to the place of a take-off.

        Raises:
            ScenarioError: it is below home.
        """
        before, place = self.place[2], self._placed(item)
        if (depth := self.home.altitude - place[2]) > _BELOW:
            got = Description(f"an altitude {depth:.4g} m below home")
            raise ScenarioError(str(item), got, f"a take-off above {self.home}")
        if not place[2] > before:
            self.skipped.append(f"the climb of {item}, whose altitude is not above the present one")
        self._go(item.name, place)

    def _pass(self, item: Item) -> None:
        """Go to the place of an item, and stay as long as it holds.

        Raises:
            ScenarioError: it holds for less than no time.
        """
        hold = item.params[0] if item.command in _HOLDING else 0.0
        if hold < 0.0:
            raise ScenarioError(f"{item}, hold time", hold, "at least 0 s")
        self._go(item.name, self._in_air(item))
        if hold > 0.0:
            self._wait(hold)
        if item.command in _PARTS:
            self.skipped.append(f"the {_PARTS[item.command]} of {item}")

    def _descend(self, item: Item, ground: FloatArray) -> None:
        """Go above a place at the present altitude, stop there, and descend to it."""
        above = np.array([*ground[:2], max(self.place[2], ground[2])])
        if ground[2] > max(self.place[2], self.home.altitude) + LEVEL:
            self.skipped.append(f"the descent of {item}, whose altitude is above the present one")
        self._go(item.name, above)
        if self.stops:
            self.stops[-1] = dataclasses.replace(self.stops[-1], rest=True)
        self._go(f"{item.name}, ground", ground)

    def _wait(self, seconds: float) -> None:
        """Rest at the last place, but not at the start."""
        if self.stops:
            last = self.stops[-1]
            if not last.dwell + seconds <= _LONGEST:
                raise ScenarioError(last.name, seconds, f"at most {_LONGEST:g} s at rest")
            self.stops[-1] = dataclasses.replace(last, dwell=last.dwell + seconds)

    def _go(self, name: str, place: FloatArray) -> None:
        """Add a place, unless the vehicle is there."""
        self.place, position = place, self.origin.local(*place)
        if not np.linalg.norm(position - self.start) <= _FARTHEST:
            near = f"a place within {_FARTHEST / 1000.0:g} km of home, {self.home}"
            expected = f"{near}, or another home=Frame(latitude, longitude, ...)"
            raise ScenarioError(name, place.tolist(), expected)
        before = self.stops[-1].position if self.stops else self.start
        if np.linalg.norm(position - before) > SAME_PLACE:
            self.stops.append(Stop(name, position, self.speed))
