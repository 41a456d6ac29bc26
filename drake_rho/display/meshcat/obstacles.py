"""Obstacles in Meshcat: their motion, and their discovery.

In the scene tree, /flight/obstacles/<number> is the obstacle's pose. Its children are `known`, the
obstacle itself, `unknown`, a fainter copy shown until an obstacle with a later `known_from` becomes
known, and `edges`, if a shape has edges. The uncertainty of an obstacle is shown as `halo/<k>` in
the k-th part of the time in which it grows, as large as at the end of that part. Maps are coloured
by height and have no halo; a map that is not known yet is shown by its bounding box.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydrake.geometry import Rgba

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.obstacle_snapshots import (
    has_halo,
    obstacle_paths,
    truncated,
)
from drake_rho.display.common.shape_faces import around, surface
from drake_rho.display.common.style import CONFLICT
from drake_rho.display.meshcat.poses import unturned
from drake_rho.display.meshcat.scene import Scene
from drake_rho.display.meshcat.shape_objects import put, put_faces, put_map
from drake_rho.display.meshcat.tree import Tree, rgba
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.shapes.quadrics import Sphere

_SOLID = Rgba(0.6, 0.63, 0.7, 0.5)
_GHOST = Rgba(0.6, 0.63, 0.7, 0.12)
_EDGES = Rgba(0.5, 0.5, 0.55)
_PATH = Rgba(0.6, 0.6, 0.65)
_HALOS = 16
"""Number of sizes of an obstacle's growing halo."""


def add_obstacles(
    tree: Tree, scene: Scene, plan: Drawn, conflicts: InfeasibleError | None = None
) -> None:
    """Add all obstacles, and lines along the paths of moving ones; obstacles in conflict are red.

    Their motion, and the times at which they are known and active, are recorded.
    """
    grid, bodies = plan.scenario.grid, plan.scenario.bodies
    marked = frozenset[int]().union(*conflicts.obstacles.values()) if conflicts else frozenset()
    for number, obstacle in enumerate(bodies, start=1):
        path = f"obstacles/{number}"
        times = tree.playback.times if obstacle.moves else np.zeros(1)
        centers = obstacle.centers(grid.start + times)
        shape, places = truncated(obstacle.shape, centers, *scene.bounds)
        _add_solid(tree, path, shape, rgba(CONFLICT, 0.5) if number in marked else None)
        if obstacle.is_late(grid):
            known = obstacle.known_from - grid.start
            box = Box(shape.center - shape.extent, shape.center + shape.extent)
            put(box if isinstance(shape, Map) else shape, tree, f"{path}/unknown", _GHOST)
            tree.show_between(f"{path}/known", known)
            tree.show_between(f"{path}/unknown", 0.0, known)
        _add_halos(tree, path, shape, _halos(plan, obstacle))
        if obstacle.active is not None:
            first, last = obstacle.active
            tree.show_between(path, first - grid.start, last - grid.start)
        if obstacle.moves:
            tree.move(path, unturned(places), _turns(times, places))
        else:
            tree.place(path, places[0])
    for number, line in enumerate(obstacle_paths(plan, bodies), start=1):
        tree.add_lines(f"obstacle_paths/{number}", [line], _PATH)


def _add_solid(tree: Tree, path: str, solid: Solid, colour: Rgba | None) -> None:
    """Add an obstacle in its own or another colour."""
    if isinstance(solid, Map) and colour is None:
        put_map(solid, tree, f"{path}/known")
        return
    put(solid, tree, f"{path}/known", colour or _SOLID)
    if not isinstance(solid, Map) and (edges := surface(solid).edges):
        tree.add_lines(f"{path}/edges", edges, _EDGES)


def _halos(plan: Drawn, obstacle: Obstacle) -> list[tuple[float, float]]:
    """Return the first times of halos since the first knot [s], and their sizes [m].

    A halo is shown until the next one.
    """
    grid = plan.scenario.grid
    if not has_halo(obstacle):
        return []
    first, last = np.clip(obstacle.active or (grid.start, grid.end), grid.start, grid.end)
    if obstacle.is_late(grid):
        first = min(max(first, obstacle.known_from), grid.end)
    times = np.linspace(first, last, _HALOS + 1) if obstacle.velocity_error > 0.0 else [first, last]
    sizes = obstacle.uncertainty(np.asarray(times[1:]))
    begins = np.asarray(times[:-1]) - grid.start
    return [(t, size) for t, size in zip(begins.tolist(), sizes.tolist(), strict=True) if size > 0]


def _add_halos(tree: Tree, path: str, shape: Solid, halos: list[tuple[float, float]]) -> None:
    """Add the surfaces at the distances of halos from a shape, each until the next; see `_halos`.

    They hide nothing.
    """
    for k, ((begin, size), (end, _)) in enumerate(pairwise([*halos, (np.inf, 0.0)]), start=1):
        halo = f"{path}/halo/{k}"
        if isinstance(shape, Sphere):
            tree.add_ball(halo, shape.radius + size, _GHOST)
        else:
            put_faces(around(shape, size).faces, tree, halo, _GHOST)
        tree.set_see_through(halo)
        tree.show_between(halo, begin, end)


def _turns(times: FloatArray, places: FloatArray) -> BoolArray:
    """Mark the ends and corners of a polyline; Meshcat interpolates linearly between them."""
    turns = np.ones(len(times), dtype=np.bool_)
    if len(times) > 2:
        part = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None]
        straight = places[:-2] + part * (places[2:] - places[:-2])
        size = float(np.ptp(places, axis=0).max())
        turns[1:-1] = np.abs(places[1:-1] - straight).max(axis=1) > 1e-9 * size
    return turns
