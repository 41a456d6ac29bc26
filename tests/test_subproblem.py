"""The convex subproblem around a reference."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.close_pairs import separation_of, violating_pairs
from drake_rho.planning.constraints.separation import KeepApart
from drake_rho.planning.planners.first_plan import restored
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp import violations
from drake_rho.planning.scp.fleet_steps import FleetSteps
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.minimum_violation import minimum_violation
from drake_rho.planning.scp.restoration import SoftRows
from drake_rho.planning.scp.subproblem import Subproblem, plan_around
from drake_rho.planning.scp.violations import violations_of
from tests.arrays import IntArray
from tests.scenarios import box, fleet, independent, single, through_the_middle
from tests.tolerances import INDEX, MOTION


def test_a_warm_start_changes_the_work_and_not_the_plan() -> None:
    scenario = single(
        start=rho.State([0, 0, 0], acceleration=[0, 0, 0]),
        limits=rho.Limits(velocity=box(1.7), jerk=box(2.4)),
        grid=rho.Grid(0.1, 81),
        obstacles=(rho.Sphere([5.0, 2.6, -1.0], 1.2),),
    )
    reference = rho.plan_convex(scenario)
    warm = Subproblem(Problem.of(scenario), rho.coupled)
    first, second = warm.solve_around(reference), warm.solve_around(reference)
    cold = Subproblem(Problem.of(scenario), rho.coupled).solve_around(reference)
    largest = np.abs(cold.accelerations).max()
    for each in (first, second):
        np.testing.assert_allclose(each.accelerations, cold.accelerations, atol=MOTION * largest)
    assert 1 <= second.statistics.programs < first.statistics.programs
    assert second.statistics.rows <= first.statistics.rows
    assert second.reference is not None
    np.testing.assert_array_equal(second.reference.accelerations, reference.accelerations)


def test_vehicles_that_are_not_planned_fly_the_reference() -> None:
    spheres = (rho.Sphere([5, 0.5, 0], 1.0), rho.Sphere([5, 10.5, 0], 1.0))
    ends = np.array([[0, 0, 0], [0, 10, 0]])
    scenario = fleet(ends, ends + np.array([10, 0, 0]), obstacles=spheres).without_separation()
    reference = rho.plan_convex(scenario)
    after = Subproblem(Problem.of(scenario)).solve_around(reference, np.array([1]))
    np.testing.assert_array_equal(after.accelerations[0], reference.accelerations[0])
    both = Subproblem(Problem.of(scenario)).solve_around(reference)
    np.testing.assert_allclose(after.accelerations[1], both.accelerations[1], atol=1e-6)
    assert not np.array_equal(both.accelerations[0], reference.accelerations[0])


def test_vehicles_without_violation_fly_the_reference_while_others_are_separated() -> None:
    starts = np.array([[-5, 0, 0], [0, 30, 0], [5, 0, 0]])
    scenario = fleet(starts, np.array([[5, 0, 0], [9, 30, 0], [-5, 0, 0]]))
    start = independent(scenario)
    subproblem = Subproblem(Problem.of(scenario), rho.decoupled)
    assert not subproblem.holds(start)
    after = SoftRows(subproblem)(start, 1e3, 0)
    np.testing.assert_array_equal(after.accelerations[1], start.accelerations[1])
    problem = Problem.of(scenario)
    close = [
        violating_pairs(problem.pair_search, plan.motion(), problem.margins.inner, between=True)
        for plan in (start, after)
    ]
    gaps = [found.distances.min(initial=1.0) for found in close]
    assert gaps[0] < 0.1 < gaps[1]


def test_pairs_left_too_close_are_named_for_both_vehicles_in_order_of_distance() -> None:
    """Three vehicles in a row pass one point; each reason has the time of its closest approach."""
    starts = np.array([[-5, 0, 0], [5, 0, 0], [0.0, -5, 0]])
    scenario = fleet(starts, np.array([[5, 0, 0], [-5, 0, 0], [0.8, 5, 0]]))
    alone = rho.plan(scenario.without_separation())
    error = Subproblem(Problem.of(scenario)).violations(alone).error(rho.Statistics(programs=7))
    assert isinstance(error, rho.InfeasibleError)
    times = np.linspace(0.0, 10.0, 100_001)
    x = alone.motion().at("position", times)
    moment = times[np.argmin(np.linalg.norm(x[0] - x[2], axis=1))]
    reasons = "separation from v1 at 5 s", f"separation from v2 at {moment:.4g} s"
    assert error.conflicts["v0"] == reasons
    assert error.conflicts["v1"][0] == "separation from v0 at 5 s"
    assert {reason.split(" at ")[0] for reason in error.conflicts["v2"]} == {
        "separation from v0",
        "separation from v1",
    }
    assert error.statistics.programs == 7
    assert error.scenario == scenario
    assert error.about_linearisation
    assert set(error.obstacles.values()) == {frozenset([0])}
    assert Subproblem(Problem.of(scenario)).violations(rho.plan(scenario)).none


def test_a_coupled_fleet_without_a_solution_has_reasons_for_each_vehicle() -> None:
    scenario = through_the_middle(2, grid=rho.Grid(5.0, 3))
    alone = rho.plan(scenario.without_separation())
    with pytest.raises(rho.InfeasibleError) as caught:
        Subproblem(Problem.of(scenario), rho.coupled).solve_around(
            dataclasses.replace(alone, scenario=scenario)
        )
    for vehicle, partner in (("v0", "v1"), ("v1", "v0")):
        assert f"separation from {partner} at 5 s" in caught.value.conflicts[vehicle]
        assert caught.value.obstacles[vehicle] == frozenset([0])


def test_vehicles_with_a_separation_iterate_together_and_others_independently() -> None:
    scenario = through_the_middle(3)
    assert len(set(Subproblem(Problem.of(scenario)).converging_together.tolist())) == 1
    assert (
        len(set(Subproblem(Problem.of(scenario).without_separation()).converging_together.tolist()))
        == 3
    )


@pytest.mark.parametrize("wrong", ["vehicles", "knots", "step"])
def test_a_reference_that_does_not_fit_is_refused(wrong: str) -> None:
    scenario = single(obstacles=(rho.Sphere([5.0, 2.6, -1.0], 1.2),))
    others = {
        "vehicles": through_the_middle(2, grid=scenario.grid).without_separation(),
        "knots": single(grid=rho.Grid(0.5, 18)),
        "step": single(grid=rho.Grid(0.51, 17)),
    }
    reference = rho.plan_convex(others[wrong])
    with pytest.raises(ValueError, match=r"reference: got . vehicles on .* expected 1 vehicles on"):
        plan_around(Problem.of(scenario), reference)


def test_violated_obstacles_are_numbered_as_in_the_scenario() -> None:
    far, near = rho.Sphere([5.0, 30.0, 0.0], 1.0), rho.Sphere([5, 0.1, 0], 2.0)
    walls = rho.Limits(rho.Box([-1, -1, -1], [11, 1, 1]), acceleration=box(5))
    for spheres, number in (((far, near), 2), ((near, far), 1), ((far, far, near), 3)):
        scenario = single(goal=rho.State([10, 0, 0]), limits=walls, obstacles=spheres)
        with pytest.raises(rho.InfeasibleError) as caught:
            rho.plan_convex(scenario)
        assert caught.value.obstacles == {"solo": frozenset([number])}
        assert any(f"obstacle {number} " in name for name in caught.value.conflicts["solo"])


def test_the_minimum_violation_plan_considers_obstacles_and_accelerations() -> None:
    """A sphere fills a corridor: the violation is shared, and acceleration limits hold."""
    walls = rho.Limits(rho.Box([-1, -1, -1], [11, 1, 1]), acceleration=box(5))
    scenario = single(
        goal=rho.State([10, 0, 0]), limits=walls, obstacles=(rho.Sphere([5, 0.1, 0], 2),)
    )
    plan = minimum_violation(Problem.of(scenario))
    assert np.abs(plan.accelerations).max() <= 5.0 * (1 + INDEX)
    free = minimum_violation(Problem.of(scenario).without_obstacles())
    assert rho.verify(free).ok
    depth = [
        2.0 - np.linalg.norm(each.positions[0] - [5, 0.1, 0], axis=1).min() for each in (plan, free)
    ]
    assert depth[0] < depth[1] - 0.1
    violations = rho.verify(plan).violations
    assert violations
    assert "acceleration box" not in {each.constraint for each in violations}


def test_the_first_restoration_has_one_normal_per_encounter_and_later_ones_search_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = through_the_middle(2)
    start = independent(scenario)
    made: list[KeepApart] = []

    solved = Subproblem.solve_with

    def noted(
        self: Subproblem,
        reference: rho.Plan,
        constraints: Sequence[Constraint],
        vehicles: IntArray | None = None,
    ) -> rho.Plan:
        made.extend(each for each in constraints if isinstance(each, KeepApart))
        return solved(self, reference, constraints, vehicles)

    monkeypatch.setattr(Subproblem, "solve_with", noted)
    for number in range(4):
        SoftRows(Subproblem(Problem.of(scenario), rho.decoupled))(start, 7.0, number)
    assert [each.one_normal for each in made] == [True, False, False, False]
    assert [each.rounds for each in made] == [1, 1, 2, 2]
    assert {each.penalty for each in made} == {7.0}


def test_pairs_are_separated_by_references_that_guarantee_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = through_the_middle(12)
    plan = independent(scenario)
    made: list[dict[str, Any]] = []
    around = InGroups.solve_around

    def noted(self: InGroups, reference: Motion, **options: Any) -> tuple[Motion, rho.Statistics]:
        made.append(options)
        return around(self, reference, **options)

    monkeypatch.setattr(InGroups, "solve_around", noted)
    subproblem = Subproblem(Problem.of(scenario), rho.decoupled)
    step = FleetSteps(subproblem)
    violations = [subproblem.violations(plan).worst]
    for number in range(20):
        if subproblem.violations(plan).is_small:
            break
        plan = step(plan, 10.0 * 3.0**number, number)
        violations.append(subproblem.violations(plan).worst)
    assert violations[-1] < 0.05 < violations[1]  # although the first references are separated
    assert [each["one_normal"] for each in made] == [True] + [False] * (len(made) - 1)
    assert [each["rounds"] for each in made] == [min(k + 1, 4) for k in range(len(made))]
    assert [each["penalty"] for each in made] == [10.0 * 3.0**k for k in range(len(made))]
    plan = step(plan, 1e6, 20)
    assert subproblem.holds(plan)
    assert rho.verify(plan).ok


def test_a_reference_that_satisfies_every_constraint_is_a_plan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """References that are far enough apart need no program with hard rows."""
    scenario = through_the_middle(12)

    def refused(*args: object) -> rho.Plan:
        raise rho.InfeasibleError({"v1": ("acceleration box",)}, scenario=scenario)

    start = independent(scenario)
    monkeypatch.setattr(Subproblem, "solve_around", refused)
    plan = restored(Problem.of(scenario), start, Backend())
    assert plan.statistics.linearisations > 1
    assert rho.verify(plan).ok


def test_only_violating_vehicles_have_programs_at_the_end_of_a_restoration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The other vehicles keep their feasible motions, and the plan as a whole is feasible."""
    scenario = rho.random_transitions(12, np.random.default_rng(5), duration=5.0)
    kept, planned = Subproblem.solve_around, list[int]()

    def noted(self: Subproblem, reference: rho.Plan, vehicles: IntArray | None = None) -> rho.Plan:
        assert vehicles is not None
        np.testing.assert_array_equal(vehicles, self.violations(reference).vehicles)
        plan = kept(self, reference, vehicles)
        planned.append(len(vehicles))
        others = np.setdiff1d(np.arange(12), vehicles)
        np.testing.assert_array_equal(plan.accelerations[others], reference.accelerations[others])
        return plan

    monkeypatch.setattr(Subproblem, "solve_around", noted)
    plan = restored(Problem.of(scenario), independent(scenario), Backend())
    assert 0 < planned[-1] < 12
    assert rho.verify(plan).ok


