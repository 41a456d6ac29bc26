"""Rotations in records: matrices, or roll, pitch and yaw as in SDF and URDF files."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import PlainSerializer, PlainValidator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import Finite, FloatArray, read_only

_OFF = 1e-6
"""Largest accepted deviation of a matrix from a rotation; smaller deviations are removed."""

_ROUNDING = 1e-14
"""Deviation of products of rotations by rounding, which is not removed."""

_EXPECTED = "roll, pitch and yaw [rad], or a 3 x 3 rotation matrix"


def rotation_of(value: Any) -> FloatArray:
    """Return a rotation matrix, shape (3, 3).

    Args:
        value: a matrix; roll, pitch and yaw about x, y and z, applied in this order [rad]; or an
            object with a method `matrix`, such as Drake's `RotationMatrix`.

    Raises:
        ScenarioError: the value is none of these.
    """
    given = value.matrix() if callable(getattr(value, "matrix", None)) else value
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.full(1, np.nan)
    shown = array.tolist() if isinstance(given, np.ndarray) else given
    if array.shape == (3,) and np.isfinite(array).all():
        return read_only(from_angles(array))
    if array.shape != (3, 3) or not np.isfinite(array).all():
        raise ScenarioError("", shown, _EXPECTED)
    off = np.abs(array @ array.T - np.eye(3)).max()
    if not off <= _OFF or np.linalg.det(array) < 0.0:
        raise ScenarioError("", shown, f"{_EXPECTED}, orthogonal and of determinant 1")
    left, _, right = np.linalg.svd(array)
    return read_only(array if off <= _ROUNDING else left @ right)  # the package's own stay exact


def from_angles(angles: npt.ArrayLike) -> FloatArray:
    """Return the rotation by roll, pitch and yaw [rad]: about x, then y, then z, of the world."""
    (a, b, c), (d, e, f) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, a, -d], [0.0, d, a]])
    about_y = np.array([[b, 0.0, e], [0.0, 1.0, 0.0], [-e, 0.0, b]])
    about_z = np.array([[c, -f, 0.0], [f, c, 0.0], [0.0, 0.0, 1.0]])
    rotation: FloatArray = about_z @ about_y @ about_x
    return rotation


Rotation = Annotated[
    FloatArray,
    PlainValidator(
        rotation_of,
        json_schema_input_type=tuple[Finite, Finite, Finite]
        | tuple[
            tuple[Finite, Finite, Finite],
            tuple[Finite, Finite, Finite],
            tuple[Finite, Finite, Finite],
        ],
    ),
    PlainSerializer(np.ndarray.tolist),
]
"""Rotation matrix, read-only, of shape (3, 3)."""
