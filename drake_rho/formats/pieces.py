"""Motions as piecewise polynomials: exact, or merged into fewer pieces of a higher degree.

A step of a motion is quadratic in time. If there are more steps than pieces allowed, adjacent steps
are merged into polynomials of degree 7. Their positions and velocities at both ends are those of
the motion; the remaining four coefficients of each axis are fitted by least squares. So pieces join
continuously in position and velocity, as steps do. Accelerations jump between pieces, as they do
between steps: making them continuous would add two conditions and increase the deviation.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache, partial
from itertools import pairwise
from math import comb

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray, IntArray

DEGREE = 7
_SAMPLES = 16
"""Number of samples of each step for the fit."""
_PARTS = 8
"""Number of parts of each step for bounding the deviation."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pieces:
    """Motions of N vehicles as P polynomials each."""

    durations: FloatArray
    """durations of the pieces [s], shape (P,)"""
    coefficients: FloatArray
    """coefficients of the powers of the time since a piece began, from the lowest up: [m], [m/s],
    [m/s²], …, shape (N, P, 3, 8)"""
    deviations: FloatArray
    """upper bound of the distance between the polynomials and the motion at the same time [m],
    shape (N,)"""


def as_pieces(motion: Motion, most: int) -> Pieces:
    """Return a motion as a bounded number of polynomials of nearly equal durations.

    Args:
        motion: motion of N vehicles.
        most: largest number of pieces, at least 1.
    """
    steps = motion.accelerations.shape[1]
    joints = np.rint(np.linspace(0, steps, min(most, steps) + 1)).astype(int)
    p, v = motion.positions[:, :steps], motion.velocities[:, :steps]
    exact = np.stack([p, v, motion.accelerations / 2.0], axis=-1)
    return Pieces(motion.step * np.diff(joints), *joined(exact, joints, partial(_merged, motion)))


def joined(
    exact: FloatArray, joints: IntArray, merge: Callable[[int, int], tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Return polynomials between joints, and their deviations from the exact pieces.

    Args:
        exact: coefficients of the exact pieces, shape (N, S, 3, at most 8).
        joints: increasing indices of the ends of the polynomials among the S + 1 ends of pieces,
            shape (P + 1,).
        merge: function from two joints that are not neighbours to coefficients, (N, 3, 8), and
            deviations [m], (N,).

    Returns:
        Coefficients, shape (N, P, 3, 8), and deviations [m], shape (N,).
    """
    coefficients = np.zeros((len(exact), len(joints) - 1, 3, DEGREE + 1))
    deviations = np.zeros(len(exact))
    for number, (first, last) in enumerate(pairwise(joints.tolist())):
        if last == first + 1:
            coefficients[:, number, :, : exact.shape[-1]] = exact[:, first]
            continue
        coefficients[:, number], off = merge(first, last)
        deviations = np.maximum(deviations, off)
    return coefficients, deviations


def _merged(motion: Motion, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    """Return polynomials for the steps between two knots, (N, 3, 8), and their deviations, (N,)."""
    steps = last - first
    lasting = steps * motion.step

    def moved(u: FloatArray) -> FloatArray:
        """Return positions of the motion at fractions u of the piece, shape (N, 3, M)."""
        return np.swapaxes(motion.at("position", motion.step * first + lasting * u), 1, 2)

    u = (np.arange(_SAMPLES * steps) + 0.5) / (_SAMPLES * steps)
    ends = _between_ends(motion, first, last)
    c = fitted(ends, _free(), u, moved(u))
    nodes, to_control = to_control_points()
    u = ((np.arange(_PARTS * steps)[:, None] + nodes) / (_PARTS * steps)).ravel()
    off = (c @ powers(u) - moved(u)).reshape(*c.shape[:2], -1, len(nodes)) @ to_control.T
    lengths = np.linalg.norm(off, axis=1)  # of control points, shape (N, parts, 8)
    deviations: FloatArray = np.max(lengths, axis=(1, 2))
    return c / lasting ** np.arange(DEGREE + 1.0), deviations


def _between_ends(motion: Motion, first: int, last: int) -> FloatArray:
    """Return cubics that match the states at two knots, in powers of u, shape (N, 3, 8)."""
    p, q = motion.positions[:, first], motion.positions[:, last]
    lasting = (last - first) * motion.step
    v, w = lasting * motion.velocities[:, first], lasting * motion.velocities[:, last]
    c = np.stack([p, v, 3.0 * (q - p) - 2.0 * v - w, 2.0 * (p - q) + v + w], axis=-1)
    return np.pad(c, ((0, 0), (0, 0), (0, DEGREE - 3)))


def powers(u: FloatArray) -> FloatArray:
    """Return the powers of u from 0 to 7, shape (8, M)."""
    return np.asarray(u ** np.arange(DEGREE + 1)[:, None])


def fitted(ends: FloatArray, free: FloatArray, u: FloatArray, values: FloatArray) -> FloatArray:
    """Return the polynomials closest to values by least squares, in powers of u, (N, 3, 8).

    Args:
        ends: polynomials that match the motion at 0 and 1, shape (N, 3, 8).
        free: polynomials that may be added, which vanish there, shape (F, 8).
        u: samples from 0 to 1, shape (M,).
        values: positions at the samples [m], shape (N, 3, M).
    """
    residuals = (values - ends @ powers(u)).reshape(-1, len(u))
    weights, *_ = np.linalg.lstsq((free @ powers(u)).T, residuals.T, rcond=None)
    return np.asarray(ends + weights.T.reshape(*ends.shape[:2], -1) @ free)


@cache
def _free() -> FloatArray:
    """Return coefficients (4, 8) of four polynomials with zero values and slopes at 0 and 1."""
    u = Polynomial([0.0, 1.0])
    flat_ends = u**2 * (1.0 - u) ** 2
    free = [Legendre.basis(k, domain=[0.0, 1.0]).convert(kind=Polynomial) for k in range(4)]
    return np.array([np.pad((flat_ends * each).coef, (0, 3 - k)) for k, each in enumerate(free)])


@cache
def to_control_points() -> tuple[FloatArray, FloatArray]:
    """Return nodes in [0, 1] and the map from values there to Bézier control points.

    A polynomial stays in the convex hull of its control points, so its norm is bounded by the
    largest norm of a control point.

    Returns:
        Nodes, shape (8,), and the matrix of the map, shape (8, 8).
    """
    nodes = (1.0 - np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)) / 2.0
    k = np.arange(DEGREE + 1)
    several = np.array([comb(DEGREE, each) for each in k])
    bernstein = several * nodes[:, None] ** k * (1.0 - nodes[:, None]) ** (DEGREE - k)
    return nodes, np.asarray(np.linalg.inv(bernstein), dtype=np.float64)
