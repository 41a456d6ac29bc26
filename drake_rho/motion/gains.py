"""The feedback's two gains, found by search: in the units of `drake_rho.motion.sampled_loop`."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from drake_rho.motion.sampled_loop import Responses, is_stable
from drake_rho.scenario.fields import FloatArray

_PARTS = np.linspace(0.0, 1.0, 9)
"""Where in a sample positions are looked at."""

_FINE_PARTS = np.linspace(0.0, 1.0, 33)
"""The same for a bound."""

_BEGIN = np.zeros(1)
"""The part of a sample at which a feedback is looked at that is constant in it."""

_COARSE, _CLOSE = 0.04, 1e-4
"""Parts of a wind by which it is made smaller until its own gains bear it, first and at last."""

_PARTS_BORNE = (1.0, *np.arange(1.0 - _COARSE, 0.0, -_COARSE).tolist())
"""Parts of a wind that are tried one after the other until its own gains bear it."""

_BANDWIDTHS = 12
_FASTEST = 1.5
_DAMPINGS = np.array([0.4, 0.6, 0.85, 1.2, 1.7, 3.0, 8.0])
"""Where the search begins: bandwidths ω times the sample, up to the fastest, and dampings ζ."""

_TIE = 1e-3
"""Weight of what decides between gains whose largest radii are all but equal."""

_SEARCHES, _EVALUATIONS = 3, 40
"""How often the simplex is made anew, so that it does not die at a bound, and its evaluations."""


class Loop(NamedTuple):
    """What the gains are for."""

    delay: int
    """d, in samples"""
    samples: int
    """of the flight"""
    sizes: tuple[float, float, float, float, float]
    """of wind, position errors, velocity errors, and position and velocity at first [m/s²]"""
    limit: float
    """the largest norm that the feedback may have [m/s²]; infinite for no limit"""


@lru_cache(maxsize=256)
def best_gains(loop: Loop) -> tuple[float, float]:
    """The gains for which the largest radius of the position is least, the feedback in its limit.

    Where many gains have the same largest radius, as when an error at first is the largest, the
    radius at the end decides, and the weaker feedback.
    """
    sizes = np.array(loop.sizes)

    def cost(responses: Responses) -> float:
        feedback = responses.radii("acceleration", [0.0], sizes).max()
        if feedback > loop.limit:
            return np.inf
        radii = responses.radii("position", _PARTS, sizes)
        weak = np.log(sizes.sum() + feedback)
        return float(np.log(radii.max() + _TIE * radii[-1, -1]) + _TIE * weak)

    if not Responses.of((0.0, 0.0), loop.delay, loop.samples).radii("position", [1.0], sizes).any():
        return 0.0, 0.0  # there is nothing to correct
    return _search(cost, loop.delay, loop.samples)[0]


@lru_cache(maxsize=256)
def largest_wind(loop: Loop, radius: float) -> float:
    """Return the largest wind [m/s²] for which a position stays within a radius, and feedback too.

    That is so with the gains that `best_gains` has for this wind, at every instant. Between two
    parts of a sample that are w apart, the radius is above the larger one of those at both by
    κ w²/8 at most, κ being that of the feedback (`drake_rho.motion.radii`).

    Args:
        loop: what the gains are for, with errors as they are; its wind is not looked at.
        radius: of the position, in m/s² times the squared sample.

    Returns:
        The wind, infinite where the radius is; 0 where the errors alone are too large.
    """
    if not np.isfinite(radius):
        return np.inf

    def cost(responses: Responses) -> float:
        most = borne(loop, responses, radius)
        return -float(np.log(most)) if most > 0.0 else np.inf

    def is_borne(wind: float) -> bool:
        gains = best_gains(loop._replace(sizes=(wind, *loop.sizes[1:])))
        return wind <= borne(loop, Responses.of(gains, loop.delay, loop.samples), radius)

    # the gains for the least peak are found by a search of their own, and may bear a little less
    wind = float(np.exp(-_search(cost, loop.delay, loop.samples)[1]))
    part = next((part for part in _PARTS_BORNE if is_borne(part * wind)), 0.0)
    if part == 1.0:
        return wind
    low, high = part * wind, min(1.0, part + _COARSE) * wind
    while high - low > _CLOSE * wind:
        middle = (low + high) / 2.0
        low, high = (middle, high) if is_borne(middle) else (low, middle)
    return low


def borne(loop: Loop, responses: Responses, radius: float) -> float:
    """Return the largest wind that given gains bear, 0 where the errors are too much [m/s²]."""
    unit, errors = np.array([1.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, *loop.sizes[1:]])
    above = (_FINE_PARTS[1] - _FINE_PARTS[0]) ** 2 / 8.0
    taken, needed = (
        responses.radii("position", _FINE_PARTS, sizes)
        + above * responses.radii("acceleration", _BEGIN, sizes)
        for sizes in (unit, errors)
    )
    pairs = [(taken, radius - needed)]
    if np.isfinite(loop.limit):
        taken, needed = (responses.radii("acceleration", _BEGIN, each) for each in (unit, errors))
        pairs.append((taken, loop.limit - needed))
    most = np.inf
    for taken, left in pairs:
        if left.min() < 0.0:
            return 0.0
        at_all = taken > 0.0
        most = min(most, float(np.min(left[at_all] / taken[at_all], initial=np.inf)))
    return most


def _search(
    cost: Callable[[Responses], float], delay: int, samples: int
) -> tuple[tuple[float, float], float]:
    """The gains of least cost, and that cost; no feedback where nothing else has a finite one.

    From the best of a coarse grid, by Nelder and Mead's simplex. The optimum is often at a bound of
    what is allowed, where the cost is infinite: there a simplex flattens, so it is made anew.
    """
    from scipy.optimize import minimize  # slow to load, so only where needed

    def cost_at(place: FloatArray) -> float:
        gains = _gains(place)
        if not is_stable(gains, delay):
            return np.inf
        return cost(Responses.of(gains, delay, samples))

    slowest = 0.3 / samples  # feedback that comes to nothing within the flight
    bandwidths = np.linspace(np.log(slowest), np.log(_FASTEST), _BANDWIDTHS)
    starts = [np.array(each) for each in product(bandwidths, np.log(_DAMPINGS))]
    best, least = min(((x, cost_at(x)) for x in starts), key=lambda each: each[1])
    sizes = np.diag([bandwidths[1] - bandwidths[0], 0.4]) / 2.0
    for number in range(_SEARCHES if np.isfinite(least) else 0):
        corners = best + np.vstack([np.zeros(2), sizes / (-3.0) ** number])
        options = {"initial_simplex": corners, "maxfev": _EVALUATIONS, "xatol": 1e-4, "fatol": 1e-5}
        found = minimize(cost_at, best, method="Nelder-Mead", options=options)
        best, least = found.x, float(found.fun)
    without = cost(Responses.of((0.0, 0.0), delay, samples))
    return (_gains(best), least) if least < without else ((0.0, 0.0), without)


def _gains(place: FloatArray) -> tuple[float, float]:
    """α = ω², β = 2 ζ ω + ω² / 2 of the logarithms of ω and ζ.

    Without delay, feedback is stable for ζ > 0 and β < 2; ω = 1 and ζ = 1/2 are deadbeat.
    """
    omega, zeta = np.exp(np.clip(place, -50.0, 5.0))
    return float(omega**2), float(2.0 * zeta * omega + omega**2 / 2.0)
