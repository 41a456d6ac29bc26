"""Messages of ROS 2 that an export has: stamps, poses, paths, trajectories and markers.

Types come from a type store of rosbags, whose classes have the fields of the messages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drake_rho.scenario.fields import FloatArray

FRAME = "map"
"""Frame of the scenario's axes."""
_SECOND = 10**9


class Messages:
    """Messages with the types of a store; times are in whole nanoseconds."""

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types
        self._no_image: Any = None

    def trajectory(
        self, name: str, states: FloatArray, turns: FloatArray, stamps: Sequence[int]
    ) -> Any:
        """Return the MultiDOFJointTrajectory of one vehicle.

        Args:
            name: of its frame.
            states: positions, velocities and accelerations, shape (M, 9).
            turns: quaternions x, y, z, w, shape (M, 4).
            stamps: times [ns], M of them.
        """
        still = self.vector(np.zeros(3))
        points = [
            self._new(
                "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
                [self._new("geometry_msgs/msg/Transform", self.vector(p), self._turn(turn))],
                [self._new("geometry_msgs/msg/Twist", self.vector(v), still)],
                [self._new("geometry_msgs/msg/Twist", self.vector(a), still)],
                self._new("builtin_interfaces/msg/Duration", *divmod(stamp - stamps[0], _SECOND)),
            )
            for (p, v, a), turn, stamp in zip(states.reshape(-1, 3, 3), turns, stamps, strict=True)
        ]
        header = self._header(stamps[0])
        return self._new("trajectory_msgs/msg/MultiDOFJointTrajectory", header, [name], points)

    def path(self, positions: FloatArray, turns: FloatArray, stamps: Sequence[int]) -> Any:
        """Return the Path through positions (M, 3) with quaternions (M, 4) and stamps."""
        poses = [
            self._new("geometry_msgs/msg/PoseStamped", self._header(stamp), self._pose(p, turn))
            for p, turn, stamp in zip(positions, turns, stamps, strict=True)
        ]
        return self._new("nav_msgs/msg/Path", self._header(stamps[0]), poses)

    def transforms(
        self, frames: Sequence[str], positions: FloatArray, turns: FloatArray, stamp: int
    ) -> Any:
        """Return the TFMessage of vehicles' frames at positions (N, 3) with quaternions (N, 4)."""
        transforms = [
            self._new(
                "geometry_msgs/msg/TransformStamped",
                self._header(stamp),
                frame,
                self._new("geometry_msgs/msg/Transform", self.vector(p), self._turn(turn)),
            )
            for frame, p, turn in zip(frames, positions, turns, strict=True)
        ]
        return self._new("tf2_msgs/msg/TFMessage", transforms)

    def markers(self, markers: Sequence[Any]) -> Any:
        """Return a MarkerArray."""
        return self._new("visualization_msgs/msg/MarkerArray", list(markers))

    def marker(
        self,
        name: tuple[str, int],
        kind: str,
        stamp: int,
        *,
        position: FloatArray,
        turn: FloatArray,
        scale: FloatArray,
        colour: tuple[float, float, float, float],
        points: FloatArray,
    ) -> Any:
        """Return a Marker.

        Args:
            name: namespace and number, which identify it.
            kind: such as SPHERE, or DELETE for a marker that vanishes.
            stamp: time [ns].
            position: place of its origin [m], shape (3,).
            turn: quaternion x, y, z, w, shape (4,).
            scale: its size along its axes [m], shape (3,).
            colour: red, green, blue and opacity, from 0 to 1.
            points: points of a list relative to the origin [m], shape (P, 3).
        """
        each = self._types["visualization_msgs/msg/Marker"]
        gone = kind == "DELETE"
        return self._new(
            "visualization_msgs/msg/Marker",
            self._header(stamp),
            *name,
            each.CUBE if gone else getattr(each, kind),
            each.DELETE if gone else each.ADD,
            self._pose(position, turn),
            self.vector(scale),
            self._new("std_msgs/msg/ColorRGBA", *colour),
            self._new("builtin_interfaces/msg/Duration", 0, 0),
            False,
            [self._new("geometry_msgs/msg/Point", *point) for point in points.tolist()],
            [],
            "",
            self._texture(),
            [],
            "",
            "",
            self._new("visualization_msgs/msg/MeshFile", "", np.zeros(0, dtype=np.uint8)),
            False,
        )

    def vector(self, values: FloatArray) -> Any:
        """Return a Vector3."""
        return self._new("geometry_msgs/msg/Vector3", *map(float, values))

    def _new(self, kind: str, *values: Any) -> Any:
        return self._types[kind](*values)

    def _header(self, stamp: int) -> Any:
        time = self._new("builtin_interfaces/msg/Time", *divmod(stamp, _SECOND))
        return self._new("std_msgs/msg/Header", time, FRAME)

    def _turn(self, turn: FloatArray) -> Any:
        return self._new("geometry_msgs/msg/Quaternion", *map(float, turn))

    def _pose(self, position: FloatArray, turn: FloatArray) -> Any:
        place = self._new("geometry_msgs/msg/Point", *map(float, position))
        return self._new("geometry_msgs/msg/Pose", place, self._turn(turn))

    def _texture(self) -> Any:
        """Return an image without content, which every marker has."""
        if self._no_image is None:
            empty = np.zeros(0, dtype=np.uint8)
            kind = "sensor_msgs/msg/CompressedImage"
            self._no_image = self._new(kind, self._header(0), "", empty)
        return self._no_image
