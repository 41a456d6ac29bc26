"""Poses of maps: a rotation about the origin of their file, then a translation."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import LARGEST, FloatArray, read_only
from drake_rho.scenario.rotations import rotation_of

_EXPECTED = "a pose: a 4 x 4 matrix of a rotation and a translation, or Drake's RigidTransform"


class Pose(NamedTuple):
    """Rotation and translation of a map, each None if there is none."""

    rotation: FloatArray | None = None
    """matrix, shape (3, 3)"""
    position: FloatArray | None = None
    """position to which the origin of the map is moved [m], shape (3,)"""

    def moved(self, x: FloatArray) -> FloatArray:
        """Return positions (M, 3) of the map's file in the world [m]."""
        turned = x if self.rotation is None else x @ self.rotation.T
        return turned if self.position is None else turned + self.position

    def arguments(self) -> dict[str, Any]:
        """Return the fields of scenario files that describe the pose."""
        given = {"position": self.position, "rotation": self.rotation}
        return {name: array.tolist() for name, array in given.items() if array is not None}


@runtime_checkable
class HasMatrix(Protocol):
    """Pose with a matrix, such as Drake's `RigidTransform`."""

    def GetAsMatrix4(self) -> FloatArray:  # noqa: N802  # Drake's name
        """Return the pose as a matrix, shape (4, 4)."""
        ...


AnyPose = FloatArray | HasMatrix | Pose | None
"""Pose as users give it: a 4 x 4 matrix or Drake's `RigidTransform`; None leaves all in place."""


def pose_of(value: Any) -> Pose:
    """Return a pose.

    Args:
        value: one of `AnyPose`.

    Raises:
        ScenarioError: the value is none of these.
    """
    if value is None or isinstance(value, Pose):
        return value or Pose()
    given = value.GetAsMatrix4() if isinstance(value, HasMatrix) else value
    try:
        matrix = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    shown = matrix.tolist() if isinstance(given, np.ndarray) else given
    if matrix.shape != (4, 4) or not np.all(np.abs(matrix) <= LARGEST):
        raise ScenarioError("pose", shown, _EXPECTED)
    if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise ScenarioError("pose", shown, f"{_EXPECTED}, with the last row 0, 0, 0, 1")
    try:
        rotation = rotation_of(matrix[:3, :3])
    except ScenarioError as error:
        raise error.inside("pose") from None
    position = read_only(matrix[:3, 3])
    return Pose(
        None if np.array_equal(rotation, np.eye(3)) else rotation,
        position if position.any() else None,
    )
