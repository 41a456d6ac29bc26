"""Dual ascent: maximisation of a Lagrangian's minimum over its multipliers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from time import monotonic
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from drake_rho.analysis.dual import Dual, Expansion
from drake_rho.analysis.lagrangian import Lagrangian, Proposal
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.errors import OutOfTimeError
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.numbers import percent

CONVERGED = 1e-8
"""Relative gap to a converged plan's cost at which the ascent ends."""

_MAX_ITERATIONS = 100
"""Largest number of iterations of one maximisation."""

_FALL, _CENTRED = 0.3, 0.05
"""Factor of a barrier over the one before, and part of the distance between dual function and bound
that a Newton step may promise when it falls."""

_TO_THE_BOUNDARY, _MOST_HALVINGS = 0.9, 25
"""Largest part of the way to a multiplier of zero, and halvings of a step."""

_IDLE, _ROUNDING, _ATTEMPTS = 1e-4, 1e-13, 10
"""Multiplier that may count as zero, over the largest one; rounding errors of second derivatives,
over the largest one, and attempts to outweigh them."""

_INSIDE = 4e-6
"""Part by which multipliers are smaller in the end, so that the least curvature is at least this
part of the cost's, and rounding errors are bounded."""


class Climb(NamedTuple):
    """Multipliers for which a Lagrangian's minimum is about the largest."""

    weights: FloatArray
    """λ >= 0, shape (S,)"""
    multipliers: FloatArray
    """y >= 0, shape (R,)"""
    at: FloatArray
    """v of the relaxed problem's solution, shape (M, 3). Where the Lagrangian is hardly convex, its
    minimum is far from that for small changes of the multipliers. So it is the minimum where the
    barrier still counts: the mean of motions that satisfy the curved terms on average."""


class Ascent:
    """Progress of a group's maximisations: the gap so far and the estimated remaining time."""

    def __init__(self, progress: Progress | None, task: str, cost: float, climbs: int) -> None:
        self._progress, self._task, self._cost = progress, task, cost
        self._remaining, self._best, self._iterations = climbs, 0.0, 0
        self._begun = monotonic()

    def begin(self) -> None:
        """Note that the next maximisation begins."""
        self._remaining -= 1
        self._iterations, self._begun = 0, monotonic()

    def report(self, bound: float) -> None:
        """Report the gap to the best bound [m²/s⁴] after an iteration, and the remaining time."""
        self._iterations += 1
        self._best = max(self._best, bound)
        each = (monotonic() - self._begun) / self._iterations
        seconds = each * (_MAX_ITERATIONS * (1 + self._remaining) - self._iterations)
        gap = 1.0 - self._best / self._cost if self._cost > 0.0 else 0.0
        tell(self._progress, f"{self._task}: gap {percent(gap)}, at most {seconds:.0f} s left")


def best_bound(proposal: Proposal, ascent: Ascent) -> tuple[float, Climb]:
    """Return the largest minimum of the Lagrangian that is found, and its multipliers.

    The multipliers of the converged program are tried first; if the Lagrangian is convex there,
    they are optimal. Else the obstacles' multipliers are scaled down until it is convex. Then the
    minimum, a concave function of the multipliers whose gradient consists of the constraints'
    violations, is maximised.

    Returns:
        The minimum [m²/s⁴], and its multipliers.
    """
    lagrangian, given = proposal.lagrangian, (proposal.weights, proposal.multipliers)
    unit = lagrangian.changes.unit**2
    first = lagrangian.minimum(*given)
    ascent.begin()
    if first.value < proposal.index * (1 - CONVERGED) and sum(map(len, given)) > 0:
        found = climbed(lagrangian, *given, progress=ascent.report)
        value = lagrangian.minimum(found.weights, found.multipliers).value
        if value > first.value:
            return unit * value, found
    return unit * first.value, Climb(*given, first.at)


