"""Texts inside axes, placed whenever they are drawn: none over another, few over a curve.

Where a text fits depends on the figure's final size, so that is not settled before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox, IdentityTransform
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Line3D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.plots.overlapping_curves import evenly
from drake_rho.scenario.fields import FloatArray

_GAP = 3.0
"""Between a text and what it is about [points]."""
_ROWS = 6
"""How many lines of text away from there it may be."""
_WAYS = ((0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (-1, 0))
"""To which sides, the first first."""
_PER_ROW = 12.0
"""Points of curves that a text rather covers than to be a line farther away."""
_SPACING = 2.0
"""Between the points of a curve that a text may cover [points]."""
_MARK = 14.0
"""How many points of a curve a mark counts for."""

Spots = Callable[[float, float, float], Iterator["Spot"]]
"""Where a text may be, of its width and height and the length of a point, all in pixels."""


@dataclasses.dataclass(frozen=True)
class Spot:
    """A place for a text."""

    x: float
    """of its lower left corner [pixels]"""
    y: float
    """the same"""
    cost: float = 0.0
    """against other places, in points of curves covered"""
    leader: tuple[float, float] | None = None
    """what it is about, if it is so far from there that a line has to lead to it [pixels]"""


class Labels(Artist):
    """The texts of one axes; drawn first of all in it, it moves the others to their places.

    Texts for which there is no room are not shown.
    """

    def __init__(self, ax: Axes) -> None:
        super().__init__()
        self.set_zorder(-1.0)
        self.set_in_layout(False)
        self._texts: list[tuple[int, Text, Spots]] = []
        self.ax = ax
        ax.add_artist(self)

    @classmethod
    def of(cls, ax: Axes) -> Labels:
        """Those of an axes, made at the first call."""
        found = [each for each in ax.artists if isinstance(each, cls)]
        return found[0] if found else cls(ax)

    def add(self, words: str, spots: Spots, *, rank: int = 0, **style: Any) -> Text:
        """Add a text; those of lower rank are placed first."""
        background = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.4}
        style = {"fontsize": 7, "bbox": background, "zorder": 2000, **style}
        text = Text(0.0, 0.0, words, ha="left", va="bottom", clip_on=False, **style)
        text.set_transform(IdentityTransform())
        text.set_in_layout(False)
        self.ax.add_artist(text)
        self._texts.append((rank, text, spots))
        return text

    def draw(self, renderer: RendererBase) -> None:
        """Place the texts; they draw themselves later."""
        if not self._texts:
            return
        point = float(np.asarray(renderer.points_to_pixels(1.0)))
        room = self.ax.bbox if not isinstance(self.ax, Axes3D) else self.ax.get_figure(True).bbox
        curves, taken = _curves(self.ax, point), _taken(self.ax, renderer)
        for _, text, spots in sorted(self._texts, key=lambda each: each[0]):
            text.set_visible(True)
            width, height = text.get_window_extent(renderer).size
            best, least = None, np.inf
            for spot in spots(width, height, point):
                around = Bbox.from_bounds(spot.x, spot.y, width, height).padded(point)
                if spot.cost >= least or not _inside(around, room):
                    continue
                if any(around.overlaps(other) for other in taken):
                    continue
                cost = spot.cost + _covered(curves, around)
                if cost < least:
                    best, least = (spot, around), cost
            text.set_visible(best is not None)
            if best is not None:
                spot, around = best
                text.set_position((spot.x, spot.y))
                taken.append(around)
                if spot.leader is not None:
                    self._lead(spot.leader, around, renderer)

    def _lead(self, begin: tuple[float, float], around: Bbox, renderer: RendererBase) -> None:
        """A thin line from a point to the nearest one of a text's outline."""
        x, y = np.clip(begin, around.min, around.max)
        line = Line2D([begin[0], x], [begin[1], y], color="black", linewidth=0.4)
        line.set_transform(IdentityTransform())
        figure = self.ax.get_figure(True)
        if figure is not None:
            line.set_figure(figure)
        line.draw(renderer)


