"""Weights of vehicles in every form of a program, in certificates, reports and assignments."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, MathematicalProgram

import drake_rho as rho
from drake_rho.motion.costs import cost_of
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces, about
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.constraints.separation import CouplingName
from drake_rho.planning.minimum_effort import Changes
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs import reduced
from drake_rho.planning.programs.backend import Backend, SolverName
from drake_rho.planning.programs.conic import ConicPrograms
from drake_rho.planning.programs.group_duals import GroupDuals
from drake_rho.planning.programs.solve import solve_all
from drake_rho.planning.scp import curved_sets
from drake_rho.planning.scp.minimum_violation import minimum_violation
from tests.arrays import FloatArray, IntArray
from tests.scenarios import box, fleet, independent, single, slow, through_the_middle
from tests.test_cli import run
from tests.tolerances import INDEX

COUPLINGS: tuple[CouplingName, ...] = ("coupled", "grouped", "decoupled")
SPHERE = rho.Sphere([5.0, 2.2, -0.9], 1.5)
APART = [[0.4, -0.2, 0.1], [0.1, 0.3, -0.2], [-0.3, 0.1, 0.2], [0.2, -0.1, -0.3]]


def weighted(scenario: rho.Scenario, weights: Sequence[float]) -> rho.Scenario:
    """Return the scenario with these weights of its vehicles."""
    pairs = zip(scenario.vehicles, weights, strict=True)
    vehicles = tuple(dataclasses.replace(vehicle, weight=each) for vehicle, each in pairs)
    return dataclasses.replace(scenario, vehicles=vehicles)


def swap(**options: object) -> rho.Scenario:
    """Return two vehicles that swap places 10 m apart, not quite through each other."""
    starts = [[-5.0, 0.2, 0.0], [5.0, -0.2, 0.1]]
    goals = [[5.0, 0.1, 0.1], [-5.0, 0.0, 0.0]]
    return fleet(starts, goals, **options)  # type: ignore[arg-type]


def crossing() -> rho.Scenario:
    """Return four vehicles that swap sides of a circle, displaced so that no two paths are alike.

    Boxes bind too, so that programs have rows of single vehicles and of pairs.
    """
    scenario = through_the_middle(4)
    starts = [v.start.position + each for v, each in zip(scenario.vehicles, APART, strict=True)]
    goals = [v.goal.position - each for v, each in zip(scenario.vehicles, APART, strict=True)]
    limits = rho.Limits(acceleration=box(0.6))
    return fleet(starts, goals, limits=limits)


def efforts(plan: rho.Plan) -> FloatArray:
    """Return the sum of squared accelerations of each vehicle, shape (N,)."""
    return np.array([np.sum(each**2) for each in plan.accelerations])


def index(plan: rho.Plan) -> float:
    """Return the cost, vehicle by vehicle."""
    weights = [vehicle.weight for vehicle in plan.scenario.vehicles]
    return float(sum(w * effort for w, effort in zip(weights, efforts(plan), strict=True)))


# Weights and costs


@pytest.mark.parametrize("solver", ["clarabel", "daqp", "osqp"])
def test_the_heavier_of_two_that_swap_places_gives_way_less(solver: SolverName) -> None:
    plans = [rho.plan(weighted(swap(), [each, 1.0]), solver=solver) for each in (1, 4, 30, 1000)]
    one, other = np.array([efforts(plan) for plan in plans]).T
    least = efforts(independent(swap()))
    assert np.all(np.diff(one) < 0.0)
    assert np.all(np.diff(other) > 0.0)
    assert one[-1] == pytest.approx(least[0], rel=1e-5)  # all but its own minimum
    assert all(rho.verify(plan).ok for plan in plans)


@pytest.mark.parametrize("weight", [*slow(1e-3), 1e3])
def test_the_motion_of_a_vehicle_alone_does_not_depend_on_its_weight(weight: float) -> None:
    limits = rho.Limits(acceleration=box(0.8))
    scenario = single(limits=limits, obstacles=[SPHERE], between_knots=True)
    plan, other = rho.plan(scenario), rho.plan(weighted(scenario, [weight]))
    np.testing.assert_allclose(other.positions, plan.positions, atol=1e-6)
    assert other.cost == pytest.approx(weight * plan.cost, rel=INDEX)
    assert rho.certify(other).is_globally_optimal


@pytest.mark.parametrize("weights", [[1.0, 1.0, 10.0, 0.1], *slow([1e-3, 1.0, 30.0, 1e3])])
@pytest.mark.parametrize("coupling", COUPLINGS)
def test_plans_of_every_coupling_hold(coupling: CouplingName, weights: list[float]) -> None:
    scenario = weighted(crossing(), weights)
    plan = rho.plan(scenario, coupling=coupling)
    assert rho.verify(plan).ok
    assert plan.cost == pytest.approx(index(plan), rel=1e-12)
    least = rho.verify(plan).summary.least_effort
    assert least is not None
    assert least <= plan.cost
    if coupling != "decoupled":
        unweighted = rho.plan(crossing(), coupling=coupling)
        assert plan.cost < index(rho.Plan.from_accelerations(scenario, unweighted.accelerations))


@pytest.mark.parametrize("coupling", ["grouped", *slow("coupled", "decoupled")])
def test_relabelled_vehicles_have_the_same_plan(coupling: CouplingName) -> None:
    scenario, order = weighted(crossing(), [0.1, 1.0, 30.0, 5.0]), [2, 0, 3, 1]
    vehicles = tuple(scenario.vehicles[each] for each in order)
    plan = rho.plan(scenario, coupling=coupling)
    other = rho.plan(dataclasses.replace(scenario, vehicles=vehicles), coupling=coupling)
    assert other.cost == pytest.approx(plan.cost, rel=1e-5)
    largest = np.abs(plan.accelerations).max()
    np.testing.assert_allclose(other.accelerations, plan.accelerations[order], atol=1e-3 * largest)


# Programs


@pytest.mark.parametrize("weights", [[1.0, 8.0], [500.0, 0.01]])
@np.errstate(invalid="ignore")  # numpy warns of Drake's symbols, without a cause
def test_one_linearisation_costs_what_the_program_written_out_costs(weights: list[float]) -> None:
    """The program has every row of the one pair at every knot, in Drake's symbols."""
    scenario = weighted(swap(between_knots=False), weights)
    at = rho.plan(scenario, coupling="decoupled")
    h, steps, twin = scenario.grid.step, scenario.grid.knots - 1, MathematicalProgram()
    a = [twin.NewContinuousVariables(steps, 3) for _ in scenario.vehicles]
    paths = list[list[np.ndarray]]()
    for vehicle, own in zip(scenario.vehicles, a, strict=True):
        path, v = [vehicle.start.position], vehicle.start.velocity
        for k in range(steps):
            path, v = [*path, path[-1] + h * v + h**2 / 2 * own[k]], v + h * own[k]
        twin.AddLinearEqualityConstraint(path[-1], vehicle.goal.position)
        twin.AddLinearEqualityConstraint(v, vehicle.goal.velocity)
        twin.AddQuadraticCost(vehicle.weight * (own**2).sum())
        paths.append(path)
    for k in range(1, steps):
        gap = at.positions[0, k] - at.positions[1, k]
        twin.AddLinearConstraint(gap @ (paths[0][k] - paths[1][k]) >= np.linalg.norm(gap))
    result = ClarabelSolver().Solve(twin)
    assert result.is_success()
    plan = rho.scp_step(at)
    assert plan.cost == pytest.approx(result.get_optimal_cost(), rel=1e-5)
    largest = np.abs(plan.accelerations).max()
    for own, found in zip(a, plan.accelerations, strict=True):
        np.testing.assert_allclose(found, result.GetSolution(own), atol=1e-3 * largest)


