"""Smooth motions: moving averages of plans, their margin, and what they need of a scenario."""

from __future__ import annotations

import csv
import dataclasses
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from scipy.optimize import linprog

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.smooth import SmoothMotion
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.smoothing import largest_accelerations
from drake_rho.simulation.small_steps import in_small_steps
from drake_rho.verification.averages import averaged
from drake_rho.verification.holds import first_violation
from drake_rho.verification.trajectory import PiecewiseTrajectory
from tests.disturbed import tracked
from tests.sampled import _center, _signed_distance
from tests.scenarios import box, fleet, single, slow

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
    return Motion(0.5, positions, velocities, a, *2 * [np.full((2, 3), np.nan)])


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.5), st.sampled_from([1, 2, 3]))
def test_no_motion_is_further_from_its_averages_than_the_margin(
    seed: int, width: float, times: int
) -> None:
    motion, smoothing = _at_rest(seed), rho.Smoothing(width, times)
    elapsed = np.linspace(-smoothing.lead, 4.0 + smoothing.lead, 999)
    smoothed, _, _ = SmoothMotion(motion, smoothing).states(elapsed)
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
    smoothed, _, _ = SmoothMotion(motion, smoothing).states(np.array([1.0]))
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


@pytest.mark.parametrize("smoothing", [*slow(*SMOOTHINGS[:-1]), SMOOTHINGS[-1]], ids=str)
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


@pytest.mark.parametrize(
    "smoothing", [SMOOTHINGS[0], *slow(*SMOOTHINGS[1:-1]), SMOOTHINGS[-1]], ids=str
)
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
            given: Any = value
            if isinstance(value, rho.Box):
                given = rho.Box(factor * value.lower, factor * value.upper)
            else:
                given = factor * float(value)
            given = {limit: given}
            if limit not in ("max_acceleration", "acceleration"):
                given["max_acceleration"] = 9.0
            scenario = smooth(rho.Smoothing(0.5, 3), limits=rho.Limits(**given))
            again = rho.Plan.from_accelerations(scenario, plan.accelerations)
            broken = {check.kind for check in rho.verify(again).violations}
            assert broken == (set() if holds else {limit}), limit


@pytest.mark.parametrize("downwash", [1.0, 2.0])
@pytest.mark.parametrize("times", [*slow(1), 3])
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


def _random(seed: int) -> rho.Scenario:
    """Return a random scene with a smoothing, of any scale, with obstacles of several kinds."""
    rng = np.random.default_rng(seed)
    size, duration, knots = (
        10 ** rng.uniform(0, 2),
        10 ** rng.uniform(0.6, 1.6),
        rng.integers(8, 30),
    )
    count, step = int(rng.integers(1, 5)), duration / (knots - 1)
    apart = rho.Separation(0.08 * size, float(rng.choice([1.0, 2.0])))
    obstacles = [_obstacle(rng, size, duration) for _ in range(rng.integers(1, 4))]
    most = rng.uniform(12.0, 30.0) * size / duration**2
    limits = rho.Limits(max_acceleration=most)
    if rng.random() < 0.5:
        limits = rho.Limits(acceleration=box(most), max_speed=6.0 * size / duration)
    vehicles = []
    for number in range(count):
        start, goal = rng.uniform(-size, size, (2, 3))
        place = (start + goal) / 2.0 + 0.05 * size * rng.standard_normal(3)
        time = duration * rng.uniform(0.4, 0.6)
        within = 0.1 * size * float(rng.random() < 0.5)
        waypoints = [rho.Waypoint(time, place, within)] * int(rng.random() < 0.3)
        ends = rho.State(start), rho.State(goal)
        vehicles.append(rho.Vehicle(f"v{number}", *ends, radius=0.02 * size, waypoints=waypoints))
    return rho.Scenario(
        f"random {seed}",
        rho.Grid(step, int(knots)),
        vehicles,
        limits,
        obstacles,
        separation=apart,
        smoothing=rho.Smoothing(step * rng.uniform(0.2, 1.0), int(rng.integers(1, 4))),
    )


