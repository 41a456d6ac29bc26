"""`plan`: the convex method, paths around obstacles where it fails, and SCP to convergence."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.constraints.separation import Coupling
from drake_rho.planning.planners import first_plan
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs import backend, solve
from drake_rho.planning.scp.subproblem import Subproblem, coupling_for
from tests.scenarios import box, fleet, single, through_the_middle
from tests.tolerances import INDEX

BESIDE = rho.Sphere([5.0, 2.6, -1.0], 1.5)


def _two_in_the_middle() -> rho.Scenario:
    """Return three vehicles; the unconstrained motions of two pass through a sphere's centre."""
    ends = np.array([[0, 0, 0], [0, 10, 0], [0, 20, 0]])
    spheres = (rho.Sphere([5, 0, 0], 1.5), rho.Sphere([5, 10, 0], 2.0))
    limits, goals = rho.Limits(velocity=box(2.5)), ends + np.array([10, 0, 0])
    scenario = fleet(ends, goals, limits=limits, obstacles=spheres, between_knots=False)
    return scenario.without_separation()


@pytest.mark.parametrize("limits", [rho.Limits(), rho.Limits(velocity=box(1.5))])
def test_without_obstacles_plan_is_the_convex_method(limits: rho.Limits) -> None:
    scenario = single(limits=limits)
    plan = rho.plan(scenario)
    np.testing.assert_array_equal(plan.accelerations, rho.plan_convex(scenario).accelerations)
    assert plan.statistics.linearisations == 0
    assert plan.statistics.tolerance is None
    assert plan.reference is None


def test_plan_iterates_from_the_plan_of_the_convex_method(paper: rho.Scenario) -> None:
    by_hand = rho.plan_convex(paper)
    for _ in range(3):
        by_hand = rho.scp_step(by_hand)
    plan = rho.plan(paper, options=rho.Options(max_iterations=3))
    assert plan.cost == pytest.approx(by_hand.cost, rel=INDEX)
    assert plan.statistics.linearisations == 1 + 3


def test_where_the_convex_method_fails_plan_finds_a_path_for_every_vehicle() -> None:
    scenario = _two_in_the_middle()
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    assert set(caught.value.conflicts) == {"v0", "v1"}
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    alone = [
        rho.plan(dataclasses.replace(scenario, vehicles=(vehicle,)))
        for vehicle in scenario.vehicles
    ]
    for index, each in enumerate(alone):
        own = float(np.sum(plan.accelerations[index] ** 2))
        assert own == pytest.approx(each.cost, rel=INDEX)


def test_an_executor_gives_the_same_plan() -> None:
    scenario = _two_in_the_middle()
    here = rho.plan(scenario)
    with ThreadPoolExecutor(2) as executor:
        there = rho.plan(scenario, executor=executor)
    np.testing.assert_allclose(there.accelerations, here.accelerations, atol=1e-9)


def test_all_vehicles_without_a_path_are_named() -> None:
    scenario = _two_in_the_middle()
    walls = rho.Limits(rho.Box([-1, -1, -1], [11, 1, 1]))
    walled = dataclasses.replace(scenario.vehicles[0], limits=walls)
    scenario = dataclasses.replace(scenario, vehicles=(walled, *scenario.vehicles[1:]))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(scenario)
    assert set(caught.value.conflicts) == {"v0"}  # the other one has a path
    assert caught.value.obstacles == {"v0": frozenset([1])}
    assert caught.value.scenario == scenario
    assert caught.value.reference is not None
    assert caught.value.about_linearisation


@pytest.mark.parametrize("separated", [False, True])
def test_an_error_carries_the_scenario_given(separated: bool) -> None:
    weak = through_the_middle(3, limits=rho.Limits(acceleration=box(0.1)))
    if not separated:
        weak = weak.without_separation()
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(weak)
    assert caught.value.scenario == weak
    assert not caught.value.about_linearisation