Priced = tuple[float, np.ndarray]
"""The price of a unit of violation, and slacks at that price."""


def written_out(
    problem: Problem, parts: Sequence[HalfSpaces], speeds: tuple[float, float] | None = None
) -> tuple[float, float]:
    """Return the least cost under some rows in Drake's own program, and the slacks' part of it.

    The unknowns are changes of the accelerations of minimum effort, and a slack for each row.

    Args:
        problem: gives the minimum effort and the weights.
        parts: the rows.
        speeds: a limit of speeds at the knots and its penalty, if there is one.
    """
    effort, twin = problem.effort, MathematicalProgram()
    a0, rows = effort.motion.accelerations, effort.goals.rows[0]
    u = [twin.NewContinuousVariables(*each.shape) for each in a0]
    for vehicle, own, least in zip(problem.scenario.vehicles, u, a0, strict=True):
        twin.AddQuadraticErrorCost(vehicle.weight * np.eye(own.size), -least.ravel(), own.ravel())
        for axis in range(3):
            twin.AddLinearEqualityConstraint(rows, np.zeros(len(rows)), own[:, axis])
    priced = [_add_rows(twin, problem, part, u) for part in parts]
    if speeds is not None:
        pairs = zip(u, effort.motion.velocities, strict=True)
        priced += [_add_cones(twin, problem.scenario.grid.step, *each, *speeds) for each in pairs]
    result = ClarabelSolver().Solve(twin)
    assert result.is_success()
    soft = [each for each in priced if np.isfinite(each[0])]
    violated = sum(float(price * result.GetSolution(slacks).sum()) for price, slacks in soft)
    return result.get_optimal_cost(), violated


