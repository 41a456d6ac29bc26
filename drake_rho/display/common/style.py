"""Common style of all drawings: colours, markers, viewpoint, sampling times."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex, to_rgb

from drake_rho.display.common.drawable import Drawn
from drake_rho.scenario.fields import FloatArray

# The first six are Okabe and Ito's, which colour-blind readers can distinguish, without their
# yellow (too pale on white) and black (reserved for limits). Each further colour is the one
# farthest from its predecessors in the perceptual space OKLab, with more weight on those that have
# the same marker.
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
"""Colour of regions that vehicles must not enter."""
ALLOWED = "#2E8B57"
"""Colour of sets in which vehicles must stay."""
LOWEST, HIGHEST = "#3D4B60", "#DCCFB4"
"""Colours of the lowest and the highest parts of a map, distinct from all vehicles'. Heights in
between are interpolated in RGB, so that a long wall needs colours at its two ends only."""
PLENTY_LEFT, NOTHING_LEFT = "#9AA0AA", "#FF2020"
"""Colours of a link with a large margin, and of a link without a margin."""
CONFLICT = "#D00000"
"""Colour of conflicts in an infeasible scenario."""
CONTINGENCY = "#B3541E"
"""Colour of contingencies, which brake to rest."""
LIMIT_STYLE: dict[str, Any] = {"color": "black", "linestyle": "--", "linewidth": 0.8}
PLANNED_STYLE: dict[str, Any] = {"linestyle": ":", "linewidth": 1.0, "alpha": 0.8}
"""Style of planned motions beside the true motion."""
MEASURED = "#202020"
"""Colour of measured samples beside the planned motion."""
MEASURED_STYLE: dict[str, Any] = {
    **{"color": MEASURED, "linewidth": 0.5, "marker": ".", "markersize": 2.5},
    **{"markeredgewidth": 0.0, "zorder": 2.6},
}
"""Style of measured samples."""
EXTREMUM_STYLE: dict[str, Any] = {
    **{"color": "black", "marker": "o", "markersize": 6.0, "fillstyle": "none"},
    **{"linestyle": "none", "zorder": 3.0, "clip_on": False},
}
"""Style of the ring around the overall minimum or maximum."""
VIEW_ELEVATION, VIEW_AZIMUTH = 22.0, -58.0
"""Viewpoint of a scene: angle above the horizon and around the vertical axis [deg]."""
STEEP_ELEVATION = 62.0
"""Elevation of the viewpoint of an animated scene in which maps would hide the flights."""
_JUST = 1e-6
"""Time before a jump at which a motion is drawn, over a step: larger than rounding errors."""
PER_STEP = 12
"""Least number of points at which the exact motion is drawn in each step."""
MAX_NAMED = len(COLOURS)
"""Largest number of vehicles drawn individually: named in a legend, with their own colours and
marked knots. More are drawn as a swarm, of lines only."""


def palette(count: int) -> tuple[str, ...]:
    """Return the colours for a number of vehicles: one each, or six to be repeated in a swarm."""
    return COLOURS[: count if count <= MAX_NAMED else len(MARKERS)]


def vehicle_colours(count: int) -> list[str]:
    """Return a colour for each vehicle; in a swarm, six colours repeat."""
    colours = palette(count)
    return [colours[index % len(colours)] for index in range(count)]


def vehicle_marker(index: int) -> str:
    """Return a vehicle's marker; up to `MAX_NAMED` vehicles, marker and colour are unique."""
    return MARKERS[index % len(MARKERS)]


def window_colours(count: int) -> list[str]:
    """Return a colour for each receding-horizon window, from dark to light in equal steps."""
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.9, count))]


def window_greys(count: int) -> list[str]:
    """Return a grey for each window, from dark to light, beside vehicles in colours."""
    return [to_hex(colour) for colour in colormaps["gray"](np.linspace(0.0, 0.75, count))]


def reddened(part: float) -> str:
    """Return the colour of a link, from grey at 1, for a large margin, to red at 0."""
    return to_hex(tuple(_between(NOTHING_LEFT, PLENTY_LEFT, np.array(part))))


def height_colours(heights: FloatArray, lowest: float, highest: float) -> FloatArray:
    """Return colours of heights [m], shape (..., 3), the middle one where all heights are equal."""
    flat = highest <= lowest
    parts = np.full(heights.shape, 0.5) if flat else (heights - lowest) / (highest - lowest)
    return _between(LOWEST, HIGHEST, parts)


def _between(first: str, last: str, parts: FloatArray) -> FloatArray:
    """Return colours between the first, at 0, and the last, at 1, interpolated in RGB, (..., 3)."""
    low, high = (np.array(to_rgb(each)) for each in (first, last))
    colours: FloatArray = low + np.clip(parts, 0.0, 1.0)[..., None] * (high - low)
    return colours


def view(
    elevation: float = VIEW_ELEVATION, azimuth: float = VIEW_AZIMUTH
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors to the right and up on the screen, and from the scene to the viewer.

    Args:
        elevation: angle of the viewpoint above the horizon [deg].
        azimuth: angle around the vertical axis [deg].
    """
    azimuth, elevation = np.radians(azimuth), np.radians(elevation)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    to_viewer = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    return right, np.cross(to_viewer, right), to_viewer


def dense_times(plan: Drawn) -> FloatArray:
    """Return the times since the first knot at which the motion is drawn, knots included [s].

    One time is just before each jump.
    """
    grid = plan.scenario.grid
    per_step = max(PER_STEP, round(grid.step / plan.motion().step))
    times = np.linspace(0.0, grid.duration, per_step * (grid.knots - 1) + 1)
    return times if not plan.jumps else np.union1d(times, before_jumps(plan))


def before_jumps(plan: Drawn) -> FloatArray:
    """Return times just before the jumps of a motion, since its first knot [s], (S,)."""
    grid = plan.scenario.grid
    return np.asarray(grid.elapsed[[*plan.jumps]] - _JUST * grid.step)


def in_pieces(plan: Drawn, times: FloatArray) -> list[slice]:
    """Return slices of increasing times since the first knot, (M,), one for each piece of motion.

    A piece begins where the motion jumps.
    """
    if not plan.jumps:
        return [slice(0, len(times))]
    ends = np.searchsorted(times, before_jumps(plan), side="right")
    cuts = np.unique([0, *ends.tolist(), len(times)]).tolist()
    return [slice(first, last) for first, last in pairwise(cuts)]


def with_gaps(plan: Drawn, times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times since the first knot, (M,), and values, (..., M), with NaN at jumps.

    Lines through them have gaps there.
    """
    begins = [each.start for each in in_pieces(plan, times)[1:]]
    if not begins:
        return times, values
    return np.insert(times, begins, times[begins]), np.insert(values, begins, np.nan, axis=-1)
