"""Waypoints: positions that vehicles pass at given times, exactly or within a distance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import drake_rho as rho
from drake_rho.analysis.trials import is_monotone
from drake_rho.planning.path_search.initial_guesses import find_paths
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.minimum_violation import minimum_violation
from drake_rho.scenario.waypoints import in_order
from tests.arrays import FloatArray
from tests.cones import TWIN, twin_cost
from tests.scenarios import (
    box,
    fleet,
    mapped,
    random_scenario,
    single,
    slow,
    through_the_middle,
)
from tests.tolerances import INDEX, MOTION
from tests.written import as_yaml, from_yaml

HALF_WAY = rho.Waypoint(3.3, [4.0, 4.0, 1.0])
"""Waypoint between two knots, off the path."""


def _position(plan: rho.Plan, vehicle: int, time: float) -> FloatArray:
    """Return a vehicle's position, integrated by hand, step by step and a part of a step."""
    grid, state = plan.scenario.grid, plan.scenario.vehicles[vehicle].start
    p, v, left = state.position, state.velocity, time - grid.start
    for a in plan.accelerations[vehicle]:
        s = min(grid.step, left)
        p, v, left = p + s * v + s**2 / 2.0 * a, v + s * a, left - s
    return np.asarray(p)


def _missed(plan: rho.Plan) -> list[float]:
    """Return the distances of all vehicles from their waypoints."""
    return [
        float(np.linalg.norm(_position(plan, index, time) - each.position))
        for index, vehicle in enumerate(plan.scenario.vehicles)
        for time, each in in_order(vehicle)
    ]


def _one_axis(knots: int, h: float, times: list[float], places: list[float]) -> FloatArray:
    """Return the accelerations of least norm from rest at 0 to rest at the last place."""
    begins, T = h * np.arange(knots - 1), h * (knots - 1)
    acted = np.clip(np.array([*times, T])[:, None] - begins, 0.0, h)
    after = np.maximum(np.array([*times, T])[:, None] - begins - h, 0.0)
    position = acted**2 / 2.0 + acted * after
    rows = np.vstack([position, np.full(knots - 1, h)])
    found: FloatArray = np.linalg.pinv(rows) @ np.array([*places, 0.0])
    return found


@pytest.mark.parametrize("times", [[2.0], [3.3], [0.1], [7.9], [1.25, 4.0], [1.3, 1.4, 6.0]])
@pytest.mark.parametrize("start", [0.0, -3.0])
def test_rest_to_rest_in_one_dimension_has_least_norm(times: list[float], start: float) -> None:
    places = [3.0 + 2.0 * number for number in range(len(times))]
    known = _one_axis(17, 0.5, times, [*places, 10.0])
    waypoints = [
        rho.Waypoint(start + time, [x, 0.0, 0.0]) for time, x in zip(times, places, strict=True)
    ]
    grid, goal = rho.Grid(0.5, 17, start), rho.State([10.0, 0.0, 0.0])
    plan = rho.plan_convex(single(grid=grid, goal=goal, waypoints=waypoints))
    assert rho.verify(plan).ok
    assert plan.cost == pytest.approx(float(known @ known), rel=INDEX)
    largest = np.abs(known).max()
    np.testing.assert_allclose(plan.accelerations[0, :, 0], known, atol=MOTION * largest)
    np.testing.assert_allclose(plan.accelerations[0, :, 1:], 0.0, atol=MOTION * largest)
    assert max(_missed(plan)) < 1e-8


@pytest.mark.parametrize("within", [0.0, 0.5])
def test_a_waypoint_holds_has_an_effect_and_is_verified(within: float) -> None:
    scenario = single(waypoints=[dataclasses.replace(HALF_WAY, within=within)])
    free, plan = rho.plan_convex(single()), rho.plan_convex(scenario)
    assert rho.verify(plan).ok
    assert _missed(plan) == pytest.approx([within], abs=1e-7)
    assert plan.cost > free.cost * 1.001

    unlimited = rho.Plan.from_accelerations(scenario, free.accelerations)
    (missed,), (violation,) = _missed(unlimited), rho.verify(unlimited).violations
    reported = (violation.constraint, violation.part, violation.unit, violation.time)
    assert reported == ("waypoint 1", "", "m", 3.3)
    assert violation.value == pytest.approx(missed)
    assert violation.limit == within
    assert violation.excess == pytest.approx(missed - within)
    assert violation.tolerance == pytest.approx(1e-6 * np.linalg.norm([10.0, 4.0, -2.0]))


