"""Generators of worlds: vehicles that swap among moving boxes; fields of spheres and boxes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.problems.generators import TRIES, check_count, circle_swap, from_rest
from drake_rho.scenario.records import (
    Box,
    Grid,
    Limits,
    Obstacle,
    Scenario,
    Separation,
    Sphere,
    Track,
    Vehicle,
)

_SWAP = Limits(
    position=Box([-15.0, -15.0, 0.0], [15.0, 15.0, 6.0]),
    velocity=Box([-10.0] * 3, [10.0] * 3),
    acceleration=Box([-20.0] * 3, [20.0] * 3),
    jerk=Box([-30.0] * 3, [30.0] * 3),
)
"""Limits of vehicles that swap among moving boxes. The position box extends 5 m beyond the circle,
more than they need."""

_SLOWNESS = 5.2
"""Time in which a trefoil's parameter increases by one [s]."""

_SHARPEST = np.sqrt(146.0 + 64.0 / 81.0) / _SLOWNESS**2
"""Largest acceleration on a trefoil [m/s²]. Its square is 65 - 16 c + 81 (1 - c²) over the fourth
power of the slowness, where c = cos 3τ, and is greatest at c = -8/81."""

_SPAN = 5.5
"""Half the side of the square that contains the centres of the trefoil knots [m]."""


@checked
def trefoil_swap(
    boxes: int,
    rng: np.random.Generator,
    *,
    vehicles: int = 10,
    duration: float = 5.0,
    step: float = 0.1,
    name: str = "trefoil swap",
) -> Scenario:
    """Generate vehicles on a circle that swap to the opposite points among moving boxes.

    The world is that of RMADER's benchmark (github.com/mit-acl/rmader): a circle of radius 10 m at
    a height of 1 m, at most 10 m/s, 20 m/s² and 30 m/s³ along each axis, and vehicles at least
    0.25 m from each other and 0.125 m from the boxes. The boxes have sides of 0.5 m and move on
    trefoil knots. The centre of a box is at (x + sin τ + 2 sin 2τ, y + cos τ - 2 cos 2τ,
    1 - sin 3τ) with τ = t / 5.2 s + φ, where x and y are drawn from ±5.5 m and φ from ±2π. A box
    that is too close to a start at the first knot, or to a goal at the last, is drawn again.
    Tracks are straight between the knots, and their deviation from the trefoil is bounded. The
    same state of `rng` gives the same scenario.

    Args:
        boxes: number of moving boxes, or 0.
        rng: random number generator.
        vehicles: number of vehicles.
        duration: T [s].
        step: h [s], which divides the duration.
        name: of the scenario.

    Raises:
        ScenarioError: an argument is invalid.
    """
    check_count("boxes", boxes, "boxes", least=0)
    check_count("vehicles", vehicles, "vehicles")
    swap = circle_swap(
        vehicles,
        radius=10.0,
        duration=duration,
        step=step,
        height=1.0,
        limits=_SWAP,
        separation=Separation(0.25),
        name=name,
    )
    fleet = tuple(dataclasses.replace(vehicle, radius=0.125) for vehicle in swap.vehicles)

    def box() -> Obstacle:
        x, y = rng.uniform(-_SPAN, _SPAN, 2)
        path = _trefoil(np.array([x, y, 1.0]), rng.uniform(-2.0 * np.pi, 2.0 * np.pi))
        shape = Box(path(0.0) - 0.25, path(0.0) + 0.25)
        return Obstacle(shape, track=Track.sampled(path, swap.grid.times, _SHARPEST))

    obstacles = tuple(_draw_clear(box, fleet, swap.grid) for _ in range(boxes))
    return dataclasses.replace(swap, vehicles=fleet, obstacles=obstacles)


