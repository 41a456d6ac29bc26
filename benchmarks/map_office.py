"""An office in an OctoMap: one vehicle, and ten, between random free places that have a way."""

from __future__ import annotations

import statistics
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.map_scenes import Array, beyond_radius, tried
from benchmarks.race import Skipped
from benchmarks.tables import Cell, Goal, Table

RADIUS, DURATION, STEP = 0.15, 60.0, 0.5
"""Radius of the vehicles [m], T and h of every flight [s]."""

_SPACING = 0.1
"""Distance of the points by which a way is proved [m]."""

_FREE, _APART = 0.25, 1.0
"""Least distance of starts and goals from cells, and from each other [m]."""

DRAWS = ((1, 10), (10, 20))
"""Numbers of vehicles, each with the number of draws."""


def run(folder: Path | None = None) -> Table:
    """Plan flights through `office.bt` in `folder`.

    Raises:
        Skipped: there is no such file.
    """
    if folder is None or not (folder / "office.bt").is_file():
        raise Skipped("no OctoMaps given; they are those of github.com/qwerty35/lsc_planner")
    office = rho.Voxels.from_octomap(folder / "office.bt", "free")
    places = _reachable(office)
    rows = list[tuple[Cell, ...]]()
    seconds: dict[int, list[float]] = {count: [] for count, _ in DRAWS}
    planned = dict.fromkeys(seconds, 0)
    for count, draws in DRAWS:
        for seed in range(draws):
            scenario = _scenario(office, places, count, np.random.default_rng(seed))
            found = tried(scenario)
            near = float(f"{beyond_radius(found, office):.2g}") if found.plan else None
            cost = round(found.plan.cost, 4) if found.plan else None
            rows.append((count, seed, found.ok, round(found.seconds, 2), cost, near))
            seconds[count].append(found.seconds)
            planned[count] += found.ok
    return Table(
        name="map_office",
        title="Maps: an office",
        columns=(
            "vehicles",
            "draw",
            "planned and verified",
            "plan [s]",
            "index f",
            "nearest cell less the radius [m]",
        ),
        rows=tuple(rows),
        notes=(_summary(office, seconds, planned), _WORK),
        goals=(
            Goal("one vehicle, slowest [s]", 5.0, max(seconds[1])),
            Goal("ten vehicles, draws without a plan", 0.0, float(DRAWS[1][1] - planned[10])),
            Goal("ten vehicles, slowest [s]", 30.0, max(seconds[10])),
        ),
    )


def _reachable(office: rho.Voxels) -> Array:
    """Return the points of a grid that one vehicle can reach from each other, shape (P, 3)."""
    from scipy import ndimage

    lower, upper = office.center - office.extent, office.center + office.extent
    axes = [np.arange(a, b, _SPACING) for a, b in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    distances = office.cover.distance_up_to(points - office.cover.center, 2.0 * _FREE)
    labels, _ = ndimage.label(distances >= RADIUS + _SPACING / 2.0)  # moves between are clear
    largest = 1 + int(np.argmax(np.bincount(labels.reshape(-1))[1:]))
    return np.asarray(points[(labels == largest) & (distances >= _FREE)])


def _scenario(
    office: rho.Voxels, places: Array, count: int, rng: np.random.Generator
) -> rho.Scenario:
    """Return a flight of vehicles between random places, each apart from all others."""
    chosen = list[Array]()
    while len(chosen) < 2 * count:
        place = places[rng.integers(len(places))]
        if all(np.linalg.norm((place - other) * [1.0, 1.0, 0.5]) > _APART for other in chosen):
            chosen.append(place)
    box = rho.Box(office.center - office.extent, office.center + office.extent)
    vehicles = [
        rho.Vehicle(f"UAV-{k}", rho.State(chosen[k]), rho.State(chosen[count + k]), radius=RADIUS)
        for k in range(count)
    ]
    return rho.Scenario(
        f"office {count}",
        rho.Grid.lasting(DURATION, step=STEP),
        vehicles,
        rho.Limits(position=box, max_speed=3.0, max_acceleration=4.0),
        [office],
        rho.Separation(2.0 * RADIUS, 2.0) if count > 1 else None,
    )


def _summary(office: rho.Voxels, seconds: dict[int, list[float]], planned: dict[int, int]) -> str:
    """Return what was measured, in a paragraph."""
    texts = [
        f"{count} vehicles: {planned[count]} of {len(times)} planned, median "
        f"{statistics.median(times):.1f} s"
        for count, times in seconds.items()
    ]
    return f"{office}, joined to {len(office.cover)} boxes. {'; '.join(texts)}."


_WORK = f"""\
`office.bt` of qwerty35/lsc_planner, unknown cells free. Starts and goals are at least {_FREE:g} m
from cells and {_APART:g} m from each other (half as much counts vertically), in one component of a
grid of {_SPACING:g} m whose points are clear by the radius and half a spacing: there is a way.
Vehicles have {RADIUS:g} m, 3 m/s and 4 m/s² and keep 0.3 m apart, with a downwash of 2."""
