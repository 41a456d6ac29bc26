"""Global optima: bounds with every shape, branches that close gaps, any number of workers."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import fleet, single

KINDS = "box", "cylinder", "sphere", "ellipsoid", "polytope"


def _obstacle(kind: str, center: np.ndarray, rng: np.random.Generator) -> rho.Obstacle:
    """Return an obstacle of a kind with a random size."""
    size = rng.uniform(0.4, 0.9, 3)
    if kind == "box":
        return rho.Obstacle(rho.Box(center - size, center + size))
    if kind == "cylinder":
        return rho.Obstacle(rho.Cylinder(center, float(size[0]), float(2 * size[1])))
    if kind == "sphere":
        return rho.Obstacle(rho.Sphere(center, float(size[0])))
    if kind == "ellipsoid":
        return rho.Obstacle(rho.Ellipsoid(center, size))
    return rho.Obstacle(rho.Polytope(center + size * rng.normal(size=(12, 3)) / 1.5))


def _behind(kind: str) -> rho.Scenario:
    """Return one vehicle with a radius, with two obstacles of a kind on its straight path."""
    rng = np.random.default_rng(53)
    obstacles = [_obstacle(kind, np.array([x, 0.1, -0.1]), rng) for x in (3.0, 7.0)]
    limits, goal = rho.Limits(max_speed=4.0, max_acceleration=5.0), rho.State([10.0, 0.0, 0.0])
    scenario = single(
        obstacles=obstacles, limits=limits, start=rho.State([0.0, 0.0, 0.0]), goal=goal
    )
    vehicles = tuple(dataclasses.replace(each, radius=0.15) for each in scenario.vehicles)
    return dataclasses.replace(scenario, vehicles=vehicles, between_knots=True)


@pytest.mark.parametrize("kind", KINDS)
def test_obstacles_of_every_kind_count_in_bounds(kind: str) -> None:
    scenario = _behind(kind)
    plan = rho.plan(scenario)
    proof = rho.certify(plan)
    least = rho.plan(scenario.without_obstacles()).cost
    assert proof.left_out == ()
    assert least * (1 + 1e-6) < proof.lower_bound <= plan.cost * (1 + 1e-9)


def balls() -> rho.Scenario:
    """Return one vehicle behind three balls, whose sides multipliers alone do not decide."""
    rng = np.random.default_rng([9, 32])
    balls = [
        rho.Sphere([x, *rng.uniform(-0.5, 0.5, 2)], rng.uniform(0.8, 1.6)) for x in (2.5, 5.0, 7.5)
    ]
    return single(obstacles=balls, goal=rho.State([10.0, 0.0, 0.0]), grid=rho.Grid(0.5, 17))


def _circle(count: int) -> rho.Scenario:
    """Return vehicles that exchange places across a circle, a little aside of it."""
    rng, angles = np.random.default_rng(1), 2.0 * np.pi * np.arange(count) / count
    ring = 1.5 * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    starts = ring + 0.1 * rng.normal(size=(count, 3))
    goals = 0.1 * rng.normal(size=(count, 3)) - starts
    apart, grid = rho.Separation(0.9), rho.Grid(0.4, 13)
    return fleet(starts, goals, separation=apart, grid=grid, between_knots=False)


def test_branches_raise_the_bound_and_no_other_plan_is_below_it() -> None:
    scenario = balls()
    before = rho.certify(rho.plan(scenario))
    best = rho.plan_global(scenario, gap=0.01)
    proof = best.certificate
    assert rho.verify(best.plan).ok
    assert -1e-9 < proof.gap <= 0.01 < before.gap
    assert proof.lower_bound > before.lower_bound
    assert proof.cost == pytest.approx(best.plan.cost, rel=1e-12)
    assert f"after {proof.nodes} branches" in str(proof)
    figure = rho.gap_figure(proof)
    _, bounds, costs = np.transpose(proof.history)
    drawn = [line.get_ydata() for line in figure.axes[0].lines]
    np.testing.assert_array_equal(drawn, [costs, bounds])
    assert np.all(np.diff(bounds) >= 0.0)
    assert bounds[-1] == pytest.approx(proof.lower_bound, rel=1e-12)
    with pytest.raises(ValueError, match="without branches"):
        rho.gap_figure(before)
    rng, others = np.random.default_rng(0), 0
    for _ in range(12):
        start = rho.Plan.from_accelerations(scenario, rng.normal(size=(1, 16, 3)))
        try:
            other = rho.plan_scp(scenario, reference=start)
        except (rho.InfeasibleError, rho.SolverError):
            continue
        others += 1
        assert other.cost >= proof.lower_bound * (1 - 1e-9)
    assert others > 3


def test_vehicles_that_exchange_places_have_cheaper_plans_on_other_sides() -> None:
    scenario = _circle(4)
    plan = rho.plan(scenario)
    best = rho.plan_global(scenario, gap=0.03)
    assert rho.verify(best.plan).ok
    assert best.plan.cost < 0.95 * plan.cost
    assert best.certificate.gap <= 0.03
    known = rho.certify(plan, gap=0.09)
    assert known.better == pytest.approx(best.plan.cost, rel=1e-3)
    assert known.cost == pytest.approx(plan.cost, rel=1e-12)
    assert known.lower_bound <= best.plan.cost
    assert "a plan that costs" in str(known)


def test_groups_are_joined_where_one_excludes_a_cheaper_plan_of_another() -> None:
    rng = np.random.default_rng([5, 39])
    lanes = np.array([-1.2, 0.0, 1.2])
    starts = np.stack([np.zeros(3), lanes, 0.1 * rng.normal(size=3)], axis=1)
    goals = np.stack([np.full(3, 8.0), rng.permutation(lanes), 0.1 * rng.normal(size=3)], axis=1)
    scenario = fleet(
        starts,
        goals,
        obstacles=[
            rho.Sphere([4.0, rng.uniform(-0.5, 0.5), 0.0], 1.1),
            rho.Box([5.5, -1.5, -0.5], [6.0, -0.3, 0.5]),
        ],
        separation=rho.Separation(0.8),
        grid=rho.Grid(0.4, 17),
        between_knots=False,
    )
    plan = rho.plan(scenario)
    best = rho.plan_global(scenario, gap=0.002)
    assert len(rho.certify(plan).vehicles) == 2
    assert len(best.certificate.vehicles) == 1
    assert rho.verify(best.plan).ok
    assert best.plan.cost < 0.98 * plan.cost
    assert best.certificate.gap <= 0.002


def test_a_fleet_too_large_for_pairs_keeps_its_separation() -> None:
    """The bound leaves the separation out; plans that are found on the way do not."""
    rng, lanes = np.random.default_rng(3), np.arange(26) * 1.05
    starts = np.stack([0.0 * lanes, lanes, 0.0 * lanes], axis=1)
    balls = [
        rho.Sphere([5.0, y + rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2)], 0.7)
        for y in (1.0, 5.0, 9.0, 13.0)
    ]
    scenario = fleet(
        starts,
        starts + np.array([10.0, 0.0, 0.0]),
        obstacles=balls,
        separation=rho.Separation(1.0),
        between_knots=False,
    )
    best = rho.plan_global(scenario, gap=1e-4)
    assert best.certificate.nodes > 0
    assert best.certificate.left_out == ("the separation",)
    assert rho.verify(rho.Plan.from_accelerations(scenario, best.plan.accelerations)).ok
    assert best.certificate.lower_bound <= best.plan.cost * (1 + 1e-9)


def test_certificates_do_not_depend_on_the_number_of_workers() -> None:
    alone = rho.plan_global(balls(), gap=0.01)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        together = rho.plan_global(balls(), gap=0.01, executor=pool)
    assert alone.certificate.nodes > 1
    assert str(together) == str(alone)
    np.testing.assert_array_equal(together.plan.accelerations, alone.plan.accelerations)


def test_time_limits_end_the_search_with_what_is_known() -> None:
    plan = rho.plan(balls())
    proof = rho.certify(plan, gap=1e-6, time_limit=1.5)
    assert proof.cut
    assert "time was up" in str(proof)
    assert 0.0 < proof.lower_bound <= plan.cost


@pytest.mark.parametrize("gap", [0.0, -0.1, 1.0, 1.5, float("nan")])
def test_gaps_are_above_zero_and_below_one(gap: float) -> None:
    with pytest.raises(ValueError, match=r"^gap: got .* above 0 and below 1"):
        rho.plan_global(single(), gap=gap)


def test_plans_that_violate_constraints_are_refused() -> None:
    plan = rho.plan(balls())
    scenario = dataclasses.replace(plan.scenario, limits=rho.Limits(max_speed=0.5))
    wrong = rho.Plan.from_accelerations(scenario, plan.accelerations)
    with pytest.raises(ValueError, match=r"violates them .*expected one that satisfies"):
        rho.certify(wrong, gap=0.01)
