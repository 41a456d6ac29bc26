"""Sample times in whole milliseconds."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.samples import evenly
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Grid

_ROUNDING = 1e-6
"""Amount by which the end may exceed a whole millisecond without being rounded up [ms]."""


def milliseconds(grid: Grid, rate: float) -> IntArray:
    """Return sample times since the first knot at a rate [1/s], in whole milliseconds, increasing.

    Times are rounded, and the end is rounded up. Callers sample states at the rounded times, so
    rounding shifts no state in time.
    """
    times = 1000.0 * evenly(grid, rate)
    times[-1] = np.ceil(times[-1] - _ROUNDING)
    return np.unique(np.rint(times).astype(np.int64))
