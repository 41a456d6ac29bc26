"""Whether straight moves keep clear of a convex set, told by its distance at a few places.

What is told holds all along a move: the distance is convex on it, and changes by no more than the
move's length.
"""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape

SAMPLES = 17
"""Places along a move at which distances are looked at where three of them leave it open."""


def kept_from(body: Obstacle, radius: float) -> float:
    """The distance that keeps a vehicle clear of an obstacle, within its tolerance [m]."""
    return radius + body.deviation - body.shape.tolerance


def least_between(values: FloatArray, length: FloatArray) -> FloatArray:
    """A lower bound of a convex function on a straight way, from values at equal parts of it.

    On each part the function lies above the lines that continue the parts before and after, and
    the bound is where the two meet.

    Args:
        values: from end to end, shape (S, ...).
        length: of the way, shape (...); the function changes no faster.
    """
    slopes = np.diff(values, axis=0)
    steepest = np.broadcast_to(length / len(slopes), slopes.shape[1:])
    before = np.concatenate([-steepest[None], slopes[:-1]])
    after = np.concatenate([slopes[1:], steepest[None]])
    bend = np.maximum(after - before, 1e-300)
    met = np.clip((after - slopes) / bend, 0.0, 1.0)
    least: FloatArray = np.min(np.minimum(values[:-1] + before * met, values[1:]), axis=0)
    return least


def are_clear(
    shape: Shape, kept: float, starts: FloatArray, way: FloatArray, rooms: FloatArray
) -> BoolArray:
    """Whether moves that all go the same way keep clear of a shape at rest.

    Args:
        shape: kept out of.
        kept: at which distance [m].
        starts: of the moves, from the shape's middle [m], shape (..., 3).
        way: that they go [m], shape (3,).
        rooms: distances beyond `kept` at their starts, middles and ends [m], shape (3, ...).
    """
    length = np.asarray(np.linalg.norm(way))
    clear: BoolArray = least_between(rooms, length) >= 0.0
    unsure = ~clear & (rooms.min(axis=0) >= 0.0)
    if unsure.any():
        along = np.linspace(0.0, 1.0, SAMPLES)[:, None, None] * way
        finer = shape.signed_distance(starts[unsure] + along) - kept
        clear[unsure] = least_between(finer, length) >= 0.0
    return clear
