"""Axes in space around what is drawn on them: equal, and as large as a figure has room for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.obstacle_snapshots import Snapshot
from drake_rho.display.common.style import VIEW_AZIMUTH, VIEW_ELEVATION, view
from drake_rho.display.plots.legends import figure_of, renderer_of
from drake_rho.scenario.fields import FloatArray

_MIN_SIDE = 0.3
"""Least side of the box over its longest: a flat scene has some room above and below."""
_OUTWARDS = np.array([[0.0, -1.0, -1.0], [1.0, 0.0, -1.0], [1.0, 1.0, 0.0]])
"""Where matplotlib puts the ticks and the label of each axis, as seen from the box's centre."""
_MIN_REACH = 0.62
"""How far one of these is seen to lie from its axis where matplotlib's own distances are enough."""
_TICKS, _LABEL = 8.0, 21.0
"""What matplotlib adds to the distances that are given for ticks and labels [points]."""
_PER_INCH = 3.2
"""Most intervals between ticks along an axis."""
_TRIES = 4
"""How often a scene's size is corrected for its ticks and labels, which keep theirs."""


class SceneAxes(Axes3D):  # type: ignore[misc]  # which has no types
    """Axes in space whose square, of which a part is drawn in, may be larger than the figure."""

    def get_tightbbox(self, *args: Any, **kwargs: Any) -> Bbox | None:
        """What they take of the figure."""
        found: Bbox | None = super().get_tightbbox(*args, **kwargs)
        return None if found is None else Bbox.intersection(found, figure_of(self).bbox)


@dataclasses.dataclass(frozen=True)
class Room:
    """Where a scene with its ticks and labels may be in a figure [in]."""

    left: float
    bottom: float
    width: float
    most_height: float


def frame_scene(ax: Axes3D, positions: FloatArray, shown: Sequence[Snapshot]) -> None:
    """Equal axes around the positions [m] and the obstacles, named with their unit.

    Args:
        ax: where to draw.
        positions: of all that is drawn beside the obstacles [m], shape (..., 3).
        shown: the obstacles.
    """
    positions = positions.reshape(-1, 3)
    bounds = [each.bounds for each in shown]
    lower = np.min([positions.min(axis=0), *(low for low, _ in bounds)], axis=0)
    upper = np.max([positions.max(axis=0), *(high for _, high in bounds)], axis=0)
    longest = float(np.max(upper - lower)) or 5.0
    half = np.maximum((upper - lower) / 2 + 0.04 * longest, _MIN_SIDE / 2 * longest)
    lower, upper = (lower + upper) / 2 - half, (lower + upper) / 2 + half
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    sides = half / np.linalg.norm(half)
    ax.set_box_aspect(tuple(sides))  # an array would be written to
    # Lines and surfaces are drawn in the order of their layers, which parallel lines of sight make
    # exact; matplotlib's own order goes by the middle of each and hides what is in front.
    ax.computed_zorder = False
    ax.set_proj_type("ortho")
    ax.view_init(elev=VIEW_ELEVATION, azim=VIEW_AZIMUTH)
    right, up, _ = view()
    for index, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        # matplotlib moves ticks and labels by so many points times the other sides, beside thin
        # ones less than the height of a letter.
        along = sides[index] * np.array([right[index], up[index]])
        x, y = np.array([right, up]) @ (_OUTWARDS[index] * sides)
        reach = abs(along[0] * y - along[1] * x) / np.linalg.norm(along)
        farther = max(1.0, _MIN_REACH / reach)
        axis.set_tick_params(pad=_TICKS * (farther - 1.0))
        axis.labelpad = 3.0 * farther + _LABEL * (farther - 1.0)


def fit_scene(figure: Figure, ax: Axes3D, room: Room) -> Bbox:
    """Make the empty axes as large as there is room for, ticks and labels included.

    Args:
        figure: whose only axes these are; it is made as high as needed.
        ax: framed by `frame_scene`.
        room: where they may be; what is above is cut off.

    Returns:
        Where they are, with ticks and labels [in]; a third of what is left is at their left.
    """
    side = room.width
    for _ in range(_TRIES):
        _place(ax, side, (0.0, 0.0))
        box, whole = _seen(figure, ax)
        rest = np.asarray(whole.size) - np.asarray(box.size)
        sizes = (np.array([room.width, room.most_height]) - rest) / box.size
        side *= float(np.clip(sizes.min(), 0.2, 5.0))
    _place(ax, side, (0.0, 0.0))
    _, whole = _seen(figure, ax)
    _thin(figure, ax)
    left = room.left + (room.width - whole.width) / 3
    figure.set_figheight(room.bottom + whole.height)
    _place(ax, side, (left - whole.x0, room.bottom - whole.y0))
    return Bbox.from_bounds(left, room.bottom, whole.width, whole.height)


def _place(ax: Axes3D, side: float, corner: tuple[float, float]) -> None:
    """Give the axes a square in the figure, all [in]; it is larger than what is drawn in it."""
    figure = ax.get_figure(True)
    wide, high = figure.get_size_inches()
    ax.set_position((corner[0] / wide, corner[1] / high, side / wide, side / high))


def _seen(figure: Figure, ax: Axes3D) -> tuple[Bbox, Bbox]:
    """The box of the axes, and all of it with ticks and labels, as they are drawn [in]."""
    ends = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    ax.apply_aspect()
    x, y, _ = proj3d.proj_transform(*np.array(list(product(*ends))).T, ax.get_proj())
    corners = ax.transData.transform(np.stack([x, y], axis=1)) / figure.dpi
    box = Bbox([corners.min(axis=0), corners.max(axis=0)])
    for index, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        line = np.stack([ends[:, 0]] * 2)
        line[1, index] = ends[index, 1]
        x, y, _ = proj3d.proj_transform(*line.T, ax.get_proj())
        begin, end = ax.transData.transform(np.stack([x, y], axis=1)) / figure.dpi
        intervals = int(np.clip(_PER_INCH * np.linalg.norm(end - begin), 1, 6))
        axis.set_major_locator(MaxNLocator(intervals, steps=[1, 2, 5, 10]))
    figure.draw_without_rendering()
    renderer = renderer_of(figure)
    parts = [axis.get_tightbbox(renderer) for axis in (ax.xaxis, ax.yaxis, ax.zaxis)]
    labels = [each.transformed(figure.dpi_scale_trans.inverted()) for each in parts if each]
    return box, Bbox.union([box, *labels])


def _thin(figure: Figure, ax: Axes3D) -> None:
    """Leave out ticks whose numbers would lie on those of another axis, or of the same."""
    renderer, taken = renderer_of(figure), list[Bbox]()
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        low, high = sorted(axis.get_view_interval())
        left = []
        for tick in axis.get_major_ticks():
            number = tick.label1.get_window_extent(renderer)
            if low <= tick.get_loc() <= high and not any(map(number.overlaps, taken)):
                taken.append(number)
                left.append(tick.get_loc())
        axis.set_major_locator(FixedLocator(left))
