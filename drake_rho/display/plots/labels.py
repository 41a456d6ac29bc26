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
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox, IdentityTransform
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.scenario.fields import FloatArray

_GAP = 3.0
"""Distance between a text and the point that it labels [points]."""
_ROWS = 6
"""Largest distance from there, in lines of text."""
_DIRECTIONS = ((0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (-1, 0))
"""Directions in which a text is placed, in order of preference."""
_PER_ROW = 36.0
"""Cost of one more line of distance, in covered points of curves."""
_MARK = 42.0
"""Cost of covering a mark, in covered points of curves."""
_LAYER = 1000.0
"""Layer of texts; they are placed just below it, after all curves are drawn."""


@dataclasses.dataclass(frozen=True, eq=False)
class Spots:
    """Possible places of a text: in some directions from any of some points."""

    points: Callable[[], FloatArray]
    """returns the points, the best first [pixels], shape (P, 2)"""
    directions: tuple[tuple[int, int], ...]
    """directions to the right and up, the best first"""
    rows: int = 1
    """largest distance, in lines of text"""


class Labels(Artist):
    """Texts of one axes, moved to their places just before they are drawn.

    Texts that fit nowhere are hidden.
    """

    def __init__(self, ax: Axes) -> None:
        super().__init__()
        self.set_zorder(_LAYER - 1.0)
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
        """Add a text; texts of lower rank are placed first."""
        background = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.4}
        style = {"fontsize": 7, "bbox": background, "zorder": _LAYER, **style}
        text = Text(0.0, 0.0, words, ha="left", va="bottom", clip_on=False, **style)
        text.set_transform(IdentityTransform())
        text.set_in_layout(False)
        self.ax.add_artist(text)
        self._texts.append((rank, text, spots))
        return text

    def draw(self, renderer: RendererBase) -> None:
        """Place the texts, which draw themselves later."""
        figure = self.ax.get_figure(True)
        if not self._texts or figure is None:
            return
        area = figure.bbox if isinstance(self.ax, Axes3D) else self.ax.bbox
        pixel = float(np.asarray(renderer.points_to_pixels(1.0)))
        own, covered = [text for _, text, _ in self._texts], _covered(self.ax, pixel)
        occupied = [
            each.get_window_extent(renderer)
            for each in [*figure.legends, *_texts_of(figure)]
            if each not in own
        ]
        for _, text, spots in sorted(self._texts, key=lambda each: each[0]):
            text.set_visible(True)
            best, least = None, np.inf
            for cost, box, point in _boxes(text.get_window_extent(renderer).size, spots, pixel):
                inside = np.all(box.min >= area.min) and np.all(box.max <= area.max)
                if cost < least and inside and box.count_overlaps(occupied) == 0:
                    here = np.all((covered[:, :2] > box.min) & (covered[:, :2] < box.max), axis=1)
                    cost += float(np.nansum(covered[here, 2]))
                    if cost < least:
                        best, least = (box, point), cost
            text.set_visible(best is not None)
            if best is not None:
                box, point = best
                occupied.append(box)
                text.set_position((box.x0 + pixel, box.y0 + pixel))
                ends = np.array([point, np.clip(point, box.min, box.max)])
                if np.linalg.norm(ends[1] - ends[0]) > box.height / 2.0:
                    leader = Line2D(*ends.T, color="black", linewidth=0.4)
                    leader.set_transform(IdentityTransform())
                    leader.set_figure(figure)
                    leader.draw(renderer)


def _covered(ax: Axes, pixel: float) -> FloatArray:
    """Return points of curves and marks [pixels] with the cost of covering them, shape (P, 3)."""
    found = [np.zeros((0, 3))]
    for line in ax.lines:
        points = line.get_transform().transform(line.get_xydata())
        costs = np.linalg.norm(np.diff(points, axis=0, append=points[-1:]), axis=1) / pixel
        if line.get_linestyle() == "None":
            costs[:] = _MARK
        found.append(np.column_stack([points, costs]))
    return np.concatenate(found)


def _texts_of(figure: Figure) -> list[Text]:
    """Return all visible texts of a figure."""
    found: list[Text] = figure.findobj(Text)
    return [text for text in found if text.get_visible() and text.get_text()]


def _boxes(
    size: tuple[float, float], spots: Spots, pixel: float
) -> Iterator[tuple[float, Bbox, FloatArray]]:
    """Yield the cost, the box with a margin, and the labelled point of each possible place.

    Args:
        size: width and height of the text [pixels].
        spots: possible places.
        pixel: length of a point [pixels].
    """
    half = np.array(size) / 2.0
    points, rows = enumerate(spots.points()), range(spots.rows)
    for (worse, point), row, (rank, way) in product(points, rows, enumerate(spots.directions)):
        far = _GAP * pixel * (0.7 if all(way) else 1.0) + row * size[1]
        low = point + np.array(way) * (far + half) - half
        cost = _PER_ROW * (row if any(way) else -1.0) + (worse + rank) / 4.0
        yield cost, Bbox([low, low + 2.0 * half]).padded(pixel), point


def around(ax: Axes, *place: float, middle: bool = False, rows: int = _ROWS) -> Spots:
    """Return spots around a point in data coordinates, first centred on it if `middle` is set."""

    def points() -> FloatArray:
        x, y, *_ = proj3d.proj_transform(*place, ax.get_proj()) if isinstance(ax, Axes3D) else place
        return np.asarray(ax.transData.transform([(x, y)]))

    return Spots(points, ((0, 0),) * middle + _DIRECTIONS, rows)


def along(ax: Axes, height: float) -> Spots:
    """Return spots below and above a horizontal line across the axes."""
    places = [(part, height) for part in np.linspace(0.0, 1.0, 33)]
    return Spots(lambda: ax.get_yaxis_transform().transform(places), ((1, -1), (1, 1)))


def beside(ax: Axes, time: float) -> Spots:
    """Return spots beside a vertical line in the axes, from the top down."""
    places = [(time, part) for part in np.linspace(1.0, 0.0, 12)]
    return Spots(lambda: ax.get_xaxis_transform().transform(places), ((1, -1), (-1, -1)))
