"""Checks of the states and the time given for a window."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario

_CLOCK = 1e-4
"""Largest difference of a caller's time from a knot, in steps; allows for errors of its clock."""


def states_of(scenario: Scenario, states: npt.ArrayLike) -> FloatArray:
    """Return states as an array, shape (N, 6), with rows of NaN for vehicles that were not seen.

    Raises:
        ValueError: the shape is wrong, or a value of a vehicle that was seen is not finite.
    """
    count = len(scenario.vehicles)
    array = np.array(states, dtype=np.float64)
    if array.shape != (count, 6):
        raise ValueError(f"states: got shape {array.shape}, expected {(count, 6)}")
    unseen = np.isnan(array).all(axis=1)
    wrong = ~np.isfinite(array).all(axis=1) & ~unseen
    if wrong.any():
        vehicle = scenario.vehicles[int(np.argmax(wrong))].name
        expected = f"finite numbers for {vehicle}, or NaN in its whole row if it was not seen"
        raise ValueError(f"states: got {array.tolist()}, expected {expected}")
    array[(np.abs(array) > LARGEST).any(axis=1)] = np.nan  # no flight has such states
    return array


def knot_at(grid: Grid, time: float, knots: range) -> int:
    """Return the number of the knot at a time.

    Args:
        grid: of the flight.
        time: on the scenario's clock [s].
        knots: possible first knots of a window, counted from 0.

    Raises:
        ValueError: the time is not that of one of these knots.
    """
    steps = (time - grid.start) / grid.step
    knot = round(steps) if np.isfinite(steps) else -1
    late = abs(steps - knot) > _CLOCK and not grid.clock.same(time, grid.start + knot * grid.step)
    if knot not in knots or late:
        first, last = (grid.times[min(k, grid.knots - 1)] for k in (knots.start, knots.stop - 1))
        expected = f"the time of a knot from {clock_number(first)} to {clock_time(last)}"
        raise ValueError(f"time: got {time!r}, expected {expected}")
    return knot