@pytest.mark.parametrize("knots", [5, 17, *slow(101)])
@pytest.mark.parametrize("within", [0.0, 0.3])
@pytest.mark.parametrize(
    "limits",
    [
        rho.Limits(),
        rho.Limits(jerk=box(3.0), max_speed=2.6),
        rho.Limits(position=box(10.2), max_acceleration=2.2),
    ],
)
def test_the_cost_equals_that_of_the_program_with_cones(
    knots: int, within: float, limits: rho.Limits
) -> None:
    waypoints = [
        dataclasses.replace(HALF_WAY, within=within),
        rho.Waypoint(6.0, [9.0, 5.0, -1.0], within),
    ]
    grid = rho.Grid(8.0 / (knots - 1), knots)
    scenario = single(grid=grid, limits=limits, waypoints=waypoints)
    known = twin_cost(scenario)
    if known is None:
        with pytest.raises(rho.InfeasibleError):
            rho.plan_convex(scenario)
        return
    plan = rho.plan_convex(scenario)
    assert plan.cost == pytest.approx(known, rel=TWIN)
    assert rho.verify(plan).ok
    assert rho.certify(plan).is_globally_optimal


def _with_waypoints(scenario: rho.Scenario, seed: int) -> rho.Scenario:
    """Return the scenario with up to three waypoints a vehicle, more or less far from its path."""
    rng, grid = np.random.default_rng(seed), scenario.grid
    motion = rho.plan_convex(dataclasses.replace(scenario, limits=rho.Limits())).motion()
    vehicles = []
    for index, vehicle in enumerate(scenario.vehicles):
        waypoints = []
        for s in grid.duration * rng.uniform(0.05, 0.95, rng.integers(0, 4)):
            size = scenario.fleet.lengths[index] * 10 ** rng.uniform(-3.0, -0.5)
            aside = size * rng.normal(size=3)
            within = size * rng.uniform(0.1, 0.9) * rng.integers(0, 2)
            place = motion.at("position", [s])[index, 0] + aside
            waypoints.append(rho.Waypoint(grid.start + s, place, within))
        vehicles.append(dataclasses.replace(vehicle, waypoints=tuple(waypoints)))
    return dataclasses.replace(scenario, vehicles=tuple(vehicles))


@given(seed=st.integers(0, 2**32 - 1), tight=st.booleans())
@settings(max_examples=20)
def test_costs_of_random_scenarios_equal_those_of_the_programs_with_cones(
    seed: int, tight: bool
) -> None:
    scenario = random_scenario(seed, tight=tight).without_obstacles()
    try:
        scenario = _with_waypoints(scenario, seed)
    except rho.ScenarioError:  # outside the position box
        return
    known = twin_cost(scenario)
    try:
        plan = rho.plan_convex(scenario)
    except rho.InfeasibleError:
        assert known is None
        return
    assert plan.cost == pytest.approx(known, rel=TWIN)
    assert rho.verify(plan).ok


@given(seed=st.integers(0, 2**31 - 1), length=st.floats(0.01, 100), time=st.floats(0.1, 10))
@settings(max_examples=6)
def test_other_coordinates_have_the_same_plan(seed: int, length: float, time: float) -> None:
    turn = Rotation.random(random_state=seed).as_matrix()
    waypoints = [HALF_WAY, rho.Waypoint(6.1, [9.0, 5.0, -1.0], 0.2)]
    scenario = single(waypoints=waypoints, limits=rho.Limits(max_speed=2.4))
    plan = rho.plan_convex(scenario)
    other = rho.plan_convex(mapped(scenario, turn, np.array([3.0, -2.0, 1.0]), length, time))
    scale = length / time**2
    assert other.cost == pytest.approx(scale**2 * plan.cost, rel=INDEX)
    expected = scale * plan.accelerations @ turn.T
    atol = 100 * MOTION * np.abs(expected).max()
    np.testing.assert_allclose(other.accelerations, expected, atol=atol)


def test_the_order_of_waypoints_does_not_matter() -> None:
    waypoints = [HALF_WAY, rho.Waypoint(6.1, [9.0, 5.0, -1.0], 0.2)]
    one, other = (rho.plan_convex(single(waypoints=each)) for each in (waypoints, waypoints[::-1]))
    assert other.cost == pytest.approx(one.cost, rel=INDEX)
    checks = [each for each in rho.verify(other).checks if "waypoint" in each.constraint]
    assert [(each.constraint, each.time) for each in checks] == [
        ("waypoint 1", 6.1),
        ("waypoint 2", 3.3),
    ]


