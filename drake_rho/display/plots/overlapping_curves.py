"""Dashes that make overlapping curves visible, and marks with sufficient spacing."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.scenario.fields import BoolArray, FloatArray

_WIDTH = 0.006
"""Half the width of a curve, over the height of its axes."""
_SHORTEST = 0.03
"""Least length of an overlap that is not a mere crossing, over the axes' width."""
_DASH = 3.5
"""Length of a dash, over the width of its line."""
_APART = 2.5
"""Least spacing of marks along a curve [points]."""
_LENGTH = 0.6
"""Typical length of a curve, over the figure's width."""
_MAX_POINTS = 5000
"""Largest number of points at which curves are compared."""

Dashes = tuple[float, tuple[float, float]]
"""Offset of a dash pattern, and its dash and gap, over the width of the line."""


def marks_every(knots: int, width: float) -> int:
    """Return n such that every n-th knot is marked on a curve in a figure of a width [in]."""
    return ceil(_APART * knots / (72.0 * _LENGTH * width))


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """A piece of a curve that lies under other curves."""

    owner: int
    """index of the curve"""
    points: FloatArray
    """points on the curve, shape (M, D)"""
    dashes: Dashes
    """dash pattern that leaves the other curves visible"""


def show_overlapping(ax: Axes, lines: Sequence[Line2D]) -> list[Line2D]:
    """Draw hidden pieces of curves again, as dashes over the curves that cover them.

    Args:
        ax: axes with their final limits.
        lines: curves over the same span of time, in drawing order.

    Returns:
        The dashed lines.
    """
    times = np.asarray(lines[0].get_xdata(), dtype=np.float64)
    values = np.stack([_values(line, times) for line in lines])
    low, high = ax.get_ylim()
    points = np.stack(np.broadcast_arrays(times, values), axis=2)
    within, shortest = _WIDTH * (high - low), _SHORTEST * float(np.ptp(times))
    dashes: list[Line2D] = []
    for index, line in enumerate(lines):
        near = np.abs(values - values[index]) <= within
        for piece in _pieces(index, points[index], near):
            if np.ptp(piece.points[:, 0]) >= shortest:
                style: dict[str, Any] = {"color": line.get_color()}
                style["linewidth"] = line.get_linewidth()
                above = line.get_zorder() + 0.1
                dashes += ax.plot(*piece.points.T, linestyle=piece.dashes, zorder=above, **style)
    return dashes


def overlapping_pieces(paths: FloatArray) -> list[Piece]:
    """Find the pieces of paths, shape (N, M, 3), that lie under those of later vehicles."""
    from scipy.spatial import cKDTree  # slow to import

    longest = float(np.max(np.ptp(paths, axis=(0, 1))))
    within, shortest = _WIDTH / 2 * longest, _SHORTEST * longest
    if longest == 0.0:
        return []
    dense = [evenly(path, within) for path in paths]
    trees = [cKDTree(each) for each in dense]
    found = []
    for index, path in enumerate(dense[:-1]):
        near = np.stack([tree.query(path, distance_upper_bound=within)[0] for tree in trees])
        pieces = _pieces(index, path, np.isfinite(near))
        found += [each for each in pieces if len(each.points) * within >= shortest]
    return found


def evenly(points: FloatArray, spacing: float) -> FloatArray:
    """Resample a polyline, shape (M, D), evenly with the given spacing or less."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], int(min(along[-1] / spacing, _MAX_POINTS)) + 2)
    return np.stack([np.interp(at, along, each) for each in points.T], axis=1)


def _pieces(index: int, points: FloatArray, near: BoolArray) -> list[Piece]:
    """Find the pieces of a curve that lie under later ones.

    Args:
        index: of the curve.
        points: on the curve, shape (M, D).
        near: whether each curve is near at each point, shape (N, M).
    """
    found = []
    under = np.any(near[index + 1 :], axis=0)
    for first, last in runs(np.atleast_1d(under)):
        bundle = np.flatnonzero(near[:, first : last + 1].mean(axis=1) > 0.5)
        count, turn = max(2, len(bundle)), int(np.sum(bundle < index))
        dashes = ((count - turn) % count * _DASH, (_DASH, (count - 1) * _DASH))
        found.append(Piece(index, points[first : last + 1], dashes))
    return found


def _values(line: Line2D, times: FloatArray) -> FloatArray:
    """Return the curve's values at `times`; its own values, jumps included, if times coincide."""
    own, values = (np.asarray(each, dtype=np.float64) for each in line.get_data())
    return values if np.array_equal(own, times) else np.interp(times, own, values)


def runs(here: BoolArray) -> list[tuple[int, int]]:
    """Return the first and last indices of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], here, [False]]).astype(np.int8)))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]