def _slacks(twin: MathematicalProgram, count: int, penalty: float) -> np.ndarray:
    """Return new slacks at a penalty; they are 0 if it is infinite."""
    slacks: np.ndarray = twin.NewContinuousVariables(count)
    soft = np.isfinite(penalty)
    twin.AddBoundingBoxConstraint(0.0, np.inf if soft else 0.0, slacks)
    if soft:
        twin.AddLinearCost(np.full(count, penalty), slacks)
    return slacks


def _add_rows(
    twin: MathematicalProgram, problem: Problem, part: HalfSpaces, u: list[np.ndarray]
) -> Priced:
    """Add the rows of one constraint, each with a slack."""
    slacks = _slacks(twin, len(part), part.constraint.penalty)
    needed = -part.margins(problem.effort.motion)
    for r, response in enumerate(part.responses(problem.scenario.grid)):
        row = np.kron(response, part.normals[r])
        terms, x = [row], [u[part.vehicles[r]].ravel()]
        if part.constraint.coupled:
            terms, x = [*terms, -row], [*x, u[part.partners[r]].ravel()]
        matrix, variables = np.concatenate([*terms, [1.0]]), np.concatenate([*x, slacks[r : r + 1]])
        twin.AddLinearConstraint(matrix[None], needed[r : r + 1], [np.inf], variables)
    return part.constraint.penalty, slacks


def _add_cones(
    twin: MathematicalProgram,
    h: float,
    u: np.ndarray,
    velocities: FloatArray,
    most: float,
    penalty: float,
) -> Priced:
    """Add the cones norm(velocity) <= most + slack at the inner knots of one vehicle."""
    slacks = _slacks(twin, len(u) - 1, penalty)
    for k in range(1, len(u)):
        matrix = np.zeros((4, 1 + 3 * k))
        matrix[0, 0], matrix[1:, 1:] = 1.0, h * np.tile(np.eye(3), k)
        x = np.concatenate([slacks[k - 1 : k], u[:k].ravel()])
        twin.AddLorentzConeConstraint(matrix, np.array([most, *velocities[k]]), x)
    return penalty, slacks


def by_duals(problem: Problem, parts: Sequence[HalfSpaces], solver: SolverName) -> Motion:
    """Return the motions that the approximate duals of groups find."""
    everyone = np.zeros(len(problem), dtype=int)
    program = GroupDuals(problem.effort, everyone, backend=Backend.of(solver))
    for part in parts:
        program.add(part)
    program.solve()
    return program.motion


def units_of(changes: Changes, groups: IntArray) -> FloatArray:
    """Return the accelerations of vehicles in groups (B, G) for unknowns of one, shape (B, G)."""
    units: FloatArray = np.repeat(changes.units[groups].max(axis=1)[:, None], groups.shape[1], 1)
    return units if changes.factors is None else units * changes.factors[groups]