@checked
def random_field(
    obstacles: int,
    rng: np.random.Generator,
    *,
    room: Box | None = None,
    radius: float = 0.15,
    max_velocity: float = 3.0,
    max_acceleration: float = 3.0,
    max_step: float = 0.2,
    name: str = "random field",
) -> Scenario:
    """Generate a vehicle that crosses a room of random spheres and boxes from wall to wall.

    It flies from rest to rest, from a random point of the wall with the least x to one of the
    opposite wall, in twice the time of the fastest motion without obstacles. Obstacles alternate
    between spheres of radius 0.4 to 1.2 m and boxes, each of whose sides is drawn from 0.4 to 2 m.
    Their centres are anywhere in the room; obstacles may overlap and extend beyond the walls. An
    obstacle that is too close to the start or the goal is drawn again. A collision-free path need
    not exist. The same state of `rng` gives the same scenario.

    Args:
        obstacles: number of spheres and boxes, or 0.
        rng: random number generator.
        room: bounds of the vehicle's position [m]; 10 by 10 by 5 m if not given.
        radius: of the vehicle, its least distance from obstacles [m].
        max_velocity: along each axis [m/s].
        max_acceleration: along each axis [m/s²].
        max_step: upper bound of the step h, the longest one that divides the duration [s].
        name: of the scenario.

    Raises:
        ScenarioError: an argument is invalid, or an obstacle does not fit into the room: it was too
            close to the start or the goal at `TRIES` random positions.
    """
    check_count("obstacles", obstacles, "obstacles", least=0)
    for field, value in (
        ("max_velocity", max_velocity),
        ("max_acceleration", max_acceleration),
        ("max_step", max_step),
    ):
        if not 1.0 / LARGEST <= value <= LARGEST:  # also true for NaN
            raise ScenarioError(field, value, "a number above 0")
    room = room or Box([0.0, 0.0, 0.0], [10.0, 10.0, 5.0])
    limits = Limits(
        position=room,
        velocity=Box([-max_velocity] * 3, [max_velocity] * 3),
        acceleration=Box([-max_acceleration] * 3, [max_acceleration] * 3),
    )
    ends = rng.uniform(room.lower, room.upper, (2, 3))
    ends[:, 0] = room.lower[0], room.upper[0]
    farthest = float(np.max(np.abs(ends[1] - ends[0])))  # the axis that takes the longest time
    duration = 2.0 * _fastest(farthest, max_velocity, max_acceleration)
    grid = Grid.lasting(duration, step=duration / np.ceil(duration / max_step))
    fleet = tuple(
        dataclasses.replace(vehicle, radius=radius) for vehicle in from_rest(ends[:1], ends[1:])
    )
    shapes = [
        _draw_clear(_sphere(room, rng) if number % 2 == 0 else _box(room, rng), fleet, grid).shape
        for number in range(obstacles)
    ]
    return Scenario(name, grid, fleet, limits, shapes)


def _draw_clear(
    draw: Callable[[], Obstacle], vehicles: tuple[Vehicle, ...], grid: Grid
) -> Obstacle:
    """Draw obstacles until one is clear of all starts and goals at their times.

    Raises:
        ScenarioError: none of `TRIES` obstacles was.
    """
    starts = np.array([vehicle.start.position for vehicle in vehicles])
    goals = np.array([vehicle.goal.position for vehicle in vehicles])
    radii = np.array([vehicle.radius for vehicle in vehicles])
    for _ in range(TRIES):
        drawn = draw()
        required = radii + drawn.deviation
        first, last = (np.array([time]) for time in (grid.start, grid.end))
        at_ends = drawn.distances(starts, first), drawn.distances(goals, last)
        if all(np.all(distances >= required) for distances in at_ends):
            return drawn
    expected = (
        f"more room: {TRIES} random positions for the next were all too close to a start or goal"
    )
    raise ScenarioError("obstacles", drawn.shape, expected)


def _trefoil(middle: FloatArray, phase: float) -> Callable[[float], FloatArray]:
    """Return the position on a trefoil knot around `middle` [m] as a function of time [s]."""

    def position(time: float) -> FloatArray:
        t = time / _SLOWNESS + phase
        offset = [
            np.sin(t) + 2.0 * np.sin(2.0 * t),
            np.cos(t) - 2.0 * np.cos(2.0 * t),
            -np.sin(3.0 * t),
        ]
        position: FloatArray = middle + offset
        return position

    return position


def _sphere(room: Box, rng: np.random.Generator) -> Callable[[], Obstacle]:
    return lambda: Obstacle(Sphere(rng.uniform(room.lower, room.upper), rng.uniform(0.4, 1.2)))


def _box(room: Box, rng: np.random.Generator) -> Callable[[], Obstacle]:
    def box() -> Obstacle:
        middle, half = rng.uniform(room.lower, room.upper), rng.uniform(0.4, 2.0, 3) / 2.0
        return Obstacle(Box(middle - half, middle + half))

    return box


def _fastest(distance: float, velocity: float, acceleration: float) -> float:
    """Return the least time from rest to rest along an axis [s].

    The fastest motion accelerates fully, cruises at the velocity limit if it gets there, and
    brakes fully.
    """
    if distance * acceleration <= velocity**2:
        return 2.0 * float(np.sqrt(distance / acceleration))
    return distance / velocity + velocity / acceleration
