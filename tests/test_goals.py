"""Goals of every kind: exact, with a free velocity, anywhere, and in convex sets."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, MathematicalProgram

import drake_rho as rho
from tests.arrays import FloatArray

START = rho.State([0.0, 0.0, 1.0], [0.4, 0.2, 0.0])
PAD = rho.Sphere([4.0, 1.0, 1.0], 0.5)
BOX = rho.Box([3.0, 0.5, 0.0], [4.0, 1.5, 0.8])
GATE = rho.Sphere([1.0, 0.0, 0.0], 0.3)
GOALS: dict[str, Any] = {
    "state": rho.State([4.0, 2.0, 3.0]),
    "free velocity": rho.State([4.0, 2.0, 3.0], None),
    "free": None,
    "anywhere at rest": rho.Goal(None),
    "anywhere at a velocity": rho.Goal(None, velocity=[0.0, 0.5, 0.2]),
    "ball": PAD,
    "box": BOX,
    "half-space": rho.HalfSpace([-1.0, 0.2, 0.0], -3.0),
    "box with any velocity": rho.Goal(BOX, velocity=None),
    "velocities": rho.Goal([4.0, 2.0, 3.0], velocity=GATE),
    "positions and velocities": rho.Goal(PAD, velocity=GATE),
}


class Ball:
    """A user's own set: the ball of radius 0.5 m around (4, 1, 1)."""

    def support(self, n: FloatArray) -> FloatArray:
        """Return the largest n · x of the ball."""
        return np.asarray(n @ PAD.center + 0.5 * np.linalg.norm(n, axis=-1))

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the sphere, negative inside."""
        return np.asarray(np.linalg.norm(x - PAD.center, axis=-1) - 0.5)

    def outward(self, x: FloatArray) -> FloatArray:
        """Return unit vectors away from the centre."""
        lengths = np.linalg.norm(x - PAD.center, axis=-1, keepdims=True)
        found = (x - PAD.center) / np.where(lengths > 0.0, lengths, 1.0)
        return np.where(lengths > 0.0, found, [1.0, 0.0, 0.0])


def flight(goal: Any, **changes: Any) -> rho.Scenario:
    """Return a flight of 5 s with limits on speed and acceleration."""
    limits = rho.Limits(max_speed=2.5, acceleration=rho.Box([-1.5] * 3, [1.5] * 3))
    return rho.Scenario(
        "flight",
        rho.Grid.lasting(5.0, step=0.25),
        [rho.Vehicle("scout", START, goal, radius=0.2)],
        **({"limits": limits} | changes),
    )


def distance(wanted: Any, value: FloatArray) -> float:
    """Return how far a value is from a goal's, 0 inside a set."""
    if wanted is None:
        return 0.0
    if isinstance(wanted, np.ndarray):
        return float(np.linalg.norm(value - wanted))
    return max(0.0, float(wanted.signed_distance(value)))


def optimum(scenario: rho.Scenario) -> float:
    """Return the least cost of a vehicle, by a program of its own written out at the knots."""
    vehicle, grid, steps = scenario.vehicles[0], scenario.grid, scenario.grid.knots - 1
    h, prog = grid.step, MathematicalProgram()
    a = prog.NewContinuousVariables(steps, 3)
    p, v = np.array(vehicle.start.position), np.array(vehicle.start.velocity)
    limits = scenario.limits
    assert limits.acceleration is not None
    assert limits.max_speed is not None
    with np.errstate(invalid="ignore"):  # of Drake's variables, which are objects
        for k in range(steps):
            p, v = p + h * v + h * h / 2.0 * a[k], v + h * a[k]
            prog.AddLorentzConeConstraint(np.append(limits.max_speed, v))
            prog.AddBoundingBoxConstraint(
                limits.acceleration.lower, limits.acceleration.upper, a[k]
            )
        for wanted, x in ((vehicle.goal.position, p), (vehicle.goal.velocity, v)):
            match wanted:
                case rho.Sphere():
                    prog.AddLorentzConeConstraint(np.append(wanted.radius, x - wanted.center))
                case rho.Box():
                    prog.AddLinearConstraint(x, wanted.lower, wanted.upper)
                case rho.HalfSpace():
                    prog.AddLinearConstraint(wanted.normal @ x <= wanted.offset)
                case np.ndarray():
                    for axis, value in zip(x, wanted, strict=True):
                        prog.AddLinearConstraint(axis == value)
    prog.AddQuadraticCost(2.0 * np.eye(3 * steps), np.zeros(3 * steps), a.reshape(-1))
    result = ClarabelSolver().Solve(prog)
    assert result.is_success()
    return float(result.get_optimal_cost())


