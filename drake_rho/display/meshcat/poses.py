"""Attitudes of vehicles: aircraft point along their velocity, quadrotors tilt with their thrust."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.limits import GRAVITY
from drake_rho.scenario.parts import Airframe

_UP = np.array([0.0, 0.0, 1.0])
_LEFT = np.array([0.0, 1.0, 0.0])


def headings(velocities: FloatArray) -> FloatArray:
    """Return the directions of flight, shape (N, M, 3); vehicles at rest keep their last one."""
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
    """Return the specific lift a + g e_z of the vehicles [m/s²], shape (N, M, 3).

    The acceleration is averaged over a step around each time, since a plan's acceleration is
    constant in each step and the attitude would jump. The vertical component is at least g/2.
    Jumps of velocities to measured ones do not count as acceleration.
    """
    half = min(step, float(motion.step) * motion.accelerations.shape[1]) / 2.0
    end = motion.step * motion.accelerations.shape[1]
    before, after = np.maximum(times - half, 0.0), np.minimum(times + half, end)
    gained = motion.at("velocity", after) - motion.at("velocity", before)
    lift: FloatArray = gained / (after - before)[:, None] + GRAVITY * _UP
    lift[..., 2] = np.maximum(lift[..., 2], GRAVITY / 2.0)
    return lift


def vehicle_poses(
    kinds: Sequence[Airframe],
    positions: FloatArray,
    velocities: FloatArray,
    up: FloatArray,
    yaws: FloatArray | None = None,
) -> FloatArray:
    """Return the poses of aircraft and quadrotors banked along their lift, shape (N, M, 3, 4).

    Noses are along the velocities, or above or below headings `yaws` [rad], (N, M).
    """
    quadrotors = np.array([kind == "quadrotor" for kind in kinds])[:, None, None, None]
    ahead = headings(velocities)
    level = headings(velocities * [1.0, 1.0, 0.0])
    if yaws is not None:
        level = np.stack([np.cos(yaws), np.sin(yaws), 0.0 * yaws], axis=-1)
        ahead = np.linalg.norm(ahead[..., :2], axis=-1, keepdims=True) * level + ahead * _UP
        level[..., 2] = -np.sum(level * up, axis=-1) / up[..., 2]  # in the plane of the rotors
    hovering = poses(positions, level, up, nose_first=False)
    return np.where(quadrotors, hovering, poses(positions, ahead, up))


def poses(
    positions: FloatArray, headings: FloatArray, up: FloatArray = _UP, *, nose_first: bool = True
) -> FloatArray:
    """Return poses with the nose along the heading and the upper side along `up`.

    Only one of the two can hold exactly; the other holds as closely as possible.

    Args:
        positions: [m], shape (N, M, 3).
        headings: unit vectors, shape (N, M, 3).
        up: desired direction of the upper side, of any length, shape (..., 3).
        nose_first: whether the nose points exactly along the heading, rather than the upper side
            exactly along `up`.

    Returns:
        Forward, left and upward axes, and positions, as columns, shape (N, M, 3, 4).
    """
    left = np.cross(up, headings)
    lengths = np.linalg.norm(left, axis=2, keepdims=True)
    steep = lengths <= 1e-6
    level = (
        _LEFT - (headings @ _LEFT)[..., None] * headings
    )  # if the heading is parallel to the lift
    left = np.where(steep, level, left)
    left = left / np.linalg.norm(left, axis=2, keepdims=True)
    if nose_first:
        above = np.cross(headings, left)
        return np.stack([headings, left, above, positions], axis=3)
    above = np.broadcast_to(up / np.linalg.norm(up, axis=-1, keepdims=True), left.shape)
    return np.stack([np.cross(left, above), left, above, positions], axis=3)


def unturned(positions: FloatArray) -> FloatArray:
    """Return poses at positions [m], (M, 3), without rotation, shape (M, 3, 4)."""
    still = np.broadcast_to(np.eye(3), (len(positions), 3, 3))
    return np.concatenate([still, positions[:, :, None]], axis=2)
