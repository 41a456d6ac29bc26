"""Fleets on tracks of a few legs with spheres on the way, drawn at random."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.distance import pdist

import drake_rho as rho
from benchmarks.clearance import distances
from benchmarks.time_scenes import LIMITS, guessed_grid, vehicle_on
from drake_rho.scenario.fields import FloatArray

VEHICLES = 10

APART, RADIUS = 0.3, 0.15
"""Separation, and radius that keeps clear of spheres [m]."""

BESIDE = 0.5
"""Distance of neighbours in the line in which they pass each place [m]."""

_LEG = (8.0, 14.0)
"""Least and greatest length of a leg [m]."""

_PLACES = 7.0
"""Least distance of two places of a track, which keeps lines from each other [m]."""

_AROUND = 0.1
"""Room around starts, waypoints and goals beyond the radius [m]."""


def scene(number: int) -> rho.Scenario:
    """Return one draw: those of even numbers stay side by side, those of odd ones cross over.

    Lines at each place have the same direction and order, or random ones.
    """
    rng, crosses = np.random.default_rng([29, number]), number % 2 == 1
    legs = int(rng.integers(3, 5))
    while True:
        track = _track(rng, legs)
        spheres = _spheres(rng, track)
        places = _lines(rng, track, crosses=crosses)
        around = [distances(sphere, places) for sphere in spheres]
        if np.min(around) > RADIUS + _AROUND:
            break
    vehicles = [vehicle_on(f"v{i}", each, RADIUS) for i, each in enumerate(places)]
    return rho.Scenario(
        f"{'crossing' if crosses else 'side by side'}, {legs} legs, seed {number}",
        guessed_grid(vehicles, legs),
        vehicles,
        LIMITS,
        obstacles=spheres,
        separation=rho.Separation(APART),
    )


def alone(fleet: rho.Scenario, index: int) -> rho.Scenario:
    """Return the scenario of one vehicle of a fleet with nobody else in the air."""
    return dataclasses.replace(fleet, vehicles=(fleet.vehicles[index],), separation=None)


def _track(rng: np.random.Generator, legs: int) -> FloatArray:
    """Return places that are far from each other [m], shape (L + 1, 3)."""
    while True:
        ways = _directions(rng, legs, steepness=0.3) * rng.uniform(*_LEG, (legs, 1))
        places = np.vstack([np.zeros(3), np.cumsum(ways, axis=0)])
        if pdist(places).min() > _PLACES:
            return places


def _spheres(rng: np.random.Generator, track: FloatArray) -> list[rho.Sphere]:
    """Return a sphere near the middle of each leg."""
    middles = (track[:-1] + track[1:]) / 2.0
    centers = middles + rng.uniform(-1.0, 1.0, middles.shape)
    radii = rng.uniform(0.5, 1.2, len(middles))
    return [rho.Sphere(x, float(r)) for x, r in zip(centers, radii, strict=True)]


def _lines(rng: np.random.Generator, track: FloatArray, *, crosses: bool) -> FloatArray:
    """Return the places of all vehicles [m], shape (N, L + 1, 3), in lines around the track's."""
    count = len(track)
    lines = _directions(rng, count if crosses else 1, steepness=1.0)
    lines = np.broadcast_to(lines, (count, 3))
    along = BESIDE * (np.arange(VEHICLES) - (VEHICLES - 1) / 2.0)
    orders = [rng.permutation(along) if crosses else along for _ in range(count)]
    return np.asarray(track + np.stack(orders, axis=1)[..., None] * lines)


def _directions(rng: np.random.Generator, count: int, steepness: float) -> FloatArray:
    """Return random unit vectors, shape (count, 3), less or more level."""
    ways = rng.normal(size=(count, 3)) * [1.0, 1.0, steepness]
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))
