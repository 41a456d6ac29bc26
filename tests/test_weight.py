"""Weights of vehicles in the cost: of two that meet, the lighter one makes the larger detour."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.cones import TWIN, twin_cost
from tests.scenarios import single

ENDS: dict[str, Any] = {"a": ([0, 0, 0], [10, 0.2, 0]), "b": ([10, 0, 0.1], [0, 0.1, 0])}


def swap(one: float = 1.0, other: float = 1.0, **fields: Any) -> rho.Scenario:
    """Return two vehicles with weights that change places and keep 1.5 m apart."""
    vehicles = [
        rho.Vehicle(name, rho.State(start), rho.State(goal), weight=weight)
        for (name, (start, goal)), weight in zip(ENDS.items(), (one, other), strict=True)
    ]
    grid = rho.Grid.lasting(8.0, step=0.25)
    apart = rho.Separation(1.5)
    return rho.Scenario("swap", grid, vehicles, separation=apart, **fields)


def efforts(plan: rho.Plan) -> list[float]:
    """Return the sum of squared accelerations of each vehicle."""
    return [float(np.sum(each**2)) for each in plan.accelerations]


def test_a_common_factor_changes_the_cost_and_no_motion() -> None:
    one, other = rho.plan(swap()), rho.plan(swap(3.0, 3.0))
    assert other.cost == pytest.approx(3.0 * one.cost, rel=1e-5)
    assert np.abs(one.positions - other.positions).max() < 1e-2


@pytest.mark.parametrize("coupling", ["coupled", "decoupled", "grouped"])
def test_the_lighter_one_gives_way_more(coupling: Any) -> None:
    same = rho.plan(swap(), coupling="coupled")
    plan = rho.plan(swap(1.0, 10.0), coupling=coupling)
    assert rho.verify(plan).ok
    light, heavy = efforts(plan)
    assert light > 1.1 * efforts(same)[0]
    assert heavy < 0.95 * efforts(same)[1]
    assert plan.cost == pytest.approx(light + 10.0 * heavy)
    assert plan.cost < efforts(same)[0] + 10.0 * efforts(same)[1]


def test_weights_belong_to_vehicles_in_any_order() -> None:
    scenario = swap(1.0, 10.0)
    turned = dataclasses.replace(scenario, vehicles=scenario.vehicles[::-1])
    one, other = rho.plan(scenario), rho.plan(turned)
    assert other.cost == pytest.approx(one.cost, rel=1e-6)
    assert efforts(other)[::-1] == pytest.approx(efforts(one), rel=1e-3)


def test_a_vehicle_alone_flies_the_same_with_any_weight() -> None:
    obstacles = [rho.Sphere([5, 1.2, 0], 1.5)]
    limits = rho.Limits(max_speed=2.0)
    light = single(obstacles=obstacles, limits=limits)
    (vehicle,) = light.vehicles
    heavy = dataclasses.replace(light, vehicles=(dataclasses.replace(vehicle, weight=7.0),))
    one, other = rho.plan(light), rho.plan(heavy)
    assert other.cost == pytest.approx(7.0 * one.cost, rel=1e-6)
    assert np.abs(one.positions - other.positions).max() < 1e-4
    assert rho.certify(other).lower_bound == pytest.approx(other.cost, rel=1e-6)


def test_the_cost_is_that_of_a_program_written_out() -> None:
    scenario = dataclasses.replace(swap(2.0, 5.0), between_knots=False)
    best = rho.plan(scenario)
    assert best.cost == pytest.approx(twin_cost(scenario, best), rel=TWIN)
    assert rho.certify(best).lower_bound == pytest.approx(best.cost, rel=1e-6)


@pytest.mark.slow
def test_fleets_of_every_size_have_weights() -> None:
    """Twenty vehicles are planned in groups by default; weights keep the cost of each."""
    fleet = rho.random_transitions(20, np.random.default_rng(0))
    heavy = dataclasses.replace(
        fleet,
        vehicles=tuple(
            dataclasses.replace(each, weight=5.0 if i % 2 else 1.0)
            for i, each in enumerate(fleet.vehicles)
        ),
    )
    plan, same = rho.plan(heavy), rho.plan(fleet)
    assert rho.verify(plan).ok
    assert sum(efforts(plan)[1::2]) < sum(efforts(same)[1::2])


def test_windows_assignments_and_reports_have_weighted_costs() -> None:
    scenario = swap(1.0, 10.0)
    flight = rho.plan_rho(scenario)
    light, heavy = efforts(flight.plan)
    assert flight.cost == pytest.approx(light + 10.0 * heavy)
    summary = rho.verify(flight).summary
    assert summary.cost == flight.cost
    free = rho.plan(scenario.without_separation())
    assert summary.least_effort == pytest.approx(free.cost, rel=1e-9)
    assert rho.assign_goals(scenario).vehicles[0].goal.position.tolist() == [0, 0.1, 0]


def test_the_heavy_vehicle_gets_the_goal_that_is_near() -> None:
    """Both goals are on a line behind the starts: unweighted, the assignment is a tie."""
    vehicles = [
        rho.Vehicle("light", rho.State([0, 0, 0]), rho.State([4, 0, 0])),
        rho.Vehicle("heavy", rho.State([0, 2, 0]), rho.State([9, 2, 0]), weight=50.0),
    ]
    scenario = rho.Scenario("line", rho.Grid.lasting(5.0, step=0.5), vehicles)
    found = rho.assign_goals(scenario)
    assert found.vehicles[1].goal.position.tolist() == [4, 0, 0]


def test_weights_are_in_files(tmp_path: Path) -> None:
    scenario = swap(2.0, 0.5)
    rho.save_scenario(scenario, tmp_path / "swap.yaml")
    assert rho.load_scenario(tmp_path / "swap.yaml") == scenario
    schema = rho.scenario_schema()
    assert "weight" in str(schema)


@pytest.mark.parametrize("weight", [0.0, -1.0, np.nan, np.inf, True, "x", None, 1e9])
def test_a_bad_weight_is_named(weight: Any) -> None:
    with pytest.raises(rho.ScenarioError) as found:
        rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([1, 0, 0]), weight=weight)
    assert found.value.field == "vehicle.weight"
