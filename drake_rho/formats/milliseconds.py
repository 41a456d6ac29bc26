"""Sample times in whole milliseconds."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.samples import evenly
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_ROUNDING = 1e-6
"""Amount by which the end may exceed a whole millisecond without being rounded up [ms]."""


def milliseconds(scenario: Scenario, rate: float) -> IntArray:
    """Return sample times since the beginning at a rate [1/s], in whole milliseconds, increasing.

    A flight begins at the first knot, and with a smoothing `Scenario.lead` before it.

    Times are rounded, and the end is rounded up. Callers sample states at the rounded times, so
    rounding shifts no state in time.
    """
    times = 1000.0 * evenly(scenario.grid, rate, scenario.lead)
    times[-1] = np.ceil(times[-1] - _ROUNDING)
    return np.unique(np.rint(times).astype(np.int64))
