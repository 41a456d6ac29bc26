"""Least time: closed forms, independent searches, invariances, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.analysis.time_search import TimeSearch
from drake_rho.planning.scp.timed import Timed
from tests.requirements import GRAVITY
from tests.scenarios import box, mapped, single, slow
from tests.test_cli import run
from tests.test_cli_json import read
from tests.written import as_yaml, from_yaml

FAST = rho.Limits(max_acceleration=4.0, max_speed=3.0)


def straight(knots: int, limits: rho.Limits, length: float = 9.0) -> rho.Scenario:
    """Return a vehicle that flies along an axis from rest to rest, with a bad guess of the step."""
    start, goal = rho.State([1.0, -2.0, 3.0]), rho.State([1.0 + length, -2.0, 3.0])
    return single(grid=rho.Grid(0.7, knots), start=start, goal=goal, limits=limits)


def least_time(scenario: rho.Scenario) -> float:
    """Return the least time of a scenario [s], after its plan has been verified."""
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    return plan.scenario.grid.duration


@pytest.mark.parametrize(
    "limits", [rho.Limits(acceleration=box(2.5)), rho.Limits(max_acceleration=2.5)]
)
@pytest.mark.parametrize("knots", [3, 11, 41])
def test_rest_to_rest_under_a_limit_of_accelerations(limits: rho.Limits, knots: int) -> None:
    """With an even number of steps, the change of sign is at a knot: T = 2 sqrt(d / a)."""
    expected = 2.0 * np.sqrt(9.0 / 2.5)
    assert least_time(straight(knots, limits)) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("knots", [4, 22, 402])
def test_with_an_odd_number_of_steps_one_of_them_coasts(knots: int) -> None:
    """With n = 2 m + 1 steps, d = a h² m (m + 1): the time is longer by 1 / (2 n²) of it."""
    n = knots - 1
    expected = 2.0 * np.sqrt(9.0 / 2.5) * np.sqrt(n**2 / (n**2 - 1.0))
    found = least_time(straight(knots, rho.Limits(acceleration=box(2.5))))
    assert found == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("knots", [12, 41, 161])
@pytest.mark.parametrize("form", ["norm", "box"])
def test_rest_to_rest_with_a_largest_speed(knots: int, form: str) -> None:
    """T is d/v + v/a as the knots grow; each cut-off corner of the speed costs a h²/(8 v)."""
    length, v, a = 9.0, 2.0, 2.5
    limits = {
        "norm": rho.Limits(max_speed=v, max_acceleration=a),
        "box": rho.Limits(velocity=box(v), acceleration=box(a)),
    }[form]
    expected = length / v + v / a
    found = least_time(straight(knots, limits, length))
    step = found / (knots - 1)
    assert -1e-8 * expected <= found - expected <= 2.0 * a * step**2 / (8.0 * v) + 1e-7


def test_a_largest_speed_alone_is_reached_in_one_step() -> None:
    found = least_time(straight(17, rho.Limits(max_speed=1.5)))
    assert found == pytest.approx(16.0 * 9.0 / (15.0 * 1.5), rel=1e-8)


@pytest.mark.parametrize("seed", [*range(4), *slow(4, 5)])
def test_no_shorter_time_has_a_plan_and_every_longer_one_does(seed: int) -> None:
    """For a convex problem the planner of a given time is the referee."""
    rng = np.random.default_rng(seed)
    a, v, j = rng.uniform(1.0, 4.0), rng.uniform(1.0, 3.0), rng.uniform(4.0, 20.0)
    limits = [
        rho.Limits(max_acceleration=a, max_speed=v),
        rho.Limits(acceleration=rho.Box([-a, -1.0, -2.0], [1.0, a, 3.0]), velocity=box(v)),
        rho.Limits(max_thrust=9.81 + a, max_tilt=0.5, max_jerk=j),
    ][seed % 3]
    limits = dataclasses.replace(limits, position=rho.Box([-0.2, -0.1, -9], [99, 99, 9]))
    goal = rho.State(rng.uniform(2.0, 9.0, 3))
    scenario = single(goal=goal, limits=limits, grid=rho.Grid(0.3, 24), between_knots=True)
    least = least_time(scenario)
    for factor in (1.0 + 1e-5, 1.1, 2.0):
        rho.plan(dataclasses.replace(scenario, grid=rho.Grid(factor * least / 23, 24)))
    for factor in (1.0 - 1e-5, 0.9):
        with pytest.raises(rho.InfeasibleError):
            rho.plan(dataclasses.replace(scenario, grid=rho.Grid(factor * least / 23, 24)))


CUBOID: list[list[float]] = [[0, 0, 0], [0, 10, 0], [0, 10, 5], [10, 0, 5], [0, 0, 0], [5, 5, 2.5]]


def through(
    places: list[list[float]], limits: rho.Limits, knots: int, within: float = 0.0
) -> rho.Scenario:
    """Return a vehicle that passes places from rest to rest, with free times."""
    passed = [rho.Waypoint(None, place, within) for place in places[1:-1]]
    start, goal = rho.State(places[0]), rho.State(places[-1])
    return single(
        start=start, goal=goal, waypoints=passed, limits=limits, grid=rho.Grid(0.1, knots)
    )


def test_a_track_is_flown_as_fast_as_an_interior_point_method_flies_it() -> None:
    """IPOPT, through CasADi, needs 4.51577 s on the same uniform grid (`make bench-time`)."""
    scenario = through(CUBOID, rho.Limits(max_thrust=34.32), 121)
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    assert plan.scenario.grid.duration == pytest.approx(4.51577, rel=2e-5)
    times = [waypoint.time for waypoint in plan.scenario.vehicles[0].waypoints]
    assert times == sorted(times)  # type: ignore[type-var]  # none of them is None
    again = dataclasses.replace(plan.scenario, vehicles=scenario.vehicles, grid=scenario.grid)
    assert again == scenario


def test_a_tolerance_of_waypoints_saves_time() -> None:
    exact, near = (
        least_time(through(CUBOID, rho.Limits(max_acceleration=6.0), 61, each))
        for each in (0.0, 0.5)
    )
    assert near < 0.98 * exact


@pytest.mark.parametrize("seed", [0, *slow(1, 2, 3, 4)])
def test_among_obstacles_no_time_is_longer_than_that_of_a_given_time(seed: int) -> None:
    """Plans with given times, ever shorter by a hundredth, end before the least time."""
    rng = np.random.default_rng(seed)
    balls = [rho.Sphere(rng.uniform([-2, -2, 0], [2, 2, 2]), rng.uniform(0.4, 1.0)) for _ in "abc"]
    count = 1 + seed % 3
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State([-4, i - 1.0, 1]), rho.State([4, 1.0 - i, 1.2]), radius=0.1)
        for i in range(count)
    ]
    apart = rho.Separation(0.4) if count > 1 else None
    scenario = rho.Scenario(
        "field", rho.Grid(0.2, 25), vehicles, FAST, obstacles=balls, separation=apart
    )
    plan = rho.plan_minimum_time(scenario)
    least, bound = plan.scenario.grid.duration, plan.statistics.time_bound
    assert rho.verify(plan).ok
    assert bound is not None
    assert 0.9 * least < bound <= least * (1.0 + 1e-7)
    longest = 1.0
    while longest > 0.5:
        try:
            rho.plan(dataclasses.replace(scenario, grid=rho.Grid(longest * least / 24, 25)))
        except (rho.InfeasibleError, rho.SolverError):
            break
        longest -= 0.01
    assert longest >= 0.98  # the planner of given times finds at most a hundredth less


def test_the_least_time_is_invariant() -> None:
    wall = rho.Sphere([5.0, 2.1, -1.0], 1.5)
    limits = rho.Limits(max_acceleration=3.0, max_speed=4.0)
    waypoints = [rho.Waypoint(None, [2.0, 3.0, 0.5], 0.1)]
    scenario = single(limits=limits, obstacles=[wall], waypoints=waypoints, between_knots=True)
    least = least_time(scenario)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = mapped(scenario, turn, np.array([100.0, -20.0, 3.0]), length=7.0, time=2.0)
    assert least_time(moved) == pytest.approx(2.0 * least, rel=1e-4)
    other = dataclasses.replace(scenario, grid=rho.Grid(2.0, 17))
    assert least_time(other) == pytest.approx(least, rel=1e-4)


def test_independent_vehicles_take_as_long_as_the_slowest() -> None:
    ends = [([0, 0, 0], [4, 0, 0]), ([0, 5, 0], [9, 5, 0]), ([0, 9, 0], [1, 9, 0])]
    vehicles = [rho.Vehicle(f"v{i}", rho.State(a), rho.State(b)) for i, (a, b) in enumerate(ends)]
    fleet = rho.Scenario("fleet", rho.Grid(0.2, 21), vehicles, rho.Limits(max_acceleration=2.0))
    plan = rho.plan_minimum_time(fleet)
    assert plan.scenario.grid.duration == pytest.approx(2.0 * np.sqrt(9.0 / 2.0), rel=1e-7)
    assert rho.verify(plan).ok
    # those with time to spare take the least effort
    least = rho.plan(dataclasses.replace(plan.scenario, vehicles=plan.scenario.vehicles[::2]))
    np.testing.assert_allclose(plan.accelerations[::2], least.accelerations, atol=1e-4)


@pytest.mark.parametrize("apart", [None, *slow(rho.Separation(0.5))])
def test_each_vehicle_arrives_as_soon_as_it_can_and_stays(apart: rho.Separation | None) -> None:
    ends = [([-5, 0, 1], [5, 0, 1]), ([0, -3, 1], [0, 3, 1]), ([2, 2, 1], [1, -2, 1])]
    turn = [(), (), [rho.Waypoint(None, [3.0, 0.0, 1.0])]]
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State(a), rho.State(b), waypoints=passed)
        for i, ((a, b), passed) in enumerate(zip(ends, turn, strict=True))
    ]
    fleet = rho.Scenario("fleet", rho.Grid(0.1, 41), vehicles, FAST, separation=apart)
    together = rho.plan_minimum_time(fleet)
    each = rho.plan_minimum_time(fleet, arrival="each")
    assert rho.verify(each).ok
    last, step = together.scenario.grid.end, each.scenario.grid.step
    np.testing.assert_allclose(together.arrivals, last)
    assert each.scenario.grid.end == pytest.approx(last, rel=1e-6)
    assert np.sum(each.arrivals) < 0.85 * np.sum(together.arrivals)
    for i in range(3):
        alone = least_time(dataclasses.replace(fleet, vehicles=(vehicles[i],)))
        assert each.arrivals[i] > alone - 1e-3 * step  # more knots are no help
        if apart is None:
            assert each.arrivals[i] < alone * (1.0 + 1e-3) + step
        rests = each.scenario.grid.times >= each.arrivals[i] - 1e-9
        at_rest = each.velocities[i][rests]
        np.testing.assert_allclose(at_rest, 0.0, atol=1e-6)


_CROSSING = rho.Obstacle(rho.Sphere([0.0, -3.0, 1.0], 1.2), velocity=[0.0, 1.5, 0.0])
_DRIFTING = rho.Obstacle(rho.Sphere([1.0, 0.1, 1.0], 1.0), velocity=[0.0, 0.3, 0.0])
_GATE = rho.Obstacle(rho.Box([2.0, -9, -9], [2.2, 9, 9]), active=(0.0, 4.0))


@pytest.mark.parametrize(
    ("body", "knots", "longer_than"),
    [
        (_DRIFTING, 11, 3.45),  # it takes 3.44 s without the obstacle
        pytest.param(_CROSSING, 31, 3.0, marks=pytest.mark.slow),
        pytest.param(_GATE, 31, 4.0, marks=pytest.mark.slow),  # it waits for the gate
    ],
    ids=["drifting", "crossing", "gate"],
)
def test_what_changes_with_time_is_kept_clear_of(
    body: rho.Obstacle, knots: int, longer_than: float
) -> None:
    vehicle = rho.Vehicle("v", rho.State([-4, 0, 1]), rho.State([4, 0, 1]), radius=0.2)
    grid = rho.Grid(6.0 / (knots - 1), knots)
    scenario = rho.Scenario("t", grid, [vehicle], FAST, obstacles=[body])
    assert longer_than < least_time(scenario) < 6.0


@pytest.mark.parametrize("balls", [[], *slow([rho.Sphere([5.0, 2.1, -1.0], 1.0)])])
def test_wind_and_given_times_are_kept(balls: list[rho.Sphere]) -> None:
    windy = dataclasses.replace(
        single(limits=FAST, obstacles=balls, between_knots=True),
        disturbance=rho.Disturbance(0.2),
    )
    calm = dataclasses.replace(windy, disturbance=None)
    assert least_time(windy) > least_time(calm)
    timed = single(limits=FAST, waypoints=[rho.Waypoint(5.0, [4.0, 0.0, 0.0])])
    plan = rho.plan_minimum_time(timed)
    assert rho.verify(plan).ok
    assert plan.scenario.vehicles[0].waypoints[0].time == 5.0
    assert plan.scenario.grid.duration > 6.0


def test_the_number_of_knots_can_be_chosen() -> None:
    scenario = straight(12, FAST)
    plan = rho.plan_minimum_time(scenario, knots=61)
    assert plan.scenario.grid.knots == 61
    assert plan.scenario.grid.duration < least_time(scenario)


@pytest.mark.parametrize("balls", [[], *slow([rho.Sphere([4.0, 1.5, 0.0], 0.8)])])
def test_free_waypoints_of_a_given_final_time_are_passed_when_it_costs_least(
    balls: list[rho.Sphere],
) -> None:
    free = [rho.Waypoint(None, [2.0, 4.0, 0.0]), rho.Waypoint(None, [6.0, -1.0, 0.0], 0.2)]
    scenario = single(limits=FAST, waypoints=free, obstacles=balls, grid=rho.Grid(0.4, 31))
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    passed = plan.scenario.vehicles[0].waypoints
    for k in (0, 1):
        for later in (-0.05, 0.05):
            times = [float(each.time or 0.0) for each in passed]
            times[k] += later
            moved = [
                dataclasses.replace(each, time=time)
                for each, time in zip(passed, times, strict=True)
            ]
            other = single(limits=FAST, waypoints=moved, obstacles=balls, grid=scenario.grid)
            assert rho.plan(other, reference=plan).cost > plan.cost * (1.0 - 1e-6)


@pytest.mark.slow
def test_a_bad_guess_of_the_step_and_vehicles_that_stay_do_no_harm() -> None:
    least = least_time(straight(21, FAST))
    for step in (1e-5, 1e4):
        other = dataclasses.replace(straight(21, FAST), grid=rho.Grid(step, 21))
        assert least_time(other) == pytest.approx(least, rel=1e-6)
    scenario = straight(21, FAST)
    stays = rho.Vehicle("stays", rho.State([0, 9, 0]), rho.State([0, 9, 0]))
    both = dataclasses.replace(scenario, vehicles=(*scenario.vehicles, stays))
    plan = rho.plan_minimum_time(both)
    assert plan.scenario.grid.duration == pytest.approx(least, rel=1e-7)
    np.testing.assert_allclose(plan.accelerations[1], 0.0, atol=1e-9)
    with pytest.raises(rho.ScenarioError, match=r"vehicles: .*least time is zero"):
        rho.plan_minimum_time(dataclasses.replace(both, vehicles=(stays,)))
    for place in ([0.0, 0.0, 0.0], [10.0, 4.0, -2.0]):  # at the start, or at the goal
        least_time(single(limits=FAST, waypoints=[rho.Waypoint(None, place)]))
    with pytest.raises(rho.InfeasibleError, match="a single step"):
        rho.plan_minimum_time(straight(2, FAST))
    crowded = [rho.Waypoint(None, [x, 0.3 * x % 1, 1.0]) for x in (1.0, 2.0, 3.0, 4.0)]
    with pytest.raises(rho.InfeasibleError, match=r"on 4 knots .*: waypoints in their order"):
        rho.plan_minimum_time(single(limits=FAST, waypoints=crowded, grid=rho.Grid(1.0, 4)))


def test_a_scenario_with_free_waypoints_is_saved_and_drawn() -> None:
    scenario = through(CUBOID, FAST, 61)
    assert from_yaml(as_yaml(scenario)) == scenario
    assert "time" not in as_yaml(scenario).split("waypoints")[1]
    assert rho.paths_figure(scenario) is not None


def test_free_waypoints_need_a_planner_that_finds_their_times() -> None:
    scenario = through(CUBOID, FAST, 61)
    for planner in (rho.plan_convex, rho.diagnose):
        with pytest.raises(rho.ScenarioError, match=r"waypoints\[0\]\.time: got none"):
            planner(scenario)


def test_what_has_no_least_time_is_refused() -> None:
    with pytest.raises(rho.ScenarioError, match=r"limits: .*there is no least time"):
        rho.plan_minimum_time(single())
    with pytest.raises(rho.ScenarioError, match=r"waypoints\[1\]\.position: .*another position"):
        through([[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]], FAST, 21)
    with pytest.raises(rho.ScenarioError, match=r"waypoints\[2\]\.time: .*after 3 s"):
        single(waypoints=[rho.Waypoint(t, [1, t or 0, 0]) for t in (3.0, None, 2.0)])
    with pytest.raises(rho.ScenarioError, match=r"waypoints\[0\]\.position: .*outside obstacle 1"):
        single(waypoints=[rho.Waypoint(None, [5, 0, 0])], obstacles=[rho.Sphere([5, 0, 0], 1)])
    with pytest.raises(rho.ScenarioError, match=r"knots"):
        rho.plan_minimum_time(single(limits=FAST), knots=1)


@pytest.mark.slow
def test_a_wall_across_a_room_is_named() -> None:
    wall = rho.Box([4.0, -99, -99], [5.0, 99, 99])
    room = dataclasses.replace(FAST, position=rho.Box([-1, -5, -5], [11, 5, 5]))
    with pytest.raises(rho.InfeasibleError, match="obstacle 1"):
        rho.plan_minimum_time(single(limits=room, obstacles=[wall], between_knots=True))


@pytest.mark.parametrize(
    ("waypoints", "why"),
    [
        ([(1.0, [0, 100, 0])], ("maximum acceleration", "waypoint 1 at 1 s")),
        pytest.param(
            [(3.0, [2, 0, 0]), (3.1, [5, 0, 0])],
            ("maximum speed", "waypoint 1", "waypoint 2"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            [(1.0, [0.5, 0, 0]), (None, [4, 3, 0]), (1.5, [9, 0, 0])],
            ("waypoint 3 at 1.5 s",),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["far", "apart", "between"],
)
def test_times_that_no_final_time_can_meet_are_named_with_the_limit(
    waypoints: list[tuple[float | None, list[float]]],
    why: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: object,
) -> None:
    passed = [rho.Waypoint(time, position) for time, position in waypoints]
    scenario = single(limits=FAST, waypoints=passed, grid=rho.Grid(0.5, 21))
    with pytest.raises(rho.InfeasibleError, match="no plan: in no final time") as caught:
        rho.plan_minimum_time(scenario)
    assert "goal" not in str(caught.value)
    for words in why:
        assert words in str(caught.value)
    path = f"{tmp_path}/late.yaml"
    rho.save_scenario(scenario, path)
    status, out, err = run(capsys, monkeypatch, "fastest", path, "--quiet")
    assert (status, out, err) == (3, "", f"drake-rho: {caught.value}\n")


@pytest.mark.parametrize(("count", "knots"), [(2, 13), pytest.param(4, 21, marks=pytest.mark.slow)])
def test_a_flight_keeps_the_given_times_among_its_waypoints(count: int, knots: int) -> None:
    passed = [rho.Waypoint(2.0, [2, 0, 0]), rho.Waypoint(None, [4, 2, 0])]
    passed += [rho.Waypoint(6.0, [6, 0, 0]), rho.Waypoint(None, [8, -1, 0])]
    scenario = single(limits=FAST, waypoints=passed[:count], grid=rho.Grid(0.5, knots))
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    times = [float(each.time or 0.0) for each in plan.scenario.vehicles[0].waypoints]
    assert times == sorted(times)
    assert times[::2] == [2.0, 6.0][: count // 2]


@pytest.mark.slow
def test_a_flight_lasts_as_long_as_its_intervals() -> None:
    home = rho.KeepIn(rho.Sphere([0, 0, 0], 2.0), active=(8.0, 8.0))
    waits = dataclasses.replace(single(limits=FAST, grid=rho.Grid(0.6, 21)), requirements=(home,))
    assert least_time(waits) > 10.0  # 8 m from there to the goal


def test_the_command_prints_and_saves_the_plan(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    path = f"{tmp_path}/track.yaml"
    rho.save_scenario(through(CUBOID, rho.Limits(max_thrust=34.32), 61), path)
    status, out, _ = run(capsys, monkeypatch, "fastest", path, "--knots", "121", "--json")
    assert status == 0
    assert read(out, "fastest")["ok"]


def test_a_smoothing_is_kept_in_the_least_time() -> None:
    smoothing = rho.Smoothing(0.05, 2)
    for balls in ([], [rho.Sphere([5.0, 1.0, -1.0], 0.5)]):
        free = single(limits=FAST, obstacles=balls, grid=rho.Grid(0.2, 25), between_knots=True)
        gate = [rho.Waypoint(None, [4.0, 3.0, 0.0], within=0.1)]
        vehicle = dataclasses.replace(free.vehicles[0], waypoints=tuple(gate))
        smooth = dataclasses.replace(free, vehicles=(vehicle,), smoothing=smoothing)
        plan = rho.plan_minimum_time(smooth)
        assert rho.verify(plan).ok
        assert plan.scenario.smoothing == smoothing
    wide = dataclasses.replace(smooth, smoothing=rho.Smoothing(0.19, 1))
    assert rho.plan_minimum_time(wide).scenario.grid.step >= 0.19  # a step is not narrower


@pytest.mark.parametrize("given", [*slow(0, 1), 2])
def test_waypoints_with_and_without_times_are_passed_in_order(given: int) -> None:
    """The given time is far from that at which a flight in the least time would be there."""
    places = [[2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [0.0, 2.0, 1.0]]
    times: list[float | None] = [None] * 3
    times[given] = [10.0, 9.5, 12.5][given]
    passed = [rho.Waypoint(at, place) for at, place in zip(times, places, strict=True)]
    ends = rho.State([0, 0, 1]), rho.State([-2, 2, 1])
    vehicle = rho.Vehicle("one", *ends, waypoints=passed)
    limits, grid = rho.Limits(max_acceleration=4.0), rho.Grid(0.5, 25, start=7.0)
    scenario = rho.Scenario("mixed", grid, [vehicle], limits)
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    found = [each.time for each in plan.scenario.vehicles[0].waypoints]
    assert found == sorted(found)  # type: ignore[type-var]  # none of them is None
    assert found[given] == times[given]
    assert plan.scenario.grid.duration < scenario.grid.duration


@pytest.mark.parametrize("step", [*slow(0.02, 0.3), 6.0])
def test_a_start_in_motion_and_a_bad_guess_of_the_step_do_no_harm(step: float) -> None:
    """From every guess the same time is found, but for local optima within two thousandths."""
    passed = [rho.Waypoint(None, [2, 1, 0], 0.1), rho.Waypoint(None, [3, -1, 1])]
    scenario = single(
        start=rho.State([0, 0, 0], [-0.5, 0.4, 0.3]),
        goal=rho.State([5, 0, 0]),
        waypoints=passed,
        limits=rho.Limits(max_acceleration=4.0, position=box(9.0)),
        grid=rho.Grid(step, 25),
    )
    assert least_time(scenario) == pytest.approx(4.035, rel=2e-3)


@pytest.mark.parametrize("spare", [1e-1, 1e-2, 1e-3])
def test_thrusts_just_above_hovering_leave_little_but_are_planned_with(spare: float) -> None:
    """A horizontal acceleration a takes the thrust (a² + g²)^½; a dip first saves a little."""
    thrust = GRAVITY + spare
    a = np.sqrt(thrust**2 - GRAVITY**2)
    vehicle = rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([2, 0, 1]))
    scenario = rho.Scenario("hover", rho.Grid(1.0, 25), [vehicle], rho.Limits(max_thrust=thrust))
    plan = rho.plan_minimum_time(scenario)
    level = 2.0 * np.sqrt(2.0 / a)
    assert 0.9 * level <= plan.scenario.grid.duration <= level * (1.0 + 1e-6)
    assert rho.verify(plan).ok
    gate = rho.Waypoint(None, [1, 0.25, 1])
    past = dataclasses.replace(
        scenario, vehicles=(dataclasses.replace(vehicle, waypoints=(gate,)),)
    )
    passing = rho.plan_minimum_time(past)
    assert rho.verify(passing).ok
    assert passing.scenario.grid.duration >= plan.scenario.grid.duration


def test_where_programs_are_too_inexact_the_plan_is_that_of_bisection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = single(limits=FAST)
    exact = rho.plan_minimum_time(scenario)
    finished, calls = TimeSearch._finished, list[Timed]()

    def first_one_violates(self: TimeSearch, best: Timed, alone: np.ndarray) -> rho.Plan:
        calls.append(best)
        if len(calls) == 1:
            raise rho.SolverError("the motion that the solvers found violates constraints")
        return finished(self, best, alone)

    monkeypatch.setattr(TimeSearch, "_finished", first_one_violates)
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    assert not plan.statistics.converged
    assert 1.0 - 1e-9 <= plan.scenario.grid.duration / exact.scenario.grid.duration <= 1.02
