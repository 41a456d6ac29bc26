"""Sample times in whole milliseconds."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.samples import evenly
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

_ROUNDING = 1e-6
"""Difference from a whole millisecond that is only rounding [ms]."""


def milliseconds(scenario: Scenario, rate: float) -> IntArray:
    """Return sample times since the beginning at a rate [1/s], in whole milliseconds, increasing.

    A flight begins at the first knot, and with a smoothing `Scenario.lead` before it.

    Times are rounded, and the end is rounded up. Callers sample states at the rounded times, so
    rounding shifts no state in time.
    """
    ticks, _ = whole_milliseconds(evenly(scenario.grid, rate, scenario.lead))
    return np.unique(ticks)


def whole_milliseconds(times: FloatArray) -> tuple[IntArray, bool]:
    """Return increasing times [s] in whole milliseconds, and whether all of them were whole.

    Times are rounded, and the last one is rounded up.
    """
    exact = 1000.0 * times
    whole = np.rint(exact)
    same = np.abs(exact - whole) <= _ROUNDING
    whole[-1] = whole[-1] if same[-1] else np.ceil(exact[-1])
    return whole.astype(np.int64), bool(same.all())
