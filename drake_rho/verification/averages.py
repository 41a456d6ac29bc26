"""Smooth motions, computed by other means than those with which plans are flown.

The acceleration of a smooth motion is an average of the plan's, in which each step has the part of
the weights that lies in it: a difference of two values of their sum up to a time, which for one,
two or three averages is the distribution of as many uniform numbers. Between the instants at which
these polynomials begin and end, it is a polynomial of degree n, found here from n + 1 of its
values. Two integrations from rest at the start lead to velocities and positions.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import SAME_TIME
from drake_rho.verification.trajectory import PiecewiseTrajectory

_REACH = np.arange(-2, 3)
"""Steps whose accelerations are in an average, relative to the one at its time: averages are at
most three steps wide."""


def averaged(trajectory: PiecewiseTrajectory) -> PiecewiseTrajectory:
    """Return the smooth motions of plans; the trajectory itself if its scenario has no smoothing.

    Args:
        trajectory: of plans, whose pieces are the steps of the grid.
    """
    scenario, knots = trajectory.scenario, trajectory.elapsed
    if scenario.smoothing is None:
        return trajectory
    n, step = scenario.smoothing.times, scenario.grid.step
    corners = knots[:, None] + scenario.smoothing.width * (np.arange(n + 1) - n / 2.0)
    instants = _distinct(np.unique(corners), knots, SAME_TIME * step)
    durations = np.diff(instants)
    nodes = (np.arange(n + 1) + 0.5) / (n + 1)
    times = (instants[:-1, None] + durations[:, None] * nodes).reshape(-1)
    values = _accelerations(trajectory, times).reshape(-1, len(durations), n + 1, 3)
    powers = np.linalg.inv(nodes[:, None] ** np.arange(n + 1))
    a = np.einsum("mi,njix->mnjx", powers, values)  # of powers of the part of a piece
    h, m = durations[:, None], np.arange(n + 1)[:, None, None, None]
    gained = h * np.sum(a / (m + 1.0), axis=0)
    start = scenario.fleet.start_velocities[:, None]
    v = np.concatenate([start, gained], axis=1).cumsum(axis=1)
    moved = h * v[:, :-1] + h**2 * np.sum(a / ((m + 1.0) * (m + 2.0)), axis=0)
    start = scenario.fleet.start_positions[:, None]
    p = np.concatenate([start, moved], axis=1).cumsum(axis=1)
    higher = [a[i] / ((i + 1.0) * (i + 2.0)) / h**i for i in range(1, n + 1)]
    return dataclasses.replace(
        trajectory,
        elapsed=instants,
        durations=durations,
        knots=np.isin(instants, knots),
        positions=p,
        velocities=v,
        accelerations=a[0],
        commands=a[0],
        higher=np.stack(higher, axis=2),
    )


def _distinct(corners: FloatArray, knots: FloatArray, same: float) -> FloatArray:
    """Return knots, and corners that are further than a time from knots and each other [s]."""
    after = np.clip(np.searchsorted(knots, corners), 1, len(knots) - 1)
    beside = knots[np.stack([after - 1, after], axis=1)]
    corners = corners[np.abs(corners[:, None] - beside).min(axis=1) > same]
    return np.union1d(corners[np.append(True, np.diff(corners) > same)[: len(corners)]], knots)


def _accelerations(trajectory: PiecewiseTrajectory, times: FloatArray) -> FloatArray:
    """Return averages of accelerations at times since the first knot [s], shape (N, M, 3)."""
    smoothing, knots = trajectory.scenario.smoothing, trajectory.elapsed
    assert smoothing is not None  # noqa: S101  # callers check this
    steps = len(trajectory.durations)
    k = np.searchsorted(knots, times, side="right")[:, None] - 1 + _REACH
    during = (k >= 0) & (k < steps)  # accelerations are zero elsewhere
    k = np.clip(k, 0, steps - 1)
    passed = (times[:, None] - knots[k], times[:, None] - knots[k + 1])
    begun, ended = (_part_before(each / smoothing.width, smoothing.times) for each in passed)
    weights = np.where(during, begun - ended, 0.0)
    return np.asarray(np.einsum("mr,nmrx->nmx", weights, trajectory.accelerations[:, k]))


def _part_before(x: FloatArray, times: int) -> FloatArray:
    """Return the part of the weights of averages up to x, in widths from their middle."""
    if times == 1:
        return np.clip(x + 0.5, 0.0, 1.0)
    s = np.minimum(np.abs(x), times / 2.0)
    if times == 2:
        after = (1.0 - s) ** 2 / 2.0
    else:
        after = np.where(s > 0.5, (1.5 - s) ** 3 / 6.0, 0.5 - 0.75 * s + s**3 / 3.0)
    return np.where(x > 0.0, 1.0 - after, after)
