"""Points and moves of a raster that collide with a map.

Distances of the points decide most moves: the distance from a map changes by no more than the
length of a move. The others are compared with each nearby part of the map, since the distance along
a move is convex for a part, though not for the map.
"""

from __future__ import annotations

import numpy as np

from drake_rho.planning.path_search.swept_clearance import SAMPLES, convex_lower_bound
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.parts import Parts

_PAIRS = 400_000
"""Number of pairs of a move and a part compared at once, to bound the memory."""

_SEGMENTS = 50_000
"""Number of moves in one search for nearby parts."""


def colliding(
    parts: Parts, required: float, x: FloatArray, moves: IntArray, spacing: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Return masks of the points and moves of a raster block that collide with a map.

    Args:
        parts: convex parts that cover the map.
        required: distance from it [m].
        x: points relative to its centre [m], shape (X, Y, Z, 3).
        moves: in units of the spacing, shape (U, 3).
        spacing: of the raster [m], shape (3,).

    Returns:
        For points, shape (X, Y, Z), and for moves by their starting point, (U, X, Y, Z). A move
        that leaves the block does not count.
    """
    shape, steps = np.array(x.shape[:3]), moves * spacing
    lengths = np.linalg.norm(steps, axis=1)
    d = parts.distance_up_to(x, required + float(lengths.max())) - required
    inside: BoolArray = d < 0.0
    blocked = np.zeros((len(moves), *shape), dtype=bool)
    unsure = np.zeros_like(blocked)
    for u, (move, length) in enumerate(zip(moves, lengths, strict=True)):
        first, last = np.maximum(0, -move), shape - np.maximum(0, move)
        begin = tuple(slice(a, max(a, b)) for a, b in zip(first, last, strict=True))
        end = tuple(slice(a, max(a, b)) for a, b in zip(first + move, last + move, strict=True))
        blocked[u][begin] = inside[begin] | inside[end]
        unsure[u][begin] = (d[begin] + d[end] < length) & ~blocked[u][begin]
    which = np.nonzero(unsure)
    starts = x[which[1:]]
    blocked[unsure] = segments_collide(parts, required, starts, starts + steps[which[0]])
    return inside, blocked


def segments_collide(
    parts: Parts, required: float, one: FloatArray, other: FloatArray, samples: int = SAMPLES
) -> BoolArray:
    """Return flags of the colliding segments between positions relative to the centre, (E,).

    Args:
        parts: convex parts that cover the map.
        required: distance from it [m].
        one: ends of the segments [m], shape (E, 3).
        other: their other ends [m], shape (E, 3).
        samples: points along a segment at which distances are computed if three leave it undecided.
    """
    one, other = parts.in_frame(one), parts.in_frame(other)
    collides = np.zeros(len(one), dtype=bool)
    lower, upper = np.minimum(one, other), np.maximum(one, other)
    for first in range(0, len(one), _SEGMENTS):
        here = slice(first, first + _SEGMENTS)
        within = np.full(len(one[here]), max(required, 0.0))
        segments, near = parts.tree.pairs(lower[here], upper[here], within)
        for begin in range(0, len(near), _PAIRS):
            who, part = first + segments[begin : begin + _PAIRS], near[begin : begin + _PAIRS]
            ends = one[who], other[who]
            collides[who[_come_near(parts, required, part, *ends, samples)]] = True
    return collides


def _come_near(
    parts: Parts,
    required: float,
    part: IntArray,
    one: FloatArray,
    other: FloatArray,
    samples: int,
) -> BoolArray:
    """Return flags of the segments (P, 3) too close to their parts (P,), shape (P,)."""
    lengths = np.linalg.norm(other - one, axis=1)
    near = np.zeros(len(part), dtype=bool)
    unsure = np.arange(len(part))
    for count in (3, samples):
        ends = one[unsure], other[unsure]
        along = np.linspace(0.0, 1.0, count)
        d = np.stack(
            [parts.distances_of(part[unsure], (1.0 - s) * ends[0] + s * ends[1]) for s in along]
        )
        hit = convex_lower_bound(d, lengths[unsure]) < required
        near[unsure[hit]] = True
        unsure = unsure[hit & (d.min(axis=0) >= required)]  # a point inside decides the check
        if len(unsure) == 0 or count == samples:
            break
        near[unsure] = False
    return near