def _obstacle(rng: np.random.Generator, size: float, duration: float) -> rho.Obstacle:
    """Return a random obstacle: at rest, active for a time, at a velocity or along a track."""
    center, radius = rng.uniform(-0.6, 0.6, 3) * size, rng.uniform(0.05, 0.25) * size
    sphere, halves = rho.Sphere(center, radius), radius * rng.uniform(0.5, 1.0, 3)
    places = center + 0.3 * size * np.array([[0, 0, 0], [1, 1, 0], [0, 0, 1]])
    track = rho.Track([0.0, 0.4 * duration, duration], places)
    kinds = [
        rho.Obstacle(sphere),
        rho.Obstacle(rho.Box(center - halves, center + halves)),
        rho.Obstacle(rho.Ellipsoid(center, halves)),
        rho.Obstacle(sphere, active=(0.3 * duration, 0.6 * duration)),
        rho.Obstacle(sphere, velocity=rng.uniform(-0.3, 0.3, 3) * size / duration),
        rho.Obstacle(rho.Sphere([0.0, 0.0, 0.0], radius), track=track),
    ]
    return kinds[rng.integers(len(kinds))]


def _check_densely(plan: rho.Plan) -> None:
    """Check distances at many instants with formulas of the tests' own."""
    scenario = plan.scenario
    times, samples = dense(plan)
    p, size = samples.positions, float(np.abs(samples.positions).max())
    for body in scenario.bodies:
        away = _signed_distance(p - _center(body, times), body.shape)
        first, last = body.active or (-np.inf, np.inf)
        due = (times >= first) & (times <= last)
        assert (away[:, due] >= scenario.vehicles[0].radius - 1e-6 * size).all()
    assert scenario.separation is not None
    scaled = p / [1.0, 1.0, scenario.separation.downwash]
    for one in range(len(p)):
        apart = np.linalg.norm(scaled[one] - scaled[:one], axis=2)
        assert (apart >= scenario.separation.distance - 1e-6 * size).all()
    for vehicle in scenario.vehicles:
        for each in vehicle.waypoints:
            assert each.time is not None
            there = plan.at(each.time, vehicle.name).positions[0]
            assert np.linalg.norm(there - each.position) <= each.within + 1e-6 * size


@pytest.mark.parametrize("seeds", [range(12), *slow(range(12, 60))], ids=["some", "many"])
def test_random_scenes_hold_at_every_instant(seeds: range) -> None:
    planned = 0
    for seed in seeds:
        try:
            scenario = _random(seed)
            plan = rho.plan(scenario)
        except (rho.ScenarioError, rho.InfeasibleError):  # a start inside an obstacle, ...
            continue
        planned += 1
        assert rho.verify(plan).ok, seed
        _check_densely(plan)
    assert planned >= len(seeds) / 2


@pytest.mark.parametrize("smoothing", [*slow(*SMOOTHINGS[:-1]), SMOOTHINGS[-1]], ids=str)
def test_waypoints_are_passed_exactly(smoothing: rho.Smoothing) -> None:
    """The averages pass, not the plan, also within the lead of the start and between knots."""
    waypoints = [
        rho.Waypoint(0.3, [0.02, 0.0, 0.0], 0.01),
        rho.Waypoint(3.1, [3.0, 5.0, 0.0]),
        rho.Waypoint(4.5, [6.0, 5.0, 0.0]),
    ]
    own = (dataclasses.replace(single().vehicles[0], waypoints=tuple(waypoints)),)
    limits = rho.Limits(max_acceleration=4.0)
    plan = rho.plan(smooth(smoothing, vehicles=own, limits=limits))
    assert rho.verify(plan).ok
    times, positions, _ = twin(plan)
    for each in waypoints:
        assert each.time is not None
        there = [np.interp(each.time, times, axis) for axis in positions[0].T]
        assert np.linalg.norm(there - each.position) <= each.within + 1e-5
        itself = plan.motion().at("position", each.time)[0, 0]
        assert each.within > 0.0 or np.linalg.norm(itself - each.position) > 1e-4
    stepwise = rho.plan(smooth(None, vehicles=own, limits=limits))
    lacking = rho.Plan.from_accelerations(plan.scenario, stepwise.accelerations)
    assert "waypoint 2" in {check.constraint for check in rho.verify(lacking).violations}


