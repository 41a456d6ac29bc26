"""Shapes for tests: one of each kind, and random ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import drake_rho as rho
from tests.arrays import FloatArray

Shape = rho.Sphere | rho.Box | rho.Ellipsoid | rho.Cylinder | rho.Polytope | rho.Capsule | rho.Posed
"""Any bounded shape that an obstacle can have."""

KINDS: dict[str, Callable[[np.random.Generator, FloatArray, float], Shape]] = {
    "sphere": lambda rng, at, size: rho.Sphere(at, size * rng.uniform(0.2, 1.0)),
    "box": lambda rng, at, size: rho.Box(
        at - size * rng.uniform(0.1, 1.0, 3), at + size * rng.uniform(0.1, 1.0, 3)
    ),
    "ellipsoid": lambda rng, at, size: rho.Ellipsoid(at, size * rng.uniform(0.1, 1.0, 3)),
    "cylinder": lambda rng, at, size: rho.Cylinder(
        at, size * rng.uniform(0.1, 1.0), size * rng.uniform(0.1, 2.0), rng.choice(["x", "y", "z"])
    ),
    "endless cylinder": lambda rng, at, size: rho.Cylinder(
        at, size * rng.uniform(0.1, 1.0), axis=rng.choice(["x", "y", "z"])
    ),
    "polytope": lambda rng, at, size: rho.Polytope(
        at + size * rng.uniform(-1.0, 1.0, (int(rng.integers(4, 20)), 3))
    ),
    "capsule": lambda rng, at, size: rho.Capsule(
        at - size * rng.uniform(-1.0, 1.0, 3),
        at + size * rng.uniform(-1.0, 1.0, 3),
        size * rng.uniform(0.1, 1.0),
    ),
    "posed": lambda rng, at, size: rho.Posed(
        KINDS[rng.choice(["box", "cylinder", "polytope"])](rng, np.zeros(3), size),
        rng.uniform(-3.0, 3.0, 3),
        at,
    ),
}
"""Constructor of a random shape of each kind, around a position and of a size."""


def random_shape(rng: np.random.Generator, kind: str, at: FloatArray, size: float) -> Shape:
    """Return a shape of a kind; flat polytopes are drawn again."""
    while True:
        try:
            shape = KINDS[kind](rng, at, size)
            shape.check_solid()
        except rho.ScenarioError:
            continue
        return shape
