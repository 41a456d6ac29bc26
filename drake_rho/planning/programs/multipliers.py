"""The multipliers of small programs, by their duals: least squares within bounds."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dtrtrs
from scipy.optimize import nnls

from drake_rho.planning.errors import SolverError
from drake_rho.planning.programs.daqp import least_within
from drake_rho.scenario.fields import FloatArray

_BROKEN = 1e-9
"""By how much a row of length one may be broken, in the largest of what rows need."""

_MOST = 10
"""Bound on the changes of the set of active rows, in numbers of rows."""


def multipliers_of(
    products: FloatArray,
    needed: FloatArray,
    y: FloatArray,
    most: FloatArray,
    *,
    dense: bool = False,
) -> FloatArray:
    """The y, 0 <= y <= most, that minimises y · products @ y / 2 - needed · y.

    Args:
        products: positive definite, shape (R, R).
        needed: shape (R,).
        y: where to begin, shape (R,); what is zero, and less than it needs, begins as free.
        most: above 0, may be infinite, shape (R,).
        dense: whether a solver of dense programs may be asked, which `Daqp` is.

    Raises:
        SolverError: it comes to no end, or `products` is not what it should be.
    """
    if np.isinf(most).all():
        return _unbounded(products, needed)
    found = least_within(products, needed, most) if dense else None
    return _bounded(products, needed, y, most) if found is None else found


def _bounded(
    products: FloatArray, needed: FloatArray, y: FloatArray, most: FloatArray
) -> FloatArray:
    """`multipliers_of` by the active-set method of Lawson and Hanson, bounds as Stark and Parker's.

    Several multipliers leave their bounds at once, all whose slope is half as steep as the
    steepest. The cost falls no less: those that would leave again at once stay before they move.
    """
    y = np.minimum(np.maximum(y, 0.0), most)
    full = y >= most
    free = ~full & ((y > 0.0) | (needed - products @ y > _BROKEN))
    left = needed - products @ np.where(full, most, 0.0)
    for _ in range(_MOST * len(y)):
        rows = free.nonzero()[0]
        z, failed = np.zeros(0), 0
        if len(rows) > 0:
            _, z, failed = dposv(products[rows[:, None], rows], left[rows])
        if failed:
            break
        out = ((z <= 0.0) | (z >= most[rows])).nonzero()[0]
        if len(out) > 0:
            gone, bounds = rows[out], np.where(z[out] <= 0.0, 0.0, most[rows[out]])
            way, before = z[out] - y[gone], bounds - y[gone]
            parts = np.divide(before, way, out=np.zeros(len(out)), where=way != 0.0)
            part = max(float(parts.min()), 0.0)
            y[rows] += part * (z - y[rows])
            first = (parts <= part).nonzero()[0]
            gone, bounds = gone[first], bounds[first]
            y[gone], free[gone], full[gone] = bounds, False, bounds > 0.0
        else:
            y[rows] = z
            steep = needed - products @ y
            steep[free] = 0.0
            steep[full] *= -1.0
            worst = float(steep.max())
            if worst <= _BROKEN:
                return y
            gone = (steep > 0.5 * worst).nonzero()[0]
            bounds = y[gone]
            free[gone], full[gone] = True, False
        if bounds.any():  # some are at their upper bounds now, or no longer
            left = needed - products @ np.where(full, most, 0.0)
    raise SolverError("the multipliers of a group were not found")


def _unbounded(products: FloatArray, needed: FloatArray) -> FloatArray:
    """`multipliers_of` without upper bounds: non-negative least squares."""
    factor, failed = dpotrf(products, lower=True, clean=True)
    if not failed:
        with suppress(RuntimeError):  # it comes to no end
            y: FloatArray = nnls(factor.T, dtrtrs(factor, needed, lower=True)[0])[0]
            return y
    raise SolverError("the multipliers of a group were not found")