def test_there_and_back_again() -> None:
    """From rest to rest at one place via another: the distance to it is the motion's scale."""
    here = rho.State([1.0, 2.0, 3.0])
    scenario = single(start=here, goal=here, waypoints=[rho.Waypoint(4.0, [11.0, 2.0, 3.0])])
    assert scenario.fleet.lengths == pytest.approx([10.0])
    plan = rho.plan_convex(scenario)
    known = _one_axis(17, 0.5, [4.0], [10.0, 0.0])
    assert plan.cost == pytest.approx(float(known @ known), rel=INDEX)
    assert rho.verify(plan).ok


@pytest.mark.parametrize("replan_every", [*slow(1), 3, 5])
@pytest.mark.parametrize("within", [0.0, 0.3])
@pytest.mark.parametrize("time", [3.3, 4.0, 0.51])
def test_windows_include_a_waypoint_until_it_has_passed(
    replan_every: int, within: float, time: float
) -> None:
    waypoints = [rho.Waypoint(time, [time, 2.0, 1.0], within), rho.Waypoint(6.1, [9, 5, -1], 0.2)]
    sphere = rho.Sphere([8.0, 4.0, -0.5], 0.5)
    scenario = single(waypoints=waypoints, obstacles=(sphere,), between_knots=True)
    flight = rho.plan_rho(scenario, replan_every=replan_every)
    assert rho.verify(flight).ok
    assert not any(window.infeasible for window in flight.windows)
    for window in flight.windows:
        asked = window.plan.scenario
        # a waypoint at a knot has been passed
        left = [
            each for each in waypoints if each.time is not None and each.time > asked.grid.start
        ]
        assert list(asked.vehicles[0].waypoints) == left
        assert from_yaml(as_yaml(asked)) == asked


@pytest.mark.parametrize("coupling", [*slow(rho.coupled), rho.decoupled])
def test_every_vehicle_of_a_fleet_passes_its_own_waypoints(coupling: object) -> None:
    """They have different numbers of waypoints at different times, and pass each other."""
    asked = through_the_middle(4)
    own = [
        [rho.Waypoint(5.2, [0.0, 0.0, 0.0])],
        [],
        [rho.Waypoint(3.0, [-2.0, 1.0, 0.5], 0.1), rho.Waypoint(7.1, [1.5, 0.0, 0.0], 0.2)],
        [rho.Waypoint(5.2, [0.5, -1.5, 0.0])],
    ]
    vehicles = tuple(
        dataclasses.replace(vehicle, waypoints=tuple(waypoints))
        for vehicle, waypoints in zip(asked.vehicles, own, strict=True)
    )
    scenario = dataclasses.replace(asked, vehicles=vehicles)
    plan = rho.plan_scp(scenario, coupling=coupling)  # type: ignore[arg-type]  # a coupling
    report = rho.verify(plan)
    assert report.ok
    found = [(each.vehicle, each.constraint) for each in report.checks if "way" in each.constraint]
    assert found == [
        ("v0", "waypoint 1"),
        ("v2", "waypoint 1"),
        ("v2", "waypoint 2"),
        ("v3", "waypoint 1"),
    ]
    assert max(_missed(plan)) < 0.2 + 1e-6
    unlimited = rho.Plan.from_accelerations(scenario, rho.plan_scp(asked).accelerations)
    assert "waypoint 1" in {each.constraint for each in rho.verify(unlimited).violations}


def test_waypoints_hold_past_obstacles_at_rest_and_moving() -> None:
    sphere = rho.Sphere([4.0, 2.2, 0.0], 1.0)
    moving = rho.Obstacle(rho.Box([6.5, 8.5, -2.0], [7.5, 9.5, 0.0]), velocity=[0.0, -1.0, 0.0])
    waypoints = [rho.Waypoint(3.3, [4.0, 3.3, 0.5]), rho.Waypoint(6.1, [7.5, 4.5, -1.0], 0.2)]
    scenario = single(waypoints=waypoints, obstacles=(sphere, moving), between_knots=True)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    proof = rho.certify(plan)
    assert 0.0 < proof.lower_bound <= plan.cost * (1.0 + INDEX)


WALL = rho.Box([4.5, -6.0, -1.0], [5.5, 6.0, 6.0])
_CROSSING = rho.Obstacle(rho.Sphere([0.0, -9.0, 1.0], 0.3), velocity=[0.5, 0.0, 0.0])