@pytest.mark.parametrize("within", [0.0, 1e-3])
@pytest.mark.parametrize("times", [*slow(1), 3])
def test_the_least_time_past_waypoints_is_that_of_averages(times: int, within: float) -> None:
    """Times of waypoints are free too; the margin that limits need is larger than `within`."""
    places = [[3.0, 5.0, 0.0], [6.0, 5.0, 0.0]]
    waypoints = tuple(rho.Waypoint(None, place, within) for place in places)
    own = (dataclasses.replace(single().vehicles[0], waypoints=waypoints),)
    scenario = smooth(rho.Smoothing(0.15, times), vehicles=own, obstacles=())
    plan = rho.plan_minimum_time(scenario)
    assert plan.statistics.converged
    assert rho.verify(plan).ok
    for each in plan.scenario.vehicles[0].waypoints:
        assert each.time is not None
        there = plan.at(each.time, "solo").positions[0]
        assert np.linalg.norm(there - each.position) <= within + 1e-5
    without = rho.plan_minimum_time(smooth(None, vehicles=own, obstacles=()))
    duration, least = (each.scenario.grid.duration for each in (plan, without))
    assert 0.999 * least <= duration <= 1.02 * least


def test_a_certificate_bounds_plans_whose_averages_pass() -> None:
    waypoints = (rho.Waypoint(3.1, [3.0, 5.0, 0.0]), rho.Waypoint(4.5, [6.0, 5.0, 0.0]))
    own = (dataclasses.replace(single().vehicles[0], waypoints=waypoints),)
    for times in (1, 3):
        limits = rho.Limits(max_acceleration=4.0)
        scenario = smooth(rho.Smoothing(0.5, times), vehicles=own, obstacles=(), limits=limits)
        plan = rho.plan(scenario)
        certificate = rho.certify(plan)
        assert 0.5 * plan.cost < certificate.lower_bound <= plan.cost * (1.0 + 1e-9)


def test_a_moving_obstacle_is_met_where_it_is_at_the_same_time() -> None:
    """An obstacle turns back just beside the vehicle: its position is not averaged."""
    track = rho.Track([0.0, 4.0, 8.0], [[5.0, 9.0, -1.0], [5.0, 2.0, -1.0], [5.0, 9.0, -1.0]])
    crossing = rho.Obstacle(rho.Sphere([0.0, 0.0, 0.0], 1.0), track=track)
    plan = rho.plan(smooth(rho.Smoothing(0.5, 3), obstacles=(crossing,)))
    assert rho.verify(plan).ok
    times, samples = dense(plan, 2000)
    away = np.linalg.norm(samples.positions[0] - _center(crossing, times), axis=1) - 1.0
    assert -1e-6 <= away.min() <= 0.1


def test_an_obstacle_that_leaves_the_start_in_time_is_refused() -> None:
    """The smooth motion begins before the first knot, when the obstacle is still at the start."""
    passing = rho.Obstacle(rho.Sphere([1.05, 0.0, 0.0], 1.0), velocity=[0.0, 4.0, 0.0])
    assert rho.plan(smooth(None, obstacles=(passing,))).cost > 0.0
    leaving = rho.Obstacle(rho.Sphere([1.6, 0.0, 0.0], 1.0), velocity=[2.0, 0.0, 0.0])
    with pytest.raises(rho.ScenarioError, match=r"start\.position.*with smoothing"):
        smooth(rho.Smoothing(0.5, 3), obstacles=(leaving,))
    assert smooth(rho.Smoothing(0.5, 1), obstacles=(leaving,)).lead == 0.25


@pytest.mark.parametrize("times", [1, 2, 3])
def test_requirements_hold_for_averages(times: int) -> None:
    """An interval is longer for the plan: its averages are required in the interval itself."""
    high = rho.KeepIn(rho.HalfSpace([0, 0, -1], -0.5), active=(2.0, 3.0), name="high")
    slow = rho.KeepIn(rho.Sphere([0, 0, 0], 1.2), of="velocity", active=(4.0, 5.0))
    calm = rho.KeepIn(rho.Sphere([0, 0, 0], 0.3), of="acceleration", active=(4.0, 5.0))
    scenario = smooth(rho.Smoothing(0.5, times), obstacles=(), requirements=(high, slow, calm))
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    during = plan.at(np.linspace(2.0, 3.0, 999), "solo")
    assert during.positions[:, 2].min() >= 0.5 - 1e-5
    during = plan.at(np.linspace(4.0, 5.0, 999), "solo")
    assert np.linalg.norm(during.velocities, axis=1).max() <= 1.2 + 1e-5
    assert np.linalg.norm(during.accelerations, axis=1).max() <= 0.3 + 1e-5
    without = rho.plan(smooth(None, obstacles=(), requirements=(high, slow, calm)))
    lacking = rho.Plan.from_accelerations(scenario, without.accelerations)
    broken = {check.constraint for check in rho.verify(lacking).violations}
    assert "requirement 1 (high)" in broken


