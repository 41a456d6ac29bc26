"""Clearance in continuous time: against dense sampling and against exact rational numbers."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.extremes import turning_points
from tests.motions import closest_approach, from_start

seeds = st.integers(0, 2**32 - 1)
small = st.integers(-6, 6)


def _random_motion(seed: int) -> tuple[Motion, np.ndarray]:
    rng = np.random.default_rng(seed)
    start = rho.State(rng.normal(size=3), rng.normal(size=3))
    a = rng.normal(size=(int(rng.integers(1, 12)), 3)) * 10 ** rng.uniform(-1, 1)
    return from_start(start, a, 10 ** rng.uniform(-1, 0.5)), rng.normal(size=3)


@given(seed=seeds)
def test_nothing_sampled_is_closer(seed: int) -> None:
    motion, center = _random_motion(seed)
    times, distances = closest_approach(motion, center)
    h = motion.step
    for k, (time, distance) in enumerate(zip(times, distances, strict=True)):
        assert h * k <= time <= h * (k + 1) * (1 + 1e-15)
        dense = motion.at("position", np.linspace(h * k, h * (k + 1), 1001))
        sampled = np.linalg.norm(dense - center, axis=1).min()
        scale = np.abs(dense - center).max()
        assert distance <= sampled + 1e-12 * scale
        attained = np.linalg.norm(motion.at("position", time)[0] - center)
        assert distance == pytest.approx(attained, abs=1e-12 * scale)


@given(p=st.tuples(small, small), v=st.tuples(small, small), a=st.tuples(small, small))
def test_the_time_of_closest_approach_is_a_root_of_the_exact_cubic(
    p: tuple[int, int], v: tuple[int, int], a: tuple[int, int]
) -> None:
    """In rational arithmetic the derivative changes sign within an ulp of the returned time."""
    start = rho.State([*p, 0.0], [*v, 0.0])
    motion = from_start(start, np.array([[*a, 0.0]]), 1.0)
    time = float(closest_approach(motion, np.zeros(3))[0][0])

    def slope(s: Fraction) -> Fraction:
        at = [pi + vi * s + Fraction(ai, 2) * s**2 for pi, vi, ai in zip(p, v, a, strict=True)]
        return sum((x * (vi + ai * s) for x, vi, ai in zip(at, v, a, strict=True)), Fraction(0))

    def length(s: Fraction) -> Fraction:
        at = [pi + vi * s + Fraction(ai, 2) * s**2 for pi, vi, ai in zip(p, v, a, strict=True)]
        return sum((x * x for x in at), Fraction(0))

    found = Fraction(time)
    nearby = Fraction(1, 10**12)
    if 0 < found < 1 and slope(found) != 0:
        assert slope(found - nearby) <= 0 <= slope(found + nearby)
    for n in range(101):
        assert length(found) <= length(Fraction(n, 100)) + nearby


def test_a_fly_by_in_the_middle_of_a_step_is_found() -> None:
    start = rho.State([-3.0, 4.0, 0.0], [2.0, 0.0, 0.0])
    motion = from_start(start, np.zeros((3, 3)), 1.0)
    times, distances = closest_approach(motion, np.zeros(3))
    np.testing.assert_allclose(times, [1.0, 1.5, 2.0])
    np.testing.assert_allclose(distances, [np.sqrt(17), 4.0, np.sqrt(17)])


def test_two_minima_in_one_step_are_both_found() -> None:
    """A parabola comes near a point twice: the closer approach is taken."""
    start = rho.State([0.15, -1.0, 0.0], [-0.3, 4.0, 0.0])
    motion = from_start(start, np.array([[0.0, -8.0, 0.0]]), 1.0)
    center = np.array([0.01, -0.6, 0.0])
    dense = np.linalg.norm(motion.at("position", np.linspace(0, 1, 100001)) - center, axis=1)
    turns = np.flatnonzero((dense[1:-1] < dense[:-2]) & (dense[1:-1] < dense[2:]))
    assert len(turns) == 2
    assert closest_approach(motion, center)[1][0] == pytest.approx(dense.min(), abs=1e-9)


@given(seed=seeds)
def test_extremes_between_knots_are_never_exceeded(seed: int) -> None:
    motion, _ = _random_motion(seed)
    times, positions = turning_points(motion)
    h, steps = motion.step, len(motion.accelerations)
    scale = np.abs(motion.positions).max()
    for k in range(steps):
        dense = motion.at("position", np.linspace(h * k, h * (k + 1), 501))
        extremes = np.stack([positions[k], motion.positions[k], motion.positions[k + 1]])
        assert np.all(dense.max(axis=0) <= extremes.max(axis=0) + 1e-12 * scale)
        assert np.all(dense.min(axis=0) >= extremes.min(axis=0) - 1e-12 * scale)
        for axis in range(3):
            at = motion.at("position", times[k, axis])[0, axis]
            assert at == pytest.approx(positions[k, axis], abs=1e-12 * scale)


def test_several_vehicles_at_once_equal_each_one_separately() -> None:
    plan = rho.plan_convex(rho.load_scenario("paper"))
    center = plan.scenario.spheres[0].center
    _, together = closest_approach(plan.motion(), center)
    for index, vehicle in enumerate(plan.scenario.vehicles):
        _, alone = closest_approach(
            from_start(vehicle.start, plan.accelerations[index], 1.0), center
        )
        np.testing.assert_allclose(together[index], alone, atol=1e-9)
