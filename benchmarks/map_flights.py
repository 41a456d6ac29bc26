"""Flights of one vehicle, and of ten, between random places of a map that are joined by a way."""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from benchmarks.map_scenes import Array, beyond_radius, tried
from benchmarks.stopwatch import Taken, median
from benchmarks.tables import Cell

RADIUS, DURATION, STEP = 0.15, 60.0, 0.5
"""Radius of the vehicles [m], T and h of every flight [s]."""

_SPACING = 0.1
"""Distance of the points by which a way is proved [m]."""

_FREE, _APART = 0.25, 1.0
"""Least distance of starts and goals from cells, and from each other [m]."""

COLUMNS = (
    "vehicles",
    "draw",
    "planned and verified",
    "plan, processor [s]",
    "plan, wall [s]",
    "index f",
    "nearest cell less the radius [m]",
)
"""Columns of the rows of `fly`."""


@dataclasses.dataclass(frozen=True)
class Flights:
    """Flights of as many vehicles."""

    rows: tuple[tuple[Cell, ...], ...]
    """a row for each draw"""
    taken: tuple[Taken, ...]
    """times of `rho.plan`"""
    planned: int
    """number of plans that `rho.verify` accepts"""

    @property
    def words(self) -> str:
        """Summary in a line."""
        own = median(self.taken)
        return (
            f"{self.rows[0][0]} vehicles: {self.planned} of {len(self.rows)} planned, median "
            f"{own.processor:.2g} s of processors, {own.wall:.2g} s on the wall"
        )


def fly(voxels: rho.Voxels, draws: tuple[tuple[int, int], ...]) -> list[Flights]:
    """Plan flights through a map.

    Args:
        voxels: the map.
        draws: numbers of vehicles, each with the number of draws.
    """
    places, found = _reachable(voxels), list[Flights]()
    for count, seeds in draws:
        rows, times, planned = list[tuple[Cell, ...]](), list[Taken](), 0
        for seed in range(seeds):
            scenario = _scenario(voxels, places, count, np.random.default_rng(seed))
            own = tried(scenario)
            near = float(f"{beyond_radius(own, voxels):.2g}") if own.plan else None
            cost = round(own.plan.cost, 4) if own.plan else None
            shown = round(own.taken.processor, 2), round(own.taken.wall, 2)
            rows.append((count, seed, own.ok, *shown, cost, near))
            times.append(own.taken)
            planned += own.ok
        found.append(Flights(tuple(rows), tuple(times), planned))
    return found


def _reachable(voxels: rho.Voxels) -> Array:
    """Return the points of a grid that one vehicle can reach from each other, shape (P, 3)."""
    from scipy import ndimage

    lower, upper = voxels.center - voxels.extent, voxels.center + voxels.extent
    axes = [np.arange(a, b, _SPACING) for a, b in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    distances = voxels.cover.distance_up_to(points - voxels.cover.center, 2.0 * _FREE)
    labels, _ = ndimage.label(distances >= RADIUS + _SPACING / 2.0)  # moves between are clear
    largest = 1 + int(np.argmax(np.bincount(labels.reshape(-1))[1:]))
    return np.asarray(points[(labels == largest) & (distances >= _FREE)])


def _scenario(
    voxels: rho.Voxels, places: Array, count: int, rng: np.random.Generator
) -> rho.Scenario:
    """Return a flight of vehicles between random places, each apart from all others."""
    chosen = list[Array]()
    while len(chosen) < 2 * count:
        place = places[rng.integers(len(places))]
        if all(np.linalg.norm((place - other) * [1.0, 1.0, 0.5]) > _APART for other in chosen):
            chosen.append(place)
    box = rho.Box(voxels.center - voxels.extent, voxels.center + voxels.extent)
    vehicles = [
        rho.Vehicle(f"UAV-{k}", rho.State(chosen[k]), rho.State(chosen[count + k]), radius=RADIUS)
        for k in range(count)
    ]
    return rho.Scenario(
        f"{count} vehicles",
        rho.Grid.lasting(DURATION, step=STEP),
        vehicles,
        rho.Limits(position=box, max_speed=3.0, max_acceleration=4.0),
        [voxels],
        rho.Separation(2.0 * RADIUS, 2.0) if count > 1 else None,
    )


WORK = f"""\
Unknown cells are free. Starts and goals are at least {_FREE:g} m from cells and {_APART:g} m from
each other (half as much counts vertically), in one component of a grid of {_SPACING:g} m whose
points are clear by the radius and half a spacing: there is a way. Vehicles have {RADIUS:g} m, 3 m/s
and 4 m/s² and keep {2.0 * RADIUS:g} m apart, with a downwash of 2; they have {DURATION:g} s, in
steps of {STEP:g} s."""
"""Description of these flights."""
