"""Obstacles as they stand at the instants at which a still picture shows them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.display.common.clearances import nearest
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.style import dense_times
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape
from drake_rho.scenario.shapes.cylinders import Cylinder

MAX_FOLLOWED = 6
"""Most moving obstacles whose ways are drawn, and where they are at first and at last."""
_MAX_NUMBERED = 60
"""Most obstacles with their numbers; more would be a picture of numbers."""
_AROUND = 0.5
"""How far from what stands still a moving obstacle is shown, in parts of the longest side."""
_APART = 0.2
"""How far an obstacle has to be from where it is drawn to be drawn again, in parts of its size."""


@dataclasses.dataclass(frozen=True, eq=False)
class Snapshot:
    """An obstacle at one instant."""

    shape: Shape
    """what it is"""
    center: FloatArray
    """where the middle of its bounding box is then [m], shape (3,)"""
    label: str = ""
    """what is written beside it, for matplotlib"""
    faint: bool = False
    """whether another snapshot of the same obstacle says more"""

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest coordinates [m]; none, that is inf and -inf, where it has no end."""
        ends = np.isfinite(self.shape.extent)
        lower = np.where(ends, self.center - self.shape.extent, np.inf)
        return lower, np.where(ends, self.center + self.shape.extent, -np.inf)

    def between(self, lower: FloatArray, upper: FloatArray) -> Snapshot:
        """This one with ends at these coordinates [m] where it has none."""
        if np.all(np.isfinite(self.shape.extent)):
            return self
        center = truncated_centers(self.shape, self.center, lower, upper)
        return dataclasses.replace(self, shape=truncated(self.shape, lower, upper), center=center)


def truncated(shape: Shape, lower: FloatArray, upper: FloatArray) -> Shape:
    """The shape, with ends [m] if it is an endless cylinder; see `placed` for its centre."""
    if not isinstance(shape, Cylinder) or shape.height is not None:
        return shape
    return dataclasses.replace(shape, height=float((upper - lower)["xyz".index(shape.axis)]))