def test_an_iteration_ends_with_the_first_decrease_below_the_tolerance(paper: rho.Scenario) -> None:
    """Relative decreases of one vehicle's cost come from plans stopped after 1, 2, ... steps."""
    alone = dataclasses.replace(paper, vehicles=paper.vehicles[:1])
    tolerance = 1e-3
    plan = rho.plan(alone, options=rho.Options(tolerance=tolerance))
    assert plan.statistics.converged
    assert plan.statistics.tolerance == tolerance
    count = plan.statistics.linearisations - 1
    assert count > 2
    stopped = [
        rho.plan(alone, options=rho.Options(tolerance=tolerance, max_iterations=most))
        for most in range(1, count + 2)
    ]
    costs = np.array([rho.plan_convex(alone).cost, *(each.cost for each in stopped)])
    falls = -np.diff(costs) / costs[:-1]
    assert np.all(falls[: count - 1] > tolerance)
    assert 0.0 <= falls[count - 1] < tolerance
    assert falls[count] == 0.0
    assert [each.statistics.converged for each in stopped] == [False] * (count - 1) + [True] * 2


@pytest.mark.parametrize("coupling", [rho.coupled, rho.decoupled])
def test_reported_convergence_is_true_for_fleets(coupling: Coupling) -> None:
    scenario = through_the_middle(4)
    options = rho.Options(tolerance=1e-4)
    plan = rho.plan(scenario, coupling=coupling, options=options)
    assert plan.statistics.converged
    assert plan.statistics.tolerance == 1e-4
    again = Subproblem(Problem.of(scenario), coupling).solve_around(plan)
    assert again.cost <= plan.cost * (1 + INDEX)
    assert plan.cost - again.cost < 1e-3 * plan.cost
    crowd = rho.random_transitions(6, np.random.default_rng(1), duration=4.6, step=0.2)
    once = rho.plan(
        crowd, coupling=coupling, options=rho.Options(tolerance=1e-15, max_iterations=1)
    )
    assert not once.statistics.converged
    assert once.statistics.tolerance == 1e-15
    assert rho.verify(once).ok


def test_progress_reports_every_linearisation_after_the_first() -> None:
    said: list[str] = []
    plan = rho.plan(single(obstacles=(BESIDE,)), progress=said.append)
    assert len(said) == plan.statistics.linearisations - 1 > 2
    for number, words in enumerate(said, start=2):
        assert words.startswith(f"linearised {number} times, cost ")
    costs = [float(words.split()[4]) for words in said]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == pytest.approx(plan.cost, rel=1e-5)


def test_progress_reports_the_restoration_of_a_fleet() -> None:
    said: list[str] = []
    plan = rho.plan(through_the_middle(4), progress=said.append)
    assert rho.verify(plan).ok
    assert len(said) > 2


def test_a_given_reference_decides_the_side_on_which_an_obstacle_is_passed() -> None:
    scenario = single(goal=rho.State([10, 0, 0]), obstacles=(rho.Sphere([5, 0.3, 0], 1.0),))
    ways = []
    for y in (-1.0, 1.0):
        pushed = rho.Sphere([5.0, 0.3 - 2.0 * y, 0.0], 3.5)
        beside = rho.plan(single(goal=rho.State([10, 0, 0]), obstacles=(pushed,)))
        plan = rho.plan(scenario, reference=dataclasses.replace(beside, scenario=scenario))
        assert rho.verify(plan).ok
        assert y * (plan.positions[0, 8, 1] - 0.3) >= 1.0 - 1e-6
        ways.append(plan.cost)
    assert ways[0] < ways[1]  # the path below is shorter
    assert rho.plan(scenario).cost == pytest.approx(ways[0], rel=INDEX)


def test_a_separated_reference_of_a_fleet_is_iterated_from() -> None:
    """Two that meet head-on and pass above and below keep doing so, though beside costs as much."""
    ends = np.array([[-5, 0, 0], [5, 0, 0]])
    scenario = fleet(ends, -ends)
    aside = fleet(ends, -ends, limits=rho.Limits(position=rho.Box([-9, -0.01, -9], [9, 0.01, 9])))
    above = rho.plan(aside)
    plan = rho.plan(scenario, reference=dataclasses.replace(above, scenario=scenario))
    assert rho.verify(plan).ok
    np.testing.assert_allclose(plan.positions[:, :, 1], 0.0, atol=1e-6)
    assert plan.statistics.linearisations < rho.plan(scenario).statistics.linearisations + 5


