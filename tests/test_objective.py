"""Costs of jerk, snap, tracking and missed goals: known solutions, own programs, windows."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions

import drake_rho as rho
from tests.scenarios import box, examples, fleet, single, slow

TERMS = (
    "effort",
    "jerk",
    "snap",
    "position",
    "velocity",
    "terminal_position",
    "terminal_velocity",
)

SAME = 1e-6
"""Relative difference of the costs of two programs that are equal."""


def one(objective: rho.Objective, knots: int = 41, **fields: Any) -> rho.Scenario:
    """Return a scenario of one vehicle from rest to rest, 10 m in 8 s."""
    scenario = single(grid=rho.Grid(8.0 / (knots - 1), knots), **fields)
    return dataclasses.replace(scenario, objective=objective)


def random_scenario(seed: int) -> rho.Scenario:
    """Return vehicles with random ends, boxes and terms, of which effort is always one."""
    rng = np.random.default_rng(seed)
    knots, T, L = int(rng.integers(8, 40)), rng.uniform(2.0, 12.0), rng.uniform(2.0, 10.0)
    grid, count = rho.Grid(T / (knots - 1), knots, float(rng.choice([0.0, 100.0]))), 2

    def state() -> rho.State:
        kind, v = rng.integers(3), rng.uniform(-1.0, 1.0, 3) * L / T
        a = rng.uniform(-1.0, 1.0, 3) * L / T**2
        return rho.State(rng.uniform(-L, L, 3), *[(), (v,), (v, a)][kind])

    vehicles = [
        rho.Vehicle(f"v{i}", state(), state(), weight=float(10 ** rng.uniform(-1, 1)))
        for i in range(count)
    ]
    t = T / 6.0
    scales = [1.0, t**2, t**4, t**-4, t**-2, 10 * t**-4, 10 * t**-2]
    on = [True, *(rng.random(6) < 0.5)]
    weights = {
        term: float(scale * 10 ** rng.uniform(-1, 1))
        for term, scale, used in zip(TERMS, scales, on, strict=True)
        if used
    }
    times = np.linspace(grid.start, grid.end, 6)
    number = int(rng.integers(1, count + 1))
    paths = [rho.Track(times, rng.uniform(-L, L, (6, 3))) for _ in range(number)]
    limits = rho.Limits(velocity=box(4.0 * L / T), acceleration=box(14.0 * L / T**2))
    return rho.Scenario(
        f"random {seed}",
        grid,
        vehicles,
        limits=limits,
        objective=rho.Objective(**weights, reference=paths),
        between_knots=False,
    )


def own_optimum(scenario: rho.Scenario) -> float | None:
    """Return the least cost by a program of its own, with states as variables; None if none."""
    prog, total = MathematicalProgram(), scenario.grid
    K, h, o = total.knots, total.step, scenario.objective
    for number, vehicle in enumerate(scenario.vehicles):
        p, v = (prog.NewContinuousVariables(K, 3) for _ in range(2))
        a, j = prog.NewContinuousVariables(K - 1, 3), prog.NewContinuousVariables(K, 3)
        for k in range(K - 1):
            for c in range(3):
                prog.AddLinearEqualityConstraint(v[k + 1, c] == v[k, c] + h * a[k, c])
                prog.AddLinearEqualityConstraint(
                    p[k + 1, c] == p[k, c] + h * v[k, c] + h * h / 2 * a[k, c]
                )
        start, goal = vehicle.start, vehicle.goal
        prog.AddLinearEqualityConstraint(np.eye(3), start.position, p[0])
        prog.AddLinearEqualityConstraint(np.eye(3), start.velocity, v[0])
        if o.terminal_position == 0.0:
            prog.AddLinearEqualityConstraint(np.eye(3), goal.position, p[-1])
        if o.terminal_velocity == 0.0:
            prog.AddLinearEqualityConstraint(np.eye(3), goal.velocity, v[-1])
        free = o.terminal_velocity > 0.0
        outside: Any = (_outside(start), None if free else _outside(goal))
        first, last = int(outside[0] is None), K - int(outside[1] is None)
        for k in range(first, last):
            later = a[k] if k < K - 1 else outside[1]
            earlier = a[k - 1] if k > 0 else outside[0]
            for c in range(3):
                prog.AddLinearEqualityConstraint(h * j[k, c] == later[c] - earlier[c])
        counts = np.ones(K)
        counts[0] += _rests(start)
        counts[-1] += not free and _rests(goal)
        limits, w = scenario.limits_of(vehicle), vehicle.weight
        for rows, limit in ((v[1:], limits.velocity), (a, limits.acceleration)):
            for each in rows if limit is not None else ():
                assert limit is not None
                prog.AddBoundingBoxConstraint(limit.lower, limit.upper, each)
        r: Any = np.zeros((K, 3))
        dr: Any = r
        if o.reference is not None:
            track = o.reference[number if len(o.reference) > 1 else 0]
            axes = [np.interp(total.times, track.times, x) for x in track.positions.T]
            r = np.stack(axes, axis=1)
            dr = np.gradient(r, h, axis=0)
        for weight, values, wanted in (
            (o.effort, a, 0 * r[1:]),
            (o.position, p[1:], r[1:]),
            (o.velocity, v[1:], dr[1:]),
            (o.terminal_position, p[-1:], goal.position[None]),
            (o.terminal_velocity, v[-1:], goal.velocity[None]),
        ):
            for x, target in zip(values, wanted, strict=True) if weight > 0.0 else ():
                prog.AddQuadraticErrorCost(weight * w * np.eye(3), target, x)
        for k in range(first, last) if o.jerk > 0.0 else ():
            prog.AddQuadraticErrorCost(counts[k] * o.jerk * w * np.eye(3), np.zeros(3), j[k])
        for k in range(first, last - 1) if o.snap > 0.0 else ():
            matrix = np.hstack([-np.eye(3), np.eye(3)]) / h
            prog.AddQuadraticCost(
                2 * o.snap * w * matrix.T @ matrix, np.zeros(6), np.append(j[k], j[k + 1])
            )
    options = SolverOptions()
    for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
        options.SetOption(ClarabelSolver.id(), name, 1e-10)
    result = ClarabelSolver().Solve(prog, None, options)
    return float(result.get_optimal_cost()) if result.is_success() else None


def _outside(state: rho.State) -> np.ndarray | None:
    if state.acceleration is not None:
        return state.acceleration
    return None if state.velocity.any() else np.zeros(3)


def _rests(state: rho.State) -> bool:
    outside = _outside(state)
    return outside is not None and not (state.velocity.any() or outside.any())


@examples(20, 60)
@given(seed=st.integers(0, 10_000))
def test_random_costs_are_those_of_an_own_program(seed: int) -> None:
    scenario = random_scenario(seed)
    known = own_optimum(scenario)
    if known is None:
        return
    plan = rho.plan_convex(scenario)
    assert plan.cost == pytest.approx(known, rel=SAME)
    assert rho.verify(plan).ok


@pytest.mark.parametrize("term", TERMS)
@pytest.mark.parametrize("knots", [21, *slow(121)])
def test_every_term_alone_has_the_cost_of_an_own_program(term: str, knots: int) -> None:
    """Long grids with many limits are solved in the sparse form, short ones in the reduced."""
    path = rho.Track([0.0, 4.0, 8.0], [[0, 0, 0], [5, 3, 1], [10, 4, -2]])
    weights = {"effort": 0.01, term: 2.0}
    scenario = one(
        rho.Objective(**weights, reference=path),
        knots,
        limits=rho.Limits(velocity=box(1.9), acceleration=box(1.5)),
    )
    plan = rho.plan_convex(scenario)
    assert plan.cost == pytest.approx(own_optimum(scenario), rel=SAME)
    other = rho.plan_convex(dataclasses.replace(scenario, objective=rho.Objective()))
    assert plan.cost < cost_with(scenario.objective, other) or term == "effort"


def cost_with(objective: rho.Objective, plan: rho.Plan) -> float:
    """Return what a plan costs under another objective."""
    scenario = dataclasses.replace(plan.scenario, objective=objective)
    return rho.Plan.from_accelerations(scenario, plan.accelerations).cost


def test_least_jerk_from_rest_to_rest_approaches_the_quintic() -> None:
    """x(s) = 10 s³ - 15 s⁴ + 6 s⁵ has the least integral of j², 720 d² / T⁵."""
    errors = []
    for knots in (26, 51, 101, 201):
        plan = rho.plan(one(rho.Objective(effort=0.0, jerk=1.0), knots))
        s = plan.times / 8.0
        distance = plan.positions[0, -1] - plan.positions[0, 0]
        quintic = plan.positions[0, 0] + np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, distance)
        integral = 720.0 * (distance @ distance) / 8.0**5
        away = np.linalg.norm(plan.positions[0] - quintic, axis=1).max()
        cost = plan.cost * plan.scenario.grid.step
        errors.append((away / np.linalg.norm(distance), abs(cost / integral - 1.0)))
    places, costs = np.transpose(errors)
    assert places[-1] < 1e-4
    assert costs[-1] < 5e-4
    np.testing.assert_allclose(places[:-1] / places[1:], 4.0, rtol=0.1)
    np.testing.assert_allclose(costs[:-1] / costs[1:], 4.0, rtol=0.1)


def test_tracking_is_that_of_the_riccati_recursion() -> None:
    """Without limits and goals the optimum is a linear feedback, computed backwards in time."""
    q, v, r, terminal = 0.7, 0.3, 0.2, (5.0, 3.0)
    rng, knots, h = np.random.default_rng(3), 41, 0.2
    path = rng.normal(size=(1, knots, 3)).cumsum(axis=1)
    objective = rho.Objective(
        effort=r,
        position=q,
        velocity=v,
        reference=path,
        terminal_position=terminal[0],
        terminal_velocity=terminal[1],
    )
    scenario = one(objective)
    plan = rho.plan(scenario)
    A, B = np.array([[1.0, h], [0.0, 1.0]]), np.array([h**2 / 2, h])
    speeds = np.gradient(path, h, axis=1)
    Q = np.diag([q, v])
    for axis in range(3):
        goal = np.array([scenario.vehicles[0].goal.position[axis], 0.0])
        P = Q + np.diag(terminal)
        s = Q @ [path[0, -1, axis], speeds[0, -1, axis]] + np.diag(terminal) @ goal
        gains = []
        for k in range(knots - 2, -1, -1):
            inverse = 1.0 / (r + B @ P @ B)
            gains.append((inverse * (B @ P @ A), inverse * (B @ s)))
            closed = A - np.outer(B, gains[-1][0])
            s = closed.T @ s
            P = A.T @ P @ closed
            if k > 0:
                P, s = P + Q, s + Q @ [path[0, k, axis], speeds[0, k, axis]]
        x = np.array([scenario.vehicles[0].start.position[axis], 0.0])
        for k, (feedback, forward) in enumerate(reversed(gains)):
            a = forward - feedback @ x
            assert plan.accelerations[0, k, axis] == pytest.approx(a, abs=1e-8 * np.abs(path).max())
            x = A @ x + B * a


@pytest.mark.parametrize("term", ["terminal_position", "terminal_velocity"])
def test_a_goal_that_may_be_missed_is_approached_as_its_price_rises(term: str) -> None:
    exact, costs, missed = rho.plan(one(rho.Objective())), [], []
    for weight in (0.01, 1.0, 100.0):
        plan = rho.plan(one(rho.Objective(**{term: weight})))
        assert rho.verify(plan).ok
        ends = plan.states(-1)[0] - exact.states(-1)[0]
        missed.append(np.linalg.norm(ends[:3] if "position" in term else ends[3:]))
        costs.append(plan.cost)
    assert missed == sorted(missed, reverse=True)
    assert missed[0] > 10.0 * missed[-1] > 0.0
    assert costs == sorted(costs)
    assert costs[-1] < exact.cost


def test_a_missed_goal_still_keeps_limits_and_obstacles_at_the_end() -> None:
    """Without an exact goal the last state has to obey what the goal would have obeyed."""
    ball = rho.Sphere([7.0, 2.0, -1.5], 1.5)
    scenario = one(
        rho.Objective(effort=0.01, terminal_position=1e-3, terminal_velocity=1e-3),
        limits=rho.Limits(velocity=box(0.9)),
        obstacles=[ball],
    )
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    times = np.linspace(0.0, 8.0, 4001)
    samples = plan.at(times)
    assert np.linalg.norm(samples.positions[0] - ball.center, axis=1).min() > 1.5 - 1e-5
    assert np.abs(samples.velocities).max() < 0.9 + 1e-5


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_of_a_cost_changes_no_plan(factor: float) -> None:
    objective = rho.Objective(effort=1.0, jerk=2.0, snap=0.3)
    larger = rho.Objective(effort=factor, jerk=2.0 * factor, snap=0.3 * factor)
    limits = rho.Limits(velocity=box(1.8))
    plan, other = (rho.plan(one(each, limits=limits)) for each in (objective, larger))
    assert other.cost == pytest.approx(factor * plan.cost, rel=1e-7)
    np.testing.assert_allclose(other.positions, plan.positions, atol=1e-6)


def test_the_default_cost_is_that_of_accelerations() -> None:
    limits = rho.Limits(velocity=box(1.8))
    plan = rho.plan(one(rho.Objective(), limits=limits))
    assert plan.cost == pytest.approx(np.sum(plan.accelerations**2), rel=1e-12)
    twice = rho.plan(one(rho.Objective(effort=2.0), limits=limits))
    assert twice.cost == pytest.approx(2.0 * plan.cost, rel=1e-7)


def test_costs_by_term_are_those_of_the_motion() -> None:
    path = np.linspace([0, 0, 0], [10, 4, -2], 41)[None]
    objective = rho.Objective(jerk=2.0, snap=0.5, position=0.1, velocity=0.2, reference=path)
    plan = rho.plan(one(objective))
    h, p, v, a = 0.2, plan.positions[0], plan.velocities[0], plan.accelerations[0]
    j = np.diff(np.concatenate([np.zeros((1, 3)), a, np.zeros((1, 3))]), axis=0) / h
    known = {
        "effort": np.sum(a**2),
        "jerk": 2.0 * (np.sum(j**2) + np.sum(j[0] ** 2) + np.sum(j[-1] ** 2)),
        "snap": 0.5 * np.sum((np.diff(j, axis=0) / h) ** 2),
        "position": 0.1 * np.sum((p - path[0])[1:] ** 2),
        "velocity": 0.2 * np.sum((v - np.gradient(path[0], h, axis=0))[1:] ** 2),
    }
    summary = rho.verify(plan).summary
    assert summary.costs == pytest.approx(known, rel=1e-9)
    assert plan.cost == pytest.approx(sum(known.values()), rel=1e-9)
    (line,) = (line for line in str(rho.verify(plan)).splitlines() if line.startswith("cost"))
    assert line.count("jerk") == line.count("snap") == line.count("velocity") == 1


def fleet_with(objective: rho.Objective) -> rho.Scenario:
    """Return three vehicles that change sides, two of another class than the third."""
    scenario = fleet(
        np.array([[0, 0, 0], [6, 0.3, 0], [3, -3, 0]]),
        np.array([[6, 0, 0], [0, 0.3, 0], [3, 3, 0.2]]),
        separation=rho.Separation(1.0),
    )
    last = scenario.vehicles[-1]
    moving = dataclasses.replace(last, start=rho.State(last.start.position, [0, 0.3, 0]))
    vehicles = *scenario.vehicles[:-1], moving
    return dataclasses.replace(scenario, vehicles=vehicles, objective=objective)


@pytest.mark.parametrize("coupling", ["coupled", "grouped", "decoupled"])
@pytest.mark.parametrize("solver", ["clarabel", "daqp"])
def test_fleets_of_several_classes_keep_apart_at_a_proved_cost(coupling: Any, solver: Any) -> None:
    scenario = fleet_with(rho.Objective(effort=0.1, jerk=1.0))
    plan = rho.plan(scenario, coupling=coupling, solver=solver)
    assert rho.verify(plan).ok
    certificate = rho.certify(plan)
    assert certificate.lower_bound <= plan.cost * (1.0 + 1e-9)
    assert certificate.lower_bound > 0.5 * plan.cost
    times = np.linspace(0.0, plan.times[-1], 3001)
    p = plan.at(times).positions
    for i in range(3):
        for other in range(i):
            assert np.linalg.norm(p[i] - p[other], axis=1).min() > 1.0 - 1e-5


@pytest.mark.parametrize("terms", [{"jerk": 1.0}, {"position": 0.2, "effort": 0.1}, {"snap": 1.0}])
def test_among_obstacles_costs_fall_and_stay_above_their_bounds(terms: dict[str, float]) -> None:
    path = rho.Track([0.0, 8.0], [[0, 0, 0], [10, 4, -2]])
    ball = rho.Sphere([5.0, 2.2, -0.9], 1.5)
    weights = {"effort": 0.0} | terms
    scenario = one(rho.Objective(**weights, reference=path), obstacles=[ball])
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    bound = rho.certify(plan).lower_bound
    rng, costs = np.random.default_rng(0), []
    for _ in range(5):
        guess = rho.plan_convex(scenario.without_obstacles()).accelerations
        moved = guess + rng.normal(size=guess.shape) * np.abs(guess).max()
        start = rho.Plan.from_accelerations(scenario, moved)
        found, before = rho.plan_scp(scenario, reference=start), np.inf
        costs.append(found.cost)
        step = start
        for _ in range(3):
            step = rho.scp_step(step)
            assert step.cost <= before * (1.0 + 1e-7)
            before = step.cost
    assert bound <= min(costs) * (1.0 + 1e-9)
    assert plan.cost <= min(costs) * 1.01


@pytest.mark.parametrize(
    "terms",
    [
        {"jerk": 1.0},
        {"snap": 1.0},
        {"effort": 0.1, "position": 0.3},
        {"jerk": 1.0, "velocity": 0.5, "terminal_velocity": 2.0},
    ],
)
def test_windows_go_on_with_the_plan_that_was_optimal(terms: dict[str, float]) -> None:
    """The rest of an optimal motion is optimal: of the reference, and from the last jerks."""
    t = np.linspace(100.0, 108.0, 9)
    path = rho.Track(t, np.stack([1.2 * (t - 100), np.sin(t), 0 * t], axis=1))
    weights = {"effort": 0.0} | terms
    scenario = dataclasses.replace(
        single(grid=rho.Grid(0.2, 41, 100.0), limits=rho.Limits(velocity=box(2.5))),
        objective=rho.Objective(**weights, reference=path),
    )
    plan, flight = rho.plan(scenario), rho.plan_rho(scenario, replan_every=7)
    assert rho.verify(flight).ok
    assert flight.cost == pytest.approx(plan.cost, rel=1e-6)
    # tracking the path only as far as it is known from the start would cost more
    np.testing.assert_allclose(flight.plan.positions, plan.positions, atol=1e-4)


def test_files_and_parts_keep_the_objective(tmp_path: Path) -> None:
    scenario = fleet_with(rho.Objective(jerk=0.5))
    paths = rho.plan(scenario)
    tracking = dataclasses.replace(
        scenario, objective=rho.Objective(jerk=0.5, position=0.1, reference=paths)
    )
    rho.save_scenario(tracking, tmp_path / "s.yaml")
    assert rho.load_scenario(tmp_path / "s.yaml") == tracking
    plan = rho.plan(tracking)
    rho.save(plan, tmp_path / "p.npz")
    loaded = rho.load(tmp_path / "p.npz")
    assert loaded.scenario == tracking
    assert loaded.cost == plan.cost
    costs = [plan.only(np.array([i])).cost for i in range(3)]
    assert sum(costs) == pytest.approx(plan.cost, rel=1e-12)
    rho.save_scenario(scenario.derived(objective=rho.Objective()), tmp_path / "d.yaml")
    assert "objective" not in (tmp_path / "d.yaml").read_text()


def test_references_of_every_form_are_the_same(tmp_path: Path) -> None:
    paths = rho.plan(one(rho.Objective()))
    forms: list[Any] = [
        paths,
        paths.positions,
        paths.positions.tolist(),
        rho.Track(paths.times, paths.positions[0]),
        [rho.Track(paths.times, paths.positions[0])],
    ]
    every = [one(rho.Objective(position=1.0, reference=each)) for each in forms]
    assert all(each == every[0] for each in every)
    text = "position: 1.0\n  reference: {times: [0, 8], positions: [[0, 0, 0], [10, 4, -2]]}"
    rho.save_scenario(one(rho.Objective()), tmp_path / "s.yaml")
    with (tmp_path / "s.yaml").open("a") as file:
        file.write(f"objective:\n  {text}\n")
    line = rho.Track([0, 8], [[0, 0, 0], [10, 4, -2]])
    assert rho.load_scenario(tmp_path / "s.yaml").objective.reference == (line,)


PATH = rho.Track([0.0, 8.0], [[0, 0, 0], [10, 4, -2]])


@pytest.mark.parametrize(
    ("terms", "field"),
    [
        ({"jerk": -1.0}, "objective.jerk"),
        ({"effort": 0.0}, "objective.effort"),
        ({"effort": np.nan}, "objective.effort"),
        ({"position": 1.0}, "objective.reference"),
        ({"velocity": 1.0}, "objective.reference"),
        ({"position": 1.0, "reference": np.zeros((1, 7, 3))}, "scenario.objective.reference"),
        ({"position": 1.0, "reference": np.zeros((2, 41, 3))}, "scenario.objective.reference"),
        ({"position": 1.0, "reference": [PATH, PATH]}, "scenario.objective.reference"),
        ({"position": 1.0, "reference": [[[0, 0, np.nan]]]}, "objective.reference"),
        ({"position": 1.0, "reference": "path"}, "objective.reference"),
        (
            {"position": 1.0, "reference": rho.Track([0.0, 7.0], [[0, 0, 0], [1, 0, 0]])},
            "scenario.objective.reference[0].times",
        ),
        ({"effort": 0.0, "terminal_position": 1.0}, "scenario.objective.effort"),
    ],
)
def test_bad_objectives_are_one_error_with_the_field(terms: dict[str, Any], field: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        one(rho.Objective(**terms))
    assert caught.value.field == field


@pytest.mark.parametrize("terms", [{"jerk": 1.0}, {"snap": 1.0}, {"jerk": 1.0, "snap": 1.0}])
def test_ends_in_motion_leave_jerks_a_unique_least(terms: dict[str, float]) -> None:
    """A constant acceleration has no jerk and a linear one no snap, but goals fix both numbers."""
    ends = rho.State([0, 0, 0], [1, 0, 0]), rho.State([9, 0, 0], [1, 0, 0])
    objective = rho.Objective(**({"effort": 0.0} | terms))
    scenario = one(objective, start=ends[0], goal=ends[1])
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert plan.cost == pytest.approx(own_optimum(scenario), rel=SAME, abs=1e-9)


@pytest.mark.parametrize("term", ["jerk", "terminal_velocity"])
def test_least_times_and_bounded_costs_take_effort_alone(term: str) -> None:
    scenario = one(rho.Objective(**{term: 1.0}), limits=rho.Limits(max_acceleration=2.0))
    for refused in (
        lambda: rho.plan_minimum_time(scenario),
        lambda: rho.certify_time(rho.plan(scenario)),
        lambda: rho.RecedingHorizon(scenario, replan_every=5, bounded_cost=True),
    ):
        with pytest.raises(rho.ScenarioError, match=f"objective.{term}"):
            refused()