def truncated_centers(
    shape: Shape, centers: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Centres [m], shape (..., 3), of a shape that was given ends there."""
    return np.where(np.isinf(shape.extent), (lower + upper) / 2.0, centers)


def as_obstacles(obstacles: Sequence[Shape | Obstacle]) -> tuple[Obstacle, ...]:
    """Each as an `Obstacle`."""
    return tuple(each if isinstance(each, Obstacle) else Obstacle(each) for each in obstacles)


def short_label(number: int, obstacle: Obstacle) -> str:
    """What an obstacle is called where there is little room: number, and name if any."""
    name = "" if obstacle.name is None else as_text(brief(obstacle.name))
    return f"{number} {name}".strip()


def snapshots(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[Snapshot]:
    """What a still picture shows of the obstacles.

    Those at rest as they are. A moving one as it is when a vehicle comes closest to it, and if
    there are few, fainter where it is at first and at last; its label has the times. One that is
    never near what else is shown is left out.
    """
    shown: list[Snapshot] = []
    few = sum(obstacle.moves for obstacle in obstacles) <= MAX_FOLLOWED
    numbered = 1 < len(obstacles) <= _MAX_NUMBERED
    for number, obstacle in enumerate(obstacles, start=1):
        label = short_label(number, obstacle) if numbered or obstacle.name is not None else ""
        if not obstacle.moves:
            (center,) = obstacle.centers(np.array([plan.scenario.grid.start]))
            shown.append(Snapshot(obstacle.shape, center, label))
            continue
        clock, near = _near_scene(plan, obstacle, obstacles)
        if not np.any(near):
            continue
        times = np.array([plan.scenario.grid.start + nearest(plan, obstacle).time])
        if few:
            times = np.append(times, clock[near][[0, -1]])
        centers = obstacle.centers(times)
        for index, (time, center) in enumerate(zip(times, centers, strict=True)):
            moved = np.linalg.norm(center - centers[0]) > _APART * obstacle.shape.size
            when = f"{round(time, 2):g} s" if few else ""
            if index == 0:
                words = ", ".join(filter(None, (label, when)))
                shown.append(Snapshot(obstacle.shape, center, words))
            elif moved:
                shown.append(Snapshot(obstacle.shape, center, when, faint=True))
    return shown


def approaches(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[FloatArray]:
    """From vehicles to the nearest points of moving obstacles when these are nearest to any.

    Returns:
        For each moving obstacle, if there are few, both ends [m], shape (2, 3).
    """
    moving = [obstacle for obstacle in obstacles if obstacle.moves]
    found = []
    for obstacle in moving if len(moving) <= MAX_FOLLOWED else []:
        if not np.any(_near_scene(plan, obstacle, obstacles)[1]):
            continue
        at = nearest(plan, obstacle)
        position = plan.motion().at("position", at.time)[at.vehicle]
        x = position - obstacle.centers(np.array([plan.scenario.grid.start + at.time]))
        way = obstacle.shape.signed_distance(x)[:, None] * obstacle.shape.outward(x)
        found.append(np.concatenate([position, position - way]))
    return found


def obstacle_paths(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[FloatArray]:
    """The ways of moving obstacles near what else is shown [m], each of shape (M, 3)."""
    moving = [obstacle for obstacle in obstacles if obstacle.moves]
    found = []
    for obstacle in moving if len(moving) <= MAX_FOLLOWED else []:
        times, near = _near_scene(plan, obstacle, obstacles)
        runs = np.split(times, np.flatnonzero(np.diff(near)) + 1)
        firsts = np.concatenate([near[:1], near[1:][np.diff(near)]])
        found += [
            obstacle.centers(run)
            for run, shown in zip(runs, firsts, strict=True)
            if shown and len(run) > 1
        ]
    return found


def obstacle_notes(plan: Drawn, obstacles: Sequence[Obstacle]) -> list[str]:
    """What has to be said of how obstacles are drawn, one line each."""
    notes = []
    radii = plan.scenario.fleet.radii
    if obstacles and radii.max() > 0.0:
        least, most = radii.min(), radii.max()
        far = f"{most:g}" if least == most else f"{least:g} to {most:g}"
        notes.append(f"vehicles keep {far} m from obstacles")
    count = sum(obstacle.moves for obstacle in obstacles)
    if count > MAX_FOLLOWED:
        notes.append("moving obstacles: where a vehicle comes closest to each")
    elif count > 0:
        notes.append(
            "moving obstacles: when a vehicle comes closest (black line); faint: at first and last"
        )
    never = [
        str(number)
        for number, obstacle in enumerate(obstacles, start=1)
        if obstacle.moves and not np.any(_near_scene(plan, obstacle, obstacles)[1])
    ]
    if never:
        which = ", ".join(never) if len(never) <= MAX_FOLLOWED else f"{len(never)} of them"
        notes.append(f"obstacles that are never near, not shown: {which}")
    return notes


def _near_scene(
    plan: Drawn, obstacle: Obstacle, obstacles: Sequence[Obstacle]
) -> tuple[FloatArray, np.ndarray]:
    """Times of the flight on the clock [s], and whether an obstacle is near the scene then.

    What comes from far away would make all else too small to be seen.
    """
    resting = [
        Snapshot(each.shape, each.centers(np.zeros(1))[0]).bounds
        for each in obstacles
        if not each.moves
    ]
    lower = np.min([plan.positions.min(axis=(0, 1)), *(low for low, _ in resting)], axis=0)
    upper = np.max([plan.positions.max(axis=(0, 1)), *(high for _, high in resting)], axis=0)
    room = _AROUND * float(np.max(upper - lower))
    times = plan.scenario.grid.start + dense_times(plan)
    centers, extent = obstacle.centers(times), obstacle.shape.extent
    beyond = (centers + extent < lower - room) | (centers - extent > upper + room)
    return times, ~np.any(beyond, axis=1)