def test_a_fleet_is_coupled_up_to_the_requested_number_of_vehicles() -> None:
    scenario = through_the_middle(3)
    assert coupling_for(scenario, rho.Options(max_coupled=3)) is rho.coupled
    assert coupling_for(scenario, rho.Options(max_coupled=2)) is rho.grouped
    assert coupling_for(scenario, rho.Options(max_coupled=2, max_grouped=2)) is rho.decoupled
    assert coupling_for(through_the_middle(15)) is rho.coupled
    assert coupling_for(through_the_middle(16, separation=rho.Separation(0.5))) is rho.grouped
    for most, coupling in ((3, rho.coupled), (2, rho.grouped)):
        plan = rho.plan(scenario, options=rho.Options(max_coupled=most))
        other = rho.plan(scenario, coupling=coupling)
        assert plan.cost == pytest.approx(other.cost, rel=INDEX)
        assert plan.statistics.tolerance == other.statistics.tolerance


def test_default_tolerances_are_the_documented_ones() -> None:
    options = rho.Options()
    alone, few, many = single(), through_the_middle(6), through_the_middle(7)
    assert options.tolerance_of(alone, together=True) == 1e-9
    assert options.tolerance_of(few, together=True) == 1e-7
    assert options.tolerance_of(many, together=True) == 1e-3
    for scenario in (few, many):
        assert options.tolerance_of(scenario, together=False) == 5e-2
        assert options.tolerance_of(scenario, together=False, in_groups=True) == 2e-3
    for scenario in (alone, few, many):
        assert rho.Options(tolerance=0.1).tolerance_of(scenario, together=False) == 0.1
    assert (options.max_iterations, options.max_coupled, options.max_ways) == (200, 15, 6)
    assert (options.max_group, options.max_grouped) == (10, 500)
    assert options.max_memory == 1e9


@pytest.mark.parametrize(
    "bad",
    [
        {"tolerance": 0.0},
        {"tolerance": 1.0},
        {"tolerance": float("nan")},
        {"max_iterations": 0},
        {"max_coupled": 0},
        {"max_group": 0},
        {"max_grouped": 0},
        {"max_ways": 0},
        {"max_memory": 9.9e6},
        {"max_memory": float("nan")},
    ],
)
def test_invalid_options_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(rho.ScenarioError, match=next(iter(bad))):
        rho.Options(**bad)  # type: ignore[arg-type]  # what is tested


def test_a_reference_with_nan_is_refused_before_any_solver_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = single(obstacles=(BESIDE,))
    plan = rho.plan(scenario)
    monkeypatch.setattr(solve, "SolveInParallel", None)
    for bad in (np.nan, np.inf):
        accelerations = np.array(plan.accelerations)
        accelerations[0, 3, 1] = bad
        with pytest.raises(ValueError, match=r"accelerations: got (nan|inf) for solo at knot 3"):
            rho.plan(scenario, reference=dataclasses.replace(plan, accelerations=accelerations))


def test_statistics_count_every_step() -> None:
    scenario = _two_in_the_middle()
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    plan = rho.plan(scenario)
    assert plan.statistics.programs > caught.value.statistics.programs + 2
    assert plan.statistics.solver == backend.DEFAULT().solver_id().name()
    assert plan.statistics.seconds > 0.0


def test_where_solvers_fail_paths_are_tried_if_there_is_an_obstacle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = single(obstacles=(BESIDE,))
    known = rho.plan(scenario)

    def failing(*args: object, **options: object) -> rho.Plan:
        raise rho.SolverError("numerically")

    monkeypatch.setattr(first_plan, "linearised_once", failing)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert plan.cost == pytest.approx(known.cost, rel=INDEX)
    with pytest.raises(rho.SolverError, match="numerically"):
        rho.plan(scenario.without_obstacles())