def climbed(
    lagrangian: Lagrangian,
    weights: FloatArray,
    multipliers: FloatArray,
    *,
    enough: float = np.inf,
    tolerance: float = CONVERGED,
    progress: Callable[[float], None] = lambda bound: None,
) -> Climb:
    """Return multipliers for which the Lagrangian's minimum is about the largest.

    An interior-point method follows the maximisers of the dual function with a barrier, whose
    factor falls: Newton steps bring them close enough to the next one.

    Args:
        lagrangian: the Lagrangian.
        weights: λ to start near, shape (S,).
        multipliers: y to start near, shape (R,).
        enough: minimum at which the maximisation ends [m²/s⁴].
        tolerance: relative distance from the largest minimum at which it ends.
        progress: called with the largest minimum so far [m²/s⁴] after each iteration.
    """
    if len(weights) + len(multipliers) == 0:
        return Climb(weights, multipliers, np.zeros((lagrangian.changes.free.shape[1], 3)))
    dual, unit = Dual(lagrangian), lagrangian.changes.unit**2
    best = x = dual.inside(weights, multipliers)
    here = dual.around(x)
    assert here is not None  # noqa: S101  # x is inside
    found = here
    factor = max(abs(lagrangian.changes.least), abs(here.value)) / dual.degree
    with suppress(OutOfTimeError):
        for _ in range(_MAX_ITERATIONS):
            near = factor * dual.degree <= tolerance * abs(found.value)
            if near or unit * found.value >= enough:
                break
            check_time()
            step, promised = _newton_step(here, factor, x)
            moved = _along(dual, x, here, step, promised, factor)
            if moved is None:
                break  # rounding
            x, here, is_whole = moved
            if here.value > found.value:
                best, found = x, here
            if is_whole or promised <= _CENTRED * factor * dual.degree:
                factor *= _FALL
            progress(unit * found.value)
    at = lagrangian.minimiser(*dual.given(x))
    assert at is not None  # noqa: S101  # the barrier is finite at x
    weights, multipliers = dual.given(_without_idle(best, found))
    if lagrangian.curvature(weights) < _INSIDE:
        # concave in all multipliers together, the minimum falls by at most this part
        weights, multipliers = (1.0 - _INSIDE) * weights, (1.0 - _INSIDE) * multipliers
    return Climb(weights, multipliers, at)


def _newton_step(here: Expansion, factor: float, x: FloatArray) -> tuple[FloatArray, float]:
    """Return the step to the maximum of the second-order model, and the rise in first order."""
    slopes = x * (here.slopes + factor * here.barrier_slopes)  # of relative changes
    falls = (here.falls + factor * here.barrier_falls) * x * x[:, None]
    added = _ROUNDING * float(np.diagonal(falls).max())
    for _ in range(_ATTEMPTS):
        step, failed = dposv(falls, slopes, lower=1)[1:]
        if not failed:
            return x * step, float(slopes @ step)
        falls[np.diag_indices(len(x))] += added  # rounding took more than its least eigenvalue
        added *= 10.0
    return np.zeros_like(x), 0.0


def _along(
    dual: Dual, x: FloatArray, here: Expansion, step: FloatArray, promised: float, factor: float
) -> tuple[FloatArray, Expansion, bool] | None:
    """Return better multipliers along a step, and whether it is a whole one; None if none are."""
    merit = here.value + factor * here.barrier
    part = min(1.0, _TO_THE_BOUNDARY / max(float(np.max(-step / x)), _TO_THE_BOUNDARY))
    for _ in range(_MOST_HALVINGS):
        at = dual.around(x + part * step)
        if at is not None:
            risen = at.value + factor * at.barrier - merit
            if risen >= 1e-4 * part * promised - 1e-9 * abs(merit):
                return x + part * step, at, part == 1.0
        part /= 2.0
    return None


def _without_idle(x: FloatArray, found: Expansion) -> FloatArray:
    """Return multipliers without those close to zero, if that lowers nothing in second order.

    Fewer terms make a Lagrangian faster, and a certificate's file smaller.
    """
    change = np.where((found.slopes < 0.0) & (x < _IDLE * x.max()), -x, 0.0)
    risen = found.slopes @ change - change @ found.falls @ change
    return x + change if risen >= -CONVERGED * abs(found.value) else x