def jerks(plan: rho.Plan, times: np.ndarray) -> np.ndarray:
    """Return jerks of averages as sums of B-splines, one for each change of the acceleration."""
    scenario, smoothing = plan.scenario, plan.scenario.smoothing
    assert smoothing is not None
    n, w, rest = smoothing.times, smoothing.width, np.zeros_like(plan.accelerations[:, :1])
    changes = np.diff(np.concatenate([rest, plan.accelerations, rest], axis=1), axis=1) / w
    corners = np.arange(n + 1) - n / 2.0
    spline = BSpline.basis_element(corners, extrapolate=False)
    u = (times[:, None] - scenario.grid.start - scenario.grid.elapsed) / w
    return np.asarray(np.einsum("tk,nkx->ntx", np.nan_to_num(spline(u)), changes))


_JERKS = rho.Box([-2.0, -1.0, -1.2], [2.0, 1.5, 1.0])


@pytest.mark.parametrize("limit", [{"max_jerk": 2.5}, {"jerk": _JERKS}], ids=str)
@pytest.mark.parametrize("smoothing", [*SMOOTHINGS[::2], *slow(*SMOOTHINGS[1::2])], ids=str)
def test_jerks_of_averages_are_limited(smoothing: rho.Smoothing, limit: dict[str, Any]) -> None:
    """The first and the last jerk too, from rest and to rest; one or two averages attain limits."""
    own = {"max_speed": 4.0, "max_acceleration": 3.0} | limit
    scenario = smooth(smoothing, limits=rho.Limits(**own))
    plan = rho.plan(scenario)
    report = rho.verify(plan)
    assert report.ok
    found = jerks(plan, np.union1d(dense(plan)[0], scenario.grid.times))[0]
    if "max_jerk" in limit:
        most = np.linalg.norm(found, axis=1).max()
        assert most <= 2.5 + 1e-6
        check = next(each for each in report.checks if each.kind == "max_jerk")
        assert check.value == pytest.approx(most, abs=1e-3)
    else:
        assert (found >= _JERKS.lower - 1e-6).all()
        assert (found <= _JERKS.upper + 1e-6).all()
    without = rho.plan(smooth(smoothing, limits=rho.Limits(**(own | {next(iter(limit)): None}))))
    lacking = rho.Plan.from_accelerations(scenario, without.accelerations)
    broken = {check.kind for check in rho.verify(lacking).violations}
    beyond = jerks(lacking, dense(lacking)[0])[0]
    over = np.linalg.norm(beyond, axis=1).max() > 2.5
    if "jerk" in limit:
        over = bool(((beyond < _JERKS.lower) | (beyond > _JERKS.upper)).any())
    assert broken == (set(limit) if over else set())
    assert over or smoothing.width == 0.5
    if smoothing.width == 0.2 and smoothing.times < 3:
        attained = np.linalg.norm(found, axis=1).max() / 2.5
        if "jerk" in limit:
            attained = (found / np.where(found < 0.0, _JERKS.lower, _JERKS.upper)).max()
        assert attained >= 0.999


@pytest.mark.parametrize("smoothing", [*SMOOTHINGS[::2], *slow(*SMOOTHINGS[1::2])], ids=str)
def test_jerks_of_averages_are_kept_in_required_sets(smoothing: rho.Smoothing) -> None:
    always = rho.KeepIn(rho.HalfSpace([1, 0, 0], 1.2), of="jerk")
    calm = rho.KeepIn(rho.Sphere([0, 0, 0], 0.8), of="jerk", active=(2.1, 3.3))
    plan = rho.plan(smooth(smoothing, requirements=(always, calm)))
    assert rho.verify(plan).ok
    times = dense(plan)[0]
    found = jerks(plan, times)[0]
    assert found[:, 0].max() <= 1.2 + 1e-6
    during = found[(times >= 2.1) & (times <= 3.3)]
    assert np.linalg.norm(during, axis=1).max() <= 0.8 + 1e-6
    without = rho.plan(smooth(smoothing))
    lacking = rho.Plan.from_accelerations(plan.scenario, without.accelerations)
    broken = {check.constraint for check in rho.verify(lacking).violations}
    assert ("requirement 1" in broken) == (jerks(lacking, times)[0][:, 0].max() > 1.2 + 1e-6)


