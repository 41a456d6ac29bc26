"""Smooth motions: moving averages of plans, their margin, and what they need of a scenario."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.smooth import SmoothMotion
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.smoothing import largest_accelerations
from tests.scenarios import box, fleet, single

LIMITS = rho.Limits(max_speed=4.0, max_acceleration=2.0)
SPHERE = rho.Sphere([5.0, 2.2, -0.9], 1.5)
SMOOTHINGS = [rho.Smoothing(width, times) for times in (1, 2, 3) for width in (0.5, 0.2)]


def smooth(smoothing: rho.Smoothing | None = SMOOTHINGS[0], **changes: Any) -> rho.Scenario:
    """Return one vehicle that flies 10 m around a sphere, with a smoothing."""
    scenario = single(obstacles=[SPHERE], limits=LIMITS, between_knots=True)
    return dataclasses.replace(scenario, **({"smoothing": smoothing} | changes))


def twin(plan: rho.Plan, dt: float = 1e-3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, positions (N, M, 3) and accelerations of a smooth motion, by sums.

    The plan's accelerations are sampled in the middle of intervals dt, averaged over the width as
    often as asked, and summed up twice from rest.
    """
    scenario, smoothing = plan.scenario, plan.scenario.smoothing
    assert smoothing is not None
    grid, width = scenario.grid, round(smoothing.width / dt)
    per_step, lead = round(grid.step / dt), smoothing.times * width
    a = np.repeat(plan.accelerations, per_step, axis=1)
    a = np.pad(a, ((0, 0), (lead, lead), (0, 0)))
    box_of = np.ones(width) / width
    for _ in range(smoothing.times):
        a = np.apply_along_axis(lambda x: np.convolve(x, box_of)[: len(x)], 1, a)
    start = np.array([each.start.position for each in scenario.vehicles])[:, None]
    v = np.cumsum(a, axis=1) * dt
    p = start + np.cumsum(v, axis=1) * dt - v * dt / 2.0
    # a causal average of samples in the middle of intervals is late by half of (n - 1) samples too
    late = smoothing.times * (width - 1) / 2.0
    ends = grid.start + dt * (np.arange(a.shape[1]) + 1.0 - lead - late)
    return ends, p, a


def dense(plan: rho.Plan, per_step: int = 200) -> tuple[np.ndarray, rho.Samples]:
    """Return many times of a flight, and the states then."""
    scenario = plan.scenario
    first, last = scenario.grid.start - scenario.lead, scenario.grid.end + scenario.lead
    times = np.linspace(first, last, per_step * scenario.grid.knots)
    return times, plan.at(times)


@pytest.mark.parametrize("smoothing", SMOOTHINGS, ids=str)
def test_a_smooth_motion_is_the_average_of_its_plan(smoothing: rho.Smoothing) -> None:
    plan = rho.plan(smooth(smoothing))
    times, positions, _ = twin(plan)
    grid, lead = plan.scenario.grid, plan.scenario.lead
    inside = (times >= grid.start - lead) & (times <= grid.end + lead)
    own = plan.at(times[inside]).positions
    assert np.abs(own - positions[:, inside]).max() < 2e-6
    drake = plan.trajectory("solo")
    assert drake.start_time() == pytest.approx(-lead)
    assert drake.end_time() == pytest.approx(grid.end + lead)
    assert drake.value(drake.start_time()).ravel() == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert drake.value(drake.end_time()).ravel() == pytest.approx([10.0, 4.0, -2.0], abs=1e-9)
    for order, values in enumerate((own, *_rates(plan, times[inside]))):
        drakes = drake.derivative(order).vector_values(times[inside]).T
        assert np.abs(drakes - values[0]).max() < 1e-9


