"""Parts of paths hidden by obstacles, and the choice between views from the side and above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.display.common.obstacle_snapshots import Snapshot
from drake_rho.display.common.style import view
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.shapes.base import Solid

_MOST_HIDDEN = 0.4
"""Largest part of the flights that maps may hide before the view is from above."""
_SAMPLES = 400
"""Number of positions for estimating that part."""
_CLOSE = 1e-3
"""Distance at which a line of sight counts as meeting an obstacle, over its size."""
_STEPS = 64
"""Largest number of steps along a line of sight."""


def hidden(points: FloatArray, shown: Sequence[Snapshot]) -> BoolArray:
    """Return flags of positions (M, 3) behind obstacles, from the common viewpoint.

    Secondary snapshots, and slices of maps, which are seen from above, hide nothing.
    """
    behind = np.zeros(len(points), dtype=np.bool_)
    for each in shown:
        if each.between is None and not each.faint:
            behind |= _hides(each.shape, points - each.center)
    return behind


def best_from_above(points: FloatArray, shown: Sequence[Snapshot]) -> bool:
    """Return whether maps would hide too many of the flights' positions (M, 3) from the side."""
    maps = [each for each in shown if isinstance(each.shape, Map)]
    some = points[:: max(1, len(points) // _SAMPLES)]
    return bool(hidden(some, maps).mean() > _MOST_HIDDEN)


def _hides(solid: Solid, x: FloatArray) -> BoolArray:
    """Return flags of positions (M, 3) hidden by an obstacle at the origin, by sphere tracing.

    Each position repeatedly moves towards the viewer by its distance from the obstacle, until it
    meets the obstacle or is beyond it.
    """
    close, to_viewer = _CLOSE * solid.size, view()[2]
    x, met, active = x + 2.0 * close * to_viewer, np.zeros(len(x), np.bool_), np.arange(len(x))
    for _ in range(_STEPS):
        distances = solid.local_distance(x[active])
        met[active] = distances < close
        x[active] += np.maximum(distances, close)[:, None] * to_viewer
        beyond = np.any(x[active] * np.sign(to_viewer) > solid.extent, axis=1)
        active = active[~(met[active] | beyond)]
    return met