@pytest.mark.parametrize("obstacles", [*slow((WALL,)), (WALL, _CROSSING)])
@pytest.mark.parametrize(
    "waypoints",
    [
        (rho.Waypoint(7.4, [9.0, 0.0, 1.0]),),
        *slow((rho.Waypoint(9.0, [9.0, 3.0, 2.0], 0.3), rho.Waypoint(6.0, [9.0, 0.0, 1.0]))),
    ],
)
def test_paths_lead_through_waypoints(
    obstacles: tuple[rho.Box | rho.Obstacle, ...], waypoints: tuple[rho.Waypoint, ...]
) -> None:
    """Start and goal are on one side of a wall, the waypoints on the other."""
    limits = rho.Limits(position=rho.Box([-2, -10, 0], [12, 10, 5]), max_acceleration=6.0)
    ends = rho.State([0.0, 0.0, 1.0]), rho.State([0.0, 2.0, 1.0])
    vehicle = rho.Vehicle("solo", *ends, radius=0.2, waypoints=waypoints)
    scenario = rho.Scenario("wall", rho.Grid(0.25, 61), (vehicle,), limits, obstacles)
    (reference, *_) = find_paths(scenario).references
    for time, each in in_order(vehicle):
        at = reference.motion().at("position", [time])[0, 0]
        assert np.linalg.norm(at - each.position) < 0.3  # straight from knot to knot
    still = dataclasses.replace(scenario, obstacles=(WALL,)).bodies[0]
    x = reference.positions[0] - still.centers(reference.times)
    assert still.shape.local_distance(x).min() > 0.2 - 1e-5
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok


UNREACHABLE = single(
    limits=rho.Limits(max_speed=2.5),
    waypoints=[rho.Waypoint(1.0, [1.0, 0.5, 0.0]), rho.Waypoint(2.0, [5.0, 2.0, 0.0])],
)
"""The second waypoint is too far from the first."""


def test_an_unreachable_waypoint_is_named() -> None:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(UNREACHABLE)
    (names,) = caught.value.conflicts.values()
    assert "waypoint 2 at 2 s" in names
    (names,) = rho.infeasible_subset(caught.value).values()
    kinds = [name.partition(" from")[0] for name in names]
    assert kinds == ["maximum speed", "waypoint 2 at 2 s"]


@pytest.mark.slow
def test_an_unreachable_waypoint_is_diagnosed() -> None:
    reason = rho.diagnose(UNREACHABLE)
    assert not reason.feasible
    assert not reason.is_monotone
    assert reason.violations
    assert "waypoint 2" in str(reason)
    least = minimum_violation(Problem.of(UNREACHABLE))
    assert max(_missed(least)) < 2.0


def test_only_scenarios_without_waypoints_are_monotone() -> None:
    assert is_monotone(single())
    assert not is_monotone(single(waypoints=[HALF_WAY]))


def test_each_of_many_waypoints_has_a_constraint_of_its_own() -> None:
    """There are as many constraints as waypoints."""
    times = np.linspace(0.3, 7.7, 30)
    way = np.stack([times, np.sin(times), np.cos(times)], axis=1)
    waypoints = [rho.Waypoint(t, p, 0.3) for t, p in zip(times.tolist(), way, strict=True)]
    spheres = (rho.Sphere([5.0, -3.0, 1.0], 0.5),) * 2
    scenario = single(waypoints=waypoints, obstacles=spheres, grid=rho.Grid(0.2, 41))
    assert len({each.key for each in Problem.of(scenario).convex}) == 30
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert len([each for each in rho.verify(plan).checks if "way" in each.constraint]) == 30


