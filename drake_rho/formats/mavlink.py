"""MAVLink's mission files (.waypoints, .txt): `QGC WPL 110`, then an item in each line.

A line has twelve columns: number, current, frame, command, four parameters, latitude, longitude,
altitude, autocontinue. Item 0 is home, in any frame: ground stations write it, and ArduPilot takes
it so. Fences are items too, in files of their own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from drake_rho.formats.mission_items import (
    AMSL,
    MOST_ITEMS,
    RELATIVE,
    TERRAIN,
    WAYPOINT,
    Fence,
    Item,
    MissionFile,
)
from drake_rho.formats.written_missions import MissionFormat, WrittenMission
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST
from drake_rho.scenario.frame import Frame

HEADER = "QGC WPL"
_VERSION = "110"
_COLUMNS = (
    *("number", "current", "frame", "command", "parameter 1", "parameter 2", "parameter 3"),
    *("parameter 4", "latitude", "longitude", "altitude", "autocontinue"),
)
_WHOLE = {0, 2, 3}
"""Columns with whole numbers."""
_POLYGONS, _CIRCLES = {5001: True, 5002: False}, {5003: True, 5004: False}
"""Commands of fences, with whether vehicles stay inside."""


def parse_waypoints(text: str) -> MissionFile:
    """Return the content of a mission file.

    Raises:
        ScenarioError: a line is not an item; the field names line and column.
    """
    header, *lines = text.split("\n")
    if (version := header.strip().removeprefix(HEADER).strip()) != _VERSION:
        expected = f"{HEADER} {_VERSION}, the version that is read"
        raise ScenarioError("line 1", Description(f"version {version}"), expected)
    rows = [(number, line.split()) for number, line in enumerate(lines, start=2)]
    rows = [(number, row) for number, row in rows if row and not row[0].startswith("#")]
    if len(rows) > MOST_ITEMS:
        raise ScenarioError("", Description(f"{len(rows)} items"), f"at most {MOST_ITEMS}")
    items = [_item(number, row) for number, row in rows]
    fences = tuple(_fences(items))
    items = [each for each in items if each.command not in _POLYGONS | _CIRCLES]
    if not _begins_at_home(items):
        return MissionFile(tuple(items), fences=fences)
    first, *after = items
    return dataclasses.replace(_homed(first), items=tuple(after), fences=fences)


def _item(line: int, row: Sequence[str]) -> Item:
    if len(row) != len(_COLUMNS):
        expected = f"{len(_COLUMNS)}: {', '.join(_COLUMNS)}"
        raise ScenarioError(f"line {line}", Description(f"{len(row)} columns"), expected)
    values = [_number(line, column, cell) for column, cell in enumerate(row)]
    name, frame, command = f"item {values[0]:.0f}", int(values[2]), int(values[3])
    return Item(name, command, frame, tuple(values[4:11]))


def _number(line: int, column: int, cell: str) -> float:
    where = f"line {line}, column {column + 1} ({_COLUMNS[column]})"
    try:
        value = float(cell)
    except ValueError:
        raise ScenarioError(where, cell, "a number") from None
    if column in _WHOLE and not (0.0 <= value <= 65535.0 and value.is_integer()):
        raise ScenarioError(where, cell, "a whole number from 0 to 65535")
    if abs(value) > LARGEST:  # NaN is a parameter that is not given
        raise ScenarioError(where, cell, f"a number of at most {LARGEST:g}")
    return value


def _begins_at_home(items: Sequence[Item]) -> bool:
    """Return whether the first item is home: not if it is the only one, relative to home."""
    if not items or items[0].name != "item 0" or items[0].command not in (0, WAYPOINT):
        return False
    frame = items[0].frame
    return frame in AMSL or (frame in (*RELATIVE, *TERRAIN) and len(items) > 1)


def _homed(first: Item) -> MissionFile:
    """Return a mission without items at the place of a first item, which may be 0, 0 for none.

    Its altitude is above mean sea level in any frame. Only 0 relative to home or to the terrain
    stands for an altitude that nobody gave.
    """
    latitude, longitude, altitude = first.params[4:]
    if not (latitude or longitude):  # home is not known yet
        return MissionFile(())
    place = dataclasses.replace(first, frame=AMSL[0]).geodetic(Frame(0.0, 0.0), np.zeros(3))
    unknown = np.isnan(altitude) or (altitude == 0.0 and first.frame not in AMSL)
    home = Frame(float(place[0]), float(place[1]), 0.0 if unknown else altitude)
    if unknown:
        return MissionFile((), home, f"{first}, altitude above mean sea level")
    passed = () if first.frame in AMSL else (f"{first} as a place to pass: the first row is home",)
    return MissionFile((), home, skipped=passed)


def _fences(items: Sequence[Item]) -> Iterator[Fence]:
    """Yield the fences among items; the first parameter is a radius or the number of corners.

    Raises:
        ScenarioError: a circle has no radius, or a polygon has fewer corners than it says.
    """
    words, number = {True: "inclusion", False: "exclusion"}, 0
    corners = list[Item]()
    for item in items:
        if corners and (item.command, item.params[0]) != (corners[0].command, corners[0].params[0]):
            break
        if item.command in _CIRCLES:
            number += 1
            inside = _CIRCLES[item.command]
            if not 1.0 / LARGEST <= item.params[0] <= 1e6:
                raise ScenarioError(f"{item.name}, radius", item.params[0], "metres above 0")
            center = np.array([item.params[4:6]])
            yield Fence(f"{words[inside]} circle {number}", inside, center, item.params[0])
        elif item.command in _POLYGONS:
            corners.append(item)
            if len(corners) >= max(item.params[0], 3.0):
                number, inside = number + 1, _POLYGONS[item.command]
                places = np.array([each.params[4:6] for each in corners])
                yield Fence(f"{words[inside]} polygon {number}", inside, places)
                corners = []
    if corners:
        count = corners[0].params[0]
        enough = f"{count:g} corners, as its first parameter says"
        expected = enough if count >= 3.0 else "at least 3 corners"  # it may be NaN
        got = Description(f"a polygon of {len(corners)} corners")
        raise ScenarioError(corners[0].name, got, expected)


class Mavlink(MissionFormat):
    """Mission of a vehicle, with altitudes relative to where it starts."""

    name = "mavlink"
    endings = (".waypoints",)
    has_fences = False  # they are items of files of their own

    def text(self, mission: WrittenMission) -> str:
        """Return the content of a vehicle's file."""
        home = Item("item 0", WAYPOINT, 0, (0.0, 0.0, 0.0, 0.0, *mission.home))
        rows = [_row(number, each) for number, each in enumerate([home, *mission.items])]
        return "\n".join([f"{HEADER} {_VERSION}", *rows, ""])


def _row(number: int, item: Item) -> str:
    """Return the line of an item; 1e-10 of a degree are a hundredth of a millimetre."""
    params = [0.0 if np.isnan(each) else each for each in item.params]
    places = [f"{each:.10f}" for each in params[4:6]]
    numbers = [*(f"{each:.6f}" for each in params[:4]), *places, f"{params[6]:.6f}"]
    head = [number, int(number == 0), item.frame, item.command]
    return "\t".join([*map(str, head), *numbers, "1"])
