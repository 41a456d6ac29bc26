"""Where vehicles point: aircraft along their way, quadrotors with their rotors along the thrust."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from drake_rho.display.meshcat.playback import Playback
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import GRAVITY, Airframe

_UP = np.array([0.0, 0.0, 1.0])
_LEFT = np.array([0.0, 1.0, 0.0])


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


def lifts(motion: Motion, times: FloatArray, step: float) -> FloatArray:
    """What keeps vehicles in the air, a + g e_z [m/s²], shape (N, M, 3).

    The acceleration is the mean over a step around each time, since a plan's own is constant in
    each step and would tilt vehicles in jumps. The part upwards is at least g/2.
    """
    half = min(step, float(motion.step) * motion.accelerations.shape[1]) / 2.0
    end = motion.step * motion.accelerations.shape[1]
    before, after = np.maximum(times - half, 0.0), np.minimum(times + half, end)
    gained = motion.at("velocity", after) - motion.at("velocity", before)
    lift: FloatArray = gained / (after - before)[:, None] + GRAVITY * _UP
    lift[..., 2] = np.maximum(lift[..., 2], GRAVITY / 2.0)
    return lift


def vehicle_poses(
    kinds: Sequence[Airframe], positions: FloatArray, velocities: FloatArray, up: FloatArray
) -> FloatArray:
    """Poses of vehicles of several kinds, shape (N, M, 3, 4), that lean as their lift asks for."""
    quadrotors = np.array([kind == "quadrotor" for kind in kinds])[:, None, None, None]
    level = velocities * [1.0, 1.0, 0.0]
    hovering = poses(positions, headings(level), up, nose_first=False)
    return np.where(quadrotors, hovering, poses(positions, headings(velocities), up))


def poses(
    positions: FloatArray, headings: FloatArray, up: FloatArray = _UP, *, nose_first: bool = True
) -> FloatArray:
    """Nose along the heading, and upright as far as that goes, or the other way round.

    Args:
        positions: [m], shape (N, M, 3).
        headings: unit vectors, shape (N, M, 3).
        up: where the upper side is to point, of any length, shape (..., 3).
        nose_first: whether the nose points exactly along the heading, or else the upper side along
            `up`.

    Returns:
        Axes ahead, to the left and up, and positions, as columns, shape (N, M, 3, 4).
    """
    left = np.cross(up, headings)
    lengths = np.linalg.norm(left, axis=2, keepdims=True)
    steep = lengths <= 1e-6
    level = _LEFT - (headings @ _LEFT)[..., None] * headings  # of one that flies along its lift
    left = np.where(steep, level, left)
    left = left / np.linalg.norm(left, axis=2, keepdims=True)
    if nose_first:
        above = np.cross(headings, left)
        return np.stack([headings, left, above, positions], axis=3)
    above = np.broadcast_to(up / np.linalg.norm(up, axis=-1, keepdims=True), left.shape)
    return np.stack([np.cross(left, above), left, above, positions], axis=3)


def record_poses(meshcat: Meshcat, path: str, values: FloatArray, playback: Playback) -> None:
    """Record poses, shape (M, 3, 4), of an object at the times of a pace; it begins in the first.

    Args:
        meshcat: which is recording.
        path: of the object.
        values: rotations, and positions [m] as their last columns.
        playback: how time in flight becomes time of playback.
    """
    meshcat.SetTransform(path, RigidTransform(values[0]))
    for time, pose in zip(playback.times, values, strict=True):
        meshcat.SetTransform(path, RigidTransform(pose), playback.time_at(time))
