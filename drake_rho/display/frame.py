"""Axes in space around what is drawn on them: equal, and with room for their ticks and labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.snapshots import Snapshot
from drake_rho.display.style import VIEW_AZIMUTH, VIEW_ELEVATION, view
from drake_rho.scenario.fields import FloatArray

_LEAST_SIDE = 0.3
"""Least side of the box over its longest: a flat scene has some room above and below."""
_ROOM = np.array([0.88, 0.70])
"""Room for the box's width, and for its height above the label of x, in diagonals."""
_MOST_BESIDE = 0.85
"""Greatest width of the box in the picture, in diagonals, that leaves room at its right."""
_OUTWARDS = np.array([[0.0, -1.0, -1.0], [1.0, 0.0, -1.0], [1.0, 1.0, 0.0]])
"""Where matplotlib puts the ticks and the label of each axis, as seen from the box's centre."""
_LEAST_REACH = 0.7
"""How far one of these is seen to lie from its axis where matplotlib's own distances are enough."""
_TICKS, _LABEL = 8.0, 21.0
"""What matplotlib adds to the distances that are given for ticks and labels [points]."""


def frame_scene(ax: Axes3D, positions: FloatArray, shown: Sequence[Snapshot]) -> bool:
    """Equal axes around the positions [m] and the obstacles, named with their unit.

    Args:
        ax: where to draw.
        positions: of all that is drawn beside the obstacles [m], shape (..., 3).
        shown: the obstacles.

    Returns:
        Whether there is room at the right of them for a legend.
    """
    positions = positions.reshape(-1, 3)
    bounds = [each.bounds for each in shown]
    lower = np.min([positions.min(axis=0), *(low for low, _ in bounds)], axis=0)
    upper = np.max([positions.max(axis=0), *(high for _, high in bounds)], axis=0)
    longest = float(np.max(upper - lower)) or 5.0
    half = np.maximum((upper - lower) / 2 + 0.04 * longest, _LEAST_SIDE / 2 * longest)
    lower, upper = (lower + upper) / 2 - half, (lower + upper) / 2 + half
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    width = _make_room(ax, half / np.linalg.norm(half))
    # Lines and surfaces are drawn in the order of their layers, which parallel lines of sight make
    # exact; matplotlib's own order goes by the middle of each and hides what is in front.
    ax.computed_zorder = False
    ax.set_proj_type("ortho")
    ax.view_init(elev=VIEW_ELEVATION, azim=VIEW_AZIMUTH)
    return width <= _MOST_BESIDE


def _make_room(ax: Axes3D, sides: FloatArray) -> float:
    """Keep ticks and labels apart, and in the picture.

    Args:
        ax: whose they are.
        sides: of the box, in diagonals, shape (3,).

    Returns:
        How wide the box is in the picture, in diagonals.
    """
    right, up, _ = view()
    seen = np.array([np.abs(right) @ sides, np.abs(up[1:]) @ sides[1:]])
    zoom = float(np.min(_ROOM / seen, initial=1.0))
    ax.set_box_aspect(tuple(sides), zoom=zoom)  # an array would be written to
    for index, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        along = zoom * sides[index] * np.array([right[index], up[index]])
        length = float(np.linalg.norm(along))
        intervals = int(np.clip(20 * length, 2, 6))  # an inch has room for four
        axis.set_major_locator(MaxNLocator(intervals, steps=[1, 2, 5, 10]))
        # matplotlib moves ticks and labels by so many points times the other sides, beside thin
        # ones less than the height of a letter.
        x, y = zoom * np.array([right, up]) @ (_OUTWARDS[index] * sides)
        reach = abs(along[0] * y - along[1] * x) / length
        farther = max(1.0, _LEAST_REACH / reach)
        axis.set_tick_params(labelsize=8, pad=(1 + _TICKS) * farther - _TICKS)
        axis.labelpad = (4 + _LABEL) * farther - _LABEL
    return zoom * float(seen[0])
