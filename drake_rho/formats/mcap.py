"""MCAP format: a rosbag2 of trajectories, paths, transforms, obstacles and tubes, without ROS.

Stamps are whole nanoseconds: those of the first time, an integer, and of the time elapsed since.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from drake_rho.formats.bags import MCAP, SQLITE
from drake_rho.formats.folders import write_folder
from drake_rho.formats.format import RATE, Format, exported
from drake_rho.formats.logs import Log
from drake_rho.formats.markers import Obstacles, Tubes
from drake_rho.formats.messages import Messages
from drake_rho.formats.reader import naming
from drake_rho.formats.record import Exported
from drake_rho.motion.flown import Flown, sample
from drake_rho.motion.headings import Heading, directions_of, headings
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.samples import with_knots
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.system.files import atomic_write

_NANOSECONDS = 1e9
_LATEST = 2**31
"""Time from which stamps do not fit into a message [s]."""
_VERSION = 8
"""Version of the rosbag2 layout, which ROS 2 Humble and all later releases read."""


class Mcap(Format):
    """Messages of ROS 2 at a rate and at every knot."""

    name = "mcap"
    endings = (".mcap",)
    folder = True
    content = "messages of ROS 2 at a rate and at every knot: motions, headings, obstacles, tubes"
    any_motion = True
    heading = "any"
    read_by = "rho.load_trajectories(path)"
    reads = "a log of ROS 2 (MCAP or SQLite)"
    from_zero = True
    tick = 1.0 / _NANOSECONDS

    def recognises(self, content: bytes) -> bool:
        """Return whether the content begins as MCAP or as SQLite."""
        return content.startswith((MCAP, SQLITE))

    def read_all(
        self, contents: Mapping[Path, bytes], topics: Mapping[str, str] | None
    ) -> Mapping[str, Polynomials]:
        """Return the motions of vehicles in the files of one log, which have one clock."""
        log = Log(_store(), _rosbags("serde").SerdeError)
        for file, content in contents.items():
            with naming(file):
                log.add(content)
        return log.motions(topics)

    def check(self, path: Path, rate: float | None, heading: Heading | None) -> None:
        """Check as `Format.check`, and that rosbags is installed.

        Raises:
            ValueError: the path, the rate or the heading is not supported, or the extra `ros` is
                not installed.
        """
        super().check(path, rate, heading)
        _rosbags("rosbag2")

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write a file, or a folder of a rosbag2 if the path does not end in .mcap."""
        directions = directions_of(flown.scenario.names, heading)
        begin, ticks = _ticks(flown.scenario, rate or RATE)
        elapsed = ticks / _NANOSECONDS - flown.scenario.lead
        yaws = None
        if heading is None and flown.simulation is not None:
            yaws = flown.simulation.headings_at(elapsed)
        if yaws is None:
            yaws = headings(flown, elapsed, directions)
        with tempfile.TemporaryDirectory(prefix="drake_rho.") as beside:
            bag = Path(beside, path.stem or "bag")
            writer = _rosbags("rosbag2").Writer(
                bag, version=_VERSION, storage_plugin=_rosbags("rosbag2").StoragePlugin.MCAP
            )
            with writer:
                _write_all(_Bag(writer), flown, elapsed, [begin + t for t in ticks.tolist()], yaws)
            files = _moved(bag, path, archive=path.suffix.lower() in self.endings)
        return exported(flown, path, files, f"{len(ticks)} states of each vehicle")