@pytest.mark.parametrize("kind", GOALS)
def test_the_least_cost_is_that_of_an_independent_program(kind: str) -> None:
    scenario = flight(GOALS[kind])
    plan = rho.plan(scenario)
    assert plan.cost == pytest.approx(optimum(scenario), rel=1e-6, abs=1e-7)
    goal = scenario.vehicles[0].goal
    assert distance(goal.position, plan.positions[0, -1]) <= 1e-5
    assert distance(goal.velocity, plan.velocities[0, -1]) <= 1e-5
    assert rho.verify(plan).ok
    bound = rho.certify(plan).lower_bound
    assert bound <= plan.cost + 1e-9
    assert bound == pytest.approx(plan.cost, rel=1e-4, abs=1e-6)


def test_random_goals_have_the_least_cost_of_an_independent_program() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        center, radius = rng.uniform([2, -2, 0], [4, 2, 3]), rng.uniform(0.1, 1.0)
        region: Any = rho.Sphere(center, radius)
        if rng.random() < 0.5:
            half = radius * rng.uniform(0.2, 1.0, 3)
            region = rho.Box(center - half, center + half)
        velocity: Any = [np.zeros(3), None, rho.Sphere(rng.uniform(-0.5, 0.5, 3), 0.3)]
        scenario = flight(rho.Goal(region, velocity=velocity[rng.integers(3)]))
        assert rho.plan(scenario).cost == pytest.approx(optimum(scenario), rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("kind", [each for each in GOALS if each != "positions and velocities"])
def test_the_least_effort_of_reports_is_in_closed_form(kind: str) -> None:
    scenario = flight(GOALS[kind], limits=rho.Limits())
    plan = rho.plan(scenario)
    least = rho.verify(plan).summary.least_effort
    assert least == pytest.approx(plan.cost, rel=1e-6, abs=1e-8)


def test_a_set_of_ones_own_is_a_goal(tmp_path: Path) -> None:
    own, known = flight(Ball()), flight(PAD)
    assert rho.plan(own).cost == pytest.approx(rho.plan(known).cost, rel=1e-6)
    with pytest.raises(
        rho.ScenarioError, match=r"vehicles\[0\].goal: got .*no file|package's sets"
    ):
        rho.save_scenario(own, tmp_path / "own.yaml")


def test_vehicles_with_goals_of_different_kinds_fly_together() -> None:
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State([0.0, 1.5 * i, 1.0]), goal, radius=0.2)
        for i, goal in enumerate(
            [PAD, rho.State([4.0, -2.0, 1.0]), rho.Goal(PAD, velocity=None), None, PAD]
        )
    ]
    scenario = rho.Scenario(
        "mixed",
        rho.Grid.lasting(6.0, step=0.25),
        vehicles,
        limits=rho.Limits(max_speed=3.0, position=rho.Box([-1, -3, 0], [5, 8, 3])),
        obstacles=[rho.Sphere([2.0, 0.5, 1.0], 0.5)],
        separation=rho.Separation(0.4),
    )
    for plan in (rho.plan(scenario), rho.plan_rho(scenario)):
        assert rho.verify(plan).ok
        ends = plan.plan.positions[[0, 2, 4], -1]
        assert np.all(PAD.signed_distance(ends) <= 1e-5)
        np.testing.assert_allclose(plan.plan.positions[1, -1], [4.0, -2.0, 1.0], atol=1e-5)


@pytest.mark.parametrize("kind", GOALS)
def test_goals_are_reached_among_obstacles_and_in_windows(kind: str) -> None:
    scenario = flight(GOALS[kind], obstacles=[rho.Sphere([2.0, 0.6, 1.1], 0.5)])
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert rho.certify(plan).lower_bound <= plan.cost * (1.0 + 1e-9) + 1e-9
    assert rho.verify(rho.plan_rho(scenario)).ok
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.02))
    assert rho.verify(rho.plan(windy)).ok
    assert rho.verify(rho.simulate(windy)).ok


