"""Skybrush compiled shows (.skyc): Bézier segments of every vehicle in one archive.

An archive (zip) holds `show.json`, which lists the drones and refers to further JSON files in the
archive by `{"$ref": "./drones/1/trajectory.json#"}`. A trajectory is a list of points
[time, position, control points of the segment that ends there], times in s, positions in m. Players
take times to the millisecond.
"""

from __future__ import annotations

import base64
import io
import json
import lzma
import zipfile
import zlib
from collections.abc import Iterator
from itertools import pairwise
from math import comb
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from drake_rho.formats.beziers import Segments, as_segments
from drake_rho.formats.folders import write_archive
from drake_rho.formats.format import Format, exported, planned
from drake_rho.formats.lights import Lights, lights_of
from drake_rho.formats.record import Exported
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading, directions_of, headings
from drake_rho.motion.plan import Plan
from drake_rho.motion.polynomials import Polynomials
from drake_rho.scenario.errors import shorten
from drake_rho.scenario.fields import LARGEST, FloatArray, IntArray
from drake_rho.system.files import LARGEST_TEXT

_HEADING_STEP = 100
"""Time between two headings, which players join by straight lines [ms]."""
_HIGHEST = 7
"""Highest degree of a segment that is read."""
_LIGHT_STEP = 0.02
"""Unit of times in light programs [s]."""
_END, _SET_COLOUR, _FADE_TO_COLOUR = 0, 4, 8
"""Commands of light programs; colours have red, green, blue and the number of units they last."""


class Skyc(Format):
    """Bézier segments, with lights, and headings if any are given."""

    name = "skyc"
    endings = (".skyc",)
    rated = False
    content = "quadratic or cubic Bézier segments, headings, lights"
    heading = "any"
    read_by = "rho.load_trajectories(path)"
    reads = "a compiled show of Skybrush"
    from_zero = True

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write a trajectory and a light program for each vehicle.

        The steps of a plan are quadratic segments, and those of a smooth motion with one average
        cubic ones. They are exact if all of them begin and end at whole milliseconds. Otherwise
        cubic segments have the motion's positions and velocities at whole milliseconds.

        Raises:
            ValueError: the motion is a simulation, or a flight that jumps.
        """
        plan = planned(flown, self.name)
        segments = as_segments(plan)
        yaws = None if heading is None else _yaws(plan, segments.ticks, heading)
        contents = dict(_contents(plan, segments, yaws))
        write_archive(path, {name: _text(each) for name, each in contents.items()})
        words = f"{len(segments.ticks) - 1} Bézier segments of each vehicle"
        return exported(flown, path, [path], words, segments.deviations)

    def recognises(self, content: bytes) -> bool:
        """Return whether the content is an archive."""
        return content.startswith(b"PK")

    def read(self, content: bytes, name: str) -> dict[str, Polynomials]:
        """Return the motions of a show's drones; one without a name is called "drone 1" and so on.

        Nothing outside the archive is read, and sizes are bounded before anything is inflated.

        Raises:
            ValueError: the archive is damaged, too large or not of version 1, or refers to files
                that are not in it.
        """
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                return _trajectories(_Documents(archive))
        except _DAMAGES as error:
            raise ValueError(f"not a Skybrush show, or damaged ({error})") from None


def _yaws(plan: Plan, ticks: IntArray, heading: Heading) -> list[list[list[float]]]:
    """Return times [s] and headings from the x axis, clockwise [deg], of each vehicle."""
    at = np.append(np.arange(0, ticks[-1], _HEADING_STEP), ticks[-1])
    directions = directions_of(plan.scenario.names, heading)
    found = headings(plan, at / 1000.0 - plan.scenario.lead, directions)
    degrees = 0.0 - np.rad2deg(found)
    return [np.stack([at / 1000.0, each], axis=1).tolist() for each in degrees]


def _contents(
    plan: Plan, segments: Segments, yaws: list[list[list[float]]] | None
) -> Iterator[tuple[str, object]]:
    """Yield the names and documents of an archive's files."""
    drones, lights = [], lights_of(plan.scenario)
    for i, name in enumerate(plan.scenario.names):
        points = _points(segments, i)
        home, landing = points[0][1], points[-1][1]
        folder = f"drones/{i + 1}"
        yield f"{folder}/trajectory.json", {"version": 1, "takeoffTime": 0.0, "points": points}
        yield f"{folder}/lights.json", {"version": 1, "data": _program(lights[i])}
        settings = {"name": name, "home": home, "landAt": landing} | {
            key: {"$ref": f"./{folder}/{key}.json#"} for key in ("trajectory", "lights")
        }
        if yaws is not None:
            settings["yawControl"] = {"version": 1, "setpoints": yaws[i]}
        drones.append({"type": "generic", "settings": settings})
    yield (
        "show.json",
        {
            "version": 1,
            "environment": {"type": "outdoor"},
            "meta": {"title": plan.scenario.name},
            "swarm": {"drones": drones},
        },
    )


def _points(segments: Segments, vehicle: int) -> list[list[Any]]:
    """Return a vehicle's points: time, position, control points of the segment that ends there."""
    times, positions = (segments.ticks / 1000.0).tolist(), segments.positions[vehicle].tolist()
    control = [[], *segments.control[vehicle].tolist()]
    return [list(each) for each in zip(times, positions, control, strict=True)]


