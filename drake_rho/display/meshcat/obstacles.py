"""Obstacles in Meshcat: their motion, and their discovery.

In the scene tree, /flight/obstacles/<number> is the obstacle's pose. Its children are `known`, the
obstacle itself, `unknown`, a fainter copy shown until an obstacle with a later `known_from` becomes
known, and `edges`, if a shape has edges. The uncertainty of an obstacle is shown as `halo/<k>` in
the k-th part of the time in which it grows, as large as at the end of that part. Maps are coloured
by height and have no halo; a map that is not known yet is shown by its bounding box.
"""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.obstacle_snapshots import obstacle_paths, truncated, truncated_centers
from drake_rho.display.common.shape_faces import around, surface
from drake_rho.display.common.style import CONFLICT
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.scene import ROOT, Scene
from drake_rho.display.meshcat.shape_objects import put, put_faces, put_map
from drake_rho.display.meshcat.trails import segments, show_between
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.shapes.quadrics import Sphere

_SOLID = Rgba(0.6, 0.63, 0.7, 0.5)
_GHOST = Rgba(0.6, 0.63, 0.7, 0.12)
_IN_CONFLICT = Rgba(*to_rgb(CONFLICT), 0.5)
_EDGES = Rgba(0.5, 0.5, 0.55)
_PATH = Rgba(0.6, 0.6, 0.65)
_HALOS = 16
"""Number of sizes of an obstacle's growing halo."""


def add_obstacles(
    meshcat: Meshcat, scene: Scene, plan: Drawn, conflicts: InfeasibleError | None = None
) -> None:
    """Add all obstacles as they are at the first knot, and lines along the paths of moving ones.

    Obstacles in conflict are red.
    """
    start, bodies = plan.scenario.grid.start, plan.scenario.bodies
    marked = frozenset[int]().union(*conflicts.obstacles.values()) if conflicts else frozenset()
    for number, obstacle in enumerate(bodies, start=1):
        path = _path(number)
        shape = truncated(obstacle.shape, scene.lower, scene.upper)
        colour = _IN_CONFLICT if number in marked else None
        _add_solid(meshcat, path, shape, colour, late=_known_late(plan, obstacle))
        for k, (_, size) in enumerate(_halos(plan, obstacle), start=1):
            _put_halo(meshcat, f"{path}/halo/{k}", shape, size)
        (place,) = _places(scene, obstacle, np.array([start]))
        meshcat.SetTransform(path, RigidTransform(place))
    for number, line in enumerate(obstacle_paths(plan, bodies), start=1):
        path = f"{ROOT}/obstacle_paths/{number}"
        meshcat.SetLineSegments(path, *segments([line]), rgba=_PATH)


def _add_solid(
    meshcat: Meshcat, path: str, solid: Solid, colour: Rgba | None, *, late: bool
) -> None:
    """Add an obstacle in its own or another colour, and a fainter copy if it is known late."""
    ghost = solid
    if isinstance(solid, Map):
        ghost = Box(solid.center - solid.extent, solid.center + solid.extent)
        if colour is None:
            put_map(solid, meshcat, f"{path}/known")
        else:
            put(solid, meshcat, f"{path}/known", colour)
    else:
        put(solid, meshcat, f"{path}/known", colour or _SOLID)
        if edges := surface(solid).edges:
            meshcat.SetLineSegments(f"{path}/edges", *segments(edges), rgba=_EDGES)
    if late:
        put(ghost, meshcat, f"{path}/unknown", _GHOST)


def _halos(plan: Drawn, obstacle: Obstacle) -> list[tuple[float, float]]:
    """Return the first times of halos since the first knot [s], and their sizes [m].

    A halo is shown until the next one.
    """
    grid = plan.scenario.grid
    if not obstacle.is_uncertain or isinstance(obstacle.shape, Map):
        return []
    first, last = np.clip(obstacle.active or (grid.start, grid.end), grid.start, grid.end)
    if _known_late(plan, obstacle):
        first = min(max(first, obstacle.known_from), grid.end)
    times = np.linspace(first, last, _HALOS + 1) if obstacle.velocity_error > 0.0 else [first, last]
    sizes = obstacle.uncertainty(np.asarray(times[1:]))
    begins = np.asarray(times[:-1]) - grid.start
    return [(t, size) for t, size in zip(begins.tolist(), sizes.tolist(), strict=True) if size > 0]


def _put_halo(meshcat: Meshcat, path: str, shape: Solid, size: float) -> None:
    """Add the surface at a distance [m] from a shape; it hides nothing."""
    if isinstance(shape, Sphere):
        put(Sphere(shape.center, shape.radius + size), meshcat, path, _GHOST)
    else:
        put_faces(around(shape, size).faces, meshcat, path, _GHOST)
    meshcat.SetProperty(f"{path}/<object>", "material.depthWrite", False)


def record_obstacles(meshcat: Meshcat, scene: Scene, plan: Drawn, playback: Playback) -> None:
    """Record the motion of obstacles, and the times at which they become known."""
    start = plan.scenario.grid.start
    for number, obstacle in enumerate(plan.scenario.bodies, start=1):
        path = _path(number)
        if _known_late(plan, obstacle):
            known = playback.time_at(obstacle.known_from - start)
            show_between(meshcat, f"{path}/known", known, None)
            show_between(meshcat, f"{path}/unknown", 0.0, known)
        begins = [playback.time_at(begin) for begin, _ in _halos(plan, obstacle)]
        for k, begin in enumerate(begins, start=1):
            end = begins[k] if k < len(begins) else None
            show_between(meshcat, f"{path}/halo/{k}", begin, end)
        if obstacle.active is not None:
            first, last = (time - start for time in obstacle.active)
            _show_while_active(meshcat, path, playback, first, last)
        if not obstacle.moves:
            continue
        places = _places(scene, obstacle, start + playback.times)
        turns = _turns(playback.times, places)
        for time, place in zip(playback.times[turns], places[turns], strict=True):
            meshcat.SetTransform(path, RigidTransform(place), playback.time_at(time))


def _show_while_active(
    meshcat: Meshcat, path: str, playback: Playback, first: float, last: float
) -> None:
    """Record that an object is visible from `first` to `last` since the first knot [s].

    Nothing is recorded after the flight: it would lengthen the playback.
    """
    end = float(playback.times[-1])
    if first > end or last < 0.0:
        meshcat.SetProperty(path, "visible", False, 0.0)
        return
    until = playback.time_at(last) if last < end else None
    show_between(meshcat, path, playback.time_at(max(0.0, first)), until)


def _path(number: int) -> str:
    return f"{ROOT}/obstacles/{number}"


def _known_late(plan: Drawn, obstacle: Obstacle) -> bool:
    return obstacle.is_late(plan.scenario.grid)


def _places(scene: Scene, obstacle: Obstacle, times: FloatArray) -> FloatArray:
    """Return the centres of an obstacle's visible part at clock times [s], in m, shape (M, 3)."""
    return truncated_centers(obstacle.shape, obstacle.centers(times), scene.lower, scene.upper)


def _turns(times: FloatArray, places: FloatArray) -> BoolArray:
    """Mark the ends and corners of a polyline; Meshcat interpolates linearly between them."""
    turns = np.ones(len(times), dtype=np.bool_)
    if len(times) > 2:
        part = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None]
        straight = places[:-2] + part * (places[2:] - places[:-2])
        size = float(np.ptp(places, axis=0).max())
        turns[1:-1] = np.abs(places[1:-1] - straight).max(axis=1) > 1e-9 * size
    return turns
