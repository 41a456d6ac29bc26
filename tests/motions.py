"""Motions of single vehicles, and their exact closest approaches to points."""

from __future__ import annotations

import numpy as np

import drake_rho as rho
from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.extremes import lengths_of, nearest_moments


def from_start(start: rho.State, accelerations: np.ndarray, step: float) -> Motion:
    """Return the motion of one vehicle; the acceleration after its last knot is unknown."""
    p, v = roll_out(start.position, start.velocity, accelerations, step)
    return Motion(step, p, v, accelerations, start.acceleration_outside, np.full(3, np.nan))


def closest_approach(motion: Motion, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and distances [m] of the closest approach to a point in every step."""
    h, a = motion.step, motion.accelerations
    p, v = motion.positions[..., :-1, :] - center, motion.velocities[..., :-1, :]
    s = nearest_moments(p, v, a, h)
    at = p + s[..., None] * (v + s[..., None] / 2 * a)
    return h * np.arange(a.shape[-2]) + s, lengths_of(at)
