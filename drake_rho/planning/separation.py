"""Pairs of vehicles that keep apart: half-spaces around a reference, as (15) for obstacles.

Distances are measured where the separation is a sphere, with z divided by the downwash: E p. With
n = E (q_i - q_j) / |E (q_i - q_j)| the row n · E (p_i - p_j) >= d keeps the pair apart. It couples
the two. Split in halves it is a plane midway between their references, each on its own side, at
d / 2 from it; then every vehicle has a program of its own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.pairs import Meetings
from drake_rho.planning.constraints import across
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity, Separation

NAME = "separation"

Coupling = Callable[[Separation, Motion, Meetings, FloatArray, float], HalfSpaces]
"""How the rows of pairs are written: (separation, reference, where, directions, price) -> rows."""


def jointly(
    separation: Separation, reference: Motion, where: Meetings, n: FloatArray, price: float
) -> HalfSpaces:
    """A row for each pair, about the difference of the two: least index, one program for all."""
    normals, lengths = _unit(separation, n)
    return HalfSpaces(
        NAME,
        "position",
        where.one,
        where.times,
        normals,
        separation.distance / lengths,
        separation.tolerance / lengths,
        partners=where.other,
        coupled=True,
        price=price,
    )


def by_halves(
    separation: Separation, reference: Motion, where: Meetings, n: FloatArray, price: float
) -> HalfSpaces:
    """Two rows for each pair, one for each vehicle: half the distance from the plane midway."""
    normals, lengths = _unit(separation, n)
    one = reference.each_at("position", where.one, where.times)
    other = reference.each_at("position", where.other, where.times)
    middle = np.einsum("mi,mi->m", normals, (one + other) / 2.0)
    half = separation.distance / 2.0 / lengths
    tolerances = np.tile(separation.tolerance / 2.0 / lengths, 2)
    vehicles = np.concatenate([where.one, where.other])
    partners = np.concatenate([where.other, where.one])
    times = np.tile(where.times, 2)
    rows = HalfSpaces(
        NAME,
        "position",
        vehicles,
        times,
        np.concatenate([normals, -normals]),
        np.concatenate([half + middle, half - middle]),
        tolerances,
        partners=partners,
        price=price,
    )
    return rows.select(np.lexsort((times, partners, vehicles)))


def _unit(separation: Separation, n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions among scaled positions as unit normals among positions, and their lengths."""
    normals = separation.scaled(n)
    lengths = np.linalg.norm(normals, axis=1)
    return normals / lengths[:, None], lengths


def directions(
    separation: Separation, reference: Motion, where: Meetings, *, aside: bool
) -> FloatArray:
    """In which direction the vehicles of each meeting are to keep apart, unit vectors (M, 3).

    From the other to the one, in the reference. Where they meet too closely for that to be a
    way past each other, it can be one direction all along an encounter instead: across their
    relative way, on the side on which they pass anyway or, where they meet head-on, on one that
    depends on that way alone, so that two mirror images choose the same.

    Args:
        separation: with its downwash.
        reference: q, of all vehicles.
        where: pairs and times, pair by pair and in the order of time.
        aside: whether encounters closer than the separation get one direction each.
    """
    offsets = _offsets(separation, reference, where, "position")
    distances = np.linalg.norm(offsets, axis=1)
    n: FloatArray = offsets / np.maximum(distances, 1e-300)[:, None]
    ways = _offsets(separation, reference, where, "velocity")
    for row in np.flatnonzero(distances <= separation.tolerance):
        n[row] = _side(np.zeros(3), ways[row])
    if not aside:
        return n
    close = distances < separation.distance
    for rows in _encounters(where, close, reference.step):
        nearest = rows[np.argmin(distances[rows])]
        n[rows] = _side(offsets[nearest], ways[nearest])
    return n


def _offsets(
    separation: Separation, reference: Motion, where: Meetings, quantity: Quantity
) -> FloatArray:
    one = reference.each_at(quantity, where.one, where.times)
    other = reference.each_at(quantity, where.other, where.times)
    offsets: FloatArray = separation.scaled(one - other)
    return offsets


def _encounters(where: Meetings, close: BoolArray, step: float) -> list[IntArray]:
    """The close meetings of each pair that follow each other, as indices."""
    rows = np.flatnonzero(close)
    if len(rows) == 0:
        return []
    follows = np.diff(where.one[rows]) == 0
    follows &= np.diff(where.other[rows]) == 0
    follows &= np.diff(where.times[rows]) < 1.5 * step
    return np.split(rows, np.flatnonzero(~follows) + 1)


def _side(offset: FloatArray, way: FloatArray) -> FloatArray:
    """A unit vector across `way`, on the side of `offset` if it has one."""
    speed = float(np.linalg.norm(way))
    ahead = way / speed if speed > 0.0 else np.zeros(3)
    side = offset - (offset @ ahead) * ahead
    length = float(np.linalg.norm(side))
    return side / length if length > 1e-3 * np.linalg.norm(offset) else across(ahead)