@pytest.mark.parametrize("times", [1, 2])
def test_the_least_time_of_limited_jerks_is_known(times: int) -> None:
    """From rest to rest along a line at a limit of the jerk of averages over a whole step.

    The plan's acceleration then changes by at most w j in a step, from 0 and back to 0. So the
    answer is that of a limit of jerk in steps, found here as a linear program for each time.
    """
    w, most = 0.1, 4.0
    vehicle = rho.Vehicle("solo", rho.State([0, 0, 0]), rho.State([9.0, 0, 0]))
    limits = rho.Limits(max_acceleration=50.0, jerk=box(most))
    grid = rho.Grid(0.2, 21)
    scenario = rho.Scenario("line", grid, [vehicle], limits, smoothing=rho.Smoothing(w, times))
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    h, k = plan.scenario.grid.step, np.arange(20)
    moved = h**2 * (20 - k - 0.5)  # of a unit of each acceleration
    changes = np.eye(21, 20) - np.eye(21, 20, -1)
    found = linprog(
        -moved,
        np.concatenate([changes, -changes]),
        np.full(42, w * most),
        np.ones((1, 20)),
        np.zeros(1),
        bounds=(None, None),
    )
    assert h > 1.2 * w
    assert -found.fun == pytest.approx(9.0, rel=1e-4)


@pytest.mark.parametrize("smoothing", [None, SMOOTHINGS[0], *slow(*SMOOTHINGS[2::2])], ids=str)
def test_required_accelerations_at_one_instant(smoothing: rho.Smoothing | None) -> None:
    """Only the value at the instant counts, not that at the beginning of a piece before."""
    calm = rho.KeepIn(rho.Sphere([0, 0, 0], 0.05), of="acceleration", active=(3.0, 3.0))
    plan = rho.plan(smooth(smoothing, requirements=(calm,)))
    assert rho.verify(plan).ok
    at = plan.at(3.0, "solo").accelerations[0]
    assert np.linalg.norm(at) <= 0.05 + 1e-6


WINDY = rho.Disturbance(0.2, feedback_every=0.125, position_error=0.005, delay=1)


def _windy(smoothing: rho.Smoothing | None) -> rho.Scenario:
    """Return a flight in wind with limits on everything, a waypoint and a requirement."""
    waypoint = rho.Waypoint(3.3, [3.5, 4.0, 0.0], 0.3)
    own = (dataclasses.replace(single().vehicles[0], waypoints=(waypoint,)),)
    limits = rho.Limits(
        rho.Box([-0.2, -0.2, -2.2], [10.2, 4.5, 0.2]),
        velocity=box(3.0),
        acceleration=box(2.2),
        max_speed=2.6,
        max_acceleration=2.6,
        max_tilt=0.28,
    )
    slow = rho.KeepIn(rho.Sphere([0, 0, 0], 2.5), of="velocity", active=(3.0, 4.0))
    parts: dict[str, Any] = {"vehicles": own, "limits": limits, "requirements": (slow,)}
    return smooth(smoothing, disturbance=WINDY, **parts)


@pytest.mark.parametrize("smoothing", [*slow(*SMOOTHINGS[:4:2]), SMOOTHINGS[4]], ids=str)
def test_disturbed_averages_keep_every_constraint_in_the_whole_tube(
    smoothing: rho.Smoothing,
) -> None:
    """Radii are those of the time, around averages of accelerations at other times."""
    scenario = _windy(smoothing)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert first_violation(plan) is None
    tube, (times, samples) = rho.error_tube(scenario), dense(plan)
    assert tube.grid.start == pytest.approx(-scenario.lead)
    assert tube.position(-scenario.lead) == 0.0
    p, v, a = samples.positions[0], samples.velocities[0], samples.accelerations[0]
    off, late, strong = tube.position(times), tube.velocity(times), tube.acceleration(times)
    assert (np.linalg.norm(p - SPHERE.center, axis=1) - off >= SPHERE.radius - 1e-5).all()
    assert (np.linalg.norm(v, axis=1) + late <= 2.6 + 1e-5).all()
    assert (np.linalg.norm(a, axis=1) + strong <= 2.6 + 1e-5).all()
    assert (np.abs(a) + strong[:, None] <= 2.2 + 1e-5).all()
    upright = a + np.array([0.0, 0.0, 9.81])
    inside = upright[:, 2] * np.sin(0.28) - np.hypot(*upright[:, :2].T) * np.cos(0.28)
    assert (inside >= strong - 1e-5).all()
    due = (times >= 3.0) & (times <= 4.0)
    assert (np.linalg.norm(v, axis=1) + late <= 2.5 + 1e-5)[due].all()
    at = plan.at(3.3, "solo").positions[0]
    assert np.linalg.norm(at - [3.5, 4.0, 0.0]) + tube.position(3.3) <= 0.3 + 1e-6
    # a plan for averages without wind has no room for it
    calm = rho.plan(dataclasses.replace(scenario, disturbance=None))
    lacking = rho.verify(rho.Plan.from_accelerations(scenario, calm.accelerations))
    assert "waypoints" in {check.kind for check in lacking.violations}


