"""Greatest convex measures of smooth motions over time, of positions or of their derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.verification.between_samples import Maximum
from drake_rho.verification.highest_over_time import Highest, highest_over_time
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory

Measure = Callable[[FloatArray], FloatArray]
"""Convex and 1-Lipschitz function of vectors (..., 3) with values of shape (...)."""


def highest_of_steps(
    steps: Steps,
    instants: FloatArray,
    measure: Measure,
    precision: FloatArray,
    pieces: BoolArray | None = None,
    errors: FloatArray | None = None,
) -> Highest:
    """Return when a measure of each of M curves is greatest.

    Args:
        steps: the curves, one after another, J steps of each.
        instants: ends of the steps [s], shape (J + 1,).
        measure: the measure.
        precision: amount by which a greater value may be missed, shape (M,).
        pieces: flags of the steps that count, shape (J,); all if not given.
        errors: largest error radii in the steps, added to the measure, shape (J,).
    """
    count, steps_each = len(precision), len(instants) - 1
    states = [each.reshape(count, steps_each, 3) for each in (steps.p, steps.v, steps.a)]
    higher = None
    if steps.higher is not None:
        more = steps.higher.reshape(count, steps_each, -1, 3)
        higher = (more, steps.acceleration_norms.reshape(count, steps_each))
    counted = np.arange(steps_each) if pieces is None else np.flatnonzero(pieces)
    radii = np.zeros(steps_each) if errors is None else errors
    parts = np.arange(len(instants), dtype=np.float64)  # time in numbers of steps
    found = highest_over_time(
        (states[0], states[1], states[2]),
        parts,
        counted,
        lambda x, _: measure(x),
        lambda piece, times: np.broadcast_to(radii[piece], times.shape),
        np.zeros(steps_each),
        precision,
        Highest(np.zeros(count), np.full(count, -np.inf), np.zeros(count)),
        higher,
    )
    return Highest(np.interp(found.times, parts, instants), found.values, found.errors)


def greatest_of_smooth(
    trajectory: PiecewiseTrajectory, order: int, measure: Measure, precision: FloatArray
) -> Maximum:
    """Return when a measure of each vehicle's velocity (1), … or jerk (3) is greatest."""
    steps = trajectory.derivatives(order)
    errors = trajectory.errors_of(order)
    found = highest_of_steps(steps, trajectory.times, measure, precision, errors=errors)
    return Maximum(found.times, found.values, found.errors)
