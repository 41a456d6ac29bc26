"""Texts inside axes, placed at drawing time so that none overlap and few cover a curve.

Placement depends on the figure's final size, which is known only then.
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

from drake_rho.display.plots.overlapping_curves import evenly, runs
from drake_rho.scenario.fields import BoolArray, FloatArray

_GAP = 3.0
"""Distance between a text and the point or line that it labels [points]."""
_ROWS = 6
"""Largest distance from there, in lines of text."""
_DIRECTIONS = ((0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (-1, 0))
"""Directions in which a text is placed, in order of preference."""
_PER_ROW = 12.0
"""Cost of one more line of distance, in covered points of curves."""
_SPACING = 2.0
"""Spacing of the points of a curve that count as covered [points]."""
_MARK = 14.0
"""Cost of covering a mark, in covered points of curves."""

Spots = Callable[[float, float, float], Iterator["Spot"]]
"""Generator of possible places of a text from its width, its height and one point, in pixels."""


@dataclasses.dataclass(frozen=True)
class Spot:
    """Possible place of a text."""

    x: float
    """abscissa of the text's lower left corner [pixels]"""
    y: float
    """ordinate of that corner [pixels]"""
    cost: float = 0.0
    """cost in comparison with other places, in covered points of curves"""
    leader: tuple[float, float] | None = None
    """start of a leader line, if the text is far from the point that it labels [pixels]"""


class Labels(Artist):
    """Manager of the texts of one axes, drawn before them to move them to their places.

    Texts that fit nowhere are hidden.
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
        """Return the labels of an axes, created at the first call."""
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
        """Place the texts, which draw themselves later."""
        if not self._texts:
            return
        point = float(np.asarray(renderer.points_to_pixels(1.0)))
        area = self.ax.bbox if not isinstance(self.ax, Axes3D) else self.ax.get_figure(True).bbox
        curves, occupied = _curves(self.ax, point), _occupied(self.ax, renderer)
        for _, text, spots in sorted(self._texts, key=lambda each: each[0]):
            text.set_visible(True)
            width, height = text.get_window_extent(renderer).size
            best, least = None, np.inf
            for spot in spots(width, height, point):
                around = Bbox.from_bounds(spot.x, spot.y, width, height).padded(point)
                if spot.cost >= least or not _inside(around, area):
                    continue
                if any(around.overlaps(other) for other in occupied):
                    continue
                cost = spot.cost + _covered(curves, around)
                if cost < least:
                    best, least = (spot, around), cost
            text.set_visible(best is not None)
            if best is not None:
                spot, around = best
                text.set_position((spot.x, spot.y))
                occupied.append(around)
                if spot.leader is not None:
                    self._draw_leader(spot.leader, around, renderer)

    def _draw_leader(
        self, begin: tuple[float, float], around: Bbox, renderer: RendererBase
    ) -> None:
        """Draw a thin line from a point to the nearest point of a text's outline."""
        x, y = np.clip(begin, around.min, around.max)
        line = Line2D([begin[0], x], [begin[1], y], color="black", linewidth=0.4)
        line.set_transform(IdentityTransform())
        figure = self.ax.get_figure(True)
        if figure is not None:
            line.set_figure(figure)
        line.draw(renderer)


def around(ax: Axes, *place: float, middle: bool = False, rows: int = _ROWS) -> Spots:
    """Return spots around a point in data coordinates, first centred on it if `middle` is set."""

    def spots(width: float, height: float, point: float) -> Iterator[Spot]:
        ((x, y),) = _in_pixels(ax, np.array([place], dtype=np.float64))
        if middle:
            yield Spot(x - width / 2, y - height / 2, -_PER_ROW)
        for row, (rank, (right, up)) in product(range(rows), enumerate(_DIRECTIONS)):
            far = _GAP * point * (0.7 if right and up else 1.0) + row * height
            corner = (
                x + right * (far + width / 2) - width / 2,
                y + up * (far + height / 2) - height / 2,
            )
            yield Spot(*corner, _PER_ROW * row + rank / 4, (x, y) if row else None)

    return spots


def along(ax: Axes, height: float, *, above: bool = False) -> Spots:
    """Return spots below and above a horizontal line across the axes, above first if `above`."""

    def spots(width: float, tall: float, point: float) -> Iterator[Spot]:
        _, y = ax.transData.transform((0.0, height))
        left = ax.bbox.x0 + _GAP * point
        free = ax.bbox.width - width - 2 * _GAP * point
        for rank, (over, part) in enumerate(product((above, not above), np.linspace(0, 1, 9))):
            gap = _GAP * point / 2
            yield Spot(left + part * free, y + gap if over else y - gap - tall, rank / 2)

    return spots


def beside(ax: Axes, time: float) -> Spots:
    """Return spots beside a vertical line in the axes, from the top down."""

    def spots(width: float, height: float, point: float) -> Iterator[Spot]:
        x, _ = ax.transData.transform((time, 0.0))
        for row, right in product(range(_ROWS), (True, False)):
            top = ax.bbox.y1 - _GAP * point - row * 1.3 * height
            left = x + _GAP * point if right else x - _GAP * point - width
            yield Spot(left, top - height, _PER_ROW * row + (0.0 if right else 1.0))

    return spots


def _in_pixels(ax: Axes, points: FloatArray) -> FloatArray:
    """Transform points in data coordinates, shape (M, 2) or (M, 3), to pixels, shape (M, 2)."""
    if isinstance(ax, Axes3D):
        x, y, _ = proj3d.proj_transform(*points.T, ax.get_proj())
        points = np.stack([x, y], axis=1)
    pixels: FloatArray = ax.transData.transform(points)
    return pixels


def _curves(ax: Axes, point: float) -> FloatArray:
    """Return points of curves and marks [pixels] with the cost of covering them, shape (P, 3)."""
    found = [np.zeros((0, 3))]
    for line in ax.lines:
        if isinstance(line, Line3D):
            drawn = _in_pixels(ax, np.stack(line.get_data_3d(), axis=1).astype(np.float64))
        else:
            drawn = line.get_transform().transform(line.get_xydata())
        drawn = drawn[np.all(np.isfinite(drawn), axis=1)]  # curves have gaps
        if len(drawn) == 0:
            continue
        marks = line.get_linestyle() == "None"
        shown: BoolArray = np.all(np.isfinite(drawn), axis=1)  # a curve may have gaps
        pieces = [drawn[shown]]
        if not marks:
            pieces = [evenly(drawn[i : j + 1], _SPACING * point) for i, j in runs(shown)]
        cost = _MARK if marks else 1.0
        found += [np.column_stack([each, np.full(len(each), cost)]) for each in pieces]
    return np.concatenate(found)


def _covered(curves: FloatArray, around: Bbox) -> float:
    inside = np.all((curves[:, :2] > around.min) & (curves[:, :2] < around.max), axis=1)
    return float(curves[inside, 2].sum())


def _inside(around: Bbox, area: Bbox) -> bool:
    return bool(np.all(around.min >= area.min) and np.all(around.max <= area.max))


def _occupied(ax: Axes, renderer: RendererBase) -> list[Bbox]:
    """Return the boxes of other elements of a figure with 3D axes, and of their tick labels."""
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
