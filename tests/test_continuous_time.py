"""The verifier's branch and bound, compared with dense sampling and the planner's exact roots."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.close_pairs import PairSearch
from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.extremes import turning_points
from drake_rho.verification.continuous_time import Least, least_over_time
from drake_rho.verification.separation import closest_at_all_times, closest_at_knots
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import ErrorRadii
from tests.motions import closest_approach
from tests.scenarios import fleet
from tests.tolerances import ROUNDING

seeds = st.integers(0, 2**32 - 1)
PRECISION = 1e-8
"""Relative to the size of a motion: a hundredth of the tolerance of a sphere of that size."""


def _motions(p: np.ndarray, v: np.ndarray, a: np.ndarray, h: float) -> Motion:
    """Return motions from starts of shape (N, 3) with accelerations of shape (N, K-1, 3)."""
    return Motion(h, *roll_out(p, v, a, h), a, *2 * [np.full(p.shape, np.nan)])


def _random(seed: int) -> tuple[Motion, float]:
    """Return motions in random units of length and time, and their typical length."""
    rng = np.random.default_rng(seed)
    count, steps = int(rng.integers(1, 5)), int(rng.integers(1, 9))
    size, h = 10 ** rng.uniform(-2, 4), 10 ** rng.uniform(-2, 2)
    p, v = size * rng.normal(size=(count, 3)), size / h * rng.normal(size=(count, 3))
    a = size / h**2 * rng.normal(size=(count, steps, 3)) * 10 ** rng.uniform(-3, 1)
    return _motions(p, v, a, h), size


def _least(
    motion: Motion, distance: Callable[[np.ndarray], np.ndarray], precision: float
) -> tuple[np.ndarray, np.ndarray]:
    states = motion.positions, motion.velocities, motion.accelerations
    return _lowest(motion.step, states, distance, precision)


def _lowest(
    step: float,
    states: tuple[np.ndarray, np.ndarray, np.ndarray],
    distance: Callable[[np.ndarray], np.ndarray],
    precision: npt.ArrayLike,
) -> tuple[np.ndarray, np.ndarray]:
    """Return times and least distances of motions."""
    steps, (*shape, count, _) = Steps.of(step, *states), states[2].shape
    unknown = Least.unknown(np.full(math.prod(shape), np.inf))
    owners, exact = np.arange(len(steps.p)) // count, ErrorRadii.constant(np.zeros(len(steps.p)))
    each = np.broadcast_to(precision, shape).ravel()[owners]
    found = least_over_time(steps, owners[:, None], distance, each, unknown, exact)
    times = step * (found.steps % count + found.moments)
    return times.reshape(shape), found.values.reshape(shape)


def _trajectory(motion: Motion) -> PiecewiseTrajectory:
    """Return a motion as the verifier sees it, in a scenario without constraints."""
    count, steps = motion.accelerations.shape[:2]
    places = 3.0 * np.arange(count)[:, None] * [1.0, 0.0, 0.0]
    scenario = fleet(places, places, grid=rho.Grid(motion.step, steps + 1))
    return PiecewiseTrajectory.of(scenario, motion)


def _length(positions: np.ndarray) -> np.ndarray:
    lengths: np.ndarray = np.linalg.norm(positions, axis=-1)
    return lengths


def _cuboid(positions: np.ndarray) -> np.ndarray:
    """Return the signed distance of a cuboid around the origin with half sides 1, 2 and 0.5."""
    beyond = np.abs(positions) - [1.0, 2.0, 0.5]
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    signed: np.ndarray = outside + np.minimum(beyond.max(axis=-1), 0.0)
    return signed


def _dense(motion: Motion, per_step: int = 500) -> np.ndarray:
    """Return positions at equal times, shape (N, M, 3)."""
    times = np.linspace(0.0, motion.step * motion.accelerations.shape[1], per_step * 8 + 1)
    return motion.at("position", times)


@given(seed=seeds)
def test_the_closest_approach_is_that_of_the_exact_roots(seed: int) -> None:
    motion, size = _random(seed)
    times, distances = _least(motion, _length, PRECISION * size)
    exact = closest_approach(motion, np.zeros(3))[1].min(axis=-1)
    np.testing.assert_allclose(distances, exact, rtol=0.0, atol=PRECISION * size)
    for index, time in enumerate(times):
        attained = np.linalg.norm(motion.at("position", time)[index, 0])
        assert attained == pytest.approx(distances[index], abs=ROUNDING * size * 100)


@pytest.mark.parametrize("distance", [_length, _cuboid])
@given(seed=seeds)
def test_nothing_sampled_is_closer(distance: Callable[[np.ndarray], np.ndarray], seed: int) -> None:
    motion, size = _random(seed)
    _, distances = _least(motion, distance, PRECISION * size)
    sampled = distance(_dense(motion)).min(axis=1)
    assert np.all(distances <= sampled + PRECISION * size)


@given(seed=seeds)
def test_a_tangent_motion_is_found_to_touch(seed: int) -> None:
    """The motion is tangent to a unit sphere within a step, straight or curved either way."""
    rng = np.random.default_rng(seed)
    normal, along = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    moment, speed = rng.uniform(0.0, 4.0), 10 ** rng.uniform(-1, 1)
    a = rng.uniform(-1.0, 3.0) * speed**2 * normal  # at -1 as curved as the sphere
    v = speed * along
    start, at_start = normal - moment * v + moment**2 / 2 * a, v - moment * a
    motion = _motions(start[None], at_start[None], np.tile(a, (1, 4, 1)), 1.0)
    (time,), (distance,) = _least(motion, _length, PRECISION)
    (exact,) = closest_approach(motion, np.zeros(3))[1].min(axis=-1)
    assert distance == pytest.approx(exact, abs=PRECISION)
    assert distance <= 1.0 + PRECISION
    if distance > 1.0 - 1e-3:
        assert time == pytest.approx(moment, abs=0.1)


def test_motions_on_a_circle_touch_in_every_step() -> None:
    """The acceleration follows the circle: every step touches it, and every bound is tight."""
    angles = 0.15 * np.arange(40)
    h, speed = 1.0, 150.0
    p = 1000.0 * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    v = speed * np.column_stack([-np.sin(angles), np.cos(angles), 0.0 * angles])
    a = -(speed**2) / 1000.0**2 * p[:, None]
    motion = _motions(p, v, a, h)
    times, distances = _least(motion, _length, 1e-5)
    np.testing.assert_allclose(distances, 1000.0, atol=1e-5)
    np.testing.assert_allclose(times, 0.0, atol=0.1)


def test_a_motion_through_the_centre_has_distance_zero() -> None:
    p, v = np.array([[-3.0, 0.3, 0.0]]), np.array([[2.0, -0.2, 0.0]])
    motion = _motions(p, v, np.zeros((1, 4, 3)), 1.0)
    times, distances = _least(motion, _length, 1e-8)
    assert times[0] == pytest.approx(1.5, abs=1e-8)
    assert distances[0] == pytest.approx(0.0, abs=1e-8)


def test_a_motion_at_rest_has_the_distance_of_its_start() -> None:
    motion = _motions(np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3)), np.zeros((1, 5, 3)), 2.0)
    assert [each.tolist() for each in _least(motion, _length, 1e-9)] == [[0.0], [5.0]]


def test_a_motion_that_accelerates_along_a_face_touches_it() -> None:
    """In the hardest case the distance is constant, and the motion is not linear in time."""
    p, a = np.array([[-0.5, 0.0, 0.5]]), np.array([[[0.5, 0.1, 0.0]]])
    motion = _motions(p, np.zeros((1, 3)), a, 1.0)
    _, distances = _least(motion, _cuboid, 1e-8)
    assert distances[0] == pytest.approx(0.0, abs=1e-8)


@given(seed=seeds)
def test_extremes_are_those_of_the_exact_turning_points(seed: int) -> None:
    motion, size = _random(seed)
    _, turns = turning_points(motion)
    every = np.concatenate([motion.positions, turns], axis=1)
    for axis in range(3):
        states = (motion.positions, motion.velocities, motion.accelerations)
        p, v, a = (each[..., axis : axis + 1] for each in states)
        _, least = _lowest(motion.step, (p, v, a), lambda x: x[..., 0], PRECISION * size)
        exact = every[..., axis].min(axis=1)
        np.testing.assert_allclose(least, exact, rtol=0.0, atol=PRECISION * size)


def test_each_motion_has_a_precision_of_its_own() -> None:
    rng = np.random.default_rng(3)
    motion = _motions(rng.normal(size=(50, 3)), rng.normal(size=(50, 3)), np.ones((50, 6, 3)), 0.5)
    precision = 10.0 ** rng.uniform(-9, -1, size=50)
    states = motion.positions, motion.velocities, motion.accelerations
    _, distances = _lowest(motion.step, states, _length, precision)
    exact = closest_approach(motion, np.zeros(3))[1].min(axis=-1)
    assert np.all(distances - exact <= precision)
    assert np.all(distances >= exact * (1 - ROUNDING))


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308])
def test_a_nan_distance_does_not_affect_the_others(bad: float) -> None:
    a = np.zeros((2, 3, 3))
    a[0, 1, 0] = bad
    with np.errstate(all="ignore"):
        motion = _motions(np.ones((2, 3)), np.zeros((2, 3)), a, 10.0)
        _, distances = _least(motion, _length, 1e-9)
    assert np.isnan(distances[0])
    assert distances[1] == pytest.approx(np.sqrt(3.0))


def _all_pairs(motion: Motion, separation: rho.Separation, *, every_instant: bool) -> np.ndarray:
    """Return the least distance of each vehicle from any other, by a visit to every pair."""
    search = PairSearch(separation)
    every = (search.in_steps if every_instant else search.at_knots)(motion, 1e12)
    least = np.full(len(motion.positions), np.inf)
    np.minimum.at(least, np.concatenate([every.one, every.other]), np.tile(every.distances, 2))
    return least


@given(seed=seeds)
@settings(max_examples=16)
def test_the_closest_partner_is_that_of_the_exact_roots(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion, size = _random(seed)
    count, steps = int(rng.integers(2, 9)), motion.accelerations.shape[1]
    h = motion.step
    p, v = size * rng.normal(size=(count, 3)), size / h * rng.normal(size=(count, 3))
    a = size / h**2 * rng.normal(size=(count, steps, 3)) * rng.integers(0, 2)
    if rng.random() < 0.3:
        p[1], v[1], a[1] = p[0], v[0], a[0]  # always in the same place
    motion = _motions(p, v, a, h)
    separation = rho.Separation(size * rng.uniform(0.1, 2.0), rng.choice([0.5, 1.0, 2.0]))
    knots = closest_at_knots(_trajectory(motion), separation)
    always = closest_at_all_times(_trajectory(motion), separation, knots, PRECISION * size)
    for found, every_instant in ((knots, False), (always, True)):
        exact = _all_pairs(motion, separation, every_instant=every_instant)
        # elsewhere the verifier may stop at an upper bound
        near = exact <= 4.0 * separation.distance
        np.testing.assert_allclose(
            found.distances[near], exact[near], rtol=0.0, atol=PRECISION * size
        )
        assert np.all(found.distances >= exact - PRECISION * size)
        for index, (partner, time) in enumerate(zip(found.partners, found.times, strict=True)):
            two = motion.of(np.array([index, partner])).at("position", time)[:, 0]
            attained = np.linalg.norm(separation.scaled(two[0] - two[1]))
            scale = np.abs(motion.positions).max()
            assert attained == pytest.approx(found.distances[index], abs=ROUNDING * scale)


def test_a_swap_in_the_middle_of_a_step_is_a_collision() -> None:
    p, v = np.array([[-5.0, 0, 0], [5.0, 0, 0], [0, 9, 0]]), np.array([[2.0, 0, 0], [-2.0, 0, 0]])
    motion = _motions(p, np.append(v, np.zeros((1, 3)), axis=0), np.zeros((3, 5, 3)), 1.0)
    separation = rho.Separation(1.0)
    knots = closest_at_knots(_trajectory(motion), separation)
    assert knots.distances[:2].tolist() == [2.0, 2.0]
    found = closest_at_all_times(_trajectory(motion), separation, knots, 1e-8)
    assert found.partners[:2].tolist() == [1, 0]
    np.testing.assert_allclose(found.times[:2], 2.5, atol=1e-8)
    np.testing.assert_allclose(found.distances[:2], 0.0, atol=1e-8)
    assert found.distances[2] == pytest.approx(9.0, abs=0.1)
