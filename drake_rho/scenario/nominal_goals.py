"""Nominal goals: one position for each vehicle whose goal is a set, or anywhere.

They serve path searches, length scales and pictures of scenarios; plans may end elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.sets import ConvexSet

_ROUNDS = 500
"""Largest number of alternating projections onto a set and a box."""

_CLOSE = 1e-12
"""Relative change of a point with which alternating projections end."""

_FACTORS = 2.0 ** np.arange(-6, 5)
"""Distances of other candidates from a nominal goal, in lengths of the motion."""


def project(convex_set: ConvexSet, x: FloatArray) -> FloatArray:
    """Return the points of a set that are nearest to x, of shape (..., 3)."""
    beyond = np.maximum(convex_set.signed_distance(x), 0.0)
    return np.asarray(x - beyond[..., None] * convex_set.outward(x))


def nearest_in(
    convex_set: ConvexSet | None, limit: Callable[[FloatArray], FloatArray], x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return points of a set and of a limit, close to x and as close to each other as possible.

    Args:
        convex_set: the set; None for all values.
        limit: function that projects onto the limit.
        x: values, shape (..., 3).
    """
    if convex_set is None:
        within = limit(x)
        return within, within
    inside = project(convex_set, x)
    for _ in range(_ROUNDS):
        within = limit(inside)
        again = project(convex_set, within)
        moved = np.abs(again - inside).max()
        inside = again
        if moved <= _CLOSE * (1.0 + np.abs(inside).max()):
            break
    return inside, limit(inside)


def nominal_position(
    convex_set: ConvexSet | None,
    limit: Callable[[FloatArray], FloatArray],
    towards: FloatArray,
    length: float,
    is_clear: Callable[[FloatArray], BoolArray],
) -> FloatArray:
    """Return a position of a set, clear of obstacles and others if one is found nearby, (3,).

    Args:
        convex_set: the goal; None for anywhere.
        limit: function that projects onto the position box.
        towards: position from which the nearest one is wanted [m], shape (3,).
        length: of the motion [m].
        is_clear: function of positions (M, 3) that returns which are clear.
    """
    nearest, _ = nearest_in(convex_set, limit, towards)
    if is_clear(nearest[None])[0]:
        return nearest
    signs = np.indices((3, 3, 3)).reshape(3, -1).T - 1.0
    directions = signs[np.any(signs, axis=1)]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    around = (length * _FACTORS[:, None, None] * directions).reshape(-1, 3)
    others, _ = nearest_in(convex_set, limit, nearest + around)
    others = others[is_clear(others)]
    if len(others) == 0:
        return nearest
    return np.asarray(others[np.argmin(np.linalg.norm(others - nearest, axis=1))])
