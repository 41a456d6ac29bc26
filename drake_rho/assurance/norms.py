"""Limits on norms, judged at the knots, which are enough for every instant.

The velocity is linear in a step, so its norm, which is convex, is largest at a knot; accelerations
are constant in a step, and with them thrust and tilt.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.assurance.report import UNITS, Column
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.norms import NormLimit
from drake_rho.scenario.parts import GRAVITY
from drake_rho.scenario.records import Scenario


def check_norms(scenario: Scenario, motion: Motion) -> Iterator[Column]:
    """The check of every limit on a norm that the scenario has."""
    limits, times = scenario.fleet.norms, scenario.grid.times
    accelerations = motion.accelerations
    thrusts = accelerations + np.array([0.0, 0.0, GRAVITY])
    if "max_speed" in limits:
        yield _check_norm(limits["max_speed"], times, motion.velocities, UNITS["velocity"])
    unit = UNITS["acceleration"]
    if "max_acceleration" in limits:
        yield _check_norm(limits["max_acceleration"], times, accelerations, unit)
    if "max_thrust" in limits:
        yield _check_norm(limits["max_thrust"], times, thrusts, unit)
    if "max_tilt" in limits:
        yield _check_tilt(limits["max_tilt"], times, thrusts)


def _check_norm(limit: NormLimit, times: FloatArray, vectors: FloatArray, unit: str) -> Column:
    """The largest norm of each vehicle's vectors, shape (N, M, 3)."""
    norms = np.linalg.norm(vectors, axis=2)
    k = np.argmax(norms, axis=1)  # the first value that is no number, if there is one
    return _column(limit, times[k], _pick(norms, k), limit.sets.tolerances, unit)


def _check_tilt(limit: NormLimit, times: FloatArray, thrusts: FloatArray) -> Column:
    """The largest angle of each vehicle's thrusts, shape (N, M, 3), to the upright.

    The tolerance is one of accelerations, so as an angle it grows as the thrust falls, and no angle
    is one of no thrust. Where a limit is broken, the angle that is most tolerances beyond is told.
    """
    angles = np.arctan2(np.linalg.norm(thrusts[..., :2], axis=2), thrusts[..., 2])
    sizes = np.linalg.norm(thrusts, axis=2)
    least = limit.sets.tolerances[:, None] / np.pi
    tolerances = limit.sets.tolerances[:, None] / np.maximum(sizes, least)  # of pi at most
    excess = angles - limit.most[:, None]
    broken = np.any(excess > tolerances, axis=1, keepdims=True)
    k = np.argmax(np.where(broken, excess / tolerances, angles), axis=1)
    return _column(limit, times[k], _pick(angles, k), _pick(tolerances, k), "rad")


def _column(
    limit: NormLimit, times: FloatArray, values: FloatArray, tolerances: FloatArray, unit: str
) -> Column:
    return Column(
        constraint=limit.kind.name,
        parts=[""] * len(values),
        times=times,
        values=values,
        limits=limit.most,
        excess=values - limit.most,
        tolerances=tolerances,
        unit=unit,
        due=np.isfinite(limit.most),
    )


def _pick(values: FloatArray, k: IntArray) -> FloatArray:
    """The k[i]-th of each row i."""
    picked: FloatArray = np.take_along_axis(values, k[:, None], axis=1)[:, 0]
    return picked
