"""Generators of missions with any number of vehicles: random transitions and circle swaps."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.records import (
    Box,
    Grid,
    Limits,
    Scenario,
    Separation,
    State,
    Vehicle,
)

_Cell = tuple[int, int, int]
_Point = tuple[float, float, float]

TRIES = 10_000
"""Number of random positions tried for a vehicle or an obstacle before generation fails."""


@checked
def flight_cube(volume: float) -> Box:
    """Return a cube of `volume` [m³], centred above the origin and 0.2 m above the ground.

    It is the flight volume in the benchmark of Luis and Schoellig: 4 m³ for up to 20 vehicles, or
    N m³ for N vehicles.

    Raises:
        ScenarioError: `volume` is not a positive number.
    """
    if not 1.0 / LARGEST <= volume <= LARGEST:  # also true for NaN
        raise ScenarioError("volume", volume, "a number of cubic metres above 0")
    side = volume ** (1 / 3)
    return Box([-side / 2, -side / 2, 0.2], [side / 2, side / 2, 0.2 + side])


@checked
def random_transitions(
    n: int,
    rng: np.random.Generator,
    *,
    volume: Box | None = None,
    duration: float = 10.0,
    step: float = 0.2,
    limits: Limits | None = None,
    separation: Separation | None = Separation(0.35, downwash=2.0),  # noqa: B008  # frozen
    name: str = "random transitions",
) -> Scenario:
    """Generate a fleet that flies from rest to rest between random positions in a volume.

    Starts are drawn uniformly in the volume one after another; each draw is repeated until the
    start keeps the separation from those before. Goals are drawn in the same way, independently of
    the starts. The defaults are those of the benchmark of Luis and Schoellig with up to 20
    vehicles in 4 m³; for its other series, with one vehicle per cubic metre, use
    `volume=flight_cube(n), duration=15.0`. The same state of `rng` gives the same scenario.

    Args:
        n: number of vehicles.
        rng: random number generator.
        volume: box in which starts and goals are drawn [m]; `flight_cube(4.0)` if not given.
        duration: T [s].
        step: h [s], which divides the duration.
        limits: of every vehicle; if not given, accelerations of 1 m/s² along each axis and the
            volume as position box.
        separation: of every pair; None for independent vehicles.
        name: of the scenario.

    Raises:
        ScenarioError: an argument is invalid, or the vehicles do not fit into the volume: `TRIES`
            random positions for one of them were all too close to others.

    Examples:
        >>> scenario = rho.random_transitions(8, np.random.default_rng(1))
        >>> len(scenario.vehicles), scenario.separation
        (8, Separation(distance=0.35, downwash=2.0))
    """
    check_count("n", n, "vehicles")
    volume = volume or flight_cube(4.0)
    limits = limits or Limits(position=volume, acceleration=Box([-1.0] * 3, [1.0] * 3))
    starts = _draw(n, rng, volume, separation)
    goals = _draw(n, rng, volume, separation)
    grid = Grid.lasting(duration, step=step)
    return Scenario(name, grid, from_rest(starts, goals), limits, separation=separation)


@checked
def circle_swap(
    n: int,
    *,
    radius: float,
    duration: float,
    step: float,
    height: float = 0.0,
    limits: Limits | None = None,
    separation: Separation | None = None,
    name: str = "circle swap",
) -> Scenario:
    """Generate vehicles on a horizontal circle that fly from rest to rest to the opposite points.

    The vehicles are evenly spaced. They start and end at rest, so that a jerk limit applies from
    the first step to the last.

    Args:
        n: number of vehicles; the first starts on the x axis, the others counter-clockwise.
        radius: of the circle [m].
        duration: T [s].
        step: h [s], which divides the duration.
        height: z of the circle [m].
        limits: of every vehicle; none if not given.
        separation: of every pair; none is required if not given.
        name: of the scenario.

    Raises:
        ScenarioError: an argument is invalid, or neighbours are closer than the separation.

    Examples:
        >>> scenario = rho.circle_swap(6, radius=5.0, duration=8.0, step=0.2)
        >>> scenario.vehicles[0].goal.position.tolist()
        [-5.0, 0.0, 0.0]
    """
    check_count("n", n, "vehicles")
    if not 1.0 / LARGEST <= radius <= LARGEST:
        raise ScenarioError("radius", radius, "a length above 0 in metres")
    angles = 2.0 * np.pi * np.arange(n) / n
    circle = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(n)], axis=1)
    above = np.array([0.0, 0.0, height])
    vehicles = from_rest(above + circle, above - circle)
    grid = Grid.lasting(duration, step=step)
    return Scenario(name, grid, vehicles, limits or Limits(), separation=separation)


def check_count(field: str, n: int, what: str, least: int = 1) -> None:
    """Check that `n`, the argument called `field`, is a valid number of `what`.

    Raises:
        ScenarioError: `n` is not a whole number, or is below `least`.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < least:
        raise ScenarioError(field, n, f"a whole number of {what}, at least {least}")


def from_rest(starts: FloatArray, goals: FloatArray) -> tuple[Vehicle, ...]:
    """Return vehicles `v1`, `v2`, ... that fly from rest, without acceleration, to rest."""
    rest = np.zeros(3)
    return tuple(
        Vehicle(f"v{number}", State(start, rest, rest), State(goal))
        for number, (start, goal) in enumerate(zip(starts, goals, strict=True), start=1)
    )


def _draw(
    n: int, rng: np.random.Generator, volume: Box, separation: Separation | None
) -> FloatArray:
    """Draw positions in the volume that keep the separation, shape (n, 3).

    Positions are stored by cells as wide as the separation, in coordinates in which it is a
    sphere: only positions in the 27 cells around a draw can be too close to it, and each cell
    holds only a few.
    """
    if separation is None:
        return rng.uniform(volume.lower, volume.upper, (n, 3))
    widths, scales = volume.upper - volume.lower, separation.shape.scales
    drawn: list[FloatArray] = []
    cells: defaultdict[_Cell, list[_Point]] = defaultdict(list)
    while len(drawn) < n:
        for _ in range(TRIES):  # in numbers of Python, which are faster than such small arrays
            position = volume.lower + widths * rng.random(3)
            x, y, z = (scales * position / separation.distance).tolist()
            cell = math.floor(x), math.floor(y), math.floor(z)
            near = _around(cell, cells)
            if all((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 >= 1.0 for a, b, c in near):
                break
        else:
            expected = (
                f"at most {len(drawn)} vehicles, or more room: {TRIES} random positions of the "
                f"next in {volume.lower.tolist()} to {volume.upper.tolist()} were all too close"
            )
            raise ScenarioError("n", n, expected)
        cells[cell].append((x, y, z))
        drawn.append(position)
    return np.array(drawn)


def _around(cell: _Cell, cells: Mapping[_Cell, list[_Point]]) -> Iterator[_Point]:
    """Yield the points in a cell and in the 26 cells around it."""
    x, y, z = cell
    for key in product((x, x - 1, x + 1), (y, y - 1, y + 1), (z, z - 1, z + 1)):
        yield from cells.get(key, ())
