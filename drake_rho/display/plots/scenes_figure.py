"""Figure of a show's formations, one panel each, with the lights' colours."""

from __future__ import annotations

from math import ceil

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.names import as_text
from drake_rho.display.common.scenes import scenes_of
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_width
from drake_rho.display.plots.publish import styled
from drake_rho.motion.flown import Flown
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.parts import Waypoint

_COLUMNS = 3
"""Largest number of panels side by side."""
_SKY, _UNLIT = "#10141c", "#3c4454"
"""Colours of the background and of vehicles whose lights are off."""
_VIEW = 14.0, -78.0
"""Elevation and azimuth of the eye, nearly in front of upright formations [deg]."""
_MARKER = 110.0
"""Area of a marker on a panel one inch wide with one vehicle [points²]; that of N is smaller."""


@checked
@styled
def scenes_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot every formation of a show, with the colours of the lights, its name and its time.

    Each panel has its own scale, and is seen from negative y, as upright formations are.

    Args:
        flown: plan of a show, or flight or simulation of one, drawn where it was planned.
        width: width of the figure [in].

    Raises:
        ValueError: the flight has no scenes, or the text would be illegible at the width.
    """
    check_width(width)
    scenes = scenes_of(flown.scenario)
    if not scenes:
        raise ValueError("flown: got a flight without scenes, expected that of a show")
    columns = min(_COLUMNS, len(scenes))
    rows = ceil(len(scenes) / columns)
    side = width / columns
    figure = Figure(figsize=(width, rows * side), facecolor=_SKY)
    places = np.array([[stop.position for stop in scene] for scene in scenes])
    for number, (scene, positions) in enumerate(zip(scenes, places, strict=True), start=1):
        ax: Axes3D = figure.add_subplot(rows, columns, number, projection="3d", facecolor=_SKY)
        _draw(ax, scene, positions, _MARKER * side / len(scene) ** 0.7)
    figure.subplots_adjust(0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
    return figure


def _draw(ax: Axes3D, scene: tuple[Waypoint, ...], positions: np.ndarray, size: float) -> None:
    """Draw the vehicles of one scene as lights, without axes."""
    off = {None, "#000000"}
    colours = [_UNLIT if stop.colour in off else stop.colour for stop in scene]
    ax.scatter(*positions.T, c=colours, s=size, linewidths=0.0, depthshade=False)
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
    half = float(np.ptp(positions, axis=0).max()) / 2.0 or 1.0
    ax.set(**{f"{axis}lim": (m - half, m + half) for axis, m in zip("xyz", middle, strict=True)})
    ax.view_init(*_VIEW)
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=1.22)
    ax.set_axis_off()
    words = f"{as_text(scene[0].name or '')}, {scene[0].time:g} s"
    ax.text2D(0.5, 0.96, words, transform=ax.transAxes, color="white", ha="center", va="top")
