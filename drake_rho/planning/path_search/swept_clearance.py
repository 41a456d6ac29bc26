"""Swept collision check of straight moves against a convex set, from distances at a few points.

The check covers the whole move, not only the sampled points: along a straight move the distance to
a convex set is convex, and changes by no more than the length of the move.
"""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape, Solid

SAMPLES = 17
"""Points along a move for distances if three points leave the check undecided."""


def required_distance(body: Obstacle, radius: float) -> float:
    """Return the distance required between a vehicle's centre and an obstacle, less tolerance [m].

    The growth of an uncertain obstacle is not included.

    Args:
        body: the obstacle.
        radius: of the vehicle [m].
    """
    return radius + body.deviation + body.position_error - body.shape.tolerance


def convex_lower_bound(values: FloatArray, length: FloatArray) -> FloatArray:
    """Return a lower bound on a convex function on a segment, from equally spaced values.

    Between two neighbouring samples the function lies above the lines through the samples before
    and after them. The bound is the value at which these two lines meet.

    Args:
        values: of the function at S equally spaced points from end to end, shape (S, ...).
        length: of the segment, shape (...). The function has the Lipschitz constant 1 in length.
    """
    slopes = np.diff(values, axis=0)
    steepest = np.broadcast_to(length / len(slopes), slopes.shape[1:])
    before = np.concatenate([-steepest[None], slopes[:-1]])
    after = np.concatenate([slopes[1:], steepest[None]])
    change = np.maximum(after - before, 1e-300)
    crossing = np.clip((after - slopes) / change, 0.0, 1.0)
    least: FloatArray = np.min(np.minimum(values[:-1] + before * crossing, values[1:]), axis=0)
    return least


def lower_bound(solid: Solid, values: FloatArray, length: FloatArray) -> FloatArray:
    """Return a lower bound on the distance from a solid on a segment; see `convex_lower_bound`.

    The distance from a map is not convex on a segment, only Lipschitz.
    """
    if isinstance(solid, Shape):
        return convex_lower_bound(values, length)
    least: FloatArray = (values[:-1] + values[1:]).min(axis=0) - length / (len(values) - 1)
    return least / 2.0


def moves_are_clear(
    shape: Shape, required: float, starts: FloatArray, steps: FloatArray, clearances: FloatArray
) -> BoolArray:
    """Return flags of straight moves that keep clear of a shape at rest, shape (U, X, Y, Z).

    Args:
        shape: to keep clear of.
        required: distance from it [m].
        starts: of the moves, relative to the centre of the shape [m], shape (X, Y, Z, 3).
        steps: displacements from each start [m], shape (U, 3).
        clearances: distances less `required` at the starts, middles and ends of the moves [m],
            shape (3, U, X, Y, Z).
    """
    lengths = np.linalg.norm(steps, axis=1)
    clear: BoolArray = convex_lower_bound(clearances, lengths[:, None, None, None]) >= 0.0
    unsure = ~clear & (clearances.min(axis=0) >= 0.0)
    if unsure.any():
        which, *places = np.nonzero(unsure)
        along = np.linspace(0.0, 1.0, SAMPLES)[:, None, None] * steps[which]
        finer = shape.local_distance(starts[tuple(places)] + along) - required
        clear[unsure] = convex_lower_bound(finer, lengths[which]) >= 0.0
    return clear
