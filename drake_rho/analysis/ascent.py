"""Dual ascent: maximisation of a Lagrangian's minimum over its multipliers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from time import monotonic

import numpy as np

from drake_rho.analysis.lagrangian import Lagrangian, Proposal
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.errors import OutOfTimeError
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.numbers import percent

CONVERGED = 1e-8
"""Relative gap to a converged plan's cost at which the ascent ends."""

_MAX_ITERATIONS = 300
"""Largest number of iterations of one maximisation."""

_CONVEX = 0.98
"""Part of the multipliers of obstacles with which the Lagrangian is just convex, to begin with."""

_INSIDE = 4e-6
"""Part by which multipliers are smaller in the end, so that the least curvature is at least this
part of the cost's, and rounding errors are bounded."""

_BEYOND = 1e3
"""Value of a Lagrangian that is not convex, as a multiple of its minima."""

_MEMORY = 20
"""Number of earlier gradients that approximate the curvature."""


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


def best_bound(proposal: Proposal, ascent: Ascent) -> tuple[float, FloatArray, FloatArray]:
    """Return the largest minimum of the Lagrangian that is found, and its multipliers λ and y.

    The multipliers of the converged program are tried first; if the Lagrangian is convex there,
    they are optimal. Else the obstacles' multipliers are scaled down until it is convex. Then the
    minimum, a concave function of the multipliers whose gradient consists of the constraints'
    violations, is maximised.

    Returns:
        The minimum [m²/s⁴], λ, shape (S,), and y, shape (R,).
    """
    lagrangian, given = proposal.lagrangian, (proposal.weights, proposal.multipliers)
    unit = lagrangian.changes.unit**2
    first = lagrangian.minimum(*given).value
    ascent.begin()
    if first >= proposal.index * (1 - CONVERGED) or sum(map(len, given)) == 0:
        return unit * first, *given
    found = climbed(lagrangian, *given, progress=ascent.report)
    value = lagrangian.minimum(*found).value
    return (unit * value, *found) if value > first else (unit * first, *given)


def climbed(
    lagrangian: Lagrangian,
    weights: FloatArray,
    multipliers: FloatArray,
    *,
    enough: float = np.inf,
    most: int = _MAX_ITERATIONS,
    progress: Callable[[float], None] = lambda bound: None,
) -> tuple[FloatArray, FloatArray]:
    """Return multipliers λ, y >= 0 for which the Lagrangian's minimum is larger.

    Args:
        lagrangian: the Lagrangian.
        weights: λ to start with, scaled down if the Lagrangian is not convex there, shape (S,).
        multipliers: y to start with, shape (R,).
        enough: minimum at which the maximisation ends [m²/s⁴].
        most: largest number of iterations.
        progress: called with the largest minimum so far [m²/s⁴] after each iteration.
    """
    from scipy.optimize import minimize  # imported here because it is slow to load

    if len(weights) + len(multipliers) == 0:
        return weights, multipliers
    # as multipliers of rows of length one, all have about the same curvature
    sizes = np.concatenate([1.0 / lagrangian.curved.sizes, np.ones(len(multipliers))])
    loss = 1.0 - lagrangian.curvature(weights)  # proportional to the weights
    convex = weights * min(1.0, _CONVEX / loss if loss > 0.0 else 1.0)
    start = np.concatenate([convex, multipliers]) / sizes
    count, unit = len(weights), lagrangian.changes.unit**2
    best, found = -np.inf, start
    scale = abs(lagrangian.changes.least) + 1.0

    def descend(x: FloatArray) -> tuple[float, FloatArray]:
        nonlocal best, found
        check_time()
        given = np.maximum(x, 0.0) * sizes
        value, *slopes = lagrangian.value_and_slopes(given[:count], given[count:])
        if value == -np.inf:
            return _BEYOND * max(scale, abs(best)), np.zeros_like(x)
        if value > best:
            best, found = value, given
            if unit * value >= enough:
                raise StopIteration
        return -value, -np.concatenate(slopes) * sizes

    with suppress(OutOfTimeError, StopIteration):
        if -descend(start)[0] < lagrangian.changes.least:  # far from the best: begin with none
            start = np.zeros_like(start)
            descend(start)
        minimize(
            descend,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, None)] * len(start),
            options={"maxiter": most, "maxcor": _MEMORY},
            callback=lambda _: progress(unit * best),
        )
    if lagrangian.curvature(found[:count]) < _INSIDE:
        # concave in all multipliers together, the minimum falls by at most this part
        found = (1.0 - _INSIDE) * found
    return found[:count], found[count:]
