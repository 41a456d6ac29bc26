"""Requirements of positions in Meshcat: links as lines that redden, sets as faint shapes.

In the scene tree, /flight/links/<number>/<name> is the line between a vehicle and its partner in
requirement <number>, another vehicle or a moving point. Meshcat records only poses, scales and
visibility, so its children are lines in several colours, one of them visible at a time.
/flight/points/<number> is the moving point, /flight/sets/<number> the set of a requirement of
single vehicles. All of them are visible only while the requirement is active.
"""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_path
from drake_rho.display.common.requirements import Kept, kept_positions
from drake_rho.display.common.set_surfaces import surface_within
from drake_rho.display.common.style import ALLOWED, reddened
from drake_rho.display.meshcat.meshes import octahedron, tube
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.poses import headings, poses, record_poses
from drake_rho.display.meshcat.scene import ROOT, Scene
from drake_rho.display.meshcat.shape_objects import put_faces
from drake_rho.display.meshcat.trails import segments, show_between
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

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
_FACES, _EDGES = Rgba(*to_rgb(ALLOWED), 0.1), Rgba(*to_rgb(ALLOWED))
_POINT = Rgba(0.15, 0.15, 0.18)


def add_requirements(meshcat: Meshcat, scene: Scene, plan: Drawn) -> None:
    """Add the sets of single vehicles, and marks of moving points."""
    for kept in kept_positions(plan.scenario):
        if kept.requirement.track is not None:
            mark = octahedron(0.5 * scene.seen)
            meshcat.SetTriangleMesh(f"{ROOT}/points/{kept.number}", *mark, rgba=_POINT)
        if kept.is_link:
            continue
        path = f"{ROOT}/sets/{kept.number}"
        skin = surface_within(kept.requirement.set, scene.lower, scene.upper)
        if skin.faces:
            put_faces(skin.faces, meshcat, f"{path}/faces", _FACES)
            meshcat.SetProperty(f"{path}/faces/<object>", "material.depthWrite", False)
        if skin.edges:
            meshcat.SetLineSegments(f"{path}/edges", *segments(skin.edges), rgba=_EDGES)


def record_requirements(meshcat: Meshcat, scene: Scene, plan: Drawn, playback: Playback) -> None:
    """Record lines and moving points, and the times at which each requirement is active."""
    times = playback.times
    for kept in kept_positions(plan.scenario):
        first, last = shown_interval(kept, plan, playback)
        begin, end = playback.time_at(first), playback.time_at(last)
        if not kept.is_link:
            if kept.requirement.active is not None:
                show_between(meshcat, f"{ROOT}/sets/{kept.number}", begin, end)
            continue
        others = kept.origins(plan, times)
        if kept.requirement.track is not None:
            still = np.broadcast_to(np.eye(3), (len(times), 3, 3))
            path = f"{ROOT}/points/{kept.number}"
            values = np.concatenate([still, others[..., None]], axis=2)
            record_poses(meshcat, path, values, playback)
            show_between(meshcat, path, begin, end)
        positions = plan.motion().at("position", times)[kept.members]
        colours = colours_of(left_while_shown(kept, plan, times, playback), kept.plenty(plan))
        for member, place, own in zip(kept.members, positions, colours, strict=True):
            name = as_path(plan.scenario.names[member])
            path = f"{ROOT}/links/{kept.number}/{name}"
            _record_line(meshcat, scene, path, (others, place), playback)
            _record_colours(meshcat, scene, path, own, playback)


def shown_interval(kept: Kept, plan: Drawn, playback: Playback) -> tuple[float, float]:
    """Return the first and last time since the first knot at which a requirement is shown [s].

    An interval too short to be seen is widened.
    """
    first, last = (time - plan.scenario.grid.start for time in kept.interval)
    more = max(0.0, _LEAST_SHOWN * playback.rate - (last - first)) / 2.0
    return max(0.0, first - more), min(plan.scenario.grid.duration, last + more)


def left_while_shown(kept: Kept, plan: Drawn, times: FloatArray, playback: Playback) -> FloatArray:
    """Return margins at times since the first knot [m], infinite while not shown, (M, T).

    Where an interval was widened to be seen, it is the margin at the interval's end.
    """
    start, (first, last) = plan.scenario.grid.start, shown_interval(kept, plan, playback)
    shown = (times >= first) & ((times < last) | (last >= plan.scenario.grid.duration))
    begin, end = (time - start for time in kept.interval)
    return np.where(shown, kept.left(plan, np.clip(times, begin, end)), np.inf)


def colours_of(left: FloatArray, plenty: float) -> IntArray:
    """Return colours from 0, red, without a margin, to `COLOURS - 1`, grey; -1 if not shown.

    Args:
        left: margins [m], infinite while not shown.
        plenty: margin from which on the colour is grey [m].
    """
    colours = np.ceil(np.clip(left / plenty, 0.0, 1.0) * (COLOURS - 1)).astype(np.int64)
    return np.where(np.isfinite(left), colours, -1)


def _record_line(
    meshcat: Meshcat,
    scene: Scene,
    path: str,
    ends: tuple[FloatArray, FloatArray],
    playback: Playback,
) -> None:
    """Record the pose and the length of a line between two moving ends, (T, 3) each."""
    along = ends[1] - ends[0]
    record_poses(meshcat, path, poses(ends[0][None], headings(along[None]))[0], playback)
    lengths = np.maximum(np.linalg.norm(along, axis=1), _MIN_LENGTH * scene.size)
    meshcat.SetProperty(path, "scale", [lengths[0], 1.0, 1.0])
    for time, length in zip(playback.times, lengths, strict=True):
        meshcat.SetProperty(path, "scale", [length, 1.0, 1.0], playback.time_at(time))


def _record_colours(
    meshcat: Meshcat, scene: Scene, path: str, colours: IntArray, playback: Playback
) -> None:
    """Add a line of length 1 in each colour that occurs, visible while it applies."""
    unit = tube(np.array([[0.0, 0, 0], [1, 0, 0]]), _THICK * scene.trail_radius, _SIDES)
    for colour in np.unique(colours[colours >= 0]):
        rgba = Rgba(*to_rgb(reddened(colour / (COLOURS - 1))))
        name = f"{path}/{colour}"
        meshcat.SetTriangleMesh(name, *unit, rgba=rgba)
        shown: BoolArray = colours == colour
        for m in (0, *(np.flatnonzero(np.diff(shown)) + 1)):
            time = playback.time_at(playback.times[m])
            meshcat.SetProperty(name, "visible", bool(shown[m]), time)
