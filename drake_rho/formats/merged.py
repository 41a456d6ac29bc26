"""Smooth motions as fewer polynomials of degree 7 with continuous accelerations.

The pieces of a smooth motion are of degree 5 at most, so they are exact if few enough. Otherwise
neighbours are merged: positions, velocities and accelerations at both ends are those of the motion,
and the two free coefficients of each axis are fitted by least squares.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.polynomial import Polynomial

from drake_rho.formats.pieces import DEGREE, Pieces, fitted, joined, powers, to_control_points
from drake_rho.motion.polynomials import Polynomials
from drake_rho.scenario.fields import FloatArray, IntArray

_SAMPLES = 8
"""Number of samples of each piece for the fit."""


def merged(motion: Polynomials, most: int) -> Pieces:
    """Return smooth motions as a bounded number of polynomials of nearly equal durations.

    Args:
        motion: motions of N vehicles.
        most: largest number of pieces, at least 1.
    """
    joints = _joints(motion.instants, most)
    found = joined(motion.coefficients, joints, partial(_merge, motion))
    return Pieces(np.diff(motion.instants[joints]), *found)


def _joints(instants: FloatArray, most: int) -> IntArray:
    """Return the indices of the ends of merged pieces, at most `most` + 1."""
    if len(instants) - 1 <= most:
        return np.arange(len(instants))
    even = np.linspace(instants[0], instants[-1], most + 1)
    after = np.clip(np.searchsorted(instants, even), 1, len(instants) - 1)
    nearer = after - (even - instants[after - 1] < instants[after] - even)
    return np.unique(nearer)


def _merge(motion: Polynomials, first: int, last: int) -> tuple[FloatArray, FloatArray]:
    """Return polynomials for the pieces between two instants, (N, 3, 8), and deviations, (N,)."""
    begin, lasting = motion.instants[first], motion.instants[last] - motion.instants[first]
    parts = range(first, last)
    fractions = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    times = np.concatenate([_within(motion, k, fractions) for k in parts])
    values = np.concatenate([_values(motion, k, fractions) for k in parts], axis=2)
    u = (times - begin) / lasting
    ends = _between_ends(motion, first, last, lasting)
    c = fitted(ends, _FREE, u, values)
    deviations = np.zeros(len(c))
    nodes, to_control = to_control_points()
    for k in parts:
        u = (_within(motion, k, nodes) - begin) / lasting
        off = (c @ powers(u) - _values(motion, k, nodes)) @ to_control.T
        deviations = np.maximum(deviations, np.linalg.norm(off, axis=1).max(axis=1))
    return c / lasting ** np.arange(DEGREE + 1.0), deviations


def _within(motion: Polynomials, k: int, fractions: FloatArray) -> FloatArray:
    """Return times at fractions of a piece [s], shape (M,)."""
    return np.asarray(motion.instants[k] + np.diff(motion.instants)[k] * fractions)


def _values(motion: Polynomials, k: int, fractions: FloatArray) -> FloatArray:
    """Return positions at fractions of a piece [m], shape (N, 3, M)."""
    s = np.diff(motion.instants)[k] * fractions
    c = motion.coefficients[:, k]
    return np.asarray(c @ s ** np.arange(c.shape[-1])[:, None])


def _between_ends(motion: Polynomials, first: int, last: int, lasting: float) -> FloatArray:
    """Return quintics that match the motion at two instants, in powers of u, shape (N, 3, 8)."""
    begin = motion.coefficients[:, first, :, :3] * lasting ** np.arange(3.0)
    u = float(np.diff(motion.instants)[last - 1]) / lasting
    c = motion.coefficients[:, last - 1]
    c = c * lasting ** np.arange(c.shape[-1])
    at_end = [c @ _rates(m, u)[: c.shape[-1]] for m in range(3)]
    known = [at_end[m] - begin @ _rates(m, 1.0)[:3] for m in range(3)]
    others = np.array([_rates(m, 1.0)[3:6] for m in range(3)])
    rest = np.stack(known, axis=-1) @ np.linalg.inv(others).T
    return np.concatenate([begin, rest, np.zeros((*begin.shape[:2], 2))], axis=-1)


def _rates(order: int, u: float) -> FloatArray:
    """Return the derivatives of the powers 0 to 7 at u, shape (8,)."""
    k = np.arange(DEGREE + 1.0)
    factors = np.prod(np.array([k - m for m in range(order)]), axis=0)
    return np.asarray(factors * u ** np.maximum(k - order, 0.0))


_FLAT = Polynomial([0.0, 1.0]) ** 3 * Polynomial([1.0, -1.0]) ** 3
_FREE = np.array([np.append(_FLAT.coef, 0.0), (_FLAT * Polynomial([-1.0, 2.0])).coef])
"""Coefficients of two polynomials that are flat at 0 and 1, without curvature, shape (2, 8)."""
