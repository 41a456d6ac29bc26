"""Times for clocks that count milliseconds."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.samples import evenly
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Grid

_ROUNDING = 1e-6
"""By how much a time may be late and still count as a millisecond [ms]."""


def milliseconds(grid: Grid, rate: float) -> IntArray:
    """Times at a rate [1/s], rounded, and the end, rounded up: since the first knot [ms], rising.

    States are to be taken at the rounded times, so that rounding moves no state in time.
    """
    times = 1000.0 * evenly(grid, rate)
    times[-1] = np.ceil(times[-1] - _ROUNDING)
    return np.unique(np.rint(times).astype(np.int64))
