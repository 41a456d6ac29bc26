"""Motions as quadratic and cubic Bézier segments between whole milliseconds.

A step of a plan is quadratic in time, and a piece of its moving average of one width cubic, so both
are Bézier curves if they begin and end at whole milliseconds. Otherwise cubic segments have the
positions and velocities of the motion at whole milliseconds, and the deviation between is bounded.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.formats.milliseconds import whole_milliseconds
from drake_rho.formats.pieces import to_control_points
from drake_rho.motion.flown import sample
from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray, IntArray

_CLOSE = 1e-4
"""Deviation up to which cubic segments follow motions of higher degrees [m], where segments of 1 ms
allow it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Segments:
    """Motions of N vehicles as Bézier curves with S + 1 ends."""

    ticks: IntArray
    """times of the ends since the beginning [ms], shape (S + 1,)"""
    positions: FloatArray
    """positions of the ends [m], shape (N, S + 1, 3)"""
    control: FloatArray
    """control points between the ends [m], one of quadratic or two of cubic curves, shape
    (N, S, 1 or 2, 3)"""
    deviations: FloatArray | None = None
    """upper bound of the distance from the motion at the same time [m], shape (N,); None if the
    curves are the motion"""


def as_segments(plan: Plan) -> Segments:
    """Return the motion of a plan as Bézier segments."""
    instants = plan.polynomials().instants + plan.scenario.lead
    ticks, exact = whole_milliseconds(instants)
    degree = 2 + (plan.scenario.smoothing.times if plan.scenario.smoothing else 0)
    if exact and degree <= 3:
        return _between(plan, ticks, degree)
    ticks = np.unique(ticks)
    joined = _between(plan, ticks, 3)
    off = _deviations(plan, joined, instants)
    # the deviation of a cubic from a smooth motion falls with the fourth power of its duration
    parts = np.ceil((off.max(axis=0) / _CLOSE) ** 0.25) if degree > 3 else np.ones(len(ticks) - 1)
    if parts.max() > 1:
        finer = [
            np.rint(np.linspace(a, b, max(1, int(n)) + 1)).astype(np.int64)
            for a, b, n in zip(ticks[:-1], ticks[1:], parts, strict=True)
        ]
        joined = _between(plan, np.unique(np.concatenate(finer)), 3)
        off = _deviations(plan, joined, instants)
    return dataclasses.replace(joined, deviations=off.max(axis=1))


def _between(plan: Plan, ticks: IntArray, degree: int) -> Segments:
    """Return segments of degree 2 or 3 with the states of a plan at times [ms].

    If the last time is after the end, by less than 1 ms, the motion goes straight on until then.
    """
    elapsed = ticks / 1000.0 - plan.scenario.lead
    after = np.maximum(elapsed - plan.scenario.lead - plan.scenario.grid.elapsed[-1], 0.0)
    samples = sample(plan, elapsed)
    v = samples.velocities
    p = samples.positions + after[:, None] * v
    lasting = np.diff(ticks)[:, None] / 1000.0
    inner = [p[:, :-1] + lasting / degree * v[:, :-1]]
    if degree == 3:
        inner.append(p[:, 1:] - lasting / degree * v[:, 1:])
    return Segments(ticks, p, np.stack(inner, axis=2))


def _deviations(plan: Plan, segments: Segments, instants: FloatArray) -> FloatArray:
    """Return bounds of the distance of cubic segments from a plan's motion [m], shape (N, S).

    Between the ends of segments and of the motion's pieces, both are polynomials; a bound of their
    difference are its control points.

    Args:
        plan: the plan.
        segments: S segments of each vehicle.
        instants: ends of the motion's pieces since the beginning [s].
    """
    ends = segments.ticks / 1000.0
    inner = instants[(instants > ends[0]) & (instants < ends[-1])]
    cuts = np.unique(np.concatenate([ends, inner]))
    cuts = cuts[cuts <= instants[-1]] if instants[-1] < ends[-1] else cuts
    nodes, to_control = to_control_points()
    times = cuts[:-1, None] + np.diff(cuts)[:, None] * nodes
    which = np.searchsorted(ends, times[:, 0], side="right") - 1
    u = ((times - ends[which, None]) / np.diff(ends)[which, None])[..., None]
    p, c = segments.positions, segments.control
    corners = p[:, which], c[:, which, 0], c[:, which, 1], p[:, which + 1]
    weights = (1.0 - u) ** 3, 3.0 * u * (1.0 - u) ** 2, 3.0 * u**2 * (1.0 - u), u**3
    off = -sample(plan, times.ravel() - plan.scenario.lead).positions.reshape(-1, *times.shape, 3)
    for w, each in zip(weights, corners, strict=True):
        off += w * each[:, :, None]
    sizes = np.linalg.norm(to_control @ off, axis=-1).max(axis=-1)
    found = np.zeros((len(p), len(ends) - 1))
    for number, size in zip(which, sizes.T, strict=True):
        found[:, number] = np.maximum(found[:, number], size)
    return found
