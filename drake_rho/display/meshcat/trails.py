"""Objects that appear in Meshcat during the flight: trails, and predictions of its windows.

Meshcat records only poses and properties, so each piece is a separate object that becomes visible
at its time.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba

from drake_rho.display.common.drawable import Drawn, Prediction
from drake_rho.display.common.map_faces import has_map
from drake_rho.display.common.names import as_path
from drake_rho.display.common.style import (
    CONTINGENCY,
    before_jumps,
    palette,
    window_colours,
)
from drake_rho.display.meshcat.meshes import tube
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.scene import ROOT, Scene, coloured
from drake_rho.scenario.fields import FloatArray, IntArray

_MAX_PIECES, _MAX_PIECES_IN_MAPS = 1200, 600
"""Largest number of pieces of trail in a scene, and in a scene with a map, whose page is large."""
_PER_STEP = 4
"""Straight segments of a curve in each step."""
_MAX_SEGMENTS_IN_MAPS = 7000
"""Largest number of segments of all trails in a scene with a map, but at least one per step."""


def record_trails(meshcat: Meshcat, scene: Scene, plan: Drawn, playback: Playback) -> None:
    """Add trails as tubes of a few steps each, visible once flown."""
    per_step, steps = _PER_STEP, len(plan.positions) * (plan.scenario.grid.knots - 1)
    if has_map(plan.scenario):
        per_step = int(np.clip(_MAX_SEGMENTS_IN_MAPS // steps, 1, _PER_STEP))
    for first, last in _pieces(plan, len(plan.positions)):
        for (vehicle, colour), path in zip(
            coloured(plan.scenario), _paths(plan, first, last, per_step), strict=True
        ):
            name = f"{ROOT}/trails/{as_path(vehicle.name)}/{first}"
            meshcat.SetTriangleMesh(name, *tube(path, scene.trail_radius), rgba=colour)
            show_between(meshcat, name, _middle(plan, playback, first, last), None)


def record_light_trails(meshcat: Meshcat, scene: Scene, plan: Drawn, playback: Playback) -> None:
    """Add trails as lines, one object per colour, so that large fleets need few objects."""
    colours = palette(len(plan.positions))
    for first, last in _pieces(plan, len(colours)):
        paths = _paths(plan, first, last, 1)
        for number, colour in enumerate(colours, start=1):
            name = f"{ROOT}/trails/{number}/{first}"
            lines = segments(paths[number - 1 :: len(colours)])
            meshcat.SetLineSegments(name, *lines, rgba=Rgba(*to_rgb(colour)))
            show_between(meshcat, name, _middle(plan, playback, first, last), None)


def record_predictions(meshcat: Meshcat, windows: Sequence[Prediction], playback: Playback) -> None:
    """Add each window's prediction and contingency as lines, visible while it is in force."""
    for number, (window, colour) in enumerate(
        zip(windows, window_colours(len(windows)), strict=True), start=1
    ):
        paths = _paths(window.shown, 0, window.shown.scenario.grid.knots - 1, _PER_STEP)
        name = f"{ROOT}/predictions/{number}"
        meshcat.SetLineSegments(name, *segments(paths), rgba=Rgba(*to_rgb(colour)))
        if (braking := window.braking) is not None:
            paths = _paths(braking, 0, braking.scenario.grid.knots - 1, _PER_STEP)
            name = f"{ROOT}/contingencies/{number}"
            meshcat.SetLineSegments(name, *segments(paths), rgba=Rgba(*to_rgb(CONTINGENCY)))
    record_windows(meshcat, f"{ROOT}/predictions", windows, playback)
    if any(window.braking is not None for window in windows):
        record_windows(meshcat, f"{ROOT}/contingencies", windows, playback)


def record_windows(
    meshcat: Meshcat, path: str, windows: Sequence[Prediction], playback: Playback
) -> None:
    """Show the object at `path`/<number> only while that window, counted from 1, is in force."""
    ends = [*(playback.time_at(window.begin) for window in windows[1:]), None]
    for number, (window, end) in enumerate(zip(windows, ends, strict=False), start=1):
        show_between(meshcat, f"{path}/{number}", playback.time_at(window.begin), end)


def _pieces(plan: Drawn, trails: int) -> list[tuple[int, int]]:
    """Return the first and last knots of a trail's pieces: one step each, or more to limit them.

    A piece ends where the motion jumps, unless there are more jumps than pieces.
    """
    steps = plan.scenario.grid.knots - 1
    pieces = _MAX_PIECES_IN_MAPS if has_map(plan.scenario) else _MAX_PIECES
    count = max(1, min(steps, pieces // trails))
    knots: IntArray = np.unique(np.linspace(0, steps, count + 1).round().astype(int))
    if len(plan.jumps) <= count:
        knots = np.union1d(knots, np.array(plan.jumps, dtype=np.int64))
    return list(pairwise(knots.tolist()))


def _paths(plan: Drawn, first: int, last: int, per_step: int) -> FloatArray:
    """Return points along all vehicles' paths between two knots [m], shape (N, M, 3)."""
    elapsed = plan.scenario.grid.elapsed
    times = np.linspace(elapsed[first], elapsed[last], per_step * (last - first) + 1)
    if last in plan.jumps:
        times[-1] = before_jumps(plan)[plan.jumps.index(last)]
    return plan.motion().at("position", times)


def segments(paths: Sequence[FloatArray] | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the starts and ends of the segments of several polylines [m], each of shape (3, S)."""
    begins = np.concatenate([path[:-1] for path in paths])
    ends = np.concatenate([path[1:] for path in paths])
    return np.asfortranarray(begins.T), np.asfortranarray(ends.T)


def _middle(plan: Drawn, playback: Playback, first: int, last: int) -> float:
    elapsed = plan.scenario.grid.elapsed
    return playback.time_at((elapsed[first] + elapsed[last]) / 2)


def show_between(meshcat: Meshcat, path: str, begin: float, end: float | None) -> None:
    """Record that an object is visible only from `begin` to `end` [s of playback]."""
    if begin > 0.0:
        meshcat.SetProperty(path, "visible", False, 0.0)
    meshcat.SetProperty(path, "visible", True, begin)
    if end is not None:
        meshcat.SetProperty(path, "visible", False, end)
