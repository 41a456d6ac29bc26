"""Search for the feedback's two gains, in the units of `drake_rho.motion.sampled_loop`."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from drake_rho.motion.sampled_loop import Measurements, Responses, is_stable
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.bisection import bisected
from drake_rho.system.threads import single_threaded_blas

_PARTS = np.linspace(0.0, 1.0, 9)
"""Parts of a sample at which radii of the position are evaluated."""

_FINE_PARTS = np.linspace(0.0, 1.0, 33)
"""Parts of a sample at which radii of the position are evaluated for a bound."""

_BEGIN = np.zeros(1)
"""Part of a sample at which the feedback, constant in the sample, is evaluated."""

_COARSE, _CLOSE = 0.04, 1e-4
"""Relative accuracies of the largest tolerable wind: of the first search, and of bisection."""

_EXACT = 1e-5
"""Relative accuracy of the largest tolerable wind for given gains, if measurements may be lost."""

_WIND_PARTS = (1.0, *np.arange(1.0 - _COARSE, 0.0, -_COARSE).tolist())
"""Parts of a wind, tried in this order until one is tolerable with its best gains."""

_BANDWIDTHS = 12
_FASTEST = 1.5
_DAMPINGS = np.array([0.4, 0.6, 0.85, 1.2, 1.7, 3.0, 8.0])
"""Grid from which the search starts: number of bandwidths ω (times the sample), the fastest of
them, and damping ratios ζ."""

_TIE = 1e-3
"""Weight of secondary criteria, which decide between gains with almost equal largest radii."""

_SEARCHES, _EVALUATIONS = 3, 40
"""Number of simplex searches, as each may collapse at a bound, and evaluations in each of them."""


class Loop(NamedTuple):
    """Feedback loop for which gains are optimised."""

    measurements: Measurements
    """measurements that the feedback is computed from"""
    samples: int
    """number of samples in the flight"""
    sizes: tuple[float, float, float, float, float]
    """sizes of wind, position and velocity estimation errors, initial position and velocity errors
    [m/s²]"""
    limit: float
    """largest norm of the feedback [m/s²]; infinite for no limit"""

    @property
    def alternatives(self) -> list[Loop]:
        """The loop with a prediction of the state and, if that is possible, the one without."""
        delay, dropouts, _ = self.measurements
        kinds = [True, False] if delay > 0 and dropouts == 0 else [True]
        return [self._replace(measurements=Measurements(delay, dropouts, each)) for each in kinds]

    def responses(self, gains: tuple[float, float]) -> Responses:
        """Return the responses of errors with given gains."""
        return Responses.of(gains, self.measurements, self.samples)


@lru_cache(maxsize=256)
@single_threaded_blas
def best_gains(loop: Loop) -> tuple[float, float]:
    """Return the gains that minimise the largest position radius, with feedback within its limit.

    If many gains have the same largest radius, for example where the initial error is the largest,
    those with a smaller final radius and weaker feedback are preferred.
    """
    sizes = np.array(loop.sizes)

    def cost(responses: Responses) -> float:
        feedback = responses.radii("acceleration", [0.0], sizes).max()
        if feedback > loop.limit:
            return np.inf
        radii = responses.radii("position", _PARTS, sizes)
        weak = np.log(sizes.sum() + feedback)
        return float(np.log(radii.max() + _TIE * radii[-1, -1]) + _TIE * weak)

    if not loop.responses((0.0, 0.0)).radii("position", [1.0], sizes).any():
        return 0.0, 0.0  # there is no error
    return _search(cost, loop)[0]


def prediction_is_better(loop: Loop) -> bool:
    """Return whether a prediction makes the position's largest radius no larger, if possible."""
    sizes = loop.sizes
    largest = [
        _bounded(each, each.responses(best_gains(each)), sizes)[0].max()
        for each in loop.alternatives
    ]
    return bool(largest[0] == min(largest))


@lru_cache(maxsize=256)
@single_threaded_blas
def largest_wind(loop: Loop, radius: float) -> float:
    """Return the largest wind [m/s²] that keeps the position's radius and feedback within limits.

    The limits hold at every instant with the gains of `best_gains` for this wind. Between two
    parts of a sample that are w apart, the radius exceeds the larger of those at both by at most
    κ w²/8, where κ is the radius of the feedback (`drake_rho.motion.radii`).

    Args:
        loop: the feedback loop with its estimation errors; its wind is ignored.
        radius: largest radius of the position, in m/s² times the squared sample.

    Returns:
        The wind; infinite for an infinite radius, and 0 where the errors alone are too large.
    """
    if not np.isfinite(radius):
        return np.inf

    def cost(responses: Responses) -> float:
        most = _tolerable_quotients(loop, responses, radius)[0]
        return -float(np.log(most)) if most > 0.0 else np.inf

    def is_tolerable(wind: float) -> bool:
        gains = best_gains(loop._replace(sizes=(wind, *loop.sizes[1:])))
        return _excess(loop, loop.responses(gains), radius, wind) <= 0.0

    # `best_gains` results from another search, and its gains may tolerate slightly less wind
    wind = float(np.exp(-_search(cost, loop)[1]))
    part = next((part for part in _WIND_PARTS if is_tolerable(part * wind)), 0.0)
    low, high = part * wind, min(1.0, part + _COARSE) * wind
    if part == 1.0:
        if loop.measurements.dropouts == 0:
            return wind
        high = (1.0 + _COARSE) * low  # quotients are lower bounds
        while is_tolerable(high):
            low, high = high, (1.0 + _COARSE) * high
    return bisected(is_tolerable, low, high, lambda low, high: high - low <= _CLOSE * wind)[0]