def _program(lights: Lights) -> str:
    """Return the light program of one vehicle, with times rounded to 20 ms."""
    ticks = np.rint(lights.times / _LIGHT_STEP).astype(np.int64)
    program, before = bytearray(), np.full(3, -1.0)
    for lasting, colour in zip(np.diff(ticks, prepend=0), lights.colours, strict=True):
        if lasting > 0:
            command = _SET_COLOUR if np.array_equal(colour, before) else _FADE_TO_COLOUR
            program += bytes([command, *colour.astype(int)]) + _number(int(lasting))
        before = colour
    return base64.b64encode(bytes([*program, _END])).decode()


def _number(value: int) -> bytes:
    """Return a number in groups of seven bits, the lowest first."""
    digits = bytearray()
    while value > 127:
        digits.append(value & 127 | 128)
        value >>= 7
    return bytes([*digits, value])


def _text(document: object) -> bytes:
    """Return a document as JSON, the same for the same document."""
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()


_DAMAGES = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError)
"""Errors of damaged archives; RuntimeError of encrypted, unsupported or deeply nested ones too."""


class _Documents:
    """JSON files of an archive, whose sizes together are bounded."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive, self._left = archive, LARGEST_TEXT

    def read(self, name: str) -> Any:
        """Return the content of a file in the archive, by its path or a reference to it.

        Raises:
            ValueError: there is no such file, it is too large, or it is no JSON.
        """
        name = unquote(name.removesuffix("#").removeprefix("./"))
        if name not in self._archive.NameToInfo:
            raise ValueError(f"got a reference to {shorten(name)}, expected a file in the archive")
        self._left -= self._archive.getinfo(name).file_size  # no more than that is inflated
        if self._left < 0:
            raise ValueError(f"more than {LARGEST_TEXT} bytes, inflated")
        try:
            return json.loads(self._archive.read(name), parse_constant=_no_number)
        except ValueError as error:
            raise ValueError(f"{name}: not valid JSON: {error}") from None


def _no_number(word: str) -> float:
    """Refuse NaN and infinities, which are no JSON."""
    raise ValueError(f"got {word}, expected a finite number")


def _trajectories(documents: _Documents) -> dict[str, Polynomials]:
    """Return the trajectories of a show by name.

    Raises:
        ValueError: the documents are not those of a show of version 1.
    """
    found = dict[str, Polynomials]()
    for number, drone in enumerate(_drones(documents.read("show.json")), start=1):
        settings = drone.get("settings") if isinstance(drone, dict) else None
        if not isinstance(settings, dict):
            raise ValueError(f"drone {number}: got no settings, expected a trajectory in them")
        name, trajectory = settings.get("name", f"drone {number}"), settings.get("trajectory")
        if isinstance(trajectory, dict) and isinstance(link := trajectory.get("$ref"), str):
            trajectory = documents.read(link)
        if not isinstance(name, str) or name in found:
            raise ValueError(
                f"drone {number}: got the name {shorten(name)}, expected one of its own"
            )
        try:
            found[name] = _polynomials(trajectory)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"drone {number}: not a trajectory of version 1: {error}") from None
    return found


def _drones(show: Any) -> list[Any]:
    """Return the drones of a show.

    Raises:
        ValueError: it is not a show of version 1 with a drone.
    """
    swarm = show.get("swarm") if isinstance(show, dict) and show.get("version") == 1 else None
    drones = swarm.get("drones") if isinstance(swarm, dict) else None
    if not isinstance(drones, list) or not drones:
        raise ValueError("show.json: not a show of version 1 with drones")
    return drones


def _polynomials(trajectory: Any) -> Polynomials:
    """Return the motion of a trajectory.

    Raises:
        KeyError, TypeError, ValueError: it is not a trajectory of version 1.
    """
    if trajectory["version"] != 1:
        raise ValueError(f"got version {shorten(trajectory['version'])}")
    points = trajectory["points"]
    times = np.array([time for time, _, _ in points], dtype=np.float64)
    corners = [[before[1], *now[2], now[1]] for before, now in pairwise(points)]
    if len(points) < 2 or points[0][2]:
        raise ValueError("expected two points or more, the first without control points")
    if not np.all(np.diff(times) > 0.0):
        raise ValueError("expected increasing times")
    degree = max(map(len, corners)) - 1
    if degree > _HIGHEST:
        raise ValueError(f"got a segment of degree {degree}, expected at most {_HIGHEST}")
    coefficients = np.zeros((len(corners), 3, degree + 1))
    for own, each, lasting in zip(coefficients, corners, np.diff(times), strict=True):
        own[:, : len(each)] = _powers(each, lasting)
    start = float(trajectory.get("takeoffTime", 0.0))
    return Polynomials(start + times, coefficients[None])


def _powers(corners: list[list[float]], lasting: float) -> FloatArray:
    """Return the coefficients of a Bézier curve of D + 1 control points, shape (3, D + 1).

    They are of the powers of the time since it began, and of a curve that lasts for a time [s].
    """
    points = np.array(corners, dtype=np.float64)
    if points.shape[1:] != (3,):
        raise ValueError(f"got points of shape {points.shape[1:]}, expected x, y, z")
    if not np.abs(points).max() <= LARGEST:
        raise ValueError(f"expected numbers up to {LARGEST:g}")
    degree = len(points) - 1
    differences = (np.diff(points, k, axis=0)[0] for k in range(degree + 1))
    scaled = [comb(degree, k) * each / lasting**k for k, each in enumerate(differences)]
    return np.stack(scaled, axis=-1)
