"""Equivalent problems have the same plan."""

from __future__ import annotations

import dataclasses
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.scenarios import mapped, scenarios
from tests.tolerances import INDEX, MOTION

SIGNED_PERMUTATIONS = [
    np.eye(3)[list(order)] * np.array(signs)
    for order in permutations(range(3))
    for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).T.reshape(-1, 3)
]


def _plan(scenario: rho.Scenario) -> rho.Plan | None:
    try:
        return rho.plan_convex(scenario)
    except rho.InfeasibleError:
        return None


@given(
    scenario=scenarios(),
    turn=st.sampled_from(SIGNED_PERMUTATIONS),
    shift=st.tuples(*[st.floats(-2, 2)] * 3),
    length=st.floats(0.01, 100),
    time=st.floats(0.1, 10),
)
@settings(max_examples=20)
def test_mirroring_turning_shifting_and_changing_units(
    scenario: rho.Scenario,
    turn: np.ndarray,
    shift: tuple[float, float, float],
    length: float,
    time: float,
) -> None:
    size = max(np.abs(vehicle.start.position).max() for vehicle in scenario.vehicles)
    plan = _plan(scenario)
    other = _plan(mapped(scenario, turn, size * np.array(shift), length, time))
    assert (plan is None) == (other is None)
    if plan is None or other is None:
        return
    scale = length / time**2
    assert other.cost == pytest.approx(scale**2 * plan.cost, rel=INDEX)
    largest = scale * np.abs(plan.accelerations).max()
    expected = scale * plan.accelerations @ turn.T
    np.testing.assert_allclose(other.accelerations, expected, atol=100 * MOTION * largest)


def test_mirroring_the_papers_flight(paper: rho.Scenario) -> None:
    mirror = np.diag([1.0, -1.0, 1.0])
    flight = rho.plan_rho(paper)
    mirrored = rho.plan_rho(mapped(paper, mirror, np.zeros(3)))
    np.testing.assert_allclose(mirrored.plan.positions, flight.plan.positions @ mirror, atol=1e-3)


@pytest.mark.parametrize("planner", [rho.plan_convex, rho.plan_scp])
def test_relabelling_the_vehicles_permutes_the_plan(paper: rho.Scenario, planner: object) -> None:
    order = [2, 0, 3, 1]
    vehicles = tuple(paper.vehicles[index] for index in order)
    plan = planner(paper)  # type: ignore[operator]  # a planner
    other = planner(dataclasses.replace(paper, vehicles=vehicles))  # type: ignore[operator]
    largest = np.abs(plan.accelerations).max()
    np.testing.assert_allclose(
        other.accelerations, plan.accelerations[order], atol=MOTION * largest
    )


def test_the_order_of_obstacles_does_not_matter() -> None:
    spheres = (rho.Sphere([3.0, 1.3, -0.5], 1.0), rho.Sphere([6.5, 2.2, -1.5], 1.2))
    vehicle = rho.Vehicle("a", rho.State([0, 0, 0]), rho.State([10, 4, -2]))
    plans = [
        rho.plan_scp(rho.Scenario("s", rho.Grid(0.5, 17), (vehicle,), obstacles=order))
        for order in (spheres, spheres[::-1])
    ]
    assert plans[0].cost == pytest.approx(plans[1].cost, rel=INDEX)


def test_a_distant_obstacle_changes_nothing(paper: rho.Scenario) -> None:
    far = rho.Sphere([1e5, 1e5, 1e5], 10.0)
    with_it = rho.plan_scp(dataclasses.replace(paper, obstacles=(*paper.obstacles, far)))
    assert with_it.cost == pytest.approx(rho.plan_scp(paper).cost, rel=INDEX)