@pytest.mark.parametrize("smoothing", [*slow(*SMOOTHINGS[:4:2]), SMOOTHINGS[4]], ids=str)
def test_the_worst_wind_reaches_the_radius_around_the_smooth_motion(
    smoothing: rho.Smoothing,
) -> None:
    """Also before the first knot; the feedback is sampled as in flights without a smoothing."""
    scenario = _windy(smoothing)
    plan = rho.plan(scenario)
    tube, lead = rho.error_tube(scenario), scenario.lead
    most = smoothing.width**2 * 2.6 / 12_000.0
    for time in (0.1 - lead / 2.0, 4.1, 8.0 + lead):
        worst = rho.worst_case(scenario, [0.0, 1.0, 0.0], time)
        flown = rho.simulate(plan, wind=worst)
        assert rho.verify(flown).ok
        assert np.all(flown.errors()[:, 0] <= flown.radii() + 1e-9)
        reached = np.linalg.norm(flown.at(time).positions - plan.at(time).positions)
        assert reached == pytest.approx(float(tube.position(time)), abs=most + 1e-9)
    found = rho.attack(scenario, plan)
    assert found.clearance == pytest.approx(found.bound, abs=1e-6)


@pytest.mark.slow
def test_a_simulated_smooth_motion_has_a_file(tmp_path: Path) -> None:
    flown = rho.simulate(rho.plan(_windy(SMOOTHINGS[0])), rng=np.random.default_rng(1))
    rho.save(flown, tmp_path / "flown.npz")
    again = rho.load(tmp_path / "flown.npz")
    assert again.scenario == flown.scenario
    assert again.scenario.disturbance is not None
    assert again.scenario.disturbance.feedback_every == pytest.approx(0.125)
    with pytest.raises(rho.ScenarioError, match="feedback_every"):
        rho.Scenario(
            "longer than a step",
            rho.Grid(0.05, 9),
            single().vehicles,
            disturbance=rho.Disturbance(0.1, feedback_every=0.1),
        )


def _vehicle(start: dict[str, Any], goal: dict[str, Any]) -> tuple[rho.Vehicle, ...]:
    ends = rho.State([0, 0, 0], **start), rho.State([10, 4, -2], **goal)
    return (rho.Vehicle("solo", *ends),)


_TRACK = rho.Track([0.0, 8.0], [[0.0, 0.0, 0.0], [10.0, 4.0, -2.0]])
_BALL = rho.Sphere([0.0, 0.0, 0.0], 50.0)
REFUSED: dict[str, dict[str, Any]] = {
    "smoothing.width": {"smoothing": rho.Smoothing(0.6)},
    "between_knots": {"between_knots": False},
    "disturbance.tracking.since": {
        "disturbance": rho.Disturbance(0.1, tracking=tracked(-3.0, (1.0, 1.0)))
    },
    "vehicles[0].start.velocity": {"vehicles": _vehicle({"velocity": [1, 0, 0]}, {})},
    "vehicles[0].start.acceleration": {"vehicles": _vehicle({"acceleration": [1, 0, 0]}, {})},
    "vehicles[0].goal.velocity": {"vehicles": _vehicle({}, {"velocity": [1, 0, 0]})},
    "limits.acceleration": {"limits": rho.Limits(acceleration=rho.Box([0.1, -9, -9], [9, 9, 9]))},
    "limits.jerk": {"limits": rho.Limits(jerk=rho.Box([1, -9, -9], [9, 9, 9]))},
    "limits.max_acceleration": {"limits": rho.Limits(max_speed=4.0)},
    "requirements[0].set of jerk": {
        "requirements": (rho.KeepIn(rho.Sphere([3, 0, 0], 1.0), of="jerk", active=(3, 4)),)
    },
    "requirements[0].relative_to": {"requirements": (rho.KeepIn(_BALL, relative_to=_TRACK),)},
    "requirements[0].set": {
        "requirements": (
            rho.KeepIn(rho.HalfSpace([-1, 0, 0], -0.1), of="acceleration", active=(0.2, 1.0)),
        )
    },
}