def test_an_infeasible_vehicle_is_planned_in_a_group_with_its_neighbours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its neighbours would otherwise keep their motions, as they violate nothing."""
    scenario = rho.random_transitions(40, np.random.default_rng(5), duration=5.0)
    hard, in_groups, stuck = Subproblem.solve_around, InGroups.solve_around, list[int]()
    beside, seen = np.zeros(40, dtype=bool), list[int]()

    def refused_once(
        self: Subproblem, reference: rho.Plan, vehicles: IntArray | None = None
    ) -> rho.Plan:
        if stuck:
            return hard(self, reference, vehicles)
        stuck.append(int(self.violations(reference).vehicles[0]))
        x = reference.motion().at("position", np.linspace(0.1, 4.9, 2000))
        x /= np.array([1.0, 1.0, separation_of(scenario).downwash])
        distances = np.linalg.norm(x - x[stuck[0]], axis=2).min(axis=1)
        beside[:] = distances < 1.05 * separation_of(scenario).distance
        beside[self.violations(reference).vehicles] = False
        names = [scenario.vehicles[each].name for each in stuck]
        raise rho.InfeasibleError({names[0]: ("separation",)}, scenario=scenario)

    def noted(self: InGroups, reference: Motion, **options: Any) -> tuple[Motion, rho.Statistics]:
        if stuck and beside.any():
            assert set(np.flatnonzero(beside)) <= set(options["vehicles"])
            assert self.groups is not None
            together = self.groups == self.groups[stuck[0]]
            assert beside[together].any()
            assert together.sum() <= 8
            seen.append(int(beside.sum()))
            beside[:] = False
        return in_groups(self, reference, **options)

    monkeypatch.setattr(Subproblem, "solve_around", refused_once)
    monkeypatch.setattr(InGroups, "solve_around", noted)
    plan = restored(Problem.of(scenario), independent(scenario), Backend())
    assert seen  # a neighbour was without violation
    assert rho.verify(plan).ok


def test_where_groups_fail_soft_rows_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = rho.random_transitions(12, np.random.default_rng(5), duration=5.0)
    around, fails = InGroups.solve_around, [False, True]

    def at_times(self: InGroups, *args: Any, **options: Any) -> tuple[Motion, rho.Statistics]:
        if fails and fails.pop(0):
            raise rho.SolverError("the multipliers of a group were not found")
        return around(self, *args, **options)

    monkeypatch.setattr(InGroups, "solve_around", at_times)
    plan = restored(Problem.of(scenario), independent(scenario), Backend())
    assert not fails
    assert rho.verify(plan).ok


def test_all_vehicles_have_hard_rows_even_where_no_reference_is_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = rho.random_transitions(12, np.random.default_rng(5), duration=5.0)
    kept, planned = Subproblem.solve_around, list[IntArray | None]()

    def noted(self: Subproblem, reference: rho.Plan, vehicles: IntArray | None = None) -> rho.Plan:
        planned.append(vehicles)
        return kept(self, reference, vehicles)

    def none_better(self: InGroups, plan: rho.Plan, tolerance: float) -> rho.Plan:
        return plan.with_statistics(rho.Statistics())

    monkeypatch.setattr(Subproblem, "solve_around", noted)
    monkeypatch.setattr(InGroups, "reference", none_better)
    plan = rho.plan(scenario, coupling=rho.grouped)
    assert planned[-1] is None
    assert plan.statistics.converged
    assert rho.verify(plan).ok


def test_leaving_a_box_between_knots_counts_if_every_instant_is_required() -> None:
    """The vehicle is at 0 m at the first two knots, and at 0.25 m between them."""
    start, goal = rho.State([0, 0, 0], [1, 0, 0]), rho.State([-1, 0, 0], [-1, 0, 0])
    accelerations = np.array([[[-2.0, 0, 0], [0, 0, 0]]])
    for upper, beyond in ((0.3, []), (0.2, [0])):
        room = rho.Box([-9.0] * 3, [upper, 9.0, 9.0])
        scenario = single(start=start, goal=goal, limits=rho.Limits(room), grid=rho.Grid(1.0, 3))
        for strict in (True, False):
            each = dataclasses.replace(scenario, between_knots=strict)
            found = violations_of(
                Problem.of(each), rho.Plan.from_accelerations(each, accelerations)
            )
            assert found.beyond.tolist() == (beyond if strict else [])


def test_vehicles_that_did_not_move_are_not_checked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The violations are the same as after checking all vehicles."""
    rng = np.random.default_rng(5)
    scenario = rho.random_transitions(12, rng, duration=5.0)
    plan = independent(scenario)
    found, looked = violations_of(Problem.of(scenario), plan), list[int]()

    def noted(*args: Any, **options: Any) -> CloseApproaches:
        looked.append(len(options["of"]))
        return violating_pairs(*args, **options)

    for _ in range(6):
        accelerations = np.array(plan.accelerations)
        some = rng.permutation(12)[:3]
        accelerations[some] += rng.normal(size=accelerations[some].shape)
        after = rho.Plan.from_accelerations(scenario, accelerations)
        with monkeypatch.context() as patched:
            patched.setattr(violations, "violating_pairs", noted)
            again = violations_of(Problem.of(scenario), after, (plan, found))
        plan, found = after, violations_of(Problem.of(scenario), after)
        assert len(found.pairs) > 0
        for name in ("one", "other", "times", "distances"):
            one, other = getattr(again.pairs, name), getattr(found.pairs, name)
            np.testing.assert_allclose(one, other, rtol=1e-14)
        np.testing.assert_array_equal(again.beyond, found.beyond)
        np.testing.assert_array_equal(again.vehicles, found.vehicles)
    assert looked == [3] * 6
