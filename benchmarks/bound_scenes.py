"""Scenes whose global optima are bounded, and the bound of one of them."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.stopwatch import Stopwatch
from drake_rho.scenario.fields import FloatArray

KINDS = "sphere", "box", "cylinder", "ellipsoid", "polytope"
"""Kinds of obstacles."""

PACKAGES = ("drake-rho", "drake", "numpy", "scipy", "clarabel")
"""Packages that bounds are computed with."""


@dataclasses.dataclass(frozen=True)
class Lap:
    """Bound of one scene."""

    name: str
    """name of the scene"""
    cost: float | None
    """of the best plan [m²/s⁴]; None if there was no plan"""
    gap: float
    """(cost - bound) / cost"""
    cheaper: float
    """part by which the best plan costs less than that of `rho.plan`"""
    nodes: int
    """number of branches that were bounded"""
    seconds: float
    """processor time [s]"""
    checked: float | None
    """bound by `rho.check_certificate` over the certificate's; None if files do not hold it"""


def bounded(scenario: rho.Scenario, gap: float, time_limit: float) -> Lap:
    """Return the bound of a scene's least cost."""
    watch = Stopwatch()
    try:
        first = rho.plan(scenario)
        best = rho.plan_global(scenario, gap=gap, time_limit=time_limit)
    except (rho.InfeasibleError, rho.OutOfTimeError):
        return Lap(scenario.name, None, np.inf, 0.0, 0, watch.taken().processor, None)
    taken, certificate = watch.taken().processor, best.certificate
    if not rho.verify(best.plan).ok:
        raise AssertionError(f"{scenario.name}: the best plan violates its constraints")
    cheaper = 1.0 - certificate.cost / first.cost
    checked = _checked(certificate)
    return Lap(
        *(scenario.name, certificate.cost, certificate.gap, cheaper, certificate.nodes, taken),
        None if checked is None else checked / certificate.lower_bound,
    )


def _checked(certificate: rho.Certificate) -> float | None:
    """Return the bound of a certificate's file; None if files do not hold the scenario."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scene.proof")
        try:
            certificate.save(path)
        except ValueError:
            return None
        return rho.check_certificate(path).lower_bound


def among_shapes(seed: int) -> rho.Scenario:
    """Return one vehicle among one to twelve obstacles of every kind."""
    rng = np.random.default_rng([seed, 12])
    start, goal = np.array([0.0, 0.0, 0.0]), np.array([12.0, *rng.uniform(-1.0, 1.0, 2)])
    obstacles = list[rho.Obstacle]()
    for _ in range(int(rng.integers(1, 13))):
        center = np.array([rng.uniform(2.5, 9.5), *rng.uniform(-2.5, 2.5, 2)])
        obstacles.append(rho.Obstacle(_shape(str(rng.choice(KINDS)), center, rng)))
    vehicle = rho.Vehicle("v", rho.State(start), rho.State(goal), radius=0.2)
    limits = rho.Limits(max_speed=4.0, max_acceleration=4.0)
    grid = rho.Grid.lasting(8.0, step=0.4)
    return rho.Scenario(f"shapes {seed}", grid, [vehicle], limits, obstacles)


def _shape(
    kind: str, center: FloatArray, rng: np.random.Generator
) -> rho.Sphere | rho.Box | rho.Cylinder | rho.Ellipsoid | rho.Polytope:
    """Return a shape of a kind and a random size."""
    size = rng.uniform(0.3, 1.0, 3)
    if kind == "sphere":
        return rho.Sphere(center, float(size[0]))
    if kind == "box":
        return rho.Box(center - size, center + size)
    if kind == "cylinder":
        return rho.Cylinder(center, float(size[0]), float(2.0 * size[1]))
    if kind == "ellipsoid":
        return rho.Ellipsoid(center, size)
    return rho.Polytope(center + size * rng.uniform(-1.0, 1.0, (12, 3)))


def six_among_two(seed: int) -> rho.Scenario:
    """Return six vehicles that exchange sides past a box and a sphere."""
    rng = np.random.default_rng([seed, 6])
    ends = np.array([[-4.0, y, z] for y in (-1.5, 0.0, 1.5) for z in (-0.6, 0.6)])
    starts = ends + rng.uniform(-0.3, 0.3, ends.shape)
    goals = ends[rng.permutation(6)] * [-1.0, 1.0, 1.0] + rng.uniform(-0.3, 0.3, ends.shape)
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State(a), rho.State(b), radius=0.15)
        for i, (a, b) in enumerate(zip(starts, goals, strict=True))
    ]
    box = rho.Box([-1.5, -1.2, -0.8], [-0.7, 0.2, 0.8])
    ball = rho.Sphere([1.2, *rng.uniform(-0.8, 0.8, 2)], 0.8)
    grid, apart = rho.Grid.lasting(6.0, step=0.4), rho.Separation(0.5)
    limits = rho.Limits(max_speed=4.0, max_acceleration=4.0)
    name = f"six, a box and a sphere {seed}"
    return rho.Scenario(name, grid, vehicles, limits, [box, ball], apart)


def median_gap(laps: Sequence[Lap]) -> float:
    """Return the median gap; that of a scene without a plan is infinite."""
    return float(np.median([each.gap for each in laps]))
