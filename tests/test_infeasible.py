"""Reasons for infeasibility: constraints are named, and the reasons are true."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject, settings
from pydrake.solvers import ClarabelSolver, GurobiSolver, OsqpSolver, SolverInterface
from scipy.optimize import linprog

import drake_rho as rho
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.programs import backend, solve
from drake_rho.planning.scp.working_set import WorkingSet
from tests.arrays import FloatArray
from tests.scenarios import box, examples, scenarios, single


def _conflict(scenario: rho.Scenario, solver: SolverInterface | None = None) -> tuple[str, ...]:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario, solver=solver)
    (names,) = rho.infeasible_subset(caught.value, solver=solver).values()
    return names


def _first_conflict(scenario: rho.Scenario) -> tuple[str, tuple[str, ...]]:
    """Return a vehicle without a plan and its conflict; skip scenarios that have a plan."""
    try:
        rho.plan_convex(scenario)
    except rho.InfeasibleError as error:
        return next(iter(rho.infeasible_subset(error).items()))
    return reject()


ACCELERATION = "acceleration box x from 0 s to 7.5 s"


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        (rho.Limits(acceleration=box(0.5)), ("goal x", ACCELERATION)),
        (rho.Limits(velocity=box(1.2)), ("goal x", "velocity box x from 0.5 s to 7.5 s")),
        (
            rho.Limits(velocity=box(50), acceleration=box(0.5), position=box(100)),
            ("goal x", ACCELERATION),
        ),
    ],
)
def test_exactly_the_conflicting_constraints_are_named(
    limits: rho.Limits, expected: tuple[str, ...], solver: SolverInterface
) -> None:
    assert _conflict(single(limits=limits), solver) == expected


def test_a_conflicting_jerk_limit_is_named() -> None:
    start = rho.State([0, 0, 0], acceleration=[0, 0, 0])
    names = _conflict(single(start=start, limits=rho.Limits(jerk=box(0.3))))
    assert names[0] == "goal x"
    assert names[1].startswith("jerk box x")


def test_an_error_names_no_axis_of_the_goal_without_conflict() -> None:
    """The jerk along x is what fails, before the conflict is reduced."""
    start = rho.State([0.0, 0.0, 0.0], acceleration=[0.0, 0.0, 0.0])
    goal, limits = rho.State([30.0, 4.0, -2.0]), rho.Limits(jerk=box(0.06))
    grid = rho.Grid.lasting(20.0, step=20.0 / 99)
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(single(start=start, goal=goal, limits=limits, grid=grid))
    assert caught.value.conflicts == {"solo": ("goal x", "jerk box x from 0 s to 20 s")}


def test_a_conflicting_obstacle_is_named_with_its_times() -> None:
    # a corridor filled by the sphere
    walls = rho.Box([-1.0, -0.5, -0.5], [11.0, 0.5, 0.5])
    goal = rho.State([10.0, 0.0, 0.0])
    obstacle = rho.Sphere([5.0, 0.1, 0.0], 2.0)
    limits = rho.Limits(position=walls, acceleration=box(5.0))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(single(goal=goal, limits=limits, obstacles=(obstacle,)))
    names = caught.value.conflicts["solo"]
    assert any(name.startswith("obstacle 1 ") for name in names), names
    text = str(caught.value)
    assert "linearised around this reference: solo cannot meet together: " in text
    assert "another reference" in text


@pytest.mark.slow
@given(scenario=scenarios(tight=True))
@settings(max_examples=10)
def test_constraints_that_are_not_named_are_not_needed_for_the_conflict(
    scenario: rho.Scenario,
) -> None:
    free = scenario.without_obstacles()
    name, names = _first_conflict(free)
    kinds = ("position", "velocity", "acceleration", "jerk")
    needed: dict[str, Any] = {
        kind: getattr(free.limits, kind)
        for kind in kinds
        if any(part.startswith(f"{kind} box") for part in names)
    }
    vehicle = free.vehicles[free.index_of(name)]
    alone = dataclasses.replace(free, vehicles=(vehicle,), limits=rho.Limits(**needed))
    assert _conflict(alone)
    without = dataclasses.replace(alone, limits=rho.Limits())
    assert rho.verify(rho.plan_convex(without)).ok


def _reachable(scenario: rho.Scenario, vehicle: rho.Vehicle, most: float) -> bool:
    """Return whether accelerations up to `most` reach the goal: a linear program for each axis."""
    h, n = scenario.grid.step, scenario.grid.knots - 1
    speed = np.full(n, h)
    place = h**2 * (n - 0.5 - np.arange(n))
    for axis in range(3):
        start, goal = vehicle.start, vehicle.goal
        change = goal.velocity[axis] - start.velocity[axis]
        way = goal.position[axis] - start.position[axis] - n * h * start.velocity[axis]
        found = linprog(
            np.zeros(n), A_eq=np.stack([speed, place]), b_eq=[change, way], bounds=(-most, most)
        )
        if found.status == 2:
            return False
        assert found.status == 0
    return True


@pytest.mark.parametrize("most", [6.0, 7.0, 8.0, 9.0])
def test_exactly_the_vehicles_without_a_plan_are_named(paper: rho.Scenario, most: float) -> None:
    scenario = dataclasses.replace(
        paper.without_obstacles(), limits=rho.Limits(acceleration=box(most))
    )
    stuck = {vehicle.name for vehicle in paper.vehicles if not _reachable(scenario, vehicle, most)}
    try:
        rho.plan_convex(scenario)
        named = set()
    except rho.InfeasibleError as error:
        named = set(error.conflicts)
    assert named == stuck
    assert stuck or most > 7.0


def test_vehicles_that_fail_in_different_rounds_are_all_named() -> None:
    def vehicle(name: str, limits: rho.Limits | None) -> rho.Vehicle:
        return rho.Vehicle(name, rho.State([0, 0, 0]), rho.State([10, 0, 0]), limits)

    scenario = rho.Scenario(
        "three",
        rho.Grid(0.5, 17),
        (
            vehicle("weak", rho.Limits(acceleration=box(0.1))),
            vehicle("slow", rho.Limits(velocity=box(1.0))),
            vehicle("free", None),
        ),
    )
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    assert set(caught.value.conflicts) == {"weak", "slow"}


def test_no_named_constraint_can_be_omitted() -> None:
    """Goal and jerk alone are a conflict; the velocity box, violated too, is not part of it."""
    start, goal = rho.State([0, 0, 0], acceleration=[0, 0, 0]), rho.State([10, 0, 0])
    limits = rho.Limits(velocity=box(1.6), jerk=box(0.2))
    names = _conflict(single(start=start, goal=goal, limits=limits))
    assert [name.split()[0] for name in names] == ["goal", "jerk"]


@given(scenario=scenarios(tight=True))
@examples(few=2, many=5)
def test_without_any_one_of_the_named_boxes_there_is_a_plan_for_their_axes(
    scenario: rho.Scenario,
) -> None:
    free = scenario.without_obstacles()
    name, names = _first_conflict(free)
    vehicle = free.vehicles[free.index_of(name)]
    boxes = {part.split()[0] for part in names if " box" in part}
    axes = {part.split()[1] for part in names if part.startswith("goal")}
    for spared in boxes:
        kept: dict[str, Any] = {
            kind: _only(axes, getattr(free.limits, kind)) for kind in boxes - {spared}
        }
        scenario = dataclasses.replace(free, vehicles=(vehicle,), limits=rho.Limits(**kept))
        rho.plan_convex(scenario)


def _only(axes: set[str], bounds: rho.Box) -> rho.Box:
    """Return the box on these axes, wide open on the others."""
    wide = 1e3 * np.abs([bounds.lower, bounds.upper]).max()
    taken = np.array([axis in axes for axis in "xyz"])
    return rho.Box(np.where(taken, bounds.lower, -wide), np.where(taken, bounds.upper, wide))


def test_the_work_of_a_failure_is_counted(paper: rho.Scenario) -> None:
    slow = dataclasses.replace(paper, limits=rho.Limits(acceleration=box(6.0)))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(slow, steps=[0.5])
    assert caught.value.statistics.programs >= 8
    assert caught.value.statistics.solver == backend.DEFAULT().solver_id().name()


COARSE = rho.Grid(4.0, 3)
TIGHT = rho.Limits(acceleration=box(0.8))


def test_another_step_is_tried_when_the_first_has_no_solution() -> None:
    """Step 3 of the paper: two steps of 4 s violate the velocity box, finer ones need not."""
    limits = rho.Limits(velocity=box(1.9))
    scenario = single(grid=COARSE, limits=limits)
    with pytest.raises(rho.InfeasibleError, match=r"steps tried: 4 s"):
        rho.plan_convex(scenario)
    plan = rho.plan_convex(scenario, steps=[8.0, 1.0, 0.5])
    assert plan.statistics.steps_tried == (4.0, 8.0, 1.0)
    assert plan.scenario.grid == rho.Grid(1.0, 9)
    assert plan.scenario.grid.duration == COARSE.duration
    assert rho.verify(plan).ok


def test_a_step_that_has_a_plan_is_kept() -> None:
    plan = rho.plan_convex(single(), steps=[0.25])
    assert plan.scenario.grid.step == 0.5
    assert plan.statistics.steps_tried == (0.5,)


def test_another_step_begins_at_the_same_time_on_the_clock() -> None:
    coarse = dataclasses.replace(COARSE, start=30.0)
    scenario = single(grid=coarse, limits=rho.Limits(velocity=box(1.9)))
    assert rho.plan_convex(scenario, steps=[1.0]).scenario.grid == rho.Grid(1.0, 9, 30.0)


def test_all_steps_without_a_solution_are_named() -> None:
    with pytest.raises(rho.InfeasibleError, match=r"steps tried: 0\.5 s, 1 s, 0\.25 s") as caught:
        rho.plan_convex(single(limits=rho.Limits(acceleration=box(0.3))), steps=[1.0, 0.25])
    assert caught.value.steps_tried == (0.5, 1.0, 0.25)


@pytest.mark.parametrize("step", [3.0, 0.0, -1.0, 9.0, float("nan"), float("inf")])
def test_a_step_that_does_not_divide_the_duration_is_refused(step: float) -> None:
    with pytest.raises(ValueError, match="steps: got"):
        rho.plan_convex(single(), steps=[step])


_OPTIONS = {"Clarabel": ("_CLARABEL", "_CLARABEL_AGAIN"), "OSQP": ("_OSQP",)}


@pytest.mark.parametrize(("first", "second"), [("Clarabel", "OSQP"), ("OSQP", "Clarabel")])
def test_the_other_solver_takes_over_from_one_that_fails(
    first: str, second: str, monkeypatch: pytest.MonkeyPatch, paper: rho.Scenario
) -> None:
    for options in _OPTIONS[first]:
        monkeypatch.setattr(solve, options, {"max_iter": 1})
    made: SolverInterface = {"Clarabel": ClarabelSolver, "OSQP": OsqpSolver}[first]()
    plan = rho.plan_convex(paper, solver=made)
    assert plan.statistics.solver == second
    assert plan.cost == pytest.approx(20920.353, rel=1e-6)


def test_two_solvers_that_fail_are_an_error(
    monkeypatch: pytest.MonkeyPatch, paper: rho.Scenario
) -> None:
    for options in (*_OPTIONS["Clarabel"], *_OPTIONS["OSQP"]):
        monkeypatch.setattr(solve, options, {"max_iter": 1})
    with pytest.raises(rho.SolverError, match="all solvers failed numerically on"):
        rho.plan_convex(paper, solver=ClarabelSolver())


def test_an_unavailable_solver_is_refused(paper: rho.Scenario) -> None:
    with pytest.raises(ValueError, match="solver: got Gurobi"):
        rho.plan_convex(paper, solver=GurobiSolver())


def test_without_multipliers_all_rows_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    multipliers = WorkingSet.multipliers

    def none(self: WorkingSet, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        return [(rows, 0.0 * y) for rows, y in multipliers(self, vehicle)]

    scenario = single(limits=rho.Limits(velocity=box(1.2)))
    with pytest.raises(rho.InfeasibleError) as weighed:
        rho.plan_convex(scenario)
    monkeypatch.setattr(WorkingSet, "multipliers", none)
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    (name,) = [name for name in caught.value.conflicts["solo"] if "box" in name]
    assert name.startswith("velocity box x")
    assert weighed.value.conflicts["solo"][0] == "goal x"


def test_a_limit_active_on_another_axis_is_not_named_in_the_subset() -> None:
    """The flight is too slow along x; along y it is limited too, but reaches its goal."""
    slow = rho.Limits(velocity=rho.Box([-1.2, -0.6, -9.0], [1.2, 0.6, 9.0]))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(single(limits=slow))
    (names,) = rho.infeasible_subset(caught.value).values()
    assert names == ("goal x", "velocity box x from 0.5 s to 7.5 s")


@pytest.mark.parametrize("knots", [21, 81, pytest.param(201, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "limits",
    [
        rho.Limits(max_acceleration=4.0, max_speed=9.0),
        rho.Limits(max_thrust=15.0, max_speed=9.0),
    ],
    ids=["acceleration", "thrust"],
)
def test_a_waypoint_out_of_reach_conflicts_with_nothing_after_it(
    limits: rho.Limits, knots: int
) -> None:
    far = rho.Waypoint(1.0, [0, 100, 0])
    late = single(limits=limits, waypoints=[far], grid=rho.Grid(0.1, knots))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(late)
    names = rho.infeasible_subset(caught.value)["solo"]
    assert len(names) == 2
    assert "from 0 s to 0.9 s" in names[0]  # the last acceleration before the waypoint
    assert names[1] == "waypoint 1 at 1 s"


@pytest.mark.parametrize("knots", [21, 81])
def test_waypoints_too_far_apart_conflict_with_the_speed_between_them(knots: int) -> None:
    passed = [rho.Waypoint(3.0, [2, 0, 0]), rho.Waypoint(3.1, [5, 0, 0])]
    limits = rho.Limits(max_acceleration=4.0, max_speed=3.0)
    fast = single(limits=limits, waypoints=passed, grid=rho.Grid(0.5, knots))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(fast)
    names = rho.infeasible_subset(caught.value)["solo"]
    assert sorted(names) == [
        "maximum speed from 3 s to 3.5 s",
        "waypoint 1 at 3 s",
        "waypoint 2 at 3.1 s",
    ]


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_waypoints_that_a_limit_keeps_apart_are_named_with_it_on_any_clock(start: float) -> None:
    """Legs of a quarter of a second in a flight of ten need thousands of times its mean effort."""
    rng = np.random.default_rng(12)
    times = start + np.array([2.166, 2.384, 2.889, 4.115])
    passed = [rho.Waypoint(time, 0.25 * rng.normal(size=3)) for time in times.tolist()]
    limits = rho.Limits(velocity=box(0.25), acceleration=box(2.0))
    goal = rho.State(0.25 * rng.normal(size=3))
    slow = single(limits=limits, waypoints=passed, goal=goal, grid=rho.Grid(0.25, 42, start))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(slow)
    names = rho.infeasible_subset(caught.value)["solo"]
    assert any("velocity box" in name for name in names)
    assert not any("goal" in name for name in names)


def test_what_a_solver_calls_infeasible_without_a_proof_is_planned() -> None:
    """Clarabel's weights for this mission exclude solutions of a hundredth of its bounds only."""
    places = [
        *([-67, -110, 31], [-131, -143, 62], [-199, 228, 57], [-104, 248, 57], [-43, -123, 63]),
        *([-224, 13, 61], [-163, 304, 54], [-34, 253, 33], [-9, 101, 31]),
    ]
    times = 32.0, 52.0, 132.0, 156.0, 236.0, 288.0, 352.0, 384.0, 420.0
    waypoints = [rho.Waypoint(*each) for each in zip(times, places, strict=True)]
    waypoints[-1] = rho.Waypoint(times[-1], places[-1], velocity=np.zeros(3))
    vehicle = rho.Vehicle("q", rho.State([0, 0, 0]), rho.State([-9, 101, 0]), waypoints=waypoints)
    floor = rho.KeepIn(rho.HalfSpace([0.0, 0.0, -1.0], 1.0), name="floor")
    limits = rho.Limits(max_speed=5.0, max_acceleration=2.5)
    grid = rho.Grid.lasting(432.0, step=2.0)
    plan = rho.plan(rho.Scenario("mission", grid, [vehicle], limits, requirements=[floor]))
    assert rho.verify(plan).ok
    assert plan.cost < 13.0