def _rates(plan: rho.Plan, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    samples = plan.at(times)
    return samples.velocities, samples.accelerations


@pytest.mark.parametrize("smoothing", SMOOTHINGS, ids=str)
def test_derivatives_are_continuous_up_to_the_number_of_averages(smoothing: rho.Smoothing) -> None:
    drake = rho.plan(smooth(smoothing)).trajectory("solo")
    assert {drake.getSegmentPolynomialDegree(0)} == {smoothing.times + 2}
    corners = np.array(drake.get_segment_times())[1:-1]
    near = 1e-9
    for order in range(smoothing.times + 2):
        rate = drake.derivative(order)
        before, after = (rate.vector_values(corners + side) for side in (-near, near))
        size = np.abs(drake.derivative(order + 1).vector_values(corners + near)).max()
        assert np.abs(after - before).max() <= 3.0 * near * size + 1e-9
    jumping = drake.derivative(smoothing.times + 2)
    jumps = jumping.vector_values(corners + near) - jumping.vector_values(corners - near)
    assert np.abs(jumps).max() > 0.1


def _at_rest(seed: int, knots: int = 9) -> Motion:
    """Return a random motion from rest to rest."""
    a = np.random.default_rng(seed).standard_normal((2, knots - 1, 3))
    a[:, -1] -= a.sum(axis=1)  # ends at rest
    p = np.zeros((2, 3))
    positions, velocities = roll_out(p, p, a, 0.5)
    return Motion(0.5, positions, velocities, a, np.full((2, 3), np.nan))


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.5), st.sampled_from([1, 2, 3]))
def test_no_motion_is_further_from_its_averages_than_the_margin(
    seed: int, width: float, times: int
) -> None:
    motion, smoothing = _at_rest(seed), rho.Smoothing(width, times)
    elapsed = np.linspace(-smoothing.lead, 4.0 + smoothing.lead, 999)
    smoothed, _, _ = SmoothMotion(motion, smoothing).at(elapsed)
    planned = motion.at("position", np.clip(elapsed, 0.0, 4.0))
    most = np.linalg.norm(motion.accelerations, axis=2).max(axis=1)
    apart = np.linalg.norm(smoothed - planned, axis=2).max(axis=1)
    for vehicle in range(2):
        margin = smoothing.margin(float(most[vehicle]))
        assert apart[vehicle] <= margin * (1.0 + 1e-9) + 1e-12


@pytest.mark.parametrize("smoothing", SMOOTHINGS, ids=str)
def test_the_margin_is_attained_where_the_acceleration_is_constant(
    smoothing: rho.Smoothing,
) -> None:
    a = np.repeat([[[0.0, 3.0, 4.0]], [[0.0, -3.0, -4.0]]], 4, axis=1).reshape(1, 8, 3)
    motion = Motion.from_starts(single().fleet, a, 0.5)
    smoothed, _, _ = SmoothMotion(motion, smoothing).at(np.array([1.0]))
    apart = np.linalg.norm(smoothed - motion.at("position", 1.0))
    assert apart == pytest.approx(smoothing.margin(5.0), rel=1e-9)


def _fleet_with(*limits: rho.Limits) -> Fleet:
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State([9.0 * i, 0, 0]), rho.State([9.0 * i, 5, 0]), each)
        for i, each in enumerate(limits)
    ]
    return rho.Scenario("limited", rho.Grid(0.5, 17), vehicles).fleet


def test_limits_bound_accelerations() -> None:
    limits = {
        3.0: rho.Limits(max_acceleration=3.0),
        np.sqrt(3.0): rho.Limits(acceleration=box(1.0), max_acceleration=3.0),
        9.81 + 15.0: rho.Limits(max_thrust=15.0),
        9.81: rho.Limits(max_thrust=9.9, max_tilt=0.3),
        np.inf: rho.Limits(max_tilt=0.3),
    }
    assert largest_accelerations(_fleet_with(*limits.values())) == pytest.approx(list(limits))
    # with a tilt, the largest of many thrusts that are allowed
    rng = np.random.default_rng(0)
    tilts, around = rng.uniform(0.0, 1.2, 99_999), rng.uniform(0.0, 2.0 * np.pi, 99_999)
    direction = [np.sin(tilts) * np.cos(around), np.sin(tilts) * np.sin(around), np.cos(tilts)]
    thrusts = 15.0 * np.sqrt(rng.random(99_999)) * np.array(direction)
    sampled = np.linalg.norm(thrusts - [[0.0], [0.0], [9.81]], axis=0).max()
    bound = largest_accelerations(_fleet_with(rho.Limits(max_thrust=15.0, max_tilt=1.2)))[0]
    assert sampled <= bound <= 1.01 * sampled


