"""Smooth motions, computed independently of the code that flies them.

The acceleration of a smooth motion is a moving average of the plan's. The weight of a step is the
integral of the kernel over it: a difference of two values of the cumulative kernel, which for one,
two or three averages is the distribution of the sum of as many uniform variables. The average is a
piecewise polynomial of degree n, found in each piece from n + 1 of its values. Two integrations
give velocities and positions, from rest at the start or, in a window of a flight, from averages of
the earlier positions and velocities, by Gauss quadrature in each piece, which is exact.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.times import Clock
from drake_rho.verification.trajectory import PiecewiseTrajectory

_OFFSETS = np.arange(-2, 3)
"""Offsets of the steps whose accelerations enter an average, which is at most three steps wide."""


def averaged(trajectory: PiecewiseTrajectory) -> PiecewiseTrajectory:
    """Return the smooth motions of plans; the trajectory itself if its scenario has no smoothing.

    Args:
        trajectory: trajectory of plans; its pieces are the steps of the grid.
    """
    scenario, knots = trajectory.scenario, trajectory.elapsed
    if scenario.smoothing is None:
        return trajectory
    n, step = scenario.smoothing.times, scenario.grid.step
    offsets = scenario.smoothing.width * (np.arange(n + 1) - n / 2.0)
    corners = np.unique(_with_flown(trajectory)[0][:, None] + offsets)
    clock = Clock.of(step)
    corners = clock.apart(clock.distinct(corners[~clock.before(corners, offsets[0])]), knots)
    instants = np.union1d(corners, knots)
    durations = np.diff(instants)
    nodes = (np.arange(n + 1) + 0.5) / (n + 1)
    times = (instants[:-1, None] + durations[:, None] * nodes).reshape(-1)
    values = _accelerations(trajectory, times).reshape(-1, len(durations), n + 1, 3)
    powers = np.linalg.inv(nodes[:, None] ** np.arange(n + 1))
    a = np.einsum("mi,njix->mnjx", powers, values)  # of powers of the part of a piece
    h, m = durations[:, None], np.arange(n + 1)[:, None, None, None]
    gained = h * np.sum(a / (m + 1.0), axis=0)
    positions, velocities = _begun(trajectory)
    v = np.concatenate([velocities[:, None], gained], axis=1).cumsum(axis=1)
    moved = h * v[:, :-1] + h**2 * np.sum(a / ((m + 1.0) * (m + 2.0)), axis=0)
    p = np.concatenate([positions[:, None], moved], axis=1).cumsum(axis=1)
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
        jerks=trajectory.jerks.none,
    )


def _accelerations(trajectory: PiecewiseTrajectory, times: FloatArray) -> FloatArray:
    """Return averages of accelerations at times since the first knot [s], shape (N, M, 3)."""
    smoothing = trajectory.scenario.smoothing
    assert smoothing is not None  # noqa: S101  # callers check this
    knots, planned = _with_flown(trajectory)
    steps = planned.shape[1]
    k = np.searchsorted(knots, times, side="right")[:, None] - 1 + _OFFSETS
    during = (k >= 0) & (k < steps)  # accelerations are zero elsewhere
    k = np.clip(k, 0, steps - 1)
    passed = (times[:, None] - knots[k], times[:, None] - knots[k + 1])
    begun, ended = (_part_before(each / smoothing.width, smoothing.times) for each in passed)
    weights = np.where(during, begun - ended, 0.0)
    return np.asarray(np.einsum("mr,nmrx->nmx", weights, planned[:, k]))


def _with_flown(trajectory: PiecewiseTrajectory) -> tuple[FloatArray, FloatArray]:
    """Return knots [s] and accelerations, preceded by those already flown, if any."""
    knots, flown = trajectory.elapsed, trajectory.scenario.fleet.flown
    if flown is None:
        return knots, trajectory.accelerations
    before = -trajectory.scenario.grid.step * np.arange(flown.shape[1], 0, -1)
    accelerations = np.concatenate([flown, trajectory.accelerations], axis=1)
    return np.append(before, knots), accelerations


def _begun(trajectory: PiecewiseTrajectory) -> tuple[FloatArray, FloatArray]:
    """Return initial positions and velocities of smooth motions, (N, 3) each."""
    scenario, smoothing = trajectory.scenario, trajectory.scenario.smoothing
    p, v, a = scenario.fleet.start_positions, scenario.fleet.start_velocities, scenario.fleet.flown
    if smoothing is None or a is None:
        return p, v
    h, n, w = scenario.grid.step, smoothing.times, smoothing.width
    corners = -scenario.lead + w * (np.arange(n + 1) - n / 2.0)
    knots = -h * np.arange(a.shape[1], 0, -1)
    cuts = np.unique(np.append(corners, knots[(knots > corners[0]) & (knots < corners[-1])]))
    nodes, parts = np.polynomial.legendre.leggauss(4)
    half = np.diff(cuts)[:, None] / 2.0
    times = (cuts[:-1, None] + half * (1.0 + nodes)).reshape(-1)
    weights = (half * parts).reshape(-1) * _density((times + scenario.lead) / w, n) / w
    # before the first knot: each step lasts from its beginning, or from a time, until 0
    since = np.maximum(times[:, None], knots)
    acted = np.maximum(np.append(knots[1:], 0.0) - since, 0.0)
    middle = (np.append(knots[1:], 0.0) + since) / 2.0
    velocities = v[:, None] - np.einsum("mk,nkx->nmx", acted, a)
    moved = np.einsum("mk,nkx->nmx", acted * (middle - times[:, None]), a)
    positions = p[:, None] + times[:, None] * v[:, None] + moved
    return np.einsum("m,nmx->nx", weights, positions), np.einsum("m,nmx->nx", weights, velocities)


def _density(x: FloatArray, times: int) -> FloatArray:
    """Return the averaging kernel at x, in widths from its middle, for a width of 1."""
    s = np.abs(x)
    if times == 1:
        return np.ones_like(s)
    if times == 2:
        return 1.0 - s
    return np.where(s > 0.5, (1.5 - s) ** 2 / 2.0, 0.75 - s**2)


def _part_before(x: FloatArray, times: int) -> FloatArray:
    """Return the integral of the averaging kernel up to x, in widths from its middle."""
    if times == 1:
        return np.clip(x + 0.5, 0.0, 1.0)
    s = np.minimum(np.abs(x), times / 2.0)
    if times == 2:
        after = (1.0 - s) ** 2 / 2.0
    else:
        after = np.where(s > 0.5, (1.5 - s) ** 3 / 6.0, 0.5 - 0.75 * s + s**3 / 3.0)
    return np.where(x > 0.0, 1.0 - after, after)
