"""Chains of relays behind a leader among obstacles, each scene around a known motion."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray

DURATION, STEPS = 20.0, 40
"""Duration of a flight [s], and its number of steps."""

_RADIUS, _SPARE = 0.3, 0.5
"""Radius of a vehicle, and least distance of the known motion from obstacles [m]."""

_FINE = 4001
"""Points by which the path is measured."""

_PRICE = 0.1
"""Price of a squared change of the known motion's acceleration, in squared metres [s⁴]."""


class ChainScene(NamedTuple):
    """Scene, and the motion that it was built around."""

    scenario: rho.Scenario
    """scenario"""
    known: rho.Plan
    """the motion, with accelerations that are constant in every step"""


def chain_scene(seed: int) -> ChainScene:
    """Return one scene; the same seed gives the same one.

    Scenes of odd seeds have endless cylinders, the others spheres; those of seeds 2 and 3 modulo 4
    have three waypoints of the leader.
    """
    rng = np.random.default_rng(seed)
    count, link = int(rng.integers(2, 11)), float(rng.uniform(2.5, 9.0))
    rng.uniform()  # keeps these scenes those that the planner was tried on
    times = np.linspace(0.0, DURATION, 801)
    motions = _motions(rng, count, (0.92 if seed % 3 else 0.75) * link, times)
    obstacles = _obstacles(rng, motions, 12 + 2 * (seed % 12), upright=seed % 2 == 1)
    names = [f"r{i}" for i in range(count)]
    vehicles = [
        rho.Vehicle(name, rho.State(each[0]), rho.State(each[-1]), radius=_RADIUS)
        for name, each in zip(names, motions, strict=True)
    ]
    if seed % 4 > 1:
        places = [rho.Waypoint(float(times[k]), motions[0, k], within=0.5) for k in (200, 400, 600)]
        vehicles[0] = dataclasses.replace(vehicles[0], waypoints=tuple(places))
    links = [
        rho.KeepIn(rho.Ball([0.0, 0.0, 0.0], link), vehicles=name, relative_to=before)
        for before, name in pairwise(names)
    ]
    grid = rho.Grid.lasting(DURATION, step=DURATION / STEPS)
    scenario = rho.Scenario(
        f"chain of {count}, seed {seed}",
        grid,
        vehicles,
        _limits(motions, float(times[1])),
        obstacles,
        requirements=links,
    )
    return ChainScene(scenario, _known(scenario, motions))


def _motions(rng: np.random.Generator, count: int, gap: float, times: FloatArray) -> FloatArray:
    """Return the positions of vehicles along one winding path from rest to rest, (N, S, 3).

    Each is a gap behind the one before, or less where the path behind the leader is too short.
    """
    turns = [[60.0 * (i + 1) / 5, rng.uniform(-12, 12), rng.uniform(3, 9)] for i in range(4)]
    ends = [[-30.0, 0.0, 5.0], [0.0, 0.0, 5.0], *turns, [72.0, rng.uniform(-8, 8), 5.0]]
    path = CubicSpline(np.linspace(-0.5, 1.0, 7), np.array(ends), bc_type="natural")
    along = np.linspace(-0.5, 1.0, _FINE)
    pieces = np.linalg.norm(np.diff(path(along), axis=0), axis=1)
    lengths = np.concatenate([[0.0], np.cumsum(pieces)])
    part = times / DURATION
    flown = np.interp(10.0 * part**3 - 15.0 * part**4 + 6.0 * part**5, along, lengths)
    gap *= min(1.0, 0.95 * flown[0] / (gap * (count - 1)))
    return np.array([path(np.interp(flown - i * gap, lengths, along)) for i in range(count)])


def _obstacles(
    rng: np.random.Generator, motions: FloatArray, wanted: int, *, upright: bool
) -> list[rho.Cylinder | rho.Sphere]:
    """Return obstacles that the motions clear: endless upright cylinders, or spheres."""
    found = list[rho.Cylinder | rho.Sphere]()
    axes = 2 if upright else 3
    for _ in range(400):
        if len(found) == wanted:
            break
        lower, upper = [-20, -14, 2], [70, 14, 10]
        center, radius = rng.uniform(lower, upper), float(rng.uniform(1.0, 4.0))
        away = np.linalg.norm((motions - center)[..., :axes], axis=-1)
        if away.min() > radius + _SPARE:
            found.append(rho.Cylinder(center, radius) if upright else rho.Sphere(center, radius))
    return found


def _limits(motions: FloatArray, step: float) -> rho.Limits:
    """Return 1.3 times the highest speed of the motions, and 1.5 times the highest acceleration."""
    velocities = np.gradient(motions, step, axis=1)
    accelerations = np.gradient(velocities, step, axis=1)
    return rho.Limits(
        max_speed=1.3 * float(np.linalg.norm(velocities, axis=2).max()),
        max_acceleration=1.5 * float(np.linalg.norm(accelerations, axis=2).max()),
    )


def _known(scenario: rho.Scenario, motions: FloatArray) -> rho.Plan:
    """Return the plan near motions from rest to rest, (N, S, 3), that ends exactly.

    Its accelerations change the motions' mean ones in each step so that knots are nearest to those
    of the motions, in least squares; without a price on the change they would alternate.
    """
    steps, h = scenario.grid.knots - 1, scenario.grid.step
    each = (motions.shape[1] - 1) // steps
    knots = motions[:, ::each] - motions[:, :1]
    velocities = np.gradient(motions, h / each, axis=1)[:, ::each]
    mean = np.diff(velocities, axis=1) / h
    moved = h**2 * np.maximum(np.arange(1, steps + 1)[:, None] - np.arange(steps) - 0.5, 0.0)
    exact = np.array([moved[-1], np.full(steps, h)])
    left = knots[:, 1:] - moved @ mean
    ends = np.stack([left[:, -1], -h * mean.sum(axis=1)], axis=1)
    priced = moved.T @ moved + _PRICE * np.eye(steps)
    matrix = np.block([[priced, exact.T], [exact, np.zeros((2, 2))]])
    change = np.linalg.solve(matrix, np.concatenate([moved.T @ left, ends], axis=1))[:, :steps]
    return rho.Plan.from_accelerations(scenario, mean + change)