class _Bag:
    """Bag being written, with a connection for each topic."""

    def __init__(self, writer: Any) -> None:
        self._store = _store()
        self._writer, self._connections = writer, dict[str, Any]()
        self.messages = Messages(self._store.types)

    def write(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        """Write a message of a kind such as nav_msgs/msg/Path with a stamp [ns]."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store
            )
        data = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], stamp, data)


def _write_all(
    bag: _Bag, flown: Flown, elapsed: FloatArray, stamps: list[int], yaws: FloatArray
) -> None:
    """Write all messages in the order of their stamps.

    Args:
        bag: to write to.
        flown: the motion.
        elapsed: M times since the first knot [s], shape (M,).
        stamps: these times [ns].
        yaws: headings of N vehicles [rad], shape (N, M).
    """
    messages, samples = bag.messages, sample(flown, elapsed)
    turns = np.stack([0.0 * yaws, 0.0 * yaws, np.sin(yaws / 2.0), np.cos(yaws / 2.0)], axis=-1)
    frames = ros_names(flown.scenario.names)
    for frame, (_, states), turned in zip(frames, samples.by_vehicle(), turns, strict=True):
        trajectory = messages.trajectory(frame, states, turned, stamps)
        kind = "trajectory_msgs/msg/MultiDOFJointTrajectory"
        bag.write(f"/{frame}/trajectory", kind, stamps[0], trajectory)
        path = messages.path(states[:, :3], turned, stamps)
        bag.write(f"/{frame}/path", "nav_msgs/msg/Path", stamps[0], path)
    drawn: dict[str, Obstacles | Tubes] = {
        "/obstacles": Obstacles(flown.scenario),
        "/tubes": Tubes(flown, frames),
    }
    for m, stamp in enumerate(stamps):
        transforms = messages.transforms(frames, samples.positions[:, m], turns[:, m], stamp)
        bag.write("/tf", "tf2_msgs/msg/TFMessage", stamp, transforms)
        for topic, each in drawn.items():
            if markers := each.at(messages, float(elapsed[m]), stamp):
                array = messages.markers(markers)
                bag.write(topic, "visualization_msgs/msg/MarkerArray", stamp, array)


def _ticks(scenario: Scenario, rate: float) -> tuple[int, IntArray]:
    """Return the first stamp and the times since then, at a rate and at all knots, in whole ns.

    The first stamp is the scenario's clock; 0 if the flight begins before 0.

    Raises:
        ValueError: the flight ends too late for stamps.
    """
    times, _ = with_knots(scenario.grid, rate, scenario.lead)
    ticks = np.rint((times + scenario.lead) * _NANOSECONDS).astype(np.int64)
    first = round((Fraction(scenario.grid.start) - Fraction(scenario.lead)) * 10**9)
    begin = max(0, first)
    if (last := (begin + int(ticks[-1])) // 10**9) >= _LATEST:
        expected = f"before {_LATEST} s with mcap, the end of its stamps"
        raise ValueError(f"grid: got an end at {last} s, expected one {expected}")
    return begin, ticks


def ros_names(names: Sequence[str]) -> list[str]:
    """Return names that ROS allows for topics and frames, distinct, from vehicles' names.

    Letters of ASCII, digits and _ stay; all else becomes _. A name that begins with a digit or _
    gets a v before it, a repeated one a number.
    """
    found = list[str]()
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9_]+|__+", "_", name).rstrip("_")
        stem = stem if stem[:1].isalpha() else f"v{stem}"
        free, number = stem, 1
        while free in found:
            number += 1
            free = f"{stem}_{number}"
        found.append(free)
    return found


def _moved(bag: Path, path: Path, *, archive: bool) -> list[Path]:
    """Move a written bag, or its one file, to its place, and return the paths of its files."""
    if not archive:
        contents = {each.name: each.read_bytes() for each in sorted(bag.iterdir())}
        write_folder(path, contents)
        return [path / name for name in contents]
    with open(bag / f"{bag.name}.mcap", "rb") as source, atomic_write(path) as file:
        shutil.copyfileobj(source, file)
    return [path]


@cache
def _store() -> Any:
    """Return the types of messages, which are compiled once: that takes 0.1 s.

    Raises:
        ValueError: rosbags is not installed.
    """
    typesys = _rosbags("typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _rosbags(module: str) -> Any:
    """Return a module of rosbags, which is loaded only here.

    Raises:
        ValueError: it is not installed.
    """
    try:
        return import_module(f"rosbags.{module}")
    except ImportError:
        expected = "the extra ros: pip install 'drake-rho[ros]'"
        raise ValueError(f"format: got mcap without rosbags, expected {expected}") from None
