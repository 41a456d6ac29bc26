"""What maps hide in pictures from the side, and whether these are better taken from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.display.common.obstacle_snapshots import Snapshot
from drake_rho.scenario.fields import BoolArray, FloatArray

_MOST_HIDDEN = 0.4
"""Largest part of the flights that maps may hide; if they hide more, the view is from above."""


def hidden(points: FloatArray, shown: Sequence[Snapshot]) -> BoolArray:
    """Return which positions (M, 3) are behind maps, from the viewpoint of all pictures.

    Slices of maps, which are seen from above, hide nothing.
    """
    behind = np.zeros(len(points), dtype=np.bool_)
    for each in shown:
        if each.faces is not None and each.between is None and not each.faint:
            behind |= each.faces.occlusion.hides(points - each.center)
    return behind


def best_from_above(points: FloatArray, shown: Sequence[Snapshot]) -> bool:
    """Return whether maps would hide so many of the flights' positions (M, 3) from the side."""
    return bool(hidden(points, shown).mean() > _MOST_HIDDEN)
