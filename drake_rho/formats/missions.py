"""`load_mission`: missions of ground stations as scenarios."""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from drake_rho.formats.fences import Zones, zones_of
from drake_rho.formats.mavlink import HEADER, parse_waypoints
from drake_rho.formats.mission_items import AMSL, Item, MissionFile
from drake_rho.formats.qgroundcontrol import parse_plan
from drake_rho.formats.routes import GROUND, LEVEL, PLACED, ROOM, Route, Stop, no_place, route_of
from drake_rho.formats.schedules import Pace, arrivals, step_for
from drake_rho.formats.texts import another_file, in_file, text_of, text_or_none
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, MissionWarning, ScenarioError, shorten
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.frame import EARTH_RADIUS, Frame
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import GOAL, START
from drake_rho.scenario.records import (
    Grid,
    HalfSpace,
    KeepIn,
    Limits,
    Polytope,
    Scenario,
    Sphere,
    State,
    Vehicle,
    Waypoint,
)

SPEED, ACCELERATION = 5.0, 2.5
"""Largest speed on legs without one [m/s], and acceleration [m/s²], if no limits are given."""
_LONGEST_NAME = 72
"""Characters of a file's name that a vehicle has; names have at most 80, a number included."""
_SAGS = 0.1
"""Difference of a level from one of constant altitude at which a warning is given [m]."""
_ABOVE = 50.0
"""Distance of the ceiling above the highest place [m], since zones have no end in height."""
_ON_LEG = np.linspace(0.0, 1.0, 101)[:, None]
"""Fractions of a leg at which it is compared with zones."""
_MOST_PAIRS = 10_000_000
"""Largest number of places times obstacles: every place is compared with every obstacle."""
_ENDINGS = ".plan", ".waypoints"
_PLAN = re.compile(r'"fileType"\s*:\s*"(Plan|Mission)"|"MAV_AUTOPILOT"\s*:')
"""Keys of plans, and of older missions, which are refused by name."""


@checked
def load_mission(
    path: str | Path | Sequence[str | Path],
    *,
    limits: Limits | None = None,
    home: Frame | None = None,
    grid: Grid | None = None,
) -> Scenario:
    """Read a mission of QGroundControl (`.plan`) or MAVLink (`.waypoints`), found by its content.

    The vehicle starts at rest at home, named after the file. Waypoints, take-offs and loiters are
    passed, for as long as they hold; before a landing or return it stops above the ground. The
    last place is the goal. Changes of speed limit the legs that follow, and so does the speed of a
    plan. Fences are requirements (inclusion) and obstacles (exclusion), and nothing is flown more
    than a metre below the lowest place or, with zones that are polygons, 50 m above the highest.
    Positions are metres east, north and up of home, which is `Scenario.frame`.

    Without a grid, every waypoint has a time: each leg gets as long as from rest to rest along a
    straight line within the limits, longer by the way around zones on it.
    `plan_minimum_time` finds the least time of a mission whose waypoints have none.

    Args:
        path: path of the file, or of several, one for each vehicle; the first has the origin.
        limits: limits of all vehicles; if not given, the largest speed in the file, else 5 m/s, and
            2.5 m/s². Without them, legs for which the file gives no speed have at most 5 m/s.
        home: place of the launch and level of relative altitudes; the file's if not given.
        grid: knots and step, with which waypoints have no times: planning finds them, which may
            take minutes for eight.

    Warns:
        MissionWarning: items are left out, by number and command, as those after a return; the
            file has no home, or no altitude of it; an item has no place or altitude; a place is
            more than a metre below home or 10 km above it, or a waypoint at home's level; or the
            mission is so far from home that a level differs from constant altitude by 0.1 m.

    Raises:
        ScenarioError: a file cannot be read or is malformed, an altitude is above the terrain, or
            above mean sea level where home's is missing, a take-off is below home, a landing far
            below it at sea level, an item is flown after a landing, there is no place to fly to, a
            scenario cannot represent an item, or the extra `missions` is not installed. The error's
            field names file and item.
    """
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(each) for each in path]
    if not paths:
        raise ScenarioError("path", [], "at least one file")
    missions = [_read(each) for each in paths]
    homes = [_home(*pair, home) for pair in zip(paths, missions, strict=True)]
    flights = list[_Flight]()
    names = _names(paths)
    for file, mission, own, name in zip(paths, missions, homes, names, strict=True):
        with in_file(file):
            route = route_of(mission, own, homes[0])
        flights.append(_Flight(file, name, route, Zones((), ())))
        for note in _notes(mission, None if home is not None else own, flights[-1]):
            # at the caller of this function, which `checked` calls
            warnings.warn(MissionWarning(f"{file}: {note}"), stacklevel=3)
    floor, ceiling = _heights(flights)
    for k, mission in enumerate(missions):
        with in_file(paths[k]):
            zones = zones_of(mission.fences, homes[0], (floor - 1.0, ceiling + 1.0))
        flights[k] = dataclasses.replace(flights[k], zones=zones)
    return _scenario(flights, limits, grid, homes[0])


