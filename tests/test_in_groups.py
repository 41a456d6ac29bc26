"""Fleets in groups: partitions, programs of groups, and plans around their solutions."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.optimize import lsq_linear

import drake_rho as rho
from drake_rho.planning.constraints.base import HalfSpaces, about
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.planners.first_plan import first_plan
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs import group_duals
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.dual import multipliers_of
from drake_rho.planning.programs.group_duals import GroupDuals
from drake_rho.planning.programs.program import add_rows
from drake_rho.planning.programs.reduced import rows_of
from drake_rho.planning.scp.fleet_improvement import AroundReferences
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.groups import groups_with_multipliers
from drake_rho.planning.scp.subproblem import Subproblem
from tests.arrays import IntArray
from tests.scenarios import box, fleet, mapped, sampled_separation, slow, through_the_middle
from tests.tolerances import INDEX

WITHIN = 1.03
"""Goal for the cost of a plan in groups, over that of the coupled plan."""

SMALL = rho.Options(max_group=3)


def crowd(seed: int, vehicles: int = 8) -> rho.Scenario:
    """Return a random transition in 4 m³ in which vehicles have to avoid each other."""
    rng = np.random.default_rng(seed)
    return rho.random_transitions(vehicles, rng, duration=4.6, step=0.2)


@pytest.fixture(scope="module")
def scenario() -> rho.Scenario:
    """Return eight vehicles whose coupled plan costs 5 % less than the decoupled one."""
    return crowd(1)


@pytest.fixture(scope="module")
def first(scenario: rho.Scenario) -> rho.Plan:
    """Return their first plan, which satisfies all constraints."""
    return first_plan(Problem.of(scenario))


# Partitions


@given(data=st.data(), vehicles=st.integers(2, 12), most=st.integers(1, 6))
@settings(max_examples=33)
def test_groups_are_a_partition_of_bounded_groups(
    data: st.DataObject, vehicles: int, most: int
) -> None:
    numbers = st.integers(0, vehicles - 1)
    pairs = data.draw(st.lists(st.tuples(numbers, numbers).filter(lambda ij: ij[0] < ij[1])))
    pairs = sorted(set(pairs))
    values = st.floats(1e-6, 1e6)
    pressures = np.array(data.draw(st.lists(values, min_size=len(pairs), max_size=len(pairs))))
    one, other = np.array(pairs, dtype=int).reshape(-1, 2).T
    groups = groups_with_multipliers(vehicles, one, other, pressures, most)
    sizes = np.bincount(groups, minlength=vehicles)
    assert sizes.sum() == vehicles
    assert sizes.max() <= most
    for number in np.unique(groups):  # the number of a group is that of one of its vehicles
        assert groups[number] == number
    for i, j in zip(one, other, strict=True):  # no vehicle is left out of a group with capacity
        assert groups[i] == groups[j] or sizes[groups[i]] + sizes[groups[j]] > most
    linked = {frozenset((i, j)) for i, j in pairs}
    for number in np.unique(groups):  # and every member of a group interacts with some other
        members = np.flatnonzero(groups == number)
        for member in members if len(members) > 1 else ():
            assert any(frozenset((member, each)) in linked for each in members)


def test_vehicles_with_the_largest_multiplier_sums_are_grouped() -> None:
    one, other = np.array([0, 1, 2]), np.array([1, 2, 3])
    groups = groups_with_multipliers(5, one, other, np.array([1.0, 3.0, 2.0]), 2)
    assert groups[1] == groups[2]
    assert len(np.unique(groups)) == 4
    assert len(np.unique(groups_with_multipliers(5, one, other, np.array([1.0, 3.0, 2.0]), 4))) == 2


def test_rounding_does_not_change_the_groups() -> None:
    one, other = np.array([0, 1, 2, 3]), np.array([1, 2, 3, 4])
    rng = np.random.default_rng(0)
    wanted = groups_with_multipliers(5, one, other, np.ones(4), 2)
    for _ in range(10):
        noisy = 1.0 + 1e-9 * rng.standard_normal(4)
        np.testing.assert_array_equal(groups_with_multipliers(5, one, other, noisy, 2), wanted)


# Programs of groups


def _rows(scenario: rho.Scenario, reference: rho.Plan) -> list[HalfSpaces]:
    """Return half-spaces that the minimum-effort motions violate, with those of a tighter box."""
    effort, everyone = MinimumEffort.of(scenario), np.arange(len(scenario.vehicles))
    tighter = box(0.9 * np.abs(effort.motion.accelerations).max())
    scenario = dataclasses.replace(scenario, limits=rho.Limits(acceleration=tighter))
    problem = Problem.of(scenario)
    constraints = [*problem.convex, problem.pairs_around(reference.motion(), rho.coupled)]
    found = [constraint.violated_rows(effort.motion, everyone) for constraint in constraints]
    return [rows for rows in found if len(rows) > 0]


def _by_drake(effort: MinimumEffort, everyone: IntArray, rows: list[HalfSpaces]) -> float:
    """Return the cost of the same program, accelerations and goals written out, by Clarabel."""
    parts = about(effort.motion, rows)
    matrix, needed, penalties = rows_of(effort.changes, everyone, parts)
    program = MathematicalProgram()
    x = program.NewContinuousVariables(matrix.shape[1])
    program.AddQuadraticCost(2.0 * np.eye(len(x)), np.zeros(len(x)), x, is_convex=True)
    add_rows(program, matrix, needed, penalties, np.arange(len(needed)), x)
    goals = np.kron(np.eye(len(everyone)), np.kron(effort.goals.rows[0], np.eye(3)))
    program.AddLinearEqualityConstraint(goals, np.zeros(len(goals)), x)
    result = ClarabelSolver().Solve(program)
    assert result.is_success()
    least = float(np.sum(effort.motion.accelerations**2))
    more: float = effort.changes.units.max() ** 2 * result.get_optimal_cost()
    return least + more


def test_the_dual_qp_satisfies_its_rows_at_the_cost_of_drake(
    scenario: rho.Scenario, first: rho.Plan
) -> None:
    rows, everyone = _rows(scenario, first), np.arange(len(scenario.vehicles))
    assert {part.constraint.coupled for part in rows} == {False, True}
    effort = MinimumEffort.of(scenario)
    program = GroupDuals(effort, np.zeros(len(everyone), dtype=int))
    for part in rows:
        program.add(part)
    program.solve()
    assert program.programs == 1
    for part in rows:
        assert part.margins(effort.motion).min() < -1e-3
        assert part.margins(program.motion).min() > -1e-6
    cost = float(np.sum(program.motion.accelerations**2))
    assert cost == pytest.approx(_by_drake(effort, everyone, rows), rel=INDEX)
    np.testing.assert_allclose(program.motion.positions[:, -1], scenario.fleet.goal_positions)
    for part, multipliers in program.active_rows():  # these rows are necessary
        assert np.abs(part.margins(program.motion)).max() < 1e-6
        assert multipliers.min() > 0.0


@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 40))
@settings(max_examples=20)
def test_unbounded_multipliers_satisfy_the_optimality_conditions(seed: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, 10)) + 3.0 * rng.standard_normal(10)  # nearly parallel rows
    gram = matrix @ matrix.T + 1e-6 * np.eye(rows)
    needed = rng.standard_normal(rows)
    begin = np.maximum(rng.standard_normal(rows), 0.0)
    for y in (np.zeros(rows), begin):
        found = multipliers_of(gram, needed, np.full(rows, np.inf), y)
        slope = gram @ found - needed
        assert found.min() >= 0.0
        assert slope.min() >= -INDEX * (1.0 + np.abs(needed).max())
        assert abs(found @ slope) <= INDEX * (1.0 + abs(found @ needed))


@pytest.mark.parametrize("by_daqp", [False, True], ids=["own", "daqp"])
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 40))
@settings(max_examples=20)
def test_bounded_multipliers_are_those_of_bounded_least_squares(
    by_daqp: bool, seed: int, rows: int
) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, 10)) + 3.0 * rng.standard_normal(10)
    gram = matrix @ matrix.T + 1e-6 * np.eye(rows)
    needed, most = rng.standard_normal(rows), 10.0 ** rng.uniform(-3, 2, rows)
    most[rng.random(rows) < 0.2] = np.inf
    triangle = np.linalg.cholesky(gram)
    target = np.linalg.solve(triangle, needed)
    wanted = lsq_linear(triangle.T, target, bounds=(0.0, most), method="bvls", tol=1e-14).x
    for y in (np.zeros(rows), np.abs(rng.standard_normal(rows))):
        found = multipliers_of(gram, needed, most, y, by_daqp=by_daqp)
        assert np.all((found >= 0.0) & (found <= most))
        least, cost = (x @ gram @ x / 2 - needed @ x for x in (wanted, found))
        assert cost <= least + INDEX * (1.0 + abs(least))


@pytest.mark.parametrize("by_daqp", [False, True], ids=["own", "daqp"])
@pytest.mark.parametrize("most", [1.0, np.inf])
def test_a_gram_matrix_that_is_none_is_told(most: float, by_daqp: bool) -> None:
    with pytest.raises(rho.SolverError, match="multipliers"):
        multipliers_of(-np.eye(2), np.ones(2), np.full(2, most), by_daqp=by_daqp)


def test_soft_rows_are_violated_where_that_costs_less(
    scenario: rho.Scenario, first: rho.Plan
) -> None:
    """The cost with slack equals Drake's, for penalties at which only some rows are violated."""
    effort, rows = MinimumEffort.of(scenario), _rows(scenario, first)
    hard = GroupDuals(effort, np.zeros(len(scenario.vehicles), dtype=int))
    for part in rows:
        hard.add(part)
    hard.solve()
    pressures = np.concatenate([multipliers for _, multipliers in hard.active_rows()])
    penalty = float(np.median(pressures))
    soft = [
        dataclasses.replace(part, form=dataclasses.replace(part.constraint, penalty=penalty))
        for part in rows
    ]
    program = GroupDuals(effort, np.zeros(len(scenario.vehicles), dtype=int))
    for part in soft:
        program.add(part)
    program.solve()
    margins = np.concatenate([part.margins(program.motion) for part in soft])
    assert margins.min() < -1e-3
    found = float(np.sum(program.motion.accelerations**2)) - penalty * np.minimum(margins, 0).sum()
    assert found == pytest.approx(_by_drake(effort, np.arange(8), soft), rel=1e-6)
    assert found < float(np.sum(hard.motion.accelerations**2))