def by_programs(problem: Problem, parts: Sequence[HalfSpaces], solver: SolverName) -> Motion:
    """Return the motions that programs find, in the form that is chosen."""
    effort = problem.effort
    motion = effort.motion
    for each in solve_all(effort.changes, about(motion, parts), Backend.of(solver)):
        units = units_of(effort.changes, each.groups)[..., None, None]
        u = (units * each.accelerations).reshape(-1, *each.accelerations.shape[2:])
        vehicles = each.groups.reshape(-1)
        order = np.argsort(vehicles)
        a = effort.motion.accelerations[vehicles] + u
        motion = motion.with_vehicles(vehicles[order], a[order])
    return motion


def in_sparse_form(problem: Problem, parts: Sequence[HalfSpaces], solver: SolverName) -> Motion:
    """Return the motions that programs find in the sparse form."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(reduced, "_FEW", 0)
        patched.setattr(reduced, "_SPARSE", 0)
        return by_programs(problem, parts, solver)


@pytest.mark.parametrize("solver", ["clarabel", *slow("daqp")])
@pytest.mark.parametrize("penalty", [np.inf, 1.0, 0.1])
@pytest.mark.parametrize("together", [True, False], ids=["coupled", "alone"])
@pytest.mark.parametrize("find", [by_duals, by_programs, in_sparse_form])
def test_every_form_finds_the_least_weighted_cost_with_its_penalties(
    find: Callable[[Problem, Sequence[HalfSpaces], SolverName], Motion],
    together: bool,
    penalty: float,
    solver: SolverName,
) -> None:
    """A penalty is the price of a unit of violation, whatever the weights of the vehicles are."""
    problem = Problem.of(weighted(crossing(), [0.3, 1.0, 40.0, 5.0]))
    reference = rho.plan(crossing(), coupling="decoupled").motion()
    pairs = [problem.pairs_around(reference, rho.coupled)] if together else []
    price = penalty if together else 0.01 * penalty  # boxes alone are cheaper
    parts = list[HalfSpaces]()
    for constraint in (*problem.convex, *pairs):
        rows = constraint.violated_rows(problem.effort.motion, np.arange(4))
        soft = dataclasses.replace(constraint, penalty=price)
        parts += [dataclasses.replace(rows, form=soft)] if len(rows) > 0 else []
    assert {part.constraint.coupled for part in parts} == {False, together}
    known, violated = written_out(problem, parts)
    least = cost_of(problem.scenario, problem.effort.motion)
    assert (violated > 0.1 * (known - least)) == np.isfinite(penalty)
    motion = find(problem, parts, solver)
    found = cost_of(problem.scenario, motion)
    if np.isfinite(penalty):
        found -= price * sum(np.minimum(part.margins(motion), 0.0).sum() for part in parts)
    assert found - least == pytest.approx(known - least, rel=1e-5, abs=1e-10 * known)


@pytest.mark.parametrize("penalty", [np.inf, 1.0])
def test_a_program_with_cones_finds_the_least_weighted_cost_with_its_penalties(
    penalty: float,
) -> None:
    scenario = weighted(swap(limits=rho.Limits(max_speed=1.45)), [0.3, 40.0])
    problem, both = Problem.of(scenario), np.arange(2)
    effort = problem.effort
    (limit,) = (each for each in problem.convex if isinstance(each, KeepInSets))
    pairs = problem.pairs_around(rho.plan(swap(), coupling="decoupled").motion(), rho.coupled)
    rows = pairs.violated_rows(effort.motion, both)
    known, violated = written_out(problem, [rows], (1.45, penalty))
    assert (violated > 0.1) == np.isfinite(penalty)
    found = ConicPrograms(effort).solve(both, [rows], [limit.softened(penalty)])
    changes = units_of(effort.changes, both[None])[0][:, None, None] * found.accelerations
    motion = effort.motion.with_accelerations(effort.motion.accelerations + changes)
    assert rows.margins(motion).min() > -1e-6
    cost = cost_of(scenario, motion)
    speeds = np.linalg.norm(motion.velocities, axis=2)
    over = np.maximum(speeds - 1.45, 0.0).sum()
    assert (over > 0.1) == np.isfinite(penalty)
    least = cost_of(scenario, effort.motion)
    more = penalty * over if np.isfinite(penalty) else 0.0
    assert cost + more - least == pytest.approx(known - least, rel=1e-5)


def test_where_only_violations_cost_anything_weights_change_nothing() -> None:
    problems = [
        Problem.of(weighted(swap(limits=rho.Limits(acceleration=box(0.2))), weights))
        for weights in ([1.0, 1.0], [70.0, 0.3])
    ]
    one, other = (minimum_violation(each) for each in problems)
    np.testing.assert_allclose(one.accelerations, other.accelerations, rtol=0.0, atol=1e-9)


def test_plans_cost_the_same_with_cones_and_with_tangent_planes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = weighted(swap(limits=rho.Limits(max_acceleration=0.6)), [0.1, 20.0])
    at = rho.plan(scenario)
    costs = []
    for rounds in (0, 10):
        monkeypatch.setattr(curved_sets, "_MAX_PLANE_ROUNDS", rounds)
        plan = rho.scp_step(at)
        assert rho.verify(plan).ok
        assert rho.certify(plan).is_globally_optimal  # with multipliers of tangent planes
        costs.append(plan.cost)
    assert costs[1] == pytest.approx(costs[0], rel=INDEX)


# Costs elsewhere


@pytest.mark.parametrize("weights", [[1.0, 1.0], [1.0, 50.0], [1e-3, 1e3]])
def test_the_certificate_bounds_the_weighted_cost(weights: list[float]) -> None:
    scenario = weighted(swap(), weights)
    certificate = rho.certify(rho.plan(scenario))
    assert certificate.cost == pytest.approx(rho.plan(scenario).cost, rel=1e-12)
    assert certificate.lower_bound <= certificate.cost * (1.0 + 1e-9)
    assert certificate.is_globally_optimal
    assert max(each.stationarity for each in certificate.vehicles) < 1e-6
    for other in ([1.0, 0.0, 0.0], [0.0, 2.0, 1.0]):  # no plan costs less, by whatever way
        reference = independent(scenario).accelerations + 0.05 * np.array(other)
        plan = rho.plan(scenario, reference=rho.Plan.from_accelerations(scenario, reference))
        assert certificate.lower_bound <= plan.cost * (1.0 + 1e-9)


def test_the_certificate_of_a_plan_under_limits_and_past_an_obstacle_bounds_its_cost() -> None:
    sphere = rho.Sphere([0.5, 0.3, 0.2], 1.2)
    limits = rho.Limits(acceleration=box(0.55))
    scenario = weighted(swap(obstacles=[sphere], limits=limits), [20.0, 0.5])
    certificate = rho.certify(rho.plan(scenario))
    assert certificate.lower_bound <= certificate.cost * (1.0 + 1e-9)
    assert certificate.gap < 0.2
    assert max(each.stationarity for each in certificate.vehicles) < 1e-4


def test_the_report_bounds_the_weighted_cost_by_the_least_weighted_effort() -> None:
    scenario = weighted(swap(), [3.0, 0.2])
    summary = rho.verify(rho.plan(scenario)).summary
    assert summary.cost == pytest.approx(rho.plan(scenario).cost)
    least = index(independent(scenario))
    assert summary.least_effort == pytest.approx(least, rel=INDEX)
    assert str(rho.verify(rho.plan(scenario))).count(f"{summary.cost:.6g} m²/s⁴") == 1


def test_goals_of_many_are_assigned_at_the_least_weighted_effort_too() -> None:
    rng = np.random.default_rng(2)
    scenario = weighted(rho.random_transitions(40, rng), (10.0 ** rng.uniform(-2, 2, 40)).tolist())
    found = (rho.assign_goals(scenario, exact=exact) for exact in (True, False))
    costs = [rho.verify(rho.plan_convex(each.without_separation())).summary for each in found]
    assert costs[1].least_effort == pytest.approx(costs[0].least_effort, rel=INDEX)
    assert [each.weight for each in rho.assign_goals(scenario).vehicles] == [
        each.weight for each in scenario.vehicles
    ]


def test_the_command_line_reports_weighted_efforts(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scenario = weighted(swap(), [3.0, 0.2])
    rho.save_scenario(scenario, tmp_path / "swap.yaml")
    _, out, _ = run(capsys, monkeypatch, "assign", str(tmp_path / "swap.yaml"), "--json")
    before = json.loads(out)["effort_before"]
    assert before == pytest.approx(index(independent(scenario)), rel=INDEX)


# Records
