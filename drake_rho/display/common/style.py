"""What drawings have in common: colours, markers, where a scene is seen from, instants."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from drake_rho.display.common.drawable import Drawn
from drake_rho.scenario.fields import FloatArray

# The first six are Okabe and Ito's, which the colour-blind can tell apart, without their yellow
# (too pale on white) and black (kept for limits). Each of the others was put where it is farthest
# from those before it, as OKLab measures what is seen, most of all from those of its marker.
COLOURS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"),
    *("#66E085", "#8F00FF", "#700066", "#005200", "#0000C2", "#7A5247"),
    *("#EB00F5", "#D6ADFF", "#667AFF", "#B80000", "#B81F8F", "#FF2966"),
    *("#857A14", "#333D85", "#FF8570", "#85AD00", "#005C66", "#473DE0"),
    *("#6600AD", "#8FAD8F", "#7AD6D6", "#7A478F", "#7A85B8", "#AD52D6"),
    *("#523347", "#00EB00", "#FF52CC", "#477A66", "#851F33", "#D6ADA3"),
)
MARKERS = ("o", "s", "^", "D", "v", "P")
FORBIDDEN = "#888888"
"""Colour of where no vehicle may be."""
LIMIT_STYLE: dict[str, Any] = {"color": "black", "linestyle": "--", "linewidth": 0.8}
PLANNED_STYLE: dict[str, Any] = {"linestyle": ":", "linewidth": 1.0, "alpha": 0.8}
"""Of what was planned, beside the true motion."""
EXTREMUM_STYLE: dict[str, Any] = {
    **{"color": "black", "marker": "o", "markersize": 6.0, "fillstyle": "none"},
    **{"linestyle": "none", "zorder": 3.0, "clip_on": False},
}
"""Of the ring around the least, or greatest, of all."""
VIEW_ELEVATION, VIEW_AZIMUTH = 22.0, -58.0
"""Where a scene is seen from, above the horizon and around the vertical axis [deg]."""
PER_STEP = 12
"""Fewest points drawn of the exact motion in each step."""
MAX_NAMED = len(COLOURS)
"""Most vehicles that are told apart: named in a legend, with colours of their own and marked
knots. More are drawn as a swarm, in which nothing but lines can be seen."""


def palette(count: int) -> tuple[str, ...]:
    """The colours of so many vehicles: one for each, or six in turn if they are a swarm."""
    return COLOURS[: count if count <= MAX_NAMED else len(MARKERS)]


def vehicle_colours(count: int) -> list[str]:
    """A colour for each vehicle; in a swarm, from the first again after six."""
    colours = palette(count)
    return [colours[index % len(colours)] for index in range(count)]


def vehicle_marker(index: int) -> str:
    """The marker of a vehicle; with its colour, no other vehicle's up to `MAX_NAMED`."""
    return MARKERS[index % len(MARKERS)]


def window_colours(count: int) -> list[str]:
    """A colour for each window of a receding horizon, in their order from dark to light."""
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.95, count))]


def view() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors: to the right and up on the screen, and from the scene to the viewer."""
    azimuth, elevation = np.radians(VIEW_AZIMUTH), np.radians(VIEW_ELEVATION)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    return right, np.cross(towards, right), towards


def dense_times(plan: Drawn) -> FloatArray:
    """Times since the first knot at which the exact motion is drawn, the knots among them [s]."""
    grid = plan.scenario.grid
    per_step = max(PER_STEP, round(grid.step / plan.motion().step))
    return np.linspace(0.0, grid.duration, per_step * (grid.knots - 1) + 1)
