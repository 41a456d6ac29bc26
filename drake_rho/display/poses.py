"""Where vehicles point: nose ahead, wings level."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from drake_rho.display.pace import Pace
from drake_rho.scenario.fields import FloatArray


def headings(velocities: FloatArray) -> FloatArray:
    """Directions of flight, shape (N, M, 3): the last one kept where a vehicle stands still."""
    speeds = np.linalg.norm(velocities, axis=2)
    still = speeds <= 1e-3 * speeds.max(axis=1, keepdims=True)
    latest = np.where(still, -1, np.arange(speeds.shape[1]))
    latest = np.maximum.accumulate(latest, axis=1)
    earliest = np.argmin(still, axis=1)  # for a vehicle that has not moved yet
    latest = np.where(latest < 0, earliest[:, None], latest)
    headings = np.take_along_axis(velocities, latest[:, :, None], axis=1)
    lengths = np.linalg.norm(headings, axis=2, keepdims=True)
    return np.where(lengths > 0, headings / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0, 0.0])


def poses(positions: FloatArray, headings: FloatArray) -> FloatArray:
    """Nose along the heading, wings level: arrays of shape (N, M, 3) give (N, M, 3, 4)."""
    left = np.cross([0.0, 0.0, 1.0], headings)
    lengths = np.linalg.norm(left, axis=2, keepdims=True)
    steep = lengths <= 1e-6
    left = np.where(steep, [0.0, 1.0, 0.0], left / np.where(steep, 1.0, lengths))
    above = np.cross(headings, left)
    return np.stack([headings, left, above, positions], axis=3)


def record_poses(meshcat: Meshcat, path: str, values: FloatArray, pace: Pace) -> None:
    """Record poses, shape (M, 3, 4), of an object at the times of a pace; it begins in the first.

    Args:
        meshcat: which is recording.
        path: of the object.
        values: rotations, and positions [m] as their last columns.
        pace: how time in flight becomes time of playback.
    """
    meshcat.SetTransform(path, RigidTransform(values[0]))
    for time, pose in zip(pace.times, values, strict=True):
        meshcat.SetTransform(path, RigidTransform(pose), pace.playback(time))