def test_a_motion_that_misses_a_set_is_found() -> None:
    scenario = flight(rho.Goal(PAD, velocity=GATE))
    coasting = rho.Plan.from_accelerations(scenario, np.zeros((1, scenario.grid.knots - 1, 3)))
    missed = {(each.kind, each.constraint) for each in rho.verify(coasting).violations}
    assert missed == {("goals", "goal of scout")}


def test_plans_among_obstacles_cost_no_more_than_those_to_sampled_goals() -> None:
    rng = np.random.default_rng(3)
    for _ in range(4):
        center = np.array([6.0, rng.uniform(-1, 1), rng.uniform(0.5, 1.5)])
        region = rho.Sphere(center, rng.uniform(0.5, 1.5))
        obstacles = [
            rho.Sphere(rng.uniform([2, -2, -1], [5, 2, 3]), rng.uniform(0.3, 0.8)) for _ in range(4)
        ]
        scenario = flight(region, obstacles=obstacles, limits=rho.Limits(max_speed=4.0))
        cost = rho.plan(scenario).cost
        for _ in range(12):
            goal = rho.State(rng.uniform(center - region.radius, center + region.radius))
            if region.signed_distance(goal.position) > 0.0:
                continue
            vehicle = dataclasses.replace(scenario.vehicles[0], goal=goal)
            try:
                exact = rho.plan(dataclasses.replace(scenario, vehicles=(vehicle,)))
            except (rho.InfeasibleError, rho.ScenarioError):  # it is inside an obstacle
                continue
            assert cost <= exact.cost * (1.0 + 1e-6)


@pytest.mark.parametrize("kind", GOALS)
def test_files_keep_every_kind_of_goal(kind: str, tmp_path: Path) -> None:
    scenario = flight(GOALS[kind])
    rho.save_scenario(scenario, tmp_path / "written.yaml")
    assert rho.load_scenario(tmp_path / "written.yaml") == scenario
    plan = rho.plan(scenario)
    rho.save(plan, tmp_path / "plan.npz")
    again = rho.load(tmp_path / "plan.npz")
    assert again.scenario == scenario
    assert rho.verify(again).ok


@pytest.mark.parametrize(
    ("written", "goal"),
    [
        ("{position: [4, 2, 3]}", rho.State([4, 2, 3])),
        ("{position: [4, 2, 3], velocity: null}", rho.State([4, 2, 3], None)),
        ("null", rho.Goal(None, velocity=None)),
        ("{position: null}", rho.Goal(None)),
        ("{center: [4, 1, 1], radius: 0.5}", rho.Goal(PAD)),
        ("{normal: [0, 0, 1], offset: 2}", rho.Goal(rho.HalfSpace([0, 0, 1], 2.0))),
        (
            "{position: {center: [4, 1, 1], radius: 0.5}, velocity: null}",
            rho.Goal(PAD, velocity=None),
        ),
        (
            "{position: [4, 2, 3], velocity: {center: [1, 0, 0], radius: 0.3}}",
            rho.Goal([4, 2, 3], velocity=GATE),
        ),
    ],
)
def test_goals_are_written_in_yaml(written: str, goal: Any, tmp_path: Path) -> None:
    text = f"""
    name: written
    grid: {{step: 0.25, knots: 21}}
    vehicles: [{{name: scout, start: {{position: [0, 0, 1]}}, goal: {written}}}]
    """
    (tmp_path / "written.yaml").write_text(text)
    assert rho.load_scenario(tmp_path / "written.yaml").vehicles[0].goal == goal


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: flight("there"), "vehicle.goal"),
        (lambda: rho.Goal([1, 2]), "goal.position"),
        (lambda: rho.Goal(PAD, velocity=3.0), "goal.velocity"),
        (lambda: rho.State([1, 2, 3], None, [0, 0, 1]), "state.acceleration"),
        (lambda: rho.Vehicle("v", rho.State([0, 0, 0], None), None), "vehicle.start.velocity"),
        (
            lambda: flight(PAD, limits=rho.Limits(position=rho.Box([-1] * 3, [3] * 3))),
            "scenario.vehicles[0].goal.position",
        ),
        (
            lambda: flight(rho.Goal(None, velocity=GATE), limits=rho.Limits(max_speed=0.6)),
            "scenario.vehicles[0].goal.velocity",
        ),
        (
            lambda: flight(PAD, objective=rho.Objective(terminal_position=1.0)),
            "scenario.objective.terminal_position",
        ),
        (lambda: flight(None, hold_at_goal=True), "scenario.vehicles[0].goal.velocity"),
    ],
)
def test_bad_goals_are_refused_by_field(make: Any, field: str) -> None:
    with pytest.raises(rho.ScenarioError) as refused:
        make()
    assert refused.value.field == field