@pytest.mark.parametrize("field", REFUSED)
def test_what_averages_do_not_keep_is_refused_by_its_field(field: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        smooth(**({"smoothing": rho.Smoothing(0.5, 2)} | REFUSED[field]))
    assert caught.value.field == f"scenario.{field.split()[0]}"


@pytest.mark.parametrize("values", [(0.0, 1), (-1.0, 1), (0.5, 0), (0.5, 4), (np.nan, 1)])
def test_widths_are_positive_and_averages_one_to_three(values: tuple[float, int]) -> None:
    with pytest.raises(rho.ScenarioError):
        rho.Smoothing(*values)


@pytest.mark.slow
@pytest.mark.parametrize("smoothing", SMOOTHINGS, ids=str)
def test_simulations_fly_the_smooth_motion(smoothing: rho.Smoothing) -> None:
    plan = rho.plan(smooth(smoothing))
    lead = plan.scenario.lead
    small = in_small_steps(plan)
    assert small.scenario.grid.start == pytest.approx(-lead)
    assert small.scenario.grid.end == pytest.approx(8.0 + lead)
    times = np.linspace(-lead, 8.0 + lead, 999)
    apart = np.linalg.norm(small.at(times).positions - plan.at(times).positions, axis=2).max()
    most = float(np.linalg.norm(plan.accelerations, axis=2).max())
    assert apart <= smoothing.width**2 * most / 12_000.0
    jumps = np.abs(np.diff(small.accelerations, axis=1)).max()
    assert jumps <= most / 10.0
    flown = rho.simulate(plan)
    apart = np.linalg.norm(flown.at(times).positions - small.at(times).positions, axis=2).max()
    assert apart <= 1e-9
    windy = rho.simulate(
        plan,
        wind=lambda t, p, v: 0.05 * np.ones_like(p),
        disturbance=rho.Disturbance(0.1, feedback_every=0.1),
    )
    assert 0.0 < windy.errors().max() <= windy.radii().max()


@pytest.mark.parametrize("times", [*slow(1), 3])
@pytest.mark.parametrize("knots", [9, 17, 41])
def test_exports_hold_the_smooth_motion(times: int, knots: int, tmp_path: Path) -> None:
    grid = rho.Grid(8.0 / (knots - 1), knots)
    plan = rho.plan(smooth(rho.Smoothing(0.9 * grid.step, times), grid=grid))
    lead = plan.scenario.lead
    written = rho.export(plan, tmp_path / "swarm", format="crazyswarm")
    assert (written.deviation > 0.0) == (len(plan.polynomials().instants) > 32)
    rows = [[float(each) for each in row] for row in _rows_of(written.files[0])]
    begin, last = -lead, None
    for duration, *numbers in rows:
        c, s = np.array(numbers[:24]).reshape(3, 8), np.linspace(0.0, duration, 50)
        own = plan.at(np.clip(begin + s, -lead, 8.0 + lead), "solo")
        off = np.linalg.norm((c @ s ** np.arange(8)[:, None]).T - own.positions, axis=1)
        assert off.max() <= written.deviation + 1e-12
        rates = [np.polynomial.Polynomial(axis).deriv(2) for axis in c]
        if last is not None:  # no jump of the acceleration between pieces
            assert [rate(0.0) for rate in rates] == pytest.approx(last, abs=1e-9)
        begin, last = begin + duration, [rate(duration) for rate in rates]
    assert len(rows) <= 31
    assert begin == pytest.approx(8.0 + lead)
    rho.export(plan, tmp_path / "plan.csv", format="csv", rate=10)
    table = np.array([row[1:] for row in _rows_of(tmp_path / "plan.csv")], dtype=np.float64)
    assert table[0, 0] == pytest.approx(-lead)
    assert table[-1, :4] == pytest.approx([8.0 + lead, 10.0, 4.0, -2.0])
    assert table[:-1, 1:] == pytest.approx(plan.at(table[:-1, 0], "solo").states, abs=1e-9)
    rho.export(plan, tmp_path / "px4.csv", format="px4")
    assert rho.export(plan, tmp_path / "show.zip", format="skybrush").deviation > 0.0
    setpoints = _rows_of(tmp_path / "px4.csv")
    assert float(setpoints[-1][1]) == np.ceil(1000.0 * (8.0 + 2.0 * lead) - 1e-6)


def _rows_of(path: Path) -> list[list[str]]:
    with open(path, newline="") as file:
        return list(csv.reader(file))[1:]


def test_files_hold_the_plan_and_its_smoothing(tmp_path: Path) -> None:
    scenario = smooth(rho.Smoothing(0.4, 2))
    rho.save_scenario(scenario, tmp_path / "scenario.yaml")
    assert rho.load_scenario(tmp_path / "scenario.yaml") == scenario
    plan = rho.plan(scenario)
    rho.save(plan, tmp_path / "plan.npz")
    rho.export(plan, tmp_path / "plan.json", format="json")
    for name in ("plan.npz", "plan.json"):
        again = rho.load(tmp_path / name)
        assert again.scenario == scenario
        assert np.array_equal(again.at(1.23).states, plan.at(1.23).states)
        assert rho.verify(again).ok
    with pytest.raises(ValueError, match="the plan that is averaged"):
        rho.export(plan, tmp_path / "more.json", format="json", rate=10)
    rho.export(plan, tmp_path / "plan.csv", format="csv")
    with pytest.raises(rho.PlanFileError, match="holds averages"):
        rho.load(tmp_path / "plan.csv", scenario=scenario)
    schema = rho.scenario_schema()
    assert "smoothing" in schema["properties"]


def test_figures_show_the_smooth_motion() -> None:
    plan = rho.plan(smooth(rho.Smoothing(0.5, 1)))
    shown = drawn(plan)
    times = np.linspace(0.0, 8.0, 17)
    assert np.array_equal(shown.positions, plan.sampled(times).positions)
    between = shown.motion().at("position", times[:-1] + 0.21)
    assert np.abs(between - plan.at(times[:-1] + 0.21).positions).max() < 1e-3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rho.paths_figure(plan)
        rho.accelerations_figure(plan)
        rho.distances_figure(plan)


def test_plans_without_smoothing_are_as_before() -> None:
    """A smoothing needs no margin where nothing is to be kept clear of: the plan is the same."""
    free = smooth(None, obstacles=())
    plan, same = rho.plan(free), rho.plan(smooth(rho.Smoothing(0.5, 3), obstacles=()))
    assert np.array_equal(plan.accelerations, same.accelerations)
    assert same.scenario.smoothing_margin == 0.0
    assert rho.verify(same).ok


def test_maps_are_kept_clear_of() -> None:
    occupied = np.zeros((8, 8, 8), dtype=bool)
    occupied[2:6, 2:6, 2:6] = True
    crates = rho.Voxels.from_grid(occupied, 0.5, [3.0, 0.5, -3.0])
    vehicles = tuple(dataclasses.replace(each, radius=0.3) for each in smooth().vehicles)
    scenario = smooth(rho.Smoothing(0.5, 3), obstacles=(crates,), vehicles=vehicles)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    _, samples = dense(plan, 500)
    beyond = np.abs(samples.positions[0] - [5.0, 2.5, -1.0]) - 1.0  # the occupied cells are a cube
    assert np.linalg.norm(np.maximum(beyond, 0.0), axis=1).min() >= 0.3 - 1e-6
    without = rho.plan(dataclasses.replace(scenario, smoothing=None))
    lacking = rho.Plan.from_accelerations(scenario, without.accelerations)
    broken = first_violation(lacking)
    assert broken is not None
    assert broken.constraint == "obstacle 1"
    assert first_violation(plan) is None


def test_a_certificate_says_of_which_plans_it_is() -> None:
    plan = rho.plan(smooth())
    certificate = rho.certify(plan)
    assert certificate.lower_bound <= plan.cost * (1.0 + 1e-6)
    assert "before they are averaged" in str(certificate)


@pytest.mark.parametrize(
    "smoothing", [SMOOTHINGS[0], *slow(*SMOOTHINGS[1:-1]), SMOOTHINGS[-1]], ids=str
)
def test_the_verifier_averages_the_rest_of_a_plan_alike(smoothing: rho.Smoothing) -> None:
    plan = rho.plan(smooth(smoothing))
    for knot in (1, 2, 3, 9):
        rest = plan.tail(knot)
        checked = averaged(PiecewiseTrajectory.of(rest.scenario, rest.motion()))
        again = rest.sampled(np.maximum(checked.elapsed, -plan.scenario.lead))
        assert np.abs(checked.positions - again.positions).max() < 1e-12
        assert np.abs(checked.velocities - again.velocities).max() < 1e-12
