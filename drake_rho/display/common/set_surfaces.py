"""Surfaces of required sets of positions, clipped to the scene.

Parts outside the scene are omitted, so that a distant fence neither shrinks the flight nor seems
nearer than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from itertools import pairwise

import numpy as np

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.obstacle_snapshots import AROUND, truncated
from drake_rho.display.common.requirements import required_positions
from drake_rho.display.common.shape_faces import (
    Surface,
    across,
    clipped,
    from_inside,
    surface,
    unit_sphere,
)
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.sets import ConvexSet
from drake_rho.scenario.shapes.base import Shape
from drake_rho.scenario.shapes.unbounded import Cone, HalfSpace

_CIRCLE = 64
"""Number of points around a circle."""


def near_bounds(
    convex_set: ConvexSet, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return the least and greatest coordinates of a set near a scene [m], (3,) each.

    Distant sides are replaced by those of the scene. None if the whole set is distant.

    Args:
        convex_set: the set.
        lower: least coordinates of the scene [m], shape (3,).
        upper: greatest coordinates of the scene [m], shape (3,).
    """
    beside = AROUND * (float(np.max(upper - lower)) or 1.0)
    low, high = -convex_set.support(-np.eye(3)), convex_set.support(np.eye(3))
    if np.any(high < lower - beside) or np.any(low > upper + beside):
        return None
    low = np.where(low >= lower - beside, low, lower)
    return low, np.where(high <= upper + beside, high, upper)


def surface_within(convex_set: ConvexSet, lower: FloatArray, upper: FloatArray) -> Surface:
    """Return the part of a set's surface inside a box [m], in the scenario's coordinates.

    A user-defined set is known only by its functions: it is drawn if it is bounded.
    """
    whole = _whole(convex_set, lower, upper)
    faces = [clipped(face, lower, upper) for face in whole.faces]
    edges = [piece for edge in whole.edges for piece in _pieces(edge, lower, upper)]
    if isinstance(convex_set, HalfSpace):
        edges = [face[[*range(len(face)), 0]] for face in faces if len(face) > 0]
    return Surface([face for face in faces if len(face) > 2], edges)


def requirements_near(
    plan: Drawn, bounds: Sequence[tuple[FloatArray, FloatArray]]
) -> list[tuple[FloatArray, FloatArray]]:
    """Return least and greatest coordinates of the drawn requirements [m], (3,) each.

    They are those of moving points, and of the sets of single vehicles where they are near.

    Args:
        plan: motion to draw.
        bounds: least and greatest coordinates of all other drawn objects [m], (3,) each.
    """
    lower = np.min([low for low, _ in bounds], axis=0)
    upper = np.max([high for _, high in bounds], axis=0)
    found = list[tuple[FloatArray, FloatArray]]()
    for required in required_positions(plan.scenario):
        if required.requirement.track is not None:
            points = required.origins(plan, required.times(plan))
            found.append((points.min(axis=0), points.max(axis=0)))
        elif not required.is_link:
            near = near_bounds(required.requirement.set, lower, upper)
            found += [] if near is None else [near]
    return found


@singledispatch
def _whole(convex_set: ConvexSet, lower: FloatArray, upper: FloatArray) -> Surface:
    """Return a set's surface; for an unbounded set, at least the part inside a box [m].

    The surface of a general bounded set is found by rays from a point inside.
    """
    ends = [-convex_set.support(-np.eye(3)), convex_set.support(np.eye(3))]
    if not np.all(np.isfinite(ends)):
        return Surface([], [])
    far = 2.0 * float(np.linalg.norm(ends[1] - ends[0]))
    around = (ends[0] + ends[1]) / 2.0 + far * unit_sphere().reshape(-1, 3)
    distances = np.asarray(convex_set.signed_distance(around))
    inside = (around - distances[:, None] * convex_set.outward(around)).mean(axis=0)
    return from_inside(convex_set.signed_distance, inside, np.full(3, far))


@_whole.register
def _(convex_set: Shape, lower: FloatArray, upper: FloatArray) -> Surface:
    beyond = upper - lower  # so that the cut ends of an infinite shape are outside
    shape, center = truncated(convex_set, convex_set.center, lower - beyond, upper + beyond)
    return surface(shape).moved(center)


@_whole.register
def _(convex_set: HalfSpace, lower: FloatArray, upper: FloatArray) -> Surface:
    middle = (lower + upper) / 2.0
    normal = convex_set.outward(middle)
    foot = middle - convex_set.signed_distance(middle) * normal
    one, other = (2.0 * np.linalg.norm(upper - lower) * each for each in across(normal))
    return Surface([foot + np.array([one + other, other - one, -one - other, one - other])], [])


@_whole.register
def _(convex_set: Cone, lower: FloatArray, upper: FloatArray) -> Surface:
    along = convex_set.axis / np.linalg.norm(convex_set.axis)
    one, other = across(along)
    far = float(np.linalg.norm(np.maximum(upper - convex_set.apex, convex_set.apex - lower)))
    angles = np.linspace(0.0, 2.0 * np.pi, _CIRCLE + 1)[:, None]
    ring = far * (
        along + np.tan(convex_set.half_angle) * (np.cos(angles) * one + np.sin(angles) * other)
    )
    apex = convex_set.apex
    return Surface([np.array([apex, apex + a, apex + b]) for a, b in pairwise(ring)], [])


def _pieces(edge: FloatArray, lower: FloatArray, upper: FloatArray) -> list[FloatArray]:
    """Return the parts of a polyline (n, 3) inside a box: itself, or segments of shape (2, 3)."""
    if np.all((edge >= lower) & (edge <= upper)):
        return [edge]
    found = []
    for begin, end in pairwise(edge):
        part = clipped(np.array([begin, end]), lower, upper)
        along = part @ (end - begin)
        if len(part) > 0 and np.ptp(along) > 0.0:
            found.append(part[[np.argmin(along), np.argmax(along)]])
    return found
