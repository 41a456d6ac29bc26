"""Three-dimensional axes of equal scale, as large as fits into a figure."""

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
"""Least ratio of a side of the box to the longest one, as space above and below flat scenes."""
_OUTWARDS = np.array([[0.0, -1.0, -1.0], [1.0, 0.0, -1.0], [1.0, 1.0, 0.0]])
"""Directions from the box's centre in which matplotlib places each axis's ticks and label."""
_MIN_DISTANCE = 0.62
"""Least projected distance of such a direction from its axis at which matplotlib's own distances
of ticks and labels are sufficient."""
_TICKS, _LABEL = 8.0, 21.0
"""Offsets that matplotlib adds to the given distances of ticks and labels [points]."""
_PER_INCH = 3.2
"""Largest number of tick intervals per inch of an axis."""
_TRIES = 4
"""Number of corrections of a scene's size for ticks and labels of constant size."""


class SceneAxes(Axes3D):  # type: ignore[misc]  # Axes3D is untyped
    """Three-dimensional axes whose square, only partly used, may exceed the figure."""

    def get_tightbbox(self, *args: Any, **kwargs: Any) -> Bbox | None:
        """Return the bounding box of the axes, clipped to the figure."""
        found: Bbox | None = super().get_tightbbox(*args, **kwargs)
        return None if found is None else Bbox.intersection(found, figure_of(self).bbox)


@dataclasses.dataclass(frozen=True)
class Area:
    """Area of a figure that is available for a scene with its ticks and labels [in]."""

    left: float
    bottom: float
    width: float
    max_height: float


def frame_scene(
    ax: Axes3D, positions: FloatArray, shown: Sequence[Snapshot], *, from_above: bool = False
) -> None:
    """Set equal axes around the positions and the obstacles, and label them with units.

    Args:
        ax: axes to set.
        positions: positions of all drawn objects except obstacles [m], shape (..., 3).
        shown: drawn obstacles.
        from_above: whether x and y are seen from above, rather than all three from the side.
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
    ax.set_box_aspect(tuple(sides))  # matplotlib would modify an array in place
    # Lines and surfaces are drawn in order of their layers, which is exact for parallel lines
    # of sight. Matplotlib's own order compares centres, which can hide objects in front.
    ax.computed_zorder = False
    ax.set_proj_type("ortho")
    elevation, azimuth = (90.0, -90.0) if from_above else (VIEW_ELEVATION, VIEW_AZIMUTH)
    ax.view_init(elev=elevation, azim=azimuth)
    if from_above:
        _without_heights(ax)
        return
    right, up, _ = view()
    for index, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        # Matplotlib's offset of ticks and labels is proportional to the other two sides. Beside
        # thin boxes it would be less than the height of a letter.
        along = sides[index] * np.array([right[index], up[index]])
        x, y = np.array([right, up]) @ (_OUTWARDS[index] * sides)
        distance = abs(along[0] * y - along[1] * x) / np.linalg.norm(along)
        factor = max(1.0, _MIN_DISTANCE / distance)
        axis.set_tick_params(pad=_TICKS * (factor - 1.0))
        axis.labelpad = 3.0 * factor + _LABEL * (factor - 1.0)


def _without_heights(ax: Axes3D) -> None:
    """Remove the height axis, invisible from above, and put labels near the other axes."""
    ax.set(zticks=[], zlabel="")
    ax.zaxis.set_visible(False)
    for axis, tick, label in ((ax.xaxis, -4.0, -6.0), (ax.yaxis, 0.0, 0.0)):
        axis.set_tick_params(pad=tick)
        axis.labelpad = label


def _axes_of(ax: Axes3D) -> list[Any]:
    """Return the visible axes, untyped in matplotlib."""
    return [axis for axis in (ax.xaxis, ax.yaxis, ax.zaxis) if axis.get_visible()]


def fit_scene(figure: Figure, ax: Axes3D, area: Area) -> Bbox:
    """Make the empty axes, with ticks and labels, as large as the available area allows.

    Args:
        figure: figure with no other axes; its height is set as needed.
        ax: axes framed by `frame_scene`.
        area: available area; the figure ends at the top of the axes.

    Returns:
        The bounding box with ticks and labels [in]; a third of the unused width is on its left.
    """
    side = area.width
    for _ in range(_TRIES):
        _place(ax, side, (0.0, 0.0))
        box, whole = _extents(figure, ax)
        rest = np.asarray(whole.size) - np.asarray(box.size)
        sizes = (np.array([area.width, area.max_height]) - rest) / box.size
        side *= float(np.clip(sizes.min(), 0.2, 5.0))
    _place(ax, side, (0.0, 0.0))
    _, whole = _extents(figure, ax)
    _drop_overlapping_ticks(figure, ax)
    left = area.left + (area.width - whole.width) / 3
    figure.set_figheight(area.bottom + whole.height)
    _place(ax, side, (left - whole.x0, area.bottom - whole.y0))
    return Bbox.from_bounds(left, area.bottom, whole.width, whole.height)


def _place(ax: Axes3D, side: float, corner: tuple[float, float]) -> None:
    """Set the place of the axes in the figure: side and corner of their square [in]."""
    figure = ax.get_figure(True)
    wide, high = figure.get_size_inches()
    ax.set_position((corner[0] / wide, corner[1] / high, side / wide, side / high))


def _extents(figure: Figure, ax: Axes3D) -> tuple[Bbox, Bbox]:
    """Return the drawn extents of the axes' box, without and with ticks and labels [in]."""
    ends = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    ax.apply_aspect()
    x, y, _ = proj3d.proj_transform(*np.array(list(product(*ends))).T, ax.get_proj())
    corners = ax.transData.transform(np.stack([x, y], axis=1)) / figure.dpi
    box = Bbox([corners.min(axis=0), corners.max(axis=0)])
    for index, axis in enumerate(_axes_of(ax)):
        line = np.stack([ends[:, 0]] * 2)
        line[1, index] = ends[index, 1]
        x, y, _ = proj3d.proj_transform(*line.T, ax.get_proj())
        begin, end = ax.transData.transform(np.stack([x, y], axis=1)) / figure.dpi
        intervals = int(np.clip(_PER_INCH * np.linalg.norm(end - begin), 1, 6))
        axis.set_major_locator(MaxNLocator(intervals, steps=[1, 2, 5, 10]))
    figure.draw_without_rendering()
    renderer = renderer_of(figure)
    parts = [axis.get_tightbbox(renderer) for axis in _axes_of(ax)]
    labels = [each.transformed(figure.dpi_scale_trans.inverted()) for each in parts if each]
    return box, Bbox.union([box, *labels])


def _drop_overlapping_ticks(figure: Figure, ax: Axes3D) -> None:
    """Remove ticks with overlapping numbers."""
    renderer, occupied = renderer_of(figure), list[Bbox]()
    for axis in _axes_of(ax):
        low, high = sorted(axis.get_view_interval())
        remaining = []
        for tick in axis.get_major_ticks():
            number = tick.label1.get_window_extent(renderer)
            if low <= tick.get_loc() <= high and not any(map(number.overlaps, occupied)):
                occupied.append(number)
                remaining.append(tick.get_loc())
        axis.set_major_locator(FixedLocator(remaining))