def around(ax: Axes, *place: float, middle: bool = False, rows: int = _ROWS) -> Spots:
    """Spots around a point in data of the axes, first on it if `middle`, in rows farther away."""

    def spots(width: float, height: float, point: float) -> Iterator[Spot]:
        ((x, y),) = _seen(ax, np.array([place], dtype=np.float64))
        if middle:
            yield Spot(x - width / 2, y - height / 2, -_PER_ROW)
        for row, (rank, (right, up)) in product(range(rows), enumerate(_WAYS)):
            far = _GAP * point * (0.7 if right and up else 1.0) + row * height
            corner = (
                x + right * (far + width / 2) - width / 2,
                y + up * (far + height / 2) - height / 2,
            )
            yield Spot(*corner, _PER_ROW * row + rank / 4, (x, y) if row else None)

    return spots


def along(ax: Axes, height: float, *, above: bool = False) -> Spots:
    """Spots below (or, first, above) a level line across the axes."""

    def spots(width: float, tall: float, point: float) -> Iterator[Spot]:
        _, y = ax.transData.transform((0.0, height))
        left = ax.bbox.x0 + _GAP * point
        free = ax.bbox.width - width - 2 * _GAP * point
        for rank, (over, part) in enumerate(product((above, not above), np.linspace(0, 1, 9))):
            aside = _GAP * point / 2
            yield Spot(left + part * free, y + aside if over else y - aside - tall, rank / 2)

    return spots


def beside(ax: Axes, time: float) -> Spots:
    """Spots beside an upright line in the axes, from the top down."""

    def spots(width: float, height: float, point: float) -> Iterator[Spot]:
        x, _ = ax.transData.transform((time, 0.0))
        for row, right in product(range(_ROWS), (True, False)):
            top = ax.bbox.y1 - _GAP * point - row * 1.3 * height
            left = x + _GAP * point if right else x - _GAP * point - width
            yield Spot(left, top - height, _PER_ROW * row + (0.0 if right else 1.0))

    return spots


def _seen(ax: Axes, points: FloatArray) -> FloatArray:
    """Points of the axes, shape (M, 2) or (M, 3), where they are drawn [pixels], shape (M, 2)."""
    if isinstance(ax, Axes3D):
        x, y, _ = proj3d.proj_transform(*points.T, ax.get_proj())
        points = np.stack([x, y], axis=1)
    seen: FloatArray = ax.transData.transform(points)
    return seen


def _curves(ax: Axes, point: float) -> FloatArray:
    """Where curves and marks are drawn [pixels] and how much each counts, shape (P, 3)."""
    found = [np.zeros((0, 3))]
    for line in ax.lines:
        if isinstance(line, Line3D):
            seen = _seen(ax, np.stack(line.get_data_3d(), axis=1).astype(np.float64))
        else:
            seen = line.get_transform().transform(line.get_xydata())
        marks = line.get_linestyle() == "None"
        seen = seen if marks else evenly(seen, _SPACING * point)
        found.append(np.column_stack([seen, np.full(len(seen), _MARK if marks else 1.0)]))
    return np.concatenate(found)


def _covered(curves: FloatArray, around: Bbox) -> float:
    inside = np.all((curves[:, :2] > around.min) & (curves[:, :2] < around.max), axis=1)
    return float(curves[inside, 2].sum())


def _inside(around: Bbox, room: Bbox) -> bool:
    return bool(np.all(around.min >= room.min) and np.all(around.max <= room.max))


def _taken(ax: Axes, renderer: RendererBase) -> list[Bbox]:
    """What is in the figure beside an axes in space, and what names its coordinates."""
    figure = ax.get_figure(True)
    if figure is None or not isinstance(ax, Axes3D):
        return []
    artists: list[Artist] = [*figure.texts, *figure.legends]
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        low, high = sorted(axis.get_view_interval())
        artists.append(axis.label)
        artists += [t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
    boxes = [each.get_window_extent(renderer) for each in artists if each.get_visible()]
    others = [each.get_tightbbox(renderer) for each in figure.axes if each is not ax]
    return [*boxes, *(each for each in others if each is not None)]
