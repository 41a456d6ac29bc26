"""Requirements of positions in Meshcat: links as lines that redden, sets as faint shapes.

In the scene tree, /flight/links/<number>/<name> is the line between a vehicle and its partner in
requirement <number>, another vehicle or a moving point. Meshcat records only poses, scales and
visibility, so its children are lines in several colours, one of them visible at a time.
/flight/points/<number> is the moving point, /flight/sets/<number> the set of a requirement of
single vehicles. All of them are visible only while the requirement is active.
"""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Rgba

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_path
from drake_rho.display.common.requirements import RequiredPositions, required_positions
from drake_rho.display.common.set_surfaces import surface_within
from drake_rho.display.common.style import ALLOWED, reddened
from drake_rho.display.meshcat.meshes import octahedron, tube
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.poses import headings, poses, unturned
from drake_rho.display.meshcat.scene import Scene
from drake_rho.display.meshcat.shape_objects import put_faces
from drake_rho.display.meshcat.tree import Tree, rgba
from drake_rho.scenario.fields import FloatArray, IntArray

COLOURS = 8
"""Number of colours of a line, from red to grey."""
_LEAST_SHOWN = 1.0
"""Least time for which a requirement is shown, however short its interval [s of playback]."""
_THICK = 1.4
"""Radius of a line over that of a trail."""
_SIDES = 6
"""Number of sides of a line."""
_MIN_LENGTH = 1e-6
"""Least length of a line over the size of the scene; Meshcat cannot show a length of zero."""
_FACES, _EDGES = rgba(ALLOWED, 0.1), rgba(ALLOWED)
_POINT = Rgba(0.15, 0.15, 0.18)


def add_requirements(tree: Tree, scene: Scene, plan: Drawn) -> None:
    """Add sets, moving points and links, and record when each requirement is active."""
    for required in required_positions(plan.scenario):
        if required.is_link:
            _add_links(tree, scene, plan, required)
        else:
            _add_set(tree, scene, plan, required)


def _add_set(tree: Tree, scene: Scene, plan: Drawn, required: RequiredPositions) -> None:
    """Add a set of single vehicles."""
    path, skin = f"sets/{required.number}", surface_within(required.requirement.set, *scene.bounds)
    if skin.faces:
        put_faces(skin.faces, tree, f"{path}/faces", _FACES)
        tree.set_see_through(f"{path}/faces")
    if skin.edges:
        tree.add_lines(f"{path}/edges", skin.edges, _EDGES)
    if required.requirement.active is not None:
        tree.show_between(path, *shown_interval(required, plan, tree.playback))


def _add_links(tree: Tree, scene: Scene, plan: Drawn, required: RequiredPositions) -> None:
    """Add the moving point of a requirement, if it has one, and the lines to its vehicles."""
    times = tree.playback.times
    others = required.origins(plan, times)
    if required.partner is None:
        path = f"points/{required.number}"
        tree.add_mesh(path, octahedron(0.5 * scene.seen), _POINT)
        tree.move(path, unturned(others))
        tree.show_between(path, *shown_interval(required, plan, tree.playback))
    positions = plan.motion().at("position", times)[required.members]
    colours = colours_of(
        margins_while_shown(required, plan, times, tree.playback), required.plenty(plan)
    )
    for member, place, own in zip(required.members, positions, colours, strict=True):
        path = f"links/{required.number}/{as_path(plan.scenario.names[member])}"
        along = place - others
        tree.move(path, poses(others[None], headings(along[None]))[0])
        lengths = np.maximum(np.linalg.norm(along, axis=1), _MIN_LENGTH * scene.size)
        tree.scale(path, np.stack([lengths, np.ones_like(lengths), np.ones_like(lengths)], axis=1))
        _add_colours(tree, scene, path, own)


def shown_interval(
    required: RequiredPositions, plan: Drawn, playback: Playback
) -> tuple[float, float]:
    """Return the first and last time since the first knot at which a requirement is shown [s].

    An interval too short to be seen is widened.
    """
    first, last = (time - plan.scenario.grid.start for time in required.interval)
    more = max(0.0, _LEAST_SHOWN * playback.rate - (last - first)) / 2.0
    return max(0.0, first - more), min(plan.scenario.grid.duration, last + more)


def margins_while_shown(
    required: RequiredPositions, plan: Drawn, times: FloatArray, playback: Playback
) -> FloatArray:
    """Return margins at times since the first knot [m], infinite while not shown, (M, T).

    Where an interval was widened to be seen, it is the margin at the interval's end.
    """
    start, (first, last) = plan.scenario.grid.start, shown_interval(required, plan, playback)
    shown = (times >= first) & ((times < last) | (last >= plan.scenario.grid.duration))
    begin, end = (time - start for time in required.interval)
    return np.where(shown, required.margins(plan, np.clip(times, begin, end)), np.inf)


def colours_of(margins: FloatArray, plenty: float) -> IntArray:
    """Return colours from 0, red, without a margin, to `COLOURS - 1`, grey; -1 if not shown.

    Args:
        margins: margins [m], infinite while not shown.
        plenty: margin from which on the colour is grey [m].
    """
    colours = np.ceil(np.clip(margins / plenty, 0.0, 1.0) * (COLOURS - 1)).astype(np.int64)
    return np.where(np.isfinite(margins), colours, -1)


def _add_colours(tree: Tree, scene: Scene, path: str, colours: IntArray) -> None:
    """Add a line of length 1 in each colour that occurs, visible while it applies."""
    unit = tube(np.array([[0.0, 0, 0], [1, 0, 0]]), _THICK * scene.trail_radius, _SIDES)
    for colour in np.unique(colours[colours >= 0]):
        tree.add_mesh(f"{path}/{colour}", unit, rgba(reddened(colour / (COLOURS - 1))))
        tree.show_while(f"{path}/{colour}", colours == colour)
