"""Points and moves of a raster that collide with a map.

Each point is compared with the parts near it, which the map's tree finds for many points at once.
Moves are compared with the parts near their start, part by part, since the distance along a move is
convex for a part, though not for the map.
"""

from __future__ import annotations

import numpy as np

from drake_rho.planning.path_search.swept_clearance import SAMPLES, convex_lower_bound
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.parts import Parts

_PAIRS = 400_000
"""Number of pairs of a point and a part that are compared at once, which bounds the memory."""

_POINTS = 4096
"""Number of points whose near parts are found at once."""


def colliding(
    parts: Parts, required: float, x: FloatArray, moves: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Return which points and which moves from them collide with a map.

    Args:
        parts: convex parts that cover the map.
        required: distance from it [m].
        x: points relative to its centre [m], shape (Q, 3).
        moves: displacements [m], shape (U, 3).

    Returns:
        For points, shape (Q,), and for moves by their starting point, shape (U, Q).
    """
    x, moves = parts.in_frame(x), parts.in_frame(moves)
    inside, blocked = np.zeros(len(x), dtype=bool), np.zeros((len(moves), len(x)), dtype=bool)
    reach = required + float(np.linalg.norm(moves, axis=1).max(initial=0.0))
    for first in range(0, len(x), _POINTS):
        here = x[first : first + _POINTS]
        points, near = parts.tree.pairs(here, here, np.full(len(here), reach))
        for begin in range(0, len(near), _PAIRS):
            block = slice(begin, begin + _PAIRS)
            who, part = first + points[block], near[block]
            at = x[who]
            d = parts.distances_of(part, at) - required
            inside[who[d < 0.0]] = True
            for u, move in enumerate(moves):
                close = d < np.linalg.norm(move)
                hit = _collide(parts, required, part[close], at[close], move, d[close])
                blocked[u, who[close][hit]] = True
    return inside, blocked


def _collide(
    parts: Parts,
    required: float,
    part: IntArray,
    start: FloatArray,
    move: FloatArray,
    clearance: FloatArray,
) -> BoolArray:
    """Return which starts (P,) of one move, with their clearances, collide with their parts."""
    samples = [
        clearance,
        parts.distances_of(part, start + move / 2.0) - required,
        parts.distances_of(part, start + move) - required,
    ]
    d = np.stack(samples)
    length = np.asarray(np.linalg.norm(move))
    hit = convex_lower_bound(d, length) < 0.0
    unsure = np.flatnonzero(hit & (d.min(axis=0) >= 0.0))
    if len(unsure) > 0:
        along = np.linspace(0.0, 1.0, SAMPLES)
        hit[unsure] = _least(parts, part[unsure], start[unsure], move, along, length) < required
    return hit


def _least(
    parts: Parts,
    part: IntArray,
    start: FloatArray,
    move: FloatArray,
    along: FloatArray,
    length: FloatArray,
) -> FloatArray:
    """Return lower bounds of the distances from parts (P,) along moves from starts, shape (P,)."""
    d = np.stack([parts.distances_of(part, start + s * move) for s in along])
    return convex_lower_bound(d, length)


def segments_collide(
    parts: Parts, required: float, one: FloatArray, other: FloatArray, samples: int
) -> BoolArray:
    """Return which segments between positions relative to the centre, (E, 3), collide: (E,)."""
    one, other = parts.in_frame(one), parts.in_frame(other)
    collides = np.zeros(len(one), dtype=bool)
    lower, upper = np.minimum(one, other), np.maximum(one, other)
    segments, near = parts.tree.pairs(lower, upper, np.full(len(one), max(required, 0.0)))
    along = np.linspace(0.0, 1.0, samples)
    for begin in range(0, len(near), _PAIRS):
        who, part = segments[begin : begin + _PAIRS], near[begin : begin + _PAIRS]
        steps = other[who] - one[who]
        lengths = np.linalg.norm(steps, axis=1)
        least = _least(parts, part, one[who], steps, along, lengths)
        collides[who[least < required]] = True
    return collides