@pytest.mark.parametrize("smoothing", SMOOTHINGS, ids=str)
def test_the_smooth_motion_keeps_clear_and_meets_its_limits(smoothing: rho.Smoothing) -> None:
    limits = rho.Limits(
        rho.Box([-0.1, -0.1, -2.005], [10.1, 4.1, 0.1]), max_speed=2.1, max_acceleration=1.5
    )
    plan = rho.plan(smooth(smoothing, limits=limits))
    report = rho.verify(plan)
    assert report.ok
    _, samples = dense(plan)
    away = np.linalg.norm(samples.positions[0] - SPHERE.center, axis=1) - SPHERE.radius
    assert away.min() > -1e-6
    found = next(check for check in report.checks if check.what == "obstacle 1 at all times")
    assert found.value == pytest.approx(away.min(), abs=1e-5)
    own = plan.scenario.limits
    assert own.position is not None
    assert (samples.positions >= own.position.lower - 1e-5).all()
    assert (samples.positions <= own.position.upper + 1e-5).all()
    assert np.linalg.norm(samples.velocities, axis=2).max() <= 2.1 + 1e-5
    assert np.linalg.norm(samples.accelerations, axis=2).max() <= 1.5 + 1e-5
    fastest = np.linalg.norm(plan.velocities, axis=2).max()
    assert np.linalg.norm(samples.velocities, axis=2).max() <= fastest + 1e-9


@pytest.mark.parametrize("smoothing", SMOOTHINGS, ids=str)
def test_the_margin_has_an_effect_and_verify_catches_what_lacks_it(
    smoothing: rho.Smoothing,
) -> None:
    without = rho.plan(smooth(None))
    lacking = rho.Plan.from_accelerations(smooth(smoothing), without.accelerations)
    report = rho.verify(lacking)
    _, samples = dense(lacking, 2000)
    away = np.linalg.norm(samples.positions[0] - SPHERE.center, axis=1) - SPHERE.radius
    assert away.min() < -1e-4
    worst = max(report.violations, key=lambda check: check.excess)
    assert worst.constraint == "obstacle 1"
    assert worst.excess == pytest.approx(-away.min(), abs=1e-6)
    assert rho.plan(smooth(smoothing)).cost > without.cost


def test_verify_sees_limits_that_the_smooth_motion_exceeds() -> None:
    """The verifier looks at every instant of velocities and accelerations, not at knots alone."""
    plan = rho.plan(smooth(rho.Smoothing(0.5, 3)))
    _, samples = dense(plan, 2000)
    speed = np.linalg.norm(samples.velocities, axis=2).max()
    force = np.linalg.norm(samples.accelerations, axis=2).max()
    upright = samples.accelerations + np.array([0.0, 0.0, 9.81])
    thrust = np.linalg.norm(upright, axis=2).max()
    tilt = np.arctan2(np.linalg.norm(upright[..., :2], axis=2), upright[..., 2]).max()
    values = {
        "max_speed": speed,
        "max_acceleration": force,
        "max_thrust": thrust,
        "max_tilt": tilt,
        "velocity": box(float(np.abs(samples.velocities).max())),
        "acceleration": box(float(np.abs(samples.accelerations).max())),
    }
    for limit, value in values.items():
        for factor, holds in ((1.001, True), (0.999, False)):
            given = value
            if isinstance(value, rho.Box):
                given = rho.Box(factor * value.lower, factor * value.upper)
            else:
                given = factor * float(value)
            others = (
                {} if limit in ("max_acceleration", "acceleration") else {"max_acceleration": 9}
            )
            scenario = smooth(rho.Smoothing(0.5, 3), limits=rho.Limits(**{limit: given}, **others))
            again = rho.Plan.from_accelerations(scenario, plan.accelerations)
            broken = {check.kind for check in rho.verify(again).violations}
            assert broken == (set() if holds else {limit}), limit


@pytest.mark.parametrize("downwash", [1.0, 2.0])
@pytest.mark.parametrize("times", [1, 3])
def test_fleets_keep_apart(times: int, downwash: float) -> None:
    separation = rho.Separation(1.0, downwash)
    rng = np.random.default_rng(times)
    starts = 3.0 * rng.permuted(np.mgrid[0:3, 0:2, 0:1].reshape(3, -1).T, axis=0)
    starts = np.unique(starts, axis=0)
    scenario = fleet(starts, -starts + [12.0, 3.0, 0.0], separation=separation, limits=LIMITS)
    scenario = dataclasses.replace(
        scenario, between_knots=True, smoothing=rho.Smoothing(scenario.grid.step, times)
    )
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    _, samples = dense(plan, 100)
    p = samples.positions / [1.0, 1.0, downwash]
    for i in range(len(starts)):
        for j in range(i):
            assert np.linalg.norm(p[i] - p[j], axis=1).min() >= 1.0 - 1e-6
