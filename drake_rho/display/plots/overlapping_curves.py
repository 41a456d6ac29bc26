"""Dashes that make overlapping curves visible, and marks with sufficient spacing."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.scenario.fields import FloatArray

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


def marks_every(knots: int, width: float) -> int:
    """Return the interval between marked knots on a curve, for a figure's width [in]."""
    return ceil(_APART * knots / (72.0 * _LENGTH * width))


def show_overlapping(ax: Axes, lines: Sequence[Line2D]) -> list[Line2D]:
    """Redraw hidden pieces of curves as dashes over the covering curves.

    Args:
        ax: axes with their final limits.
        lines: curves over the same span of time, in drawing order.

    Returns:
        The dashed lines.
    """
    times = np.asarray(lines[0].get_xdata(), dtype=np.float64)
    values = np.stack([_values(line, times) for line in lines])
    low, high = ax.get_ylim()
    within, shortest = _WIDTH * (high - low), _SHORTEST * float(np.ptp(times))
    dashed: list[Line2D] = []
    for index, line in enumerate(lines):
        near = np.abs(values - values[index]) <= within
        under = np.concatenate([[False], near[index + 1 :].any(axis=0), [False]])
        for first, end in np.flatnonzero(np.diff(under)).reshape(-1, 2):
            if times[end - 1] - times[first] < shortest:
                continue
            bundle = np.flatnonzero(near[:, first:end].mean(axis=1) > 0.5)
            count, turn = max(2, len(bundle)), int(np.sum(bundle < index))
            dashes = ((count - turn) % count * _DASH, (_DASH, (count - 1) * _DASH))
            (piece,) = ax.plot(times[first:end], values[index, first:end], linestyle=dashes)
            piece.set(color=line.get_color(), linewidth=line.get_linewidth())
            piece.set_zorder(line.get_zorder() + 0.1)
            dashed.append(piece)
    return dashed


def _values(line: Line2D, times: FloatArray) -> FloatArray:
    """Return the curve's values at `times`; its own values, jumps included, if times coincide."""
    own, values = (np.asarray(each, dtype=np.float64) for each in line.get_data())
    return values if np.array_equal(own, times) else np.interp(times, own, values)
