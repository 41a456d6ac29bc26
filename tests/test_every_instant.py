"""Plans for every instant: constraints hold between the knots too."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings

import drake_rho as rho
from tests.scenarios import box, scenarios, single

PLANNERS = [rho.plan_convex, rho.plan_scp, rho.plan_rho]


@pytest.fixture(scope="module")
def careful() -> rho.Scenario:
    """Return the paper's scenario with constraints at every instant."""
    return dataclasses.replace(rho.load_scenario("paper"), between_knots=True)


@pytest.mark.parametrize("planner", PLANNERS)
def test_safety_at_every_instant_of_the_papers_scenario_costs_little(
    careful: rho.Scenario, planner: object
) -> None:
    safe = planner(careful)  # type: ignore[operator]  # a planner
    sampled = planner(dataclasses.replace(careful, between_knots=False))  # type: ignore[operator]
    assert rho.verify(safe).ok
    assert sampled.cost <= safe.cost <= 1.003 * sampled.cost
    motion = (safe.plan if isinstance(safe, rho.Flight) else safe).motion()
    dense = motion.at("position", np.linspace(0, 49, 49 * 1000 + 1))
    distances = np.linalg.norm(dense - careful.spheres[0].center, axis=2)
    assert distances.min() >= 1000.0 * (1 - 1e-6)


def test_a_dip_between_knots_counts_only_if_every_instant_is_required(
    careful: rho.Scenario,
) -> None:
    sampled = rho.plan_scp(dataclasses.replace(careful, between_knots=False))
    report = rho.verify(sampled)
    assert report.ok
    assert "not required" in str(report)
    checked = rho.verify(dataclasses.replace(sampled, scenario=careful))
    assert not checked.ok
    worst = checked.violations[0]
    assert (worst.constraint, worst.part) == ("obstacle 1", "at all times")
    assert worst.excess == pytest.approx(3.5, abs=0.1)
    assert worst.time != round(worst.time)


@pytest.mark.slow
@given(scenario=scenarios(between_knots=True))
@settings(max_examples=33)
def test_random_plans_hold_at_a_thousand_samples_a_step(scenario: rho.Scenario) -> None:
    try:
        plan = rho.plan_scp(scenario)
    except rho.InfeasibleError:
        return
    assert rho.verify(plan).ok
    grid = scenario.grid
    times = np.linspace(0.0, grid.duration, 1000 * (grid.knots - 1) + 1)
    for index, vehicle in enumerate(scenario.vehicles):
        motion = plan.motion().of(index)
        dense = motion.at("position", times)
        for sphere in scenario.spheres:
            distances = np.linalg.norm(dense - sphere.center, axis=1)
            assert distances.min() >= sphere.radius * (1 - 2e-6)
        limits = scenario.limits_of(vehicle).position
        if limits is not None:
            room = 2e-6 * scenario.fleet.lengths[scenario.index_of(vehicle.name)]
            assert np.all(dense >= limits.lower - room)
            assert np.all(dense <= limits.upper + room)


def test_a_position_box_holds_where_the_motion_turns_between_knots() -> None:
    start = rho.State([0, 0, 0], [0.0, 3.0, 0.0])
    limits = rho.Limits(position=rho.Box([-20, -20, -20], [20, 4.4, 20]))
    coarse = rho.Grid(2.0, 6)
    sampled = rho.plan_convex(single(start=start, grid=coarse, limits=limits))
    scenario = single(start=start, grid=coarse, limits=limits, between_knots=True)
    over = rho.verify(dataclasses.replace(sampled, scenario=scenario))
    assert {check.constraint for check in over.violations} == {"position box"}
    assert over.violations[0].part == "y upper at all times"
    safe = rho.plan_convex(scenario)
    assert rho.verify(safe).ok
    assert safe.cost > sampled.cost
    dense = safe.motion().at("position", np.linspace(0, 10, 10001))
    assert dense[0, :, 1].max() <= 4.4 + 1e-5


def test_a_small_obstacle_between_two_knots_is_avoided() -> None:
    """At 2.5 m a step, a ball of 0.4 m fits between two knots and touches neither."""
    ball = rho.Sphere([5.6, 2.24, -1.12], 0.4)
    sampled = rho.plan_scp(single(obstacles=(ball,), grid=rho.Grid(2.0, 5)))
    assert sampled.statistics.rows == 0
    scenario = single(obstacles=(ball,), grid=rho.Grid(2.0, 5), between_knots=True)
    assert not rho.verify(dataclasses.replace(sampled, scenario=scenario)).ok
    assert rho.verify(rho.plan_scp(scenario)).ok


def test_a_plan_along_a_path_is_safe_at_every_instant() -> None:
    scenario = dataclasses.replace(
        single(
            start=rho.State([0, 1, 2]),
            goal=rho.State([20, 1, 2]),
            grid=rho.Grid(0.5, 21),
            limits=rho.Limits(velocity=box(4.0)),
            obstacles=(rho.Sphere([10.0, 1.0, 2.0], 2.0),),
        ),
        between_knots=True,
    )
    for flown in (rho.plan_scp(scenario), rho.plan_rho(scenario, planner=rho.plan_scp)):
        assert rho.verify(flown).ok
