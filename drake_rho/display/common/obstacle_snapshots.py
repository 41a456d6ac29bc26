"""Obstacles at the instants shown in a still picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import cast

import numpy as np

from drake_rho.display.common.clearances import nearest, sample_times
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.map_faces import MapFaces, map_faces
from drake_rho.display.common.names import as_text, brief
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape, Solid
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.posed import Posed

MAX_FOLLOWED = 6
"""Largest number of moving obstacles drawn with their paths and their first and last positions."""
_MAX_NUMBERED = 60
"""Largest number of numbered obstacles; more numbers would cover the picture."""
AROUND = 0.5
"""Margin around a scene within which moving obstacles and sets enlarge it, over its longest
side."""
_APART = 0.2
"""Least displacement for a second snapshot of an obstacle, over its largest extent."""


@dataclasses.dataclass(frozen=True, eq=False)
class Snapshot:
    """An obstacle at one instant."""

    shape: Solid
    """shape of the obstacle"""
    center: FloatArray
    """centre of its bounding box at that instant [m], shape (3,)"""
    number: int
    """number of the obstacle, from 1"""
    label: str = ""
    """text beside it, escaped for matplotlib"""
    faint: bool = False
    """true for a secondary snapshot, at the first or last position of a moving obstacle, and for an
    obstacle that is not active in the flight"""
    halo: float = 0.0
    """uncertainty of the obstacle's position [m]"""
    between: tuple[float, float] | None = None
    """lower and upper height of the shown slice of a map [m]; the whole map if not given"""

    @cached_property
    def faces(self) -> MapFaces | None:
        """Faces of a map, relative to its centre; None of a shape."""
        if not isinstance(self.shape, Map):
            return None
        heights = self.between and (
            self.between[0] - self.center[2],
            self.between[1] - self.center[2],
        )
        return map_faces(self.shape, heights)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest coordinates [m]; inf and -inf along an axis without bounds."""
        ends = np.isfinite(self.shape.extent)
        extent = self.shape.extent + self.halo
        lower = np.where(ends, self.center - extent, np.inf)
        return lower, np.where(ends, self.center + extent, -np.inf)

    def truncated(self, lower: FloatArray, upper: FloatArray) -> Snapshot:
        """Return the snapshot with an infinite shape cut off at these coordinates [m]."""
        shape, center = truncated(self.shape, self.center, lower, upper)
        return dataclasses.replace(self, shape=shape, center=center)


def truncated(
    shape: Solid, centers: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[Solid, FloatArray]:
    """Return a shape with its infinite direction cut off at coordinates [m], and its new centres.

    A posed shape extends beyond the coordinates.

    Args:
        shape: shape of an obstacle.
        centers: its centres [m], shape (..., 3).
        lower: least coordinates [m], shape (3,).
        upper: greatest coordinates [m], shape (3,).
    """
    if np.all(np.isfinite(shape.extent)):
        return shape, centers
    along = _endless_along(shape)
    moved = centers + (((lower + upper) / 2.0 - centers) @ along)[..., None] * along
    posed = isinstance(shape, Posed)
    height = 2.0 * np.linalg.norm(upper - lower) if posed else (upper - lower) @ along
    return _with_height(shape, float(height)), moved


def _endless_along(shape: Solid) -> FloatArray:
    """Return the direction in which a shape is infinite, shape (3,)."""
    if isinstance(shape, Posed):
        along: FloatArray = shape.rotation @ _endless_along(shape.shape)
        return along
    return np.isinf(shape.extent).astype(np.float64)


def _with_height(shape: Solid, height: float) -> Solid:
    """Return an infinite cylinder, in its pose, with a height [m]."""
    if isinstance(shape, Posed):
        inner = cast(Shape, _with_height(shape.shape, height))
        return Posed(inner, shape.rotation, shape.translation)
    return dataclasses.replace(cast(Cylinder, shape), height=height)


def as_obstacles(obstacles: Sequence[Solid | Obstacle]) -> tuple[Obstacle, ...]:
    """Return each shape as an `Obstacle`, and obstacles unchanged."""
    return tuple(each if isinstance(each, Obstacle) else Obstacle(each) for each in obstacles)


def has_halo(obstacle: Obstacle) -> bool:
    """Return whether the space where an obstacle may be is drawn, which it is not around maps."""
    return obstacle.is_uncertain and not isinstance(obstacle.shape, Map)


def short_label(number: int, obstacle: Obstacle) -> str:
    """Return a short label of an obstacle: its number, and its shortened name if it has one."""
    name = "" if obstacle.name is None else as_text(brief(obstacle.name))
    return f"{number} {name}".strip()


def active_in_words(active: tuple[float, float] | None) -> str:
    """Describe a constraint's active interval; nothing if it is always active."""
    if active is None:
        return ""
    first, last = active
    if first == last:
        return f"active at {clock_time(first)}"
    return f"active {clock_number(first)} to {clock_time(last)}"


