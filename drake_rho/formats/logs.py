"""Positions of vehicles in logs of ROS 2.

A source is a topic of one vehicle, or a child frame of transforms. Of several that are named after
one vehicle, measured ones come before planned ones.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np

from drake_rho.formats.bags import ZSTD, Message, messages
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.trajectories import sampled
from drake_rho.scenario.errors import shorten, shortened

_ODOMETRY, _POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
_TRANSFORMS, _PATH = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Path"
_TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
KINDS = (_ODOMETRY, _POSE, _TRANSFORMS, _TRAJECTORY, _PATH)
"""Kinds of messages with positions, measured ones first."""
_SECOND = 10**9

Places = Sequence[tuple[int, Any]]
"""Time stamps [ns] and positions, which have x, y and z [m]."""


class Source:
    """Positions of one vehicle, with their frames."""

    def __init__(self, kind: str) -> None:
        self.kind, self.frames = kind, set[str]()
        self._samples = list[tuple[int, tuple[float, float, float]]]()

    def add(self, frame: str, places: Places) -> None:
        """Add positions; a later plan replaces the rest of an earlier one."""
        self.frames.add(frame.strip("/"))
        found = sorted((stamp, (each.x, each.y, each.z)) for stamp, each in places)
        if self.kind in (_TRAJECTORY, _PATH) and found:
            del self._samples[bisect_left(self._samples, found[0][0], key=itemgetter(0)) :]
        self._samples += found

    @property
    def moves(self) -> bool:
        """Whether there are positions at two times or more."""
        return len({stamp for stamp, _ in self._samples}) > 1

    def samples(self) -> list[tuple[int, tuple[float, float, float]]]:
        """Return the positions in the order of their stamps, equal ones once.

        Raises:
            ValueError: two positions of one stamp differ.
        """
        found = sorted(set(self._samples))
        for (stamp, one), (next_stamp, other) in pairwise(found):
            if stamp == next_stamp:
                got = f"got the positions {shorten(one)} and {shorten(other)} at {stamp} ns"
                raise ValueError(f"{got}, expected one at each stamp")
        return found


class Log:
    """Sources of positions in the files of a log.

    Args:
        store: type store of rosbags.
        refusal: error of the store for a message that is none.
    """

    def __init__(self, store: Any, refusal: type[Exception]) -> None:
        self._refusals = (refusal, ValueError, IndexError, AssertionError, struct.error)
        self._store, self._sources = store, dict[tuple[str, str], Source]()

    def add(self, content: bytes) -> None:
        """Add the messages of a file.

        Raises:
            ValueError: the file is damaged.
        """
        for each in messages(content, frozenset(KINDS)):
            try:
                message = self._store.deserialize_cdr(each.data, each.kind)
                for place, frame, places in _places(each, message):
                    self._sources.setdefault((each.kind, place), Source(each.kind)).add(
                        frame, places
                    )
            except self._refusals as error:
                where = f"topic {shorten(each.topic)}, at {each.stamp} ns"
                if each.data.startswith(ZSTD):
                    got = "got a bag compressed message by message (zstd)"
                    raise ValueError(f"{where}: {got}, expected one without compression") from None
                raise ValueError(f"{where}: not a message of {each.kind} ({error})") from None

    def motions(self, topics: Mapping[str, str] | None) -> dict[str, Polynomials]:
        """Return the motions of vehicles by name; times count from the first stamp of any.

        Args:
            topics: topic or child frame of each vehicle; if not given, vehicles are named after the
                namespaces of topics and frames, or after the topic or frame if it has none.

        Raises:
            ValueError: there are no positions, a vehicle has several sources or two positions at
                one stamp, or frames differ.
        """
        chosen = self._named(topics)
        frames = sorted(set[str]().union(*(each.frames for each in chosen.values())))
        if len(frames) > 1:
            got = f"got positions in the frames {shorten(frames[0])} and {shorten(frames[1])}"
            raise ValueError(f"{got}, expected one frame")
        samples = dict[str, list[tuple[int, tuple[float, float, float]]]]()
        for name, each in chosen.items():
            try:
                samples[name] = each.samples()
            except ValueError as error:
                raise ValueError(f"{shorten(name)}: {error}") from None
        begin = min(each[0][0] for each in samples.values())
        return {
            name: sampled(name, np.array([[(s - begin) / _SECOND, *p] for s, p in each]))
            for name, each in samples.items()
        }

    def _named(self, topics: Mapping[str, str] | None) -> dict[str, Source]:
        """Return the source of each vehicle."""
        moving = {
            key: each
            for key, each in sorted(self._sources.items(), key=lambda e: KINDS.index(e[0][0]))
            if each.moves
        }
        by_place = {place.strip("/"): each for (_, place), each in reversed(moving.items())}
        if topics is not None:
            if missing := [place for place in topics.values() if place.strip("/") not in by_place]:
                expected = f"one of {shortened(', '.join(by_place) or 'none')}"
                raise ValueError(f"topics: got {shorten(missing[0])}, expected {expected}")
            return {name: by_place[place.strip("/")] for name, place in topics.items()}
        frames = {place for kind, place in moving if kind == _TRANSFORMS}
        found = dict[str, tuple[str, Source]]()
        for (kind, place), each in moving.items():
            if kind == _TRANSFORMS and each.frames & frames:
                continue  # relative to another vehicle
            name = place.strip("/").rpartition("/")[0] or place.strip("/")
            other, first = found.setdefault(name, (place, each))
            if first.kind == kind and other != place:
                got = f"got positions on {other} and {place}"
                raise ValueError(f"{shorten(name)}: {got}, expected one; topics= chooses")
        if not found:
            kinds = ", ".join(each.rpartition("/")[2] for each in KINDS)
            raise ValueError(f"got no positions at two times, expected messages of {kinds}")
        return {name: each for name, (_, each) in found.items()}


def _places(each: Message, message: Any) -> Iterator[tuple[str, str, Places]]:
    """Yield sources, frames and positions in a message."""

    def stamp(header: Any) -> int:
        """Return the stamp of a header, or else of its record [ns]."""
        return int(header.stamp.sec) * _SECOND + int(header.stamp.nanosec) or each.stamp

    if each.kind == _TRANSFORMS:
        for one in message.transforms:
            place = one.child_frame_id.strip("/")
            yield place, one.header.frame_id, [(stamp(one.header), one.transform.translation)]
        return
    frame, begin = message.header.frame_id, stamp(message.header)
    if each.kind == _ODOMETRY:
        yield each.topic, frame, [(begin, message.pose.pose.position)]
    elif each.kind == _POSE:
        yield each.topic, frame, [(begin, message.pose.position)]
    elif each.kind == _PATH:
        yield each.topic, frame, [(stamp(one.header), one.pose.position) for one in message.poses]
    else:
        joints = message.joint_names if len(message.joint_names) > 1 else [each.topic]
        for k, joint in enumerate(joints):
            places = [
                (begin + _elapsed(one.time_from_start), one.transforms[k].translation)
                for one in message.points
            ]
            yield joint, frame, places


def _elapsed(duration: Any) -> int:
    """Return a duration [ns]."""
    return int(duration.sec) * _SECOND + int(duration.nanosec)