def test_vehicles_hold_where_their_plans_end() -> None:
    later = rho.Obstacle(rho.Sphere([20.0, 1.0, 1.0], 0.3), velocity=[-1.0, 0.0, 0.0])
    scenario = flight(PAD, obstacles=[later], hold_at_goal=True)
    report = rho.verify(rho.plan(scenario))
    assert {each.kind for each in report.violations} == {"holding"}
    assert rho.verify(rho.plan(flight(PAD, obstacles=[PAD_OBSTACLE], hold_at_goal=True))).ok


PAD_OBSTACLE = rho.Sphere([2.0, 0.6, 1.1], 0.5)


@pytest.mark.parametrize("kind", ["state", "ball", "anywhere at rest"])
def test_windows_with_a_free_final_time_end_at_rest_in_sets(kind: str) -> None:
    flown = rho.plan_rho(flight(GOALS[kind]), free_final_time=True)
    assert rho.verify(flown).ok
    with pytest.raises(rho.ScenarioError, match=r"vehicles\[0\].goal.velocity"):
        rho.plan_rho(flight(rho.Goal(PAD, velocity=None)), free_final_time=True)


@pytest.mark.parametrize("kind", ["free velocity", "ball", "box with any velocity", "velocities"])
def test_the_least_time_is_that_of_bisected_final_times(kind: str) -> None:
    scenario = flight(GOALS[kind])
    least = rho.plan_minimum_time(scenario)
    assert rho.verify(least).ok
    for factor, holds in ((0.995, False), (1.005, True)):
        step = factor * least.scenario.grid.step
        grid = rho.Grid(step, scenario.grid.knots)
        try:
            found = rho.verify(rho.plan(scenario.on_grid(grid))).ok
        except rho.InfeasibleError:
            found = False
        assert found == holds


def test_goals_are_assigned_by_the_distance_to_their_nearest_points() -> None:
    starts = [[0.0, 0.0, 1.0], [0.0, 5.0, 1.0], [0.0, 2.5, 1.0]]
    goals: list[Any] = [rho.Box([4, 4, 0], [6, 9, 2]), rho.Sphere([5, 0, 1], 0.5), None]
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State(start), goal)
        for i, (start, goal) in enumerate(zip(starts, goals, strict=True))
    ]
    scenario = rho.Scenario("three", rho.Grid.lasting(5.0, step=0.25), vehicles)
    better = rho.assign_goals(scenario)
    assert [each.goal for each in better.vehicles[:2]] == [
        vehicles[1].goal,
        vehicles[0].goal,
    ]
    assert rho.plan(better).cost < rho.plan(scenario).cost


@pytest.mark.parametrize("kind", GOALS)
def test_scenarios_with_any_goal_are_printed_drawn_and_written_out(kind: str) -> None:
    scenario = flight(GOALS[kind])
    assert "vehicle scout" in str(scenario)
    plan = rho.plan(scenario)
    for shown in (scenario, plan):
        rho.paths_figure(shown)
        rho.viewer_page(shown)
    between = dataclasses.replace(scenario, between_knots=False)
    program = rho.program(between)
    solved = program.plan(ClarabelSolver().Solve(program.prog))
    assert solved.cost == pytest.approx(rho.plan(between).cost, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e5, 1e7])
@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
def test_a_free_goal_has_the_scale_of_what_is_required(length: float, solver: Any) -> None:
    """Nothing else tells how far the vehicle flies; a wrong scale makes solvers see no solution."""
    vehicle = rho.Vehicle("free", rho.State([0, 0, 0]), None)
    requirements = [
        rho.KeepIn(rho.Ball([length, 0, 0], length / 10), active=(10, 15)),
        rho.KeepIn(rho.Ball([0, 0, 0], length / 4), of="velocity"),
    ]
    scenario = rho.Scenario("far", rho.Grid(0.5, 31), [vehicle], requirements=requirements)
    plan = rho.plan(scenario, solver=solver)
    assert rho.verify(plan).ok
    assert plan.cost / length**2 == pytest.approx(0.0092119872, rel=1e-6)
