"""The quadratic program: known answers, and twins written and solved in other ways."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from pydrake.math import eq, ge, le
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverInterface
from scipy.optimize import LinearConstraint, minimize

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import acceleration_outside, box, scenarios, single
from tests.tolerances import INDEX, MOTION


@np.errstate(invalid="ignore")  # numpy warns of Drake's symbols, without a cause
def symbolic_twin(scenario: rho.Scenario, reference: rho.Plan) -> FloatArray | None:
    """Solve (16) with states and accelerations as variables, (1)-(7) and (15) at every knot."""
    h, K = scenario.grid.step, scenario.grid.knots
    answers = []
    for index, vehicle in enumerate(scenario.vehicles):
        program = MathematicalProgram()
        p = program.NewContinuousVariables(K, 3, "p")
        v = program.NewContinuousVariables(K, 3, "v")
        a = program.NewContinuousVariables(K - 1, 3, "a")
        limits = scenario.limits_of(vehicle)
        for k in range(K - 1):
            program.AddLinearConstraint(eq(v[k + 1], v[k] + h * a[k]))
            program.AddLinearConstraint(eq(p[k + 1], p[k] + h * v[k] + h**2 / 2 * a[k]))
            program.AddQuadraticCost(a[k] @ a[k])
        for states, start, goal in (
            (p, vehicle.start.position, vehicle.goal.position),
            (v, vehicle.start.velocity, vehicle.goal.velocity),
        ):
            program.AddLinearConstraint(eq(states[0], start))
            program.AddLinearConstraint(eq(states[-1], goal))
        for states, bounds in (
            (p[1:-1], limits.position),
            (v[1:-1], limits.velocity),
            (a, limits.acceleration),
        ):
            if bounds is not None:
                for row in states:
                    program.AddBoundingBoxConstraint(bounds.lower, bounds.upper, row)
        if limits.jerk is not None:
            outside = [acceleration_outside(each) for each in (vehicle.start, vehicle.goal)]
            known = [[each] * (not np.isnan(each).any()) for each in outside]
            for before, after in pairwise([*known[0], *a, *known[1]]):
                jerk = (after - before) / h
                program.AddLinearConstraint(ge(jerk, limits.jerk.lower))
                program.AddLinearConstraint(le(jerk, limits.jerk.upper))
        for sphere in scenario.spheres:
            for k in range(1, K - 1):
                q = reference.positions[index, k] - sphere.center
                distance = float(np.linalg.norm(q))
                n = q / distance
                program.AddLinearConstraint(
                    n @ (p[k] - reference.positions[index, k]) + distance >= sphere.radius
                )
        result = ClarabelSolver().Solve(program)
        if not result.is_success():
            return None
        answers.append(result.GetSolution(a))
    return np.array(answers)


def test_the_symbolic_twin_of_example_2_gives_the_same_plan(
    paper: rho.Scenario, solver: SolverInterface
) -> None:
    reference = rho.plan_convex(paper.without_obstacles(), solver=solver)
    plan = rho.plan_convex(paper, solver=solver)
    twin = symbolic_twin(paper, reference)
    assert twin is not None
    assert plan.cost == pytest.approx(np.sum(twin**2), rel=INDEX)
    largest = np.abs(twin).max()
    # Drake's default tolerances, at which the twin is solved, are its limit here
    np.testing.assert_allclose(plan.accelerations, twin, atol=100 * MOTION * largest)


@given(scenario=scenarios())
@settings(max_examples=13)
def test_the_symbolic_twin_of_random_scenarios_gives_the_same_index(
    scenario: rho.Scenario,
) -> None:
    free = scenario.without_obstacles()
    try:
        reference = rho.plan_convex(free)
        plan = rho.plan_convex(scenario, reference=reference)
    except rho.InfeasibleError:
        return  # tests/test_infeasible.py covers these
    twin = symbolic_twin(scenario, reference)
    assert twin is not None
    # the twin is in metres and seconds, so that an absolute tolerance of 1e-8 counts
    assert plan.cost == pytest.approx(np.sum(twin**2), rel=10 * INDEX, abs=1e-8)


def test_scipy_finds_the_same_plan() -> None:
    """A dense SQP solver of another kind solves the condensed form."""
    scenario = single(limits=rho.Limits(velocity=box(1.8), acceleration=box(0.9)))
    plan = rho.plan_convex(scenario)
    h, steps = 0.5, 16
    integrate = h * np.tril(np.ones((steps, steps)))
    moves = h * np.vstack([np.zeros(steps), integrate[:-1]]) + h**2 / 2 * np.eye(steps)
    place = np.cumsum(moves, axis=0)
    total = 0.0
    for axis, distance in enumerate([10.0, 4.0, -2.0]):
        found = minimize(
            lambda a: float(a @ a),
            np.zeros(steps),
            bounds=[(-0.9, 0.9)] * steps,
            constraints=[
                LinearConstraint(integrate[:-1], -1.8, 1.8),
                LinearConstraint(integrate[-1:], 0.0, 0.0),
                LinearConstraint(place[-1:], distance, distance),
            ],
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 1000},
        )
        assert found.success
        total += found.fun
        np.testing.assert_allclose(plan.accelerations[0, :, axis], found.x, atol=1e-5)
    assert plan.cost == pytest.approx(total, rel=INDEX)


@pytest.mark.parametrize("knots", [3, 4, 17, 200])
def test_least_effort_from_rest_to_rest_is_known(knots: int) -> None:
    """With two equalities an axis a[j] is linear, and f = 12 d² / (h⁴ n (n² - 1)) for n steps."""
    h, n = 0.7, knots - 1
    plan = rho.plan_convex(single(grid=rho.Grid(h, knots)))
    d = np.array([10.0, 4.0, -2.0])
    falling = (n - 1) / 2 - np.arange(n)
    known = 12 * falling[:, None] * d / (h**2 * n * (n**2 - 1))
    np.testing.assert_allclose(plan.accelerations[0], known, atol=1e-9)
    assert plan.cost == pytest.approx(12 * (d @ d) / (h**4 * n * (n**2 - 1)), rel=1e-9)


def test_one_step_reaches_only_goals_of_one_acceleration() -> None:
    grid = rho.Grid(2.0, 2)
    start, a = rho.State([0, 0, 0], [1, 0, 0]), np.array([0.5, -1.0, 0.25])
    goal = rho.State(2 * start.velocity + 2 * a, start.velocity + 2 * a)
    plan = rho.plan_convex(single(grid=grid, start=start, goal=goal))
    np.testing.assert_allclose(plan.accelerations[0, 0], a, rtol=1e-9)
    with pytest.raises(rho.InfeasibleError, match="a single step"):
        rho.plan_convex(single(grid=grid, start=start, goal=rho.State([5, 0, 0])))


def test_rows_enter_only_when_they_are_violated(paper: rho.Scenario) -> None:
    free = rho.plan_convex(paper.without_obstacles())
    assert free.statistics.rows == 0
    assert free.statistics.programs == 0
    avoiding = rho.plan_convex(paper)
    every = 4 * 48 * (6 + 6 + 1)  # boxes of position and velocity, and the obstacle
    assert 0 < avoiding.statistics.rows < every / 20
