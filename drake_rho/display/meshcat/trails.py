"""Objects that appear in Meshcat during the flight: trails, and predictions of its windows.

Meshcat records only poses and properties, so each piece is a separate object that becomes visible
at its time.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from drake_rho.display.common.drawable import Drawn, Prediction
from drake_rho.display.common.map_faces import has_map
from drake_rho.display.common.names import as_path
from drake_rho.display.common.style import (
    CONTINGENCY,
    MEASURED,
    before_jumps,
    palette,
    window_greys,
)
from drake_rho.display.meshcat.meshes import tube
from drake_rho.display.meshcat.scene import Scene, coloured
from drake_rho.display.meshcat.tree import Tree, rgba
from drake_rho.scenario.fields import FloatArray, IntArray

_MAX_PIECES, _MAX_PIECES_IN_MAPS = 1200, 600
"""Largest number of pieces of trail in a scene, and in a scene with a map, whose page is large."""
_PER_STEP = 4
"""Straight segments of a curve in each step."""
_MAX_SEGMENTS_IN_MAPS = 7000
"""Largest number of segments of all trails in a scene with a map, but at least one per step."""


def add_trails(tree: Tree, scene: Scene, plan: Drawn) -> None:
    """Add trails as tubes of a few steps each, visible once flown."""
    per_step, steps = _PER_STEP, len(plan.positions) * (plan.scenario.grid.knots - 1)
    if has_map(plan.scenario):
        per_step = int(np.clip(_MAX_SEGMENTS_IN_MAPS // steps, 1, _PER_STEP))
    for first, last in _pieces(plan, len(plan.positions)):
        paths = _paths(plan, first, last, per_step)
        for (vehicle, colour), path in zip(coloured(plan.scenario), paths, strict=True):
            name = f"trails/{as_path(vehicle.name)}/{first}"
            tree.add_mesh(name, tube(path, scene.trail_radius), colour)
            tree.show_between(name, _middle(plan, first, last))


def add_measured(tree: Tree, plan: Drawn) -> None:
    """Add lines through consecutive measured positions, which grow as trails do."""
    if (samples := plan.measured) is None:
        return
    elapsed, path = plan.scenario.grid.elapsed, samples.positions
    for first, last in _pieces(plan, len(path)):
        here = np.flatnonzero(
            (samples.elapsed >= elapsed[first]) & (samples.elapsed < elapsed[last])
        )
        here = here[here < len(samples.elapsed) - 1]
        for i, vehicle in enumerate(plan.scenario.vehicles):
            both = here[samples.seen[i, here] & samples.seen[i, here + 1]]
            if len(both) > 0:
                name = f"measured/{as_path(vehicle.name)}/{first}"
                tree.add_lines(name, [path[i, m : m + 2] for m in both], rgba(MEASURED))
                tree.show_between(name, _middle(plan, first, last))


def add_light_trails(tree: Tree, plan: Drawn) -> None:
    """Add trails as lines, one object per colour, so that large fleets need few objects."""
    colours = palette(len(plan.positions))
    for first, last in _pieces(plan, len(colours)):
        paths = _paths(plan, first, last, 1)
        for number, colour in enumerate(colours, start=1):
            name = f"trails/{number}/{first}"
            tree.add_lines(name, paths[number - 1 :: len(colours)], rgba(colour))
            tree.show_between(name, _middle(plan, first, last))


def add_predictions(tree: Tree, windows: Sequence[Prediction]) -> None:
    """Add each window's prediction and contingency as lines, visible while it is in force."""
    colours = window_greys(len(windows))
    for number, (window, colour) in enumerate(zip(windows, colours, strict=True), start=1):
        predicted, contingency = f"predictions/{number}", f"contingencies/{number}"
        tree.add_lines(predicted, _whole_paths(window.shown), rgba(colour))
        if window.braking is not None:
            tree.add_lines(contingency, _whole_paths(window.braking), rgba(CONTINGENCY))
    show_in_force(tree, "predictions", windows)
    if any(window.braking is not None for window in windows):
        show_in_force(tree, "contingencies", windows)


def show_in_force(tree: Tree, path: str, windows: Sequence[Prediction]) -> None:
    """Show the object at `path`/<number> only while that window, counted from 1, is in force."""
    begins = [*(window.begin for window in windows), np.inf]
    for number, (begin, end) in enumerate(pairwise(begins), start=1):
        tree.show_between(f"{path}/{number}", begin, end)


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


def _whole_paths(plan: Drawn) -> FloatArray:
    """Return points along all vehicles' whole paths [m], shape (N, M, 3)."""
    return _paths(plan, 0, plan.scenario.grid.knots - 1, _PER_STEP)


def _middle(plan: Drawn, first: int, last: int) -> float:
    """Return the time midway between two knots, since the first knot [s]."""
    elapsed = plan.scenario.grid.elapsed
    return float(elapsed[first] + elapsed[last]) / 2
