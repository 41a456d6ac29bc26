"""Warning about maps that are probably in another unit than the flight."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.errors import MapScaleWarning
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.obstacles import Obstacle

_RATIO = 1000.0
"""Ratio of sizes from which on a unit is probably wrong: millimetres and metres differ as much."""


def warn_of_scales(fleet: Fleet, obstacles: Sequence[Obstacle]) -> None:
    """Warn of maps that are far larger or smaller than the flight.

    The size of a flight is the longest side of its position box; where there is none, that of the
    box around all starts and goals.
    """
    maps = [
        (number, each) for number, each in enumerate(obstacles, 1) if isinstance(each.shape, Map)
    ]
    if not maps:
        return
    bounds = fleet.bounds("position")
    box = np.inf if bounds is None else float((bounds.upper - bounds.lower).max())
    ends = np.concatenate([fleet.start_positions, fleet.goal_positions])
    span, of = float(np.ptp(ends, axis=0).max()), "starts and goals that span"
    if np.isfinite(box):
        span, of = box, "a position box of"
    for number, each in maps:
        size = 2.0 * float(each.shape.extent.max())
        if span > 0.0 and not span / _RATIO < size < span * _RATIO:
            text = f"{each.called(number)}: a map of {size:.3g} m beside {of} {span:.3g} m"
            warnings.warn(MapScaleWarning(f"{text}; is its unit the metre?"), stacklevel=2)
