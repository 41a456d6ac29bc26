"""Lines in space, faint where obstacles hide them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.hidden import hidden
from drake_rho.display.common.obstacle_snapshots import Snapshot
from drake_rho.scenario.fields import FloatArray

FAINT = 0.4
"""Opacity of lines behind an obstacle, relative to lines in front of it."""


def draw_line(
    ax: Axes3D, points: FloatArray, shown: Sequence[Snapshot], **style: Any
) -> list[Line3D]:
    """Draw a line, or marks, with the parts behind obstacles faint.

    The first returned line is the visible one, which legends show.
    """
    behind = hidden(points, shown)
    before = ~behind
    before[1:] |= before[:-1]  # a line continues to the first hidden point
    faint = {"alpha": FAINT * style.get("alpha", 1.0)}
    parts = [(before, style), (behind, style | faint)]
    return [
        ax.plot(*np.where(here[:, None], points, np.nan).T, **own)[0]
        for here, own in parts
        if here.any()
    ]
