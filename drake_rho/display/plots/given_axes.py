"""Axes given by the user, instead of those of a new figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D

_INTERVALS = 4
"""Largest number of tick intervals of an axis of given three-dimensional axes."""


def given_axes(ax: Axes | Sequence[Axes], count: int) -> list[Axes]:
    """Return given axes as a list.

    Args:
        ax: one axes, or several in any nesting, such as the array that `plt.subplots` returns.
        count: number of axes that the figure draws in.

    Raises:
        ValueError: their number is wrong, or one is three-dimensional or not an axes.
    """
    found = list(np.ravel(np.array(ax, dtype=object)))
    if len(found) != count:
        expected = "one" if count == 1 else f"{count}, one for each panel, as of plt.subplots"
        raise ValueError(f"ax: got {len(found)} axes, expected {expected}")
    for each in found:
        if not isinstance(each, Axes) or isinstance(each, Axes3D):
            got = "three-dimensional axes" if isinstance(each, Axes3D) else type(each).__name__
            raise ValueError(f"ax: got {got}, expected axes of a plane")
    return found


def given_axes_in_space(ax: Axes) -> Axes3D:
    """Return given three-dimensional axes.

    Raises:
        ValueError: they are not three-dimensional.
    """
    if not isinstance(ax, Axes3D):
        expected = "three-dimensional ones, as of figure.add_subplot(projection='3d')"
        raise ValueError(f"ax: got axes of a plane, expected {expected}")
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):  # matplotlib's ticks overlap on short axes
        axis.set_major_locator(MaxNLocator(_INTERVALS, steps=[1, 2, 5, 10]))
    return ax
