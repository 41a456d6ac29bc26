"""Goals are assigned to vehicles so that the total effort is least."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.scenarios import scenarios
from tests.tolerances import INDEX, ROUNDING


def free(scenario: rho.Scenario) -> rho.Scenario:
    """Return the same vehicles without constraints."""
    vehicles = [dataclasses.replace(vehicle, limits=None) for vehicle in scenario.vehicles]
    return rho.Scenario(scenario.name, scenario.grid, vehicles)


def in_order(scenario: rho.Scenario, order: tuple[int, ...]) -> rho.Scenario:
    """Return the scenario with the goals in another order."""
    goals = [scenario.vehicles[index].goal for index in order]
    vehicles = tuple(
        dataclasses.replace(vehicle, goal=goal)
        for vehicle, goal in zip(scenario.vehicles, goals, strict=True)
    )
    return dataclasses.replace(scenario, vehicles=vehicles)


@given(scenario=scenarios().map(free))
@settings(max_examples=5)
def test_no_order_of_the_goals_costs_less(scenario: rho.Scenario) -> None:
    orders = itertools.permutations(range(len(scenario.vehicles)))
    costs = [rho.plan_convex(in_order(scenario, order)).cost for order in orders]
    assert rho.plan_convex(rho.assign_goals(scenario)).cost == pytest.approx(min(costs), rel=INDEX)


@given(scenario=scenarios().map(free), data=st.data())
def test_the_order_of_the_goals_does_not_matter(
    scenario: rho.Scenario, data: st.DataObject
) -> None:
    order = tuple(data.draw(st.permutations(range(len(scenario.vehicles)))))
    one, other = (
        rho.plan_convex(rho.assign_goals(asked)).cost
        for asked in (scenario, in_order(scenario, order))
    )
    assert one == pytest.approx(other, rel=INDEX)


def test_velocities_belong_to_the_goals_and_affect_the_assignment() -> None:
    """The fast vehicle takes the goal at rest of two goals at one place.

    The index of velocities v at the start and v' at the goal contains 4 v v' / T.
    """
    fast, slow = rho.State([0, 0, 0], [5, 0, 0]), rho.State([0, 0, 0])
    passing, resting = rho.State([50, 0, 0], [5, 0, 0]), rho.State([50, 0, 0])
    vehicles = (rho.Vehicle("fast", fast, passing), rho.Vehicle("slow", slow, resting))
    scenario = rho.Scenario("s", rho.Grid(0.01, 1001), vehicles)
    assigned = rho.assign_goals(scenario)
    assert [vehicle.goal for vehicle in assigned.vehicles] == [resting, passing]
    saved = rho.plan_convex(scenario).cost - rho.plan_convex(assigned).cost
    assert 0.01 * saved == pytest.approx(4.0 * 5.0**2 / 10.0, rel=1e-3)  # nearly the integral


def test_the_slots_of_the_assembly_have_a_cheaper_order() -> None:
    scenario = rho.load_scenario("paper_assembly")
    assigned = rho.assign_goals(scenario)
    assert assigned != scenario
    assert dataclasses.replace(assigned, vehicles=scenario.vehicles) == scenario
    assert [vehicle.name for vehicle in assigned.vehicles] == ["UAV-1", "UAV-2", "UAV-3", "UAV-4"]
    before, after = (rho.plan_convex(free(each)).cost for each in (scenario, assigned))
    assert before == pytest.approx(13649.628, rel=INDEX)
    assert after == pytest.approx(13452.179, rel=INDEX)
    assert rho.assign_goals(assigned) == assigned


def test_a_vehicles_box_that_does_not_hold_its_goal_is_named() -> None:
    own = rho.Limits(position=rho.Box([-1, -1, -1], [9, 2, 1]))
    vehicles = (
        rho.Vehicle("a", rho.State([8, 0, 0]), rho.State([0, 1, 0]), own),
        rho.Vehicle("b", rho.State([0, 0, 0]), rho.State([10, 1, 0])),
    )
    scenario = rho.Scenario("s", rho.Grid(1.0, 11), vehicles)
    with pytest.raises(rho.ScenarioError, match=r"vehicles\[0\]\.goal\.position"):
        rho.assign_goals(scenario)


def test_one_step_takes_each_vehicle_to_the_goal_it_can_reach() -> None:
    grid = rho.Grid(1.0, 2)
    starts = [rho.State([0, 0, 0], [1, 0, 0]), rho.State([0, 5, 0], [3, 0, 0])]
    goals = [rho.State([2, 5, 0], [1, 0, 0]), rho.State([1, 0, 0], [1, 0, 0])]
    vehicles = [
        rho.Vehicle(name, start, goal)
        for name, start, goal in zip("ab", starts, goals, strict=True)
    ]
    assigned = rho.assign_goals(rho.Scenario("s", grid, vehicles))
    assert [vehicle.goal for vehicle in assigned.vehicles] == goals[::-1]
    assert rho.plan_convex(assigned).cost == pytest.approx(4.0, rel=INDEX)
    far = dataclasses.replace(vehicles[0], goal=rho.State([9, 9, 9]))
    with pytest.raises(rho.ScenarioError, match=r"grid\.knots: got 2"):
        rho.assign_goals(rho.Scenario("s", grid, [far, vehicles[1]]))


def test_the_assignment_of_a_thousand_vehicles_is_no_worse_than_the_given_order() -> None:
    room = rho.flight_cube(1000.0)
    scenario = rho.random_transitions(1000, np.random.default_rng(0), volume=room)
    assigned = rho.assign_goals(scenario)
    ways = [
        np.linalg.norm(each.fleet.goal_positions - each.fleet.start_positions, axis=1)
        for each in (scenario, assigned)
    ]  # from rest to rest the index is proportional to the square of the distance
    assert np.sum(ways[1] ** 2) < 0.2 * np.sum(ways[0] ** 2)
    goals = [np.sort(each.fleet.goal_positions, axis=0) for each in (scenario, assigned)]
    np.testing.assert_allclose(goals[0], goals[1], rtol=ROUNDING)


def test_a_goal_beside_an_obstacle_goes_to_a_vehicle_that_is_small_enough() -> None:
    """The obstacle arrives at its end beside the goal that is nearer to the large vehicle."""
    vehicles = [
        rho.Vehicle("large", rho.State([0, 0, 0]), rho.State([10, 9, 0]), radius=0.5),
        rho.Vehicle("small", rho.State([0, 9, 0]), rho.State([10, 0, 0]), radius=0.2),
    ]
    wall = rho.Box([-1, -1, -1], [1, 1, 1])
    for beside, kept in ((1.6, "small"), (1.4, "large")):
        track = rho.Track([3.0, 12.0], [[10.0, 40.0, 0.0], [10.0, beside, 0.0]])
        scenario = rho.Scenario(
            "s", rho.Grid(0.5, 21, 2.0), vehicles, obstacles=[rho.Obstacle(wall, track=track)]
        )
        ends = {vehicle.name: vehicle.goal for vehicle in rho.assign_goals(scenario).vehicles}
        assert (ends["small"] == vehicles[1].goal) == (kept == "large")


@pytest.mark.parametrize("seed", range(4))
def test_exchanges_of_near_pairs_equal_those_of_all_pairs(seed: int) -> None:
    """Some goals may be too close to an obstacle for some of the vehicles."""
    rng, count = np.random.default_rng(seed), 300
    places = rng.uniform(0.0, 12.0, (2, count, 3))
    speeds = rng.normal(0.0, 0.3, (2, count, 3))
    post = rho.Cylinder([6.0, 6.0, 6.0], 1.0) if seed % 2 else None
    if (
        post is not None
    ):  # each place is outside the post, but some are too close to it for large vehicles
        around = places[..., :2] - 6.0
        far = np.maximum(np.linalg.norm(around, axis=-1), 1e-9)
        places[..., :2] += around * np.maximum(1.05 / far - 1.0, 0.0)[..., None]
    scenario = rho.Scenario(
        "many",
        rho.Grid(0.2, 51),
        [
            rho.Vehicle(
                f"v{i}",
                rho.State(places[0, i], speeds[0, i]),
                rho.State(places[1, i], speeds[1, i]),
                radius=0.02 * (i % 3),
            )
            for i in range(count)
        ],
        obstacles=[] if post is None else [post],
    )
    near, every = (rho.assign_goals(scenario, exact=exact) for exact in (False, True))
    assert _effort(near) == pytest.approx(_effort(every), rel=1e-12)
    assert _effort(every) < 0.5 * _effort(scenario)
    goals = [str(vehicle.goal) for vehicle in near.vehicles]
    assert sorted(goals) == sorted(str(vehicle.goal) for vehicle in scenario.vehicles)


def _effort(scenario: rho.Scenario) -> float:
    """Return the cost of the motions of minimum effort: the least norms that reach the goals."""
    h, after = scenario.grid.step, np.arange(scenario.grid.knots - 1)[::-1] + 0.5
    rows, total = np.array([h**2 * after, np.full(len(after), h)]), 0.0
    for vehicle in scenario.vehicles:
        (p, v), goal = (vehicle.start.position, vehicle.start.velocity), vehicle.goal
        drift = [goal.position - p - scenario.grid.duration * v, goal.velocity - v]
        total += float(np.sum((np.linalg.pinv(rows) @ drift) ** 2))
    return total