def snapshots(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[Snapshot]:
    """Return the snapshots of obstacles in a still picture.

    A static obstacle has one snapshot, faint if it is not active in the flight, with its
    uncertainty at the closest approach of a vehicle. A moving obstacle is shown at the closest
    approach of a vehicle and, if few obstacles move, more faintly at its first and last positions,
    with the times as labels. A moving obstacle never near the rest of the scene while active is
    omitted.
    """
    start, near, shown = plan.scenario.grid.start, _near_scene(plan, obstacles), list[Snapshot]()
    numbered = 1 < len(obstacles) <= _MAX_NUMBERED
    for number, obstacle in enumerate(obstacles, start=1):
        if obstacle.moves and number not in near:
            continue
        followed = obstacle.moves and _few_move(obstacles)
        times = np.array([start + nearest(plan, obstacle).time if obstacle.changes else start])
        if followed:
            clock, here = near[number]
            times = np.append(times, clock[here][[0, -1]])
        centers, halos = obstacle.centers(times), obstacle.uncertainty(times).tolist()
        whens = [clock_time(round(time, 2)) if followed else "" for time in times]
        name = short_label(number, obstacle) if numbered or obstacle.name is not None else ""
        words = ", ".join(filter(None, (name, whens[0], active_in_words(obstacle.active))))
        faint = not obstacle.moves and _is_never_active(plan, obstacle)
        shown.append(Snapshot(obstacle.shape, centers[0], number, words, faint, halos[0]))
        for center, when, halo in zip(centers[1:], whens[1:], halos[1:], strict=True):
            if np.linalg.norm(center - centers[0]) > _APART * _largest(obstacle):
                shown.append(Snapshot(obstacle.shape, center, number, when, True, halo))
    return shown


def approaches(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[FloatArray]:
    """Return the line from vehicle to obstacle at the closest approach to each moving obstacle.

    Returns:
        For each moving obstacle near the scene, the vehicle's position and the nearest possible
        point of the obstacle [m], shape (2, 3); nothing if many obstacles move.
    """
    found = []
    for number in _near_scene(plan, obstacles) if _few_move(obstacles) else ():
        obstacle = obstacles[number - 1]
        at = nearest(plan, obstacle)
        position = plan.motion().at("position", at.time)[at.vehicle]
        now = np.array([plan.scenario.grid.start + at.time])
        x = position - obstacle.centers(now)
        distances = obstacle.shape.local_distance(x) - obstacle.uncertainty(now)
        offset = distances[:, None] * obstacle.shape.local_outward(x)
        found.append(np.concatenate([position, position - offset]))
    return found


def obstacle_paths(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[FloatArray]:
    """Return the paths of a few moving obstacles while near the scene [m], each of shape (M, 3)."""
    found = []
    for number, (times, near) in _near_scene(plan, obstacles).items():
        ends = np.flatnonzero(np.diff(near, prepend=False, append=False)).reshape(-1, 2)
        runs = [times[first:last] for first, last in ends if last - first > 1]
        found += [obstacles[number - 1].centers(run) for run in runs]
    return found if _few_move(obstacles) else []


def obstacle_notes(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[str]:
    """Return notes that explain how obstacles are drawn, one line each."""
    notes = []
    radii = plan.scenario.fleet.radii
    if obstacles and radii.max() > 0.0:
        least, most = radii.min(), radii.max()
        far = f"{most:g}" if least == most else f"{least:g} to {most:g}"
        notes.append(f"vehicles keep {far} m from obstacles")
    if not _few_move(obstacles):
        notes.append("moving obstacles: at the closest approach of a vehicle to each")
    elif any(obstacle.moves for obstacle in obstacles):
        notes.append(
            "moving obstacles: at the closest approach (black line); faint: at the start and end"
        )
    if any(map(has_halo, obstacles)):
        notes.append("halos: where obstacles may be at that time, or at the closest approach")
    moving = {number for number, each in enumerate(obstacles, start=1) if each.moves}
    never = [str(number) for number in sorted(moving - {*_near_scene(plan, obstacles)})]
    if never:
        which = ", ".join(never) if len(never) <= MAX_FOLLOWED else f"{len(never)} of them"
        timed = " while active" if any(each.active for each in obstacles) else ""
        notes.append(f"obstacles never near the scene{timed}, not shown: {which}")
    if any(not each.moves and _is_never_active(plan, each) for each in obstacles):
        notes.append("faint: obstacles at rest that are not active in the flight")
    return notes


def _largest(obstacle: Obstacle) -> float:
    """Return the largest finite extent of an obstacle [m]."""
    extent = obstacle.shape.extent
    return float(np.max(extent, where=np.isfinite(extent), initial=0.0))


def _is_never_active(plan: Drawn, obstacle: Obstacle) -> bool:
    grid, active = plan.scenario.grid, obstacle.active
    return active is not None and not grid.clock.overlap(active, (grid.start, grid.end))


def _few_move(obstacles: Sequence[Obstacle]) -> bool:
    """Return whether moving obstacles are drawn with their paths and their ends."""
    return sum(obstacle.moves for obstacle in obstacles) <= MAX_FOLLOWED


def _near_scene(
    plan: Drawn, obstacles: Sequence[Obstacle]
) -> dict[int, tuple[FloatArray, BoolArray]]:
    """Return the moving obstacles that are ever near the scene while active, by their numbers.

    Only these are shown: distant ones would shrink everything else.

    Returns:
        Times on the scenario's clock [s], and whether the obstacle is near at each, (M,) each.
    """
    bounds = [(plan.positions.min(axis=(0, 1)), plan.positions.max(axis=(0, 1)))]
    bounds += [
        Snapshot(each.shape, each.centers(np.zeros(1))[0], 0).bounds
        for each in obstacles
        if not each.moves
    ]
    lower = np.min([low for low, _ in bounds], axis=0)
    upper = np.max([high for _, high in bounds], axis=0)
    margin = AROUND * float(np.max(upper - lower))
    found = dict[int, tuple[FloatArray, BoolArray]]()
    for number, obstacle in enumerate(obstacles, start=1):
        if obstacle.moves:
            times = plan.scenario.grid.start + sample_times(plan, [obstacle])
            centers, extent = obstacle.centers(times), obstacle.shape.extent
            beyond = (centers + extent < lower - margin) | (centers - extent > upper + margin)
            near = obstacle.is_active(times) & ~np.any(beyond, axis=1)
            if np.any(near):
                found[number] = times, near
    return found