def tolerable_wind(loop: Loop, responses: Responses, radius: float) -> float:
    """Return the largest tolerable wind for given gains [m/s²]; 0 if errors alone are too large."""

    def is_tolerable(wind: float) -> bool:
        return _excess(loop, responses, radius, wind) <= 0.0

    def are_close(low: float, high: float) -> bool:
        return not high - low > _EXACT * low > 0.0

    return bisected(is_tolerable, *_tolerable_quotients(loop, responses, radius), are_close)[0]


def _tolerable_quotients(loop: Loop, responses: Responses, radius: float) -> tuple[float, float]:
    """Return a lower and an upper bound of the largest tolerable wind for given gains [m/s²].

    Radii are affine in the wind, and the bounds are equal. If measurements may be lost, radii are
    the largest of several that are affine, one for each pattern, and so convex. They are at most
    the sum of those by a wind and by the errors, and at least the larger one.
    """
    low = high = np.inf
    by_wind = _bounded(loop, responses, (1.0, 0.0, 0.0, 0.0, 0.0))
    by_errors = _bounded(loop, responses, (0.0, *loop.sizes[1:]))
    for wind, errors, most in zip(by_wind, by_errors, (radius, loop.limit), strict=False):
        slack = most - errors
        if slack.min() < 0.0:
            return 0.0, 0.0
        affected = wind > 0.0
        low = min(low, float(np.min(slack[affected] / wind[affected], initial=np.inf)))
        high = min(high, float(np.min(most / wind[affected], initial=np.inf)))
    return low, low if loop.measurements.dropouts == 0 else high


def _excess(loop: Loop, responses: Responses, radius: float, wind: float) -> float:
    """Return the largest excess of radii over their limits in a wind; negative if within all."""
    found = _bounded(loop, responses, (wind, *loop.sizes[1:]))
    limits = zip(found, (radius, loop.limit), strict=False)
    return max(float(each.max()) - most for each, most in limits)


def _bounded(
    loop: Loop, responses: Responses, sizes: tuple[float, float, float, float, float]
) -> list[FloatArray]:
    """Return bounds of the position's radius in parts of samples, and feedback if it is limited."""
    above = (_FINE_PARTS[1] - _FINE_PARTS[0]) ** 2 / 8.0
    feedback = responses.radii("acceleration", _BEGIN, np.array(sizes))
    position = responses.radii("position", _FINE_PARTS, np.array(sizes)) + above * feedback
    return [position, feedback] if np.isfinite(loop.limit) else [position]


def _search(cost: Callable[[Responses], float], loop: Loop) -> tuple[tuple[float, float], float]:
    """Return the gains of least cost, and that cost; no feedback unless others cost less.

    The Nelder-Mead simplex search starts from the best point of a coarse grid. It is restarted,
    because the optimum is often at the bound of the feasible region, outside which the cost is
    infinite and where a simplex collapses.
    """
    from scipy.optimize import minimize  # imported here: slow to load

    def cost_at(logarithms: FloatArray) -> float:
        gains = _gains(logarithms)
        if not is_stable(gains, loop.measurements.queued):
            return np.inf
        return cost(loop.responses(gains))

    slowest = 0.3 / loop.samples  # feedback that has almost no effect within the flight
    bandwidths = np.linspace(np.log(slowest), np.log(_FASTEST), _BANDWIDTHS)
    starts = [np.array(each) for each in product(bandwidths, np.log(_DAMPINGS))]
    best, least = min(((x, cost_at(x)) for x in starts), key=lambda each: each[1])
    sizes = np.diag([bandwidths[1] - bandwidths[0], 0.4]) / 2.0
    for number in range(_SEARCHES if np.isfinite(least) else 0):
        corners = best + np.vstack([np.zeros(2), sizes / (-3.0) ** number])
        options = {"initial_simplex": corners, "maxfev": _EVALUATIONS, "xatol": 1e-4, "fatol": 1e-5}
        found = minimize(cost_at, best, method="Nelder-Mead", options=options)
        best, least = found.x, float(found.fun)
    without = cost(loop.responses((0.0, 0.0)))
    return (_gains(best), least) if least < without else ((0.0, 0.0), without)


def _gains(logarithms: FloatArray) -> tuple[float, float]:
    """Return the gains α = ω² and β = 2 ζ ω + ω² / 2 for the logarithms of ω and ζ.

    Without delay, feedback is stable for ζ > 0 and β < 2; ω = 1 and ζ = 1/2 are deadbeat.
    """
    omega, zeta = np.exp(np.clip(logarithms, -50.0, 5.0))
    return float(omega**2), float(2.0 * zeta * omega + omega**2 / 2.0)
