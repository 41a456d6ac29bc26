"""Skybrush compiled shows (.skyc): Bézier segments of every vehicle in one archive.

An archive (zip) holds `show.json`, which lists the drones and refers to further JSON files in the
archive by `{"$ref": "./drones/1/trajectory.json#"}`. A trajectory is a list of points
[time, position, control points of the segment that ends there], times in s, positions in m. Players
take times to the millisecond.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from math import comb
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from drake_rho.formats.archives import Members, is_archive, open_archive
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

SHOW = "show.json"
"""File of an archive that lists the drones."""
_HEADING_STEP = 100
"""Time between two headings, which players join by straight lines [ms]."""
_HIGHEST = 7
"""Highest degree of a segment that is read."""
_MOST_SEGMENTS = 5_000_000
"""Largest number of segments of all drones that is read: 5000 drones with 1000 each."""
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
    tick = 1e-3

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
        return is_archive(content)

    def read(self, content: bytes, name: str) -> dict[str, Polynomials]:
        """Return the motions of a show's drones; one without a name is called "drone 1" and so on.

        Nothing outside the archive is read, and sizes are bounded before anything is inflated.

        Raises:
            ValueError: the archive is damaged, too large or not of version 1, or refers to files
                that are not in it.
        """
        with open_archive(content, "a Skybrush show") as archive:
            return _trajectories(archive)


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
        SHOW,
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


def _read(archive: Members, link: str) -> Any:
    """Return the document in an archive that a path or a reference names.

    Raises:
        ValueError: there is no such file, it is too large, or it is no JSON.
    """
    name = unquote(link.removesuffix("#").removeprefix("./"))
    content = archive.read(name)
    try:
        return json.loads(content, parse_constant=_no_number)
    except RecursionError:
        raise ValueError(f"{name}: not valid JSON: nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"{name}: not valid JSON: {error}") from None


def _no_number(word: str) -> float:
    """Refuse NaN and infinities, which are no JSON."""
    raise ValueError(f"got {word}, expected a finite number")


def _trajectories(archive: Members) -> dict[str, Polynomials]:
    """Return the trajectories of a show by name; a file that several drones share is read once.

    Raises:
        ValueError: the documents are not those of a show of version 1.
    """
    if SHOW not in archive.names:
        raise ValueError(f"got an archive without {SHOW}, expected a Skybrush show")
    found, shared, segments = dict[str, Polynomials](), dict[str, Polynomials](), 0
    for number, drone in enumerate(_drones(_read(archive, SHOW)), start=1):
        settings = drone.get("settings") if isinstance(drone, dict) else None
        if not isinstance(settings, dict):
            raise ValueError(f"drone {number}: got no settings, expected a trajectory in them")
        name, trajectory = settings.get("name", f"drone {number}"), settings.get("trajectory")
        if not isinstance(name, str) or name in found:
            raise ValueError(
                f"drone {number}: got the name {shorten(name)}, expected one of its own"
            )
        link = trajectory.get("$ref") if isinstance(trajectory, dict) else None
        try:
            if not isinstance(link, str):
                found[name] = _polynomials(trajectory)
            elif link in shared:
                found[name] = shared[link]
            else:
                found[name] = shared[link] = _polynomials(_read(archive, link))
        except ValueError as error:
            raise ValueError(f"drone {number}: not a trajectory of version 1: {error}") from None
        segments += len(found[name].instants) - 1
        if segments > _MOST_SEGMENTS:
            raise ValueError(f"got more than {_MOST_SEGMENTS} segments of all drones")
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
        ValueError: it is not a trajectory of version 1.
    """
    if not isinstance(trajectory, dict):
        raise ValueError(f"got {shorten(trajectory)}, expected version and points")
    if "$ref" in trajectory:
        raise ValueError("got a reference in the file of a reference, expected version and points")
    if trajectory.get("version") != 1:
        raise ValueError(f"got version {shorten(trajectory.get('version'))}")
    start = trajectory.get("takeoffTime", 0.0)
    if not _is_number(start):
        raise ValueError(f"takeoffTime: got {shorten(start)}, expected a time in s")
    times, corners = _segments(trajectory.get("points"))
    durations = np.diff(times)
    sizes = np.array([len(each) for each in corners])
    coefficients = np.zeros((len(corners), 3, sizes.max()))
    for size in np.unique(sizes):
        those = np.flatnonzero(sizes == size)
        control = np.array([corners[k] for k in those])
        coefficients[those, :, :size] = _powers(control, durations[those])
    return Polynomials(start + times, coefficients[None])


def _segments(points: Any) -> tuple[FloatArray, list[list[list[float]]]]:
    """Return the times of points, and the control points of the segments between them.

    Raises:
        ValueError: there are less than two points, or one is damaged; the message names it.
    """
    if not isinstance(points, list) or len(points) < 2:
        raise ValueError(f"points: got {shorten(points)}, expected a list of two or more")
    times, corners, last = list[float](), list[list[list[float]]](), None
    for number, point in enumerate(points, start=1):
        try:
            time, place, control = _point(point, times, 0 if last is None else _HIGHEST - 1)
        except ValueError as error:
            raise ValueError(f"point {number}: {error}") from None
        if last is not None:
            corners.append([last, *control, place])
        times.append(time)
        last = place
    return np.array(times, dtype=np.float64), corners


def _point(
    point: Any, before: list[float], most: int
) -> tuple[float, list[float], list[list[float]]]:
    """Return the time, position and control points of a point.

    Args:
        point: the point in the document.
        before: times of the points before it [s].
        most: largest number of control points.

    Raises:
        ValueError: it is none, or not after those before.
    """
    if not (isinstance(point, list) and len(point) == 3 and isinstance(point[2], list)):
        expected = "a time, a position and a list of control points"
        raise ValueError(f"got {shorten(point)}, expected {expected}")
    time, place, control = point
    if not _is_number(time) or (before and not time > before[-1]):
        after = f"a time after {before[-1]:.12g} s" if before else "a time in s"
        raise ValueError(f"got {shorten(time)}, expected {after}")
    for each in (place, *control):
        if not _is_place(each):
            raise ValueError(f"got {shorten(each)}, expected x, y and z of at most {LARGEST:g}")
    if len(control) > most:
        raise ValueError(f"got {len(control)} control points, expected at most {most}")
    return time, place, control


def _is_place(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))


def _is_number(value: Any) -> bool:
    kind = type(value)  # a truth value is an int too
    return (kind is float or kind is int) and abs(value) <= LARGEST


def _powers(corners: FloatArray, lasting: FloatArray) -> FloatArray:
    """Return the coefficients of Bézier curves of D + 1 control points, shape (S, 3, D + 1).

    They are of the powers of the time since a curve began.

    Args:
        corners: control points [m], shape (S, D + 1, 3).
        lasting: durations [s], shape (S,).
    """
    degree = corners.shape[1] - 1
    differences = (np.diff(corners, k, axis=1)[:, 0] for k in range(degree + 1))
    with np.errstate(over="ignore"):  # such numbers are refused with all others
        scaled = [
            comb(degree, k) * each / lasting[:, None] ** k for k, each in enumerate(differences)
        ]
    return np.stack(scaled, axis=-1)
