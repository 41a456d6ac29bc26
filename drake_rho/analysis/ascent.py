"""Dual ascent: maximisation of a Lagrangian's minimum over its multipliers."""

from __future__ import annotations

from contextlib import suppress
from time import monotonic

import numpy as np

from drake_rho.analysis.lagrangian import Lagrangian
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.errors import OutOfTimeError
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.numbers import percent

CONVERGED = 1e-8
"""Relative gap to a converged plan's cost at which the ascent ends."""

_MAX_ITERATIONS = 300
"""Largest number of iterations of one maximisation."""


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


def best_bound(lagrangian: Lagrangian, ascent: Ascent) -> float:
    """Return the largest minimum of the Lagrangian that is found, in the Lagrangian's unit.

    The multipliers of the converged program are tried first; if the Lagrangian is convex there,
    they are optimal. Else the obstacles' multipliers are scaled down until it is convex. Then the
    minimum, a concave function of the multipliers whose gradient consists of the constraints'
    violations, is maximised.
    """
    weights, multipliers = lagrangian.weights, lagrangian.multipliers
    first = lagrangian.minimum(weights, multipliers)
    ascent.begin()
    index = lagrangian.cost
    if first.value >= index * (1 - CONVERGED) or len(weights) + len(multipliers) == 0:
        return first.value
    loss = 1.0 - lagrangian.curvature(weights)  # proportional to the weights
    scaled = weights * min(1.0, 0.98 / loss if loss > 0.0 else 1.0)
    return max(first.value, _climb(lagrangian, scaled, multipliers, ascent))


def _climb(
    lagrangian: Lagrangian, weights: FloatArray, multipliers: FloatArray, ascent: Ascent
) -> float:
    """Maximise the Lagrangian's minimum over λ, y >= 0, from multipliers for which it is convex."""
    from scipy.optimize import minimize  # imported here because it is slow to load

    start = np.concatenate([weights, multipliers])
    sizes = np.maximum(start, 1e-3 * start.max())
    best = -np.inf

    def descend(x: FloatArray) -> tuple[float, FloatArray]:
        nonlocal best
        check_time()
        given = np.maximum(x, 0.0) * sizes
        found = lagrangian.minimum(given[: len(weights)], given[len(weights) :])
        if not np.isfinite(found.value):
            return 1e3 * scale, np.zeros_like(x)
        best = max(best, found.value)
        return -found.value, -np.concatenate(lagrangian.slopes(found.at)) * sizes

    scale = lagrangian.cost + 1.0
    with suppress(OutOfTimeError):
        minimize(
            descend,
            start / sizes,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, None)] * len(start),
            options={"maxiter": _MAX_ITERATIONS},
            callback=lambda _: ascent.report(lagrangian.unit**2 * best),
        )
    return best
