"""Drawing order of lines and obstacles: lines in front of obstacles are drawn over them.

Maps are below everything else. Parts of lines behind a map are drawn over it, but faintly.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.hidden_by_maps import hidden
from drake_rho.display.common.obstacle_snapshots import Snapshot
from drake_rho.display.common.style import view
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.shapes.base import Shape

FAINT = 0.3
"""Opacity of lines behind a map, over that of lines in front of it."""


def ranks(shown: Sequence[Snapshot]) -> IntArray:
    """Return the position of each obstacle in the drawing order, the farthest first after maps."""
    _, _, to_viewer = view()
    depths = np.array([each.center @ to_viewer if _is_convex(each) else -np.inf for each in shown])
    order: IntArray = np.argsort(np.argsort(depths, kind="stable"), kind="stable")
    return order


def layers(points: FloatArray, shown: Sequence[Snapshot]) -> IntArray:
    """Return the number of obstacles, counted from the farthest, that each point is drawn over.

    If no number is correct for all obstacles, the chosen one is wrong for as few as possible.
    Obstacles that overlap the point in the picture take precedence over all others.

    Args:
        points: positions [m], shape (M, 3).
        shown: the obstacles.
    """
    maps = sum(not _is_convex(each) for each in shown)
    over: IntArray = np.full(len(points), maps)
    order = np.argsort(ranks(shown), kind="stable")[maps:]
    if len(order) == 0:
        return over
    gains = np.stack([_gains(points, shown[index], len(shown)) for index in order], axis=1)
    sums = np.concatenate([np.zeros((len(points), 1)), np.cumsum(gains, axis=1)], axis=1)
    over += np.argmax(sums, axis=1)
    return over


def _is_convex(each: Snapshot) -> bool:
    return isinstance(each.shape, Shape)


def _gains(points: FloatArray, each: Snapshot, count: int) -> FloatArray:
    """Return the gain of drawing points over an obstacle, negative if behind it, shape (M,)."""
    right, up, _ = view()
    x = points - each.center
    sides = np.stack([right, up])
    extent = each.shape.local_support(sides) if isinstance(each.shape, Shape) else 0.0
    overlaps = np.all(np.abs(x @ sides.T) <= extent, axis=1)
    weights = np.where(overlaps, count + 1.0, 1.0)
    return np.where(before(points, each), weights, -weights)


def before(points: FloatArray, each: Snapshot) -> BoolArray:
    """Tell which points are on the viewer's side of an obstacle, shape (M,).

    The boundary is the plane of the points at which lines of sight touch the ellipsoid of the same
    extent; it contains the ellipsoid's centre.
    """
    _, _, to_viewer = view()
    narrow = np.min(each.shape.extent)
    normal = to_viewer * (narrow / each.shape.extent) ** 2
    nearer: BoolArray = (points - each.center) @ normal > 0.0
    return nearer


def draw_line(
    ax: Axes3D, points: FloatArray, shown: Sequence[Snapshot], **style: Any
) -> list[Line3D]:
    """Draw a line in pieces, each over the obstacles behind it and under those in front of it.

    The first piece is a visible one, if there is any, since legends show it.
    """
    over, behind = layers(points, shown), hidden(points, shown)
    cuts = [0, *(np.flatnonzero(np.diff(2 * over + behind)) + 1), len(points) - 1]
    pieces = [(first, last) for first, last in pairwise(cuts) if last > first]
    faint = {"alpha": FAINT * style.get("alpha", 1.0)}
    return [
        ax.plot(
            *points[first : last + 1].T,
            zorder=2 * over[first] + 1,
            **(style | faint if behind[first] else style),
        )[0]
        for first, last in sorted(pieces, key=lambda piece: bool(behind[piece[0]]))
    ]