def is_mission(path: str | Path) -> bool:
    """Return whether a file holds a mission of a ground station, or ends like one that does.

    It may be malformed, or missing.
    """
    if Path(path).suffix.lower() in _ENDINGS:
        return True
    text = text_or_none(path) or ""
    return text.startswith(HEADER) or (
        text.lstrip().startswith("{") and _PLAN.search(text) is not None
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Flight:
    """Mission of a vehicle."""

    file: Path
    name: str
    route: Route
    zones: Zones

    def lengths(self, obstacles: Sequence[Obstacle]) -> list[float]:
        """Return the lengths of the legs, with the ways around obstacles on them [m]."""
        places = self.positions
        legs, middles = np.diff(places, axis=0), 0.5 * (places[:-1] + places[1:])
        found = np.linalg.norm(legs, axis=1)
        halves = 0.5 * found
        for each in obstacles:
            shape = each.shape
            for k in np.flatnonzero(shape.signed_distance(middles) <= halves):  # others are away
                if (shape.signed_distance(places[k] + _ON_LEG * legs[k]) < 0.0).any():
                    found[k] += 2.0 * float(np.hypot(*shape.extent[:2]))
        return [float(each) for each in found]

    def no_faster(self, speed: float) -> _Flight:
        """Return the mission with a largest speed [m/s] on legs that have none."""
        stops = (
            dataclasses.replace(each, speed=speed if each.speed is None else each.speed)
            for each in self.route.stops
        )
        return dataclasses.replace(self, route=dataclasses.replace(self.route, stops=tuple(stops)))

    @property
    def positions(self) -> FloatArray:
        """Start and places [m], shape (M + 1, 3)."""
        return np.array([self.route.start, *(each.position for each in self.route.stops)])

    @property
    def speeds(self) -> list[float | None]:
        """Largest speeds on the legs [m/s]."""
        return [stop.speed for stop in self.route.stops]


def _read(path: Path) -> MissionFile:
    """Return a parsed mission file of either format."""
    with in_file(path):
        text = text_of(path, "mission (.plan or .waypoints)")
        if text.startswith(HEADER):
            return parse_waypoints(text)
        if text.lstrip().startswith("{"):
            return parse_plan(text)
        expected = "a plan of QGroundControl (JSON) or a mission of MAVLink (QGC WPL 110)"
        raise ScenarioError("", another_file(text), expected)


def _home(path: Path, mission: MissionFile, given: Frame | None) -> Frame:
    """Return the place of the launch, or of the first item on the map if there is none.

    Raises:
        ScenarioError: there is none, or nothing to fly to from there, or items are above mean sea
            level and its altitude is missing.
    """
    if given is not None:
        return given
    found, unknown = mission.home, mission.no_altitude or ("" if mission.home else "home")
    if unknown and (item := _above_sea(mission)) is not None:
        expected = f"the altitude of home, or home=Frame(...): {item} is above mean sea level"
        raise ScenarioError(f"{path}: {unknown}", Description("nothing"), expected)
    if found is not None:
        return found
    if (first := _first_placed(mission)) is not None:
        return Frame(*first.params[4:6])
    if not any(each.command in PLACED for each in mission.items):
        with in_file(path):
            raise no_place([*mission.skipped, *map(str, mission.items)])
    expected = "one in the file, or home=Frame(latitude, longitude, ...)"
    raise ScenarioError(str(path), Description("no home"), expected)


def _first_placed(mission: MissionFile) -> Item | None:
    """Return the first item with a place on the map."""
    for item in mission.items:
        latitude, longitude = item.params[4:6]
        if abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and (latitude or longitude):
            return item
    return None


def _above_sea(mission: MissionFile) -> Item | None:
    """Return the first item that is flown to at an altitude above mean sea level."""
    placed = (each for each in mission.items if each.command in PLACED and each.frame in AMSL)
    return next((each for each in placed if not np.isnan(each.params[6])), None)


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the names of vehicles after their files, numbered where equal."""
    names = list[str]()
    for path in paths:
        stem = "".join(each for each in path.stem if each.isprintable())
        name = stem[:_LONGEST_NAME].strip() or "vehicle"
        number = 1
        while (own := name if number == 1 else f"{name}-{number}") in names:
            number += 1
        names.append(own)
    return names


def _notes(mission: MissionFile, home: Frame | None, flight: _Flight) -> Iterator[str]:
    """Yield warnings of omissions and assumptions in reading a mission.

    Args:
        mission: content of the file.
        home: place of the launch that was taken from the file; None if it was given.
        flight: the same mission as a route.
    """
    if home is not None and mission.no_altitude:
        yield f"{mission.no_altitude} is missing, so that home is taken to be at altitude 0"
    elif home is not None and mission.home is None:
        yield f"no home, so that of {_first_placed(mission)} at altitude 0 is taken"
    yield from (f"{what}: {_listed(each)}" for what, each in flight.route.notes.items() if each)
    away = float(np.hypot(*flight.positions[:, :2].T).max())
    if (sag := away**2 / (2.0 * EARTH_RADIUS)) > _SAGS:
        yield f"{away:.0f} m from the origin, constant z is {sag:.2g} m above its altitude"


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - 20} more" if len(items) > 20 else ""
    return f"{', '.join(items[:20])}{more}"


def _scenario(
    flights: Sequence[_Flight], limits: Limits | None, grid: Grid | None, origin: Frame
) -> Scenario:
    _check_size(flights)
    obstacles = list[Obstacle]()
    for each in flights:
        obstacles += [zone for zone in each.zones.obstacles if zone not in obstacles]
    if limits is None:
        speeds = [most for each in flights for most in each.speeds if most is not None]
        limits = Limits(max_speed=max(speeds, default=SPEED), max_acceleration=ACCELERATION)
        flights = [each.no_faster(SPEED) for each in flights]
    pace, lengths = Pace.of(limits), [each.lengths(obstacles) for each in flights]
    times = None
    if grid is None:
        with in_file(flights[0].file):
            grid, times = _scheduled(flights, lengths, pace)
    vehicles = [
        _vehicle(each, None if times is None else times[k]) for k, each in enumerate(flights)
    ]
    requirements = [own for each in flights for own in _requirements(each, pace, len(flights))]
    floor, ceiling = _heights(flights)
    requirements.append(KeepIn(HalfSpace([0.0, 0.0, -1.0], -floor), name="floor"))
    if any(isinstance(each.shape, Polytope) for each in obstacles):  # nobody flies over them
        requirements.append(KeepIn(HalfSpace([0.0, 0.0, 1.0], ceiling), name="ceiling"))
    try:
        name = " and ".join(each.name for each in flights[:3])[:_LONGEST_NAME].strip()
        return Scenario(
            name, grid, vehicles, limits, obstacles, requirements=requirements, frame=origin
        )
    except ScenarioError as error:
        raise _at_item(flights, error) from None


def _check_size(flights: Sequence[_Flight]) -> None:
    """Check that places can be compared with zones in reasonable time.

    Raises:
        ScenarioError: there are too many of both.
    """
    places = sum(len(each.route.stops) for each in flights)
    zones = sum(len(each.zones.obstacles) for each in flights)
    if places * zones > _MOST_PAIRS:
        got = Description(f"{places} places and {zones} parts of fences")
        expected = f"at most {_MOST_PAIRS} pairs of them"
        raise ScenarioError(str(flights[0].file), got, expected)


def _heights(flights: Sequence[_Flight]) -> tuple[float, float]:
    """Return the heights between which all fly [m]."""
    heights = np.concatenate([each.positions[:, 2] for each in flights])
    return float(heights.min()) - ROOM, float(heights.max()) + _ABOVE


def _scheduled(
    flights: Sequence[_Flight], lengths: Sequence[Sequence[float]], pace: Pace
) -> tuple[Grid, list[list[float]]]:
    """Return a grid, and the times of all places of each vehicle [s]."""
    seconds = [
        sum(pace.times(own, each.speeds)) + sum(stop.dwell for stop in each.route.stops)
        for each, own in zip(flights, lengths, strict=True)
    ]

    def knots(step: float) -> list[IntArray]:
        found = list[IntArray]()
        for each, own in zip(flights, lengths, strict=True):
            rests = [int(np.ceil(stop.dwell / step - 1e-9)) for stop in each.route.stops]
            found.append(arrivals(pace.steps(step, own, each.speeds), rests))
        return found

    step = step_for(max(seconds), lambda step: max(int(each[-1]) for each in knots(step)))
    found = [(step * each).tolist() for each in knots(step)]
    return Grid(step, round(max(times[-1] for times in found) / step) + 1), found


def _vehicle(flight: _Flight, times: Sequence[float] | None) -> Vehicle:
    """Return a vehicle, whose waypoints have no times if none are given."""
    stops = flight.route.stops
    waypoints = [
        Waypoint(
            None if times is None else times[k],
            stop.position,
            velocity=np.zeros(3) if stop.rest and not stop.dwell else None,
            dwell=stop.dwell,
            name=stop.name,
        )
        for k, stop in enumerate(_distinct(stops[:-1]))
    ]
    start, goal = State(flight.route.start), State(stops[-1].position)
    return Vehicle(flight.name, start, goal, waypoints=waypoints)


def _distinct(stops: Sequence[Stop]) -> list[Stop]:
    """Return stops with different names: an item number may be there twice."""
    names, found = set[str](), list[Stop]()
    for stop in stops:
        name, number = stop.name, 1
        while name in names:
            number += 1
            name = f"{stop.name}, {number}"
        names.add(name)
        found.append(dataclasses.replace(stop, name=name))
    return found


def _requirements(flight: _Flight, pace: Pace, count: int) -> Iterator[KeepIn]:
    """Yield inclusion fences, the ground of a landing, and the speeds on legs below the others."""
    who = None if count == 1 else (flight.name,)
    for fence in flight.zones.requirements:
        yield dataclasses.replace(fence, vehicles=who)
    names = [START, *(each.name for each in _distinct(flight.route.stops[:-1])), GOAL]
    above, ground = flight.positions[-2:, 2]
    if flight.route.lands and above > ground > flight.route.start[2] + LEVEL:
        floor, descent = HalfSpace([0.0, 0.0, -1.0], ROOM - ground), (names[-2], GOAL)
        yield KeepIn(floor, vehicles=(flight.name,), between=descent, name=GROUND)
    speeds, first = flight.speeds, 0
    for k, speed in enumerate(speeds):
        if k + 1 < len(speeds) and speeds[k + 1] == speed:
            continue
        if speed is not None and speed < pace.speed:
            ball, legs = Sphere(np.zeros(3), speed), (names[first], names[k + 1])
            own, name = (flight.name,), f"{speed:g} m/s"
            yield KeepIn(ball, of="velocity", vehicles=own, between=legs, name=name)
        first = k + 1


_PART = re.compile(r"^(?:scenario\.)?vehicles\[(\d+)\]\.(start|goal|waypoints\[(\d+)\])")
_LONG = re.compile(r"-?\d+\.\d{5,}")
"""Numbers with digits that say nothing: metres of a projection."""


def _at_item(flights: Sequence[_Flight], error: ScenarioError) -> ScenarioError:
    """Return the error with file and item in place of the scenario's field."""
    if (found := _PART.match(error.field)) is None:
        return error
    flight = flights[int(found[1])]
    index = -1 if found[2] == "goal" else int(found[3] or 0)
    item = "home" if found[2] == "start" else flight.route.stops[index].name
    got, expected = (
        _LONG.sub(lambda digits: str(float(f"{float(digits[0]):.4g}")), text)
        for text in (shorten(error.value), error.expected)
    )
    return ScenarioError(f"{flight.file}: {item}", Description(got), expected)
