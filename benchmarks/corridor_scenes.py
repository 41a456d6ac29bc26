"""Random corridors of overlapping boxes at given times, for one vehicle."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray

FEWEST, MOST, STEP, LEAST_STEPS = 5, 20, 0.25, 4
"""Fewest and most boxes, step of the grid [s], and least number of steps in a box."""


def corridor(seed: int, *, every_instant: bool = False) -> rho.Scenario:
    """Return one corridor; those of even seeds are flat.

    A box holds a piece of a random polyline, so corners lie in two boxes each. From rest to rest
    along each piece is a motion that keeps all boxes, so every corridor has a plan.
    """
    rng = np.random.default_rng([27, seed])
    flat, count = seed % 2 == 0, int(rng.integers(FEWEST, MOST + 1))
    corners = _polyline(rng, count, flat=flat)
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    steps = np.maximum(np.rint(lengths / rng.uniform(2.0, 5.0) / STEP).astype(int), LEAST_STEPS)
    grid = rho.Grid(STEP, int(steps.sum()) + 1)
    times = grid.times[np.append(0, np.cumsum(steps))]
    boxes = [_box(rng, *ends, flat=flat) for ends in pairwise(corners)]
    kept = [
        rho.KeepIn(box, active=(float(first), float(last)))
        for box, first, last in zip(boxes, times, times[1:], strict=False)
    ]
    return rho.Scenario(
        f"{count} {'flat ' if flat else ''}boxes, seed {seed}",
        grid,
        [rho.Vehicle("v0", rho.State(corners[0]), rho.State(corners[-1]))],
        requirements=kept,
        between_knots=every_instant,
    )


def _polyline(rng: np.random.Generator, pieces: int, *, flat: bool) -> FloatArray:
    """Return corners of a polyline that turns by less than 120 degrees, shape (pieces + 1, 3)."""
    ways = list[FloatArray]()
    while len(ways) < pieces:
        way = rng.normal(size=3) * [1.0, 1.0, 0.0 if flat else 1.0]
        way /= np.linalg.norm(way)
        if not ways or way @ ways[-1] > -0.5 * np.linalg.norm(ways[-1]):
            ways.append(rng.uniform(2.0, 10.0) * way)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(ways, axis=0)])


def _box(rng: np.random.Generator, first: FloatArray, last: FloatArray, *, flat: bool) -> rho.Box:
    """Return a box that holds two points, 0.2 to 1.5 m from its sides; flat ones have no height."""
    spare = rng.uniform(0.2, 1.5, (2, 3)) * [1.0, 1.0, 0.0 if flat else 1.0]
    return rho.Box(np.minimum(first, last) - spare[0], np.maximum(first, last) + spare[1])