def test_rows_fixed_by_the_goal_are_left_out(scenario: rho.Scenario, first: rho.Plan) -> None:
    """A row at the last knot restates the goal: whatever its bound, nothing changes."""
    effort, rows = MinimumEffort.of(scenario), _rows(scenario, first)
    box_rows = rows[0]
    at_goal = dataclasses.replace(
        box_rows.select(slice(1)),
        form=dataclasses.replace(box_rows.constraint, quantity="position"),
        times=np.array([scenario.grid.duration]),
        bounds=np.array([1e3]),
    )
    with_it, without = (GroupDuals(effort, np.arange(len(scenario.vehicles))) for _ in range(2))
    for program in (with_it, without):
        program.add(box_rows)
    with_it.add(at_goal)
    for program in (with_it, without):
        program.solve()
    np.testing.assert_allclose(
        with_it.motion.accelerations, without.motion.accelerations, atol=1e-9
    )


def test_programs_on_an_executor_are_the_same_to_the_last_digit(
    scenario: rho.Scenario, first: rho.Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(group_duals, "_BLOCK", 10)
    effort, alone = MinimumEffort.of(scenario), np.arange(len(scenario.vehicles))
    with ThreadPoolExecutor(2) as executor:
        workers = Backend(executor=executor)
        programs = [GroupDuals(effort, alone, backend=each) for each in (None, workers)]
        for program in programs:
            program.add(_rows(scenario, first)[0])
            program.solve()
    here, there = (program.motion.accelerations for program in programs)
    np.testing.assert_array_equal(here, there)
    assert np.abs(here - effort.motion.accelerations).max() > 0.0


def test_rows_added_later_lead_to_the_same_motion(scenario: rho.Scenario, first: rho.Plan) -> None:
    rows = _rows(scenario, first)
    together = np.zeros(len(scenario.vehicles), dtype=int)
    at_once, later = (GroupDuals(MinimumEffort.of(scenario), together) for _ in range(2))
    for part in rows:
        at_once.add(part)
        later.add(part)
        later.solve()
    at_once.solve()
    np.testing.assert_allclose(later.motion.positions, at_once.motion.positions, atol=1e-6)


def test_groups_without_new_rows_are_not_solved_again(
    scenario: rho.Scenario, first: rho.Plan
) -> None:
    boxes = _rows(scenario, first)[0]
    alone = np.arange(len(scenario.vehicles))
    program = GroupDuals(MinimumEffort.of(scenario), alone)
    program.add(boxes)
    program.solve()
    before, whose = program.motion, boxes.vehicles[0]
    assert program.programs == len(np.unique(boxes.vehicles))
    program.solve()
    assert program.programs == len(np.unique(boxes.vehicles))
    program.add(boxes.select(boxes.vehicles == whose))
    program.solve()
    assert program.programs == len(np.unique(boxes.vehicles)) + 1
    others = np.flatnonzero(alone != whose)
    np.testing.assert_array_equal(program.motion.positions[others], before.positions[others])


# Plans


@pytest.mark.parametrize("solver", [None, *slow(rho.Daqp())])
@pytest.mark.parametrize("seed", [*slow(1), 4])
def test_the_index_of_a_grouped_plan_is_almost_that_of_the_coupled_plan(
    seed: int, solver: rho.Daqp | None
) -> None:
    scenario = crowd(seed)
    least, halves = (
        rho.plan(scenario, coupling=each).cost for each in (rho.coupled, rho.decoupled)
    )
    assert halves > 1.05 * least
    plan = rho.plan(scenario, coupling=rho.grouped, options=SMALL, solver=solver)
    assert plan.cost < WITHIN * least
    assert plan.statistics.converged
    assert rho.verify(plan).ok
    assert sampled_separation(plan) >= 0.35 - 1e-6


def test_planning_in_groups_is_deterministic(scenario: rho.Scenario) -> None:
    one, other = (rho.plan(scenario, coupling=rho.grouped, options=SMALL) for _ in range(2))
    np.testing.assert_array_equal(one.accelerations, other.accelerations)


def test_relabelled_vehicles_cost_the_same(scenario: rho.Scenario) -> None:
    plan = rho.plan(scenario, coupling=rho.grouped, options=SMALL)
    order = np.random.default_rng(2).permutation(len(scenario.vehicles))
    other = rho.plan(scenario.of_vehicles(order.tolist()), coupling=rho.grouped, options=SMALL)
    assert other.cost == pytest.approx(plan.cost, rel=INDEX)


def test_references_of_a_mirrored_fleet_are_mirror_images(
    scenario: rho.Scenario, first: rho.Plan
) -> None:
    mirror = np.diag([-1.0, 1.0, 1.0])
    other = mapped(scenario, mirror, np.array([0.3, -2.0, 1.0]))
    motion = first.motion()
    mirrored = rho.Plan.from_accelerations(other, motion.accelerations @ mirror).motion()
    one, two = (InGroups(Problem.of(each), 3) for each in (scenario, other))
    for _ in range(3):
        motion, mirrored = one.solve_around(motion)[0], two.solve_around(mirrored)[0]
        largest = np.abs(motion.accelerations).max()
        np.testing.assert_allclose(
            mirrored.accelerations @ mirror, motion.accelerations, atol=1e-4 * largest
        )
        np.testing.assert_array_equal(one.groups, two.groups)


def test_the_cost_never_increases_and_every_iterate_is_feasible(
    scenario: rho.Scenario, first: rho.Plan
) -> None:
    improve = AroundReferences(Subproblem(Problem.of(scenario), rho.grouped), most=3)
    everyone, plans = np.arange(len(scenario.vehicles)), [first]
    for _ in range(4):
        plans.append(improve(plans[-1], everyone, 1e-3)[0])
        assert rho.verify(plans[-1]).ok
    for before, after in pairwise(plans):
        assert after.cost <= before.cost * (1 + INDEX)
    assert plans[-1].cost < 0.95 * first.cost


def test_references_cost_no_more_than_the_plan_and_groups_change(
    scenario: rho.Scenario, first: rho.Plan
) -> None:
    in_groups = InGroups(Problem.of(scenario), 3)
    assert in_groups.groups is None
    assert in_groups.reference(first, 1e-3).cost < first.cost
    motion, seen = first.motion(), set[tuple[int, ...]]()
    for _ in range(4):
        motion, statistics = in_groups.solve_around(motion)
        groups = in_groups.groups
        assert groups is not None
        assert np.bincount(groups).max() == 3
        assert statistics.linearisations == 1
        seen.add(tuple(groups.tolist()))
    assert len(seen) > 1


def test_a_fleet_no_larger_than_two_groups_is_one() -> None:
    problem = Problem.of(crowd(1))
    groups = InGroups(problem, 4).groups
    assert groups is not None
    assert len(np.unique(groups)) == 1
    assert InGroups(problem, 3).groups is None


@pytest.mark.parametrize("useless", ["none", "far", "dear"])
def test_where_groups_are_useless_vehicles_yield_half_each(
    scenario: rho.Scenario, first: rho.Plan, useless: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    everyone = np.arange(len(scenario.vehicles))
    halves = Subproblem(Problem.of(scenario), rho.decoupled).solve_around(first)

    def reference(self: InGroups, plan: rho.Plan, tolerance: float) -> rho.Plan:
        if useless == "none":
            raise rho.SolverError("no multipliers")
        accelerations = MinimumEffort.of(scenario).motion.accelerations
        if useless == "far":  # all vehicles in one place, so that directions of pairs are arbitrary
            accelerations = np.zeros_like(accelerations)
        return rho.Plan.from_accelerations(scenario, accelerations)

    monkeypatch.setattr(InGroups, "reference", reference)
    improve = AroundReferences(Subproblem(Problem.of(scenario), rho.grouped))
    plan, _ = improve(first, everyone, 1e-3)
    assert rho.verify(plan).ok
    assert plan.cost <= first.cost
    if useless == "none":
        assert plan.cost == pytest.approx(halves.cost, rel=INDEX)


def test_among_obstacles_and_limits_of_all_kinds_every_instant_holds() -> None:
    sphere = rho.Sphere([0.0, 0.0, 0.5], 1.5)
    limits = rho.Limits(acceleration=rho.Box([-2.0] * 3, [2.0] * 3), max_speed=3.0)
    scenario = through_the_middle(
        6, separation=rho.Separation(1.0, 2.0), limits=limits, obstacles=(sphere,)
    )
    plan = rho.plan(scenario, coupling=rho.grouped, options=SMALL)
    assert rho.verify(plan).ok
    assert plan.cost <= rho.plan(scenario, coupling=rho.decoupled).cost * (1 + INDEX)


def test_vehicles_without_encounters_fly_their_independent_plan() -> None:
    starts = np.array([[0.0, 5.0 * i, 0.0] for i in range(6)])
    starts[1] = [6.0, 0.0, 0.0]
    goals = starts + np.array([0.0, 0.0, 5.0])
    goals[[0, 1]] = starts[[1, 0]]
    scenario = fleet(starts, goals)
    plan = rho.plan(scenario, coupling=rho.grouped, options=rho.Options(max_group=2))
    independent = rho.plan(scenario.without_separation())
    moved = np.any(np.abs(plan.accelerations - independent.accelerations) > 1e-9, axis=(1, 2))
    assert moved.tolist() == [True, True, False, False, False, False]
