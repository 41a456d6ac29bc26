"""What drawings have in common: colours, markers, where a scene is seen from, instants."""

from __future__ import annotations

from itertools import cycle, islice
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

# Okabe and Ito's palette, which the colour-blind can tell apart, without its yellow (too pale on
# white) and black (kept for limits).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
FORBIDDEN = "#888888"
"""Colour of where no vehicle may be."""
LIMIT_STYLE: dict[str, Any] = {"color": "black", "linestyle": "--", "linewidth": 0.9}
VIEW_ELEVATION, VIEW_AZIMUTH = 22.0, -58.0
"""Where a scene is seen from, above the horizon and around the vertical axis [deg]."""
PER_STEP = 12
"""Points drawn of the exact motion in each step."""
MOST_NAMED = 14
"""Most vehicles that a legend names and whose knots are marked: among more it would hide them."""


def vehicle_colours(count: int) -> list[str]:
    """A colour for each vehicle, from the first again after six."""
    return list(islice(cycle(COLOURS), count))


def window_colours(count: int) -> list[str]:
    """A colour for each window of a receding horizon, in their order from dark to light."""
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.95, count))]


def vehicle_handles(scenario: Scenario) -> list[Line2D]:
    """Legend entries of the vehicles, as they are drawn; none with more than `MOST_NAMED`."""
    if len(scenario.vehicles) > MOST_NAMED:
        return []
    colours = vehicle_colours(len(scenario.vehicles))
    return [
        Line2D(
            [],
            [],
            color=colours[index],
            marker=MARKERS[index % len(MARKERS)],
            markersize=4,
            linewidth=1.2,
            label=vehicle.name,
        )
        for index, vehicle in enumerate(scenario.vehicles)
    ]


def dense_times(plan: Plan) -> FloatArray:
    """Times at which the exact motion is drawn, the knots among them [s]."""
    grid = plan.scenario.grid
    return np.linspace(0.0, grid.duration, PER_STEP * (grid.knots - 1) + 1)