GRID = rho.Grid(1.0, 9, 2.0)
_MOVING = rho.Obstacle(rho.Sphere([0.0, 5.0, 0.0], 0.5), velocity=[1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("waypoints", "options", "field", "words"),
    [
        ([rho.Waypoint(2.0, [1, 0, 0])], {}, "[0].time", "in the flight, after 2 s and before 10"),
        ([rho.Waypoint(10.0, [1, 0, 0])], {}, "[0].time", "in the flight"),
        ([HALF_WAY, rho.Waypoint(0.0, [1, 0, 0])], {}, "[1].time", "in the flight"),
        (
            [rho.Waypoint(5.0, [3, 9, 0], 2.0)],
            {"limits": rho.Limits(position=rho.Box([-1, -8, -8], [20, 8, 8]))},
            "[0].position",
            "within [-1.0, -8.0, -8.0] to [20.0, 8.0, 8.0]",
        ),
        (
            [rho.Waypoint(5.0, [3, 2, 0])],
            {"obstacles": (rho.Sphere([3, 2, 0.5], 0.6),)},
            "[0].position",
            "outside obstacle 1",
        ),
        (
            [rho.Waypoint(4.0, [3, 5, 0]), rho.Waypoint(5.0, [5, 5.2, 0])],
            {"obstacles": (_MOVING,)},
            "[1].position",
            "at 5 s",
        ),
    ],
)
def test_invalid_waypoints_are_refused(
    waypoints: list[rho.Waypoint], options: dict[str, object], field: str, words: str
) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        single(grid=GRID, waypoints=waypoints, **options)  # type: ignore[arg-type]
    assert caught.value.field == f"scenario.vehicles[0].waypoints{field}"
    assert words in str(caught.value)


def test_the_radius_of_a_vehicle_counts_at_a_waypoint() -> None:
    scenario = single(
        waypoints=[rho.Waypoint(5.0, [3, 2, 0])], obstacles=(rho.Sphere([3, 3, 0], 0.6),)
    )
    wide = dataclasses.replace(scenario.vehicles[0], radius=0.5)
    with pytest.raises(
        rho.ScenarioError, match=r"at least 0\.5 m from obstacle 1, not 0\.4 m"
    ) as caught:
        dataclasses.replace(scenario, vehicles=(wide,))
    assert caught.value.field == "scenario.vehicles[0].waypoints[0].position"


def test_two_waypoints_at_one_time_are_refused() -> None:
    twice = [rho.Waypoint(3.0, [1, 0, 0]), rho.Waypoint(3.0, [1, 0, 0])]
    with pytest.raises(rho.ScenarioError) as caught:
        single(waypoints=twice)
    assert caught.value.field == "vehicle.waypoints[1].time"
    assert caught.value.value == 3.0
    assert "no other waypoint" in str(caught.value)
    # different vehicles may have one time
    scenario = fleet([[0, 0, 0], [0, 5, 0]], [[9, 0, 0], [9, 5, 0]])
    vehicles = tuple(
        dataclasses.replace(each, waypoints=(rho.Waypoint(3.0, [1, y, 0]),))
        for each, y in zip(scenario.vehicles, (0, 5), strict=True)
    )
    assert rho.verify(rho.plan(dataclasses.replace(scenario, vehicles=vehicles))).ok


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ((np.nan, [1, 0, 0], 0.0), "time"),
        ((1.0, [1, 0], 0.0), "position"),
        ((1.0, [1, 0, 0], -0.1), "within"),
        ((1.0, [1, 0, 0], np.inf), "within"),
    ],
)
def test_invalid_numbers_are_refused(values: tuple[float, list[float], float], field: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Waypoint(*values)
    assert caught.value.field == f"waypoint.{field}"


def test_files_and_schema_preserve_the_waypoints() -> None:
    text = as_yaml(single())
    added = text.replace(
        "waypoints: []", "waypoints: [{time: 5, position: [5, 2, 1.5], within: 0.2}]"
    )
    assert added != text
    read = from_yaml(added)
    assert read.vehicles[0].waypoints == (rho.Waypoint(5.0, [5.0, 2.0, 1.5], 0.2),)
    assert from_yaml(as_yaml(read)) == read
    fields = rho.scenario_schema()["$defs"]["Waypoint"]["properties"]
    for field, unit in (("time", "[s]"), ("position", "[m]"), ("within", "[m]")):
        assert unit in fields[field]["description"]


def test_a_survey_of_two_hundred_legs_is_planned() -> None:
    step, leg, count = 5.0, 12, 200
    places = np.array(
        [[200.0 * ((k + 1) // 2 % 2), 20.0 * (k // 2), 30.0] for k in range(count + 1)]
    )
    waypoints = [rho.Waypoint(step * leg * k, each) for k, each in enumerate(places[1:-1], 1)]
    vehicle = rho.Vehicle(
        "survey", rho.State(places[0]), rho.State(places[-1]), waypoints=waypoints
    )
    plan = rho.plan(rho.Scenario("survey", rho.Grid(step, count * leg + 1), [vehicle]))
    assert rho.verify(plan).ok
    np.testing.assert_allclose(plan.positions[0, ::leg], places, atol=1e-3)
