"""The moves of a lattice, compared with dense sampling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.planning.path_search.lattice import MOVES, STAY, Lattice, Raster
from drake_rho.planning.path_search.moving_obstacles import Moving, MovingObstacle, MovingVehicle
from drake_rho.planning.path_search.space_time import TimeExpandedGraph
from drake_rho.planning.path_search.swept_clearance import convex_lower_bound
from tests.arrays import FloatArray

DENSE = np.linspace(0.0, 1.0, 41)[:, None]
"""Relative times within a move."""


@given(
    st.lists(st.floats(-3, 3), min_size=6, max_size=6),
    st.lists(st.floats(0.2, 2), min_size=3, max_size=3),
    st.integers(3, 9),
)
def test_the_bound_of_a_distance_is_below_all_of_it(
    ends: list[float], half: list[float], samples: int
) -> None:
    box = rho.Box(-np.array(half), half)
    one, other = np.array(ends).reshape(2, 3)
    values = box.local_distance(one + np.linspace(0, 1, samples)[:, None] * (other - one))
    bound = convex_lower_bound(values, np.asarray(np.linalg.norm(other - one)))
    dense = box.local_distance(one + DENSE * (other - one))
    assert bound <= dense.min() + 1e-9
    assert bound >= values.min() - np.linalg.norm(other - one) / 2.0 / (samples - 1) - 1e-9


def world() -> tuple[Lattice, list[rho.Obstacle]]:
    """Return a lattice of about a thousand points among three obstacles."""
    obstacles = [
        rho.Obstacle(rho.Box([0.2, -1, -2], [0.8, 0.3, 2])),
        rho.Obstacle(rho.Sphere([-1, 0.5, 0], 0.6)),
        rho.Obstacle(rho.Cylinder([1.5, 1.5, 0], 0.3)),
    ]
    raster = Raster.filling(np.full(3, -2.0), np.full(3, 2.0), np.array([0.4, 0.45, 0.5]))
    return Lattice(raster, obstacles, 0.1), obstacles


def test_free_moves_agree_with_dense_sampling() -> None:
    lattice, obstacles = world()
    count = len(lattice.points)
    blocked = unsure = 0
    for u, move in enumerate(MOVES):
        to = lattice.neighbors[u]
        known = to < count
        start = lattice.points
        x = start + DENSE[:, None] * move * lattice.raster.spacing
        least = np.min(
            [body.shape.local_distance(x - body.shape.center).min(axis=0) for body in obstacles],
            axis=0,
        )
        inside = np.all(abs(start + move * lattice.raster.spacing) < 2.0 + 1e-9, axis=1)
        assert np.all(least[known] >= 0.1 - 1e-5)
        assert np.array_equal(lattice.points[to[known]], (start + x[-1] - start)[known]) or (
            np.allclose(lattice.points[to[known]], x[-1][known])
        )
        unsure += int(np.sum(inside & ~known & (least > 0.1)))
        blocked += int(np.sum(inside & ~known))
    assert blocked > 1000
    assert unsure < 0.02 * blocked  # some moves that only touch are left out, for lack of certainty


def test_obstacles_may_be_added_to_a_lattice() -> None:
    every, obstacles = world()
    some = Lattice(every.raster, obstacles[:1], 0.1)
    points = some.points.copy()
    more = some.with_more(obstacles[1:])
    assert np.array_equal(more.points, every.points)
    assert np.array_equal(more.neighbors, every.neighbors)
    one, other = np.array([[-1.9, 0.5, 0.0]]), np.array([[-0.1, 0.5, 0.0]])  # across the sphere
    assert some.are_clear(one, other).all()
    assert not more.are_clear(one, other).any()
    assert np.array_equal(some.points, points)  # the lattice without them is as it was


def test_moves_are_reversible() -> None:
    lattice, _ = world()
    count = len(lattice.points)
    assert np.array_equal(lattice.neighbors[STAY], np.arange(count))
    for u in range(len(MOVES)):
        to = lattice.neighbors[u]
        known = to < count
        assert np.array_equal(lattice.neighbors[26 - u, to[known]], np.flatnonzero(known))


def moving_things() -> list[tuple[Moving, object]]:
    """Return what moves through the lattice, or grows in it, in eight layers of 0.5 s."""
    times = np.linspace(0.0, 4.0, 9)
    obstacle = rho.Obstacle(rho.Box([-2, -0.4, -0.4], [-1.2, 0.4, 0.4]), velocity=[0.8, 0.1, 0.2])
    way = np.stack([np.linspace(2, -2, 9), 0.3 * np.cos(times), 0.2 * times - 0.5], axis=-1)
    separation = rho.Separation(0.5, 1.5)

    def from_obstacle(x: FloatArray, t: FloatArray) -> FloatArray:
        return obstacle.shape.local_distance(x - obstacle.centers(t)[:, None, None]) - 0.1

    def from_vehicle(x: FloatArray, t: FloatArray) -> FloatArray:
        at = np.stack([np.interp(t, times, axis) for axis in way.T], axis=-1)
        away = separation.scaled(x - at[:, None, None])
        distances: FloatArray = np.linalg.norm(away, axis=-1) - 0.5
        return distances

    growing = rho.Obstacle(obstacle.shape, velocity_error=0.3, seen_at=1.2, position_error=0.1)

    def from_growing(x: FloatArray, t: FloatArray) -> FloatArray:
        far = 0.1 + 0.3 * np.maximum(t - 1.2, 0.0)[:, None, None]
        return growing.shape.local_distance(x - growing.shape.center) - 0.1 - far

    return [
        (MovingObstacle(obstacle, 0.1, times), from_obstacle),
        (MovingVehicle(way, separation), from_vehicle),
        (MovingObstacle(growing, 0.1, times), from_growing),
    ]


@pytest.mark.parametrize("which", [0, 1, 2])
def test_blocked_moves_agree_with_dense_sampling(which: int) -> None:
    moving, distance = moving_things()[which]
    lattice, _ = world()
    count = len(lattice.points)
    layers = TimeExpandedGraph(lattice, 8, [moving])
    found = 0
    for t in (0, 3, 5):
        u, start = np.nonzero(lattice.neighbors < count)
        to = lattice.neighbors[u, start]
        x = lattice.points[start] + DENSE[:, None] * (lattice.points[to] - lattice.points[start])
        least = distance(x[:, None], 0.5 * (t + DENSE[:, 0]))[:, 0].min(axis=0)  # type: ignore[operator]
        blocked = np.isin(u * count + to, layers.blocked[t])
        # moves that begin inside an obstacle, which nothing reaches, are not compared

        inside = moving.blocks & (distance(x[:1, None], np.array([0.5 * t]))[0, 0] < 0.0)  # type: ignore[operator]
        assert np.all(blocked[(least < -1e-4) & ~(inside & (t > 0))])
        assert not np.any(blocked[least > 0.05])
        found += int(blocked.sum())
    assert found > 500
