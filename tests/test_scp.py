"""Sequential convex programming: every iterate is feasible, and the cost never increases."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise, repeat

import numpy as np
import pytest
from hypothesis import assume, given, settings
from pydrake.solvers import SolverInterface

import drake_rho as rho
from drake_rho.planning.call.options import DEFAULTS
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.patience import PATIENCE, DeadEnds
from drake_rho.planning.scp.restoration import SoftRows, restore_feasibility
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from tests.arrays import IntArray
from tests.scenarios import fleet, independent, scenarios, through_the_middle
from tests.tolerances import INDEX


def _iterate(plan: rho.Plan, steps: int, solver: SolverInterface | None = None) -> list[rho.Plan]:
    plans = [plan]
    for _ in range(steps):
        plans.append(rho.scp_step(plans[-1], solver=solver))
    return plans


def test_every_iterate_is_feasible_and_the_cost_does_not_increase(
    paper: rho.Scenario, solver: SolverInterface
) -> None:
    plans = _iterate(rho.plan_convex(paper, solver=solver), 12, solver)
    assert all(rho.verify(plan).ok for plan in plans)
    costs = np.array([plan.cost for plan in plans])
    assert np.all(np.diff(costs) <= 1e-9 * costs[:-1])
    assert costs[-1] < 0.81 * costs[0]


@given(scenario=scenarios())
@settings(max_examples=13)
def test_iterates_of_random_scenarios_are_feasible_and_cost_no_more(scenario: rho.Scenario) -> None:
    assume(scenario.obstacles)
    try:
        plans = _iterate(rho.plan_convex(scenario), 6)
    except rho.InfeasibleError:
        assume(False)
    assert all(rho.verify(plan).ok for plan in plans)
    for before, after in pairwise(plans):
        # rows are satisfied to a tenth of the verifier's tolerance, and so is the cost
        assert after.cost <= before.cost * (1 + INDEX)


def test_a_converged_plan_is_optimal_for_its_own_linearisation(paper: rho.Scenario) -> None:
    plan = rho.plan_scp(paper)
    assert plan.statistics.converged
    again = rho.scp_step(plan)
    assert again.cost == pytest.approx(plan.cost, rel=INDEX)


def test_without_obstacles_there_is_nothing_to_iterate(paper: rho.Scenario) -> None:
    plan = rho.plan_scp(paper.without_obstacles())
    assert plan.statistics.programs == 0
    assert plan.statistics.linearisations == 0


def test_another_first_reference_is_used(paper: rho.Scenario) -> None:
    convex = rho.plan_convex(paper)
    from_convex = rho.plan_scp(paper, reference=convex)
    assert from_convex.cost == pytest.approx(rho.plan_scp(paper).cost, rel=INDEX)
    assert from_convex.statistics.linearisations < 1 + rho.plan_scp(paper).statistics.linearisations


def test_a_reference_on_another_grid_is_refused(paper: rho.Scenario) -> None:
    tail = rho.plan_convex(paper).tail(5)
    with pytest.raises(ValueError, match="reference"):
        rho.plan_scp(paper, reference=tail)


class ScriptedIterations:
    """Iterations with given plans: constant accelerations [m/s²] of each vehicle.

    Args:
        scenario: the vehicles.
        script: for each iteration a number for each vehicle, or an error.
    """

    def __init__(
        self, scenario: rho.Scenario, script: Sequence[Sequence[float] | Exception]
    ) -> None:
        self.scenario, self.script = scenario, list(script)
        self.planned: list[list[int]] = []

    def __call__(
        self, plan: rho.Plan, vehicles: IntArray, tolerance: float
    ) -> tuple[rho.Plan, bool]:
        """Return the next plan."""
        self.planned.append(vehicles.tolist())
        after = self.script.pop(0)
        if isinstance(after, Exception):
            raise after
        return flown(self.scenario, after), False


class ScriptedSteps:
    """Steps of a restoration with given plans.

    Args:
        script: the plan of each step.
    """

    max_growth = SoftRows.max_growth

    def __init__(self, script: Iterable[rho.Plan]) -> None:
        self.script = iter(script)
        self.penalties: list[tuple[float, int]] = []

    def __call__(self, reference: rho.Plan, penalty: float, number: int) -> rho.Plan:
        """Return the next plan."""
        self.penalties.append((penalty, number))
        return next(self.script)


def iterated(
    improve: ScriptedIterations,
    start: rho.Plan,
    tolerance: float,
    *,
    together: bool = False,
    most: int = DEFAULTS.max_iterations,
) -> rho.Plan:
    """Return the last plan of scripted iterations, whose vehicles may all stop together."""
    subproblem = Subproblem(Problem.of(start.scenario))
    labels = np.zeros(len(start.accelerations), dtype=int) if together else None
    return sequential_convex(
        subproblem, start, tolerance, improve=improve, labels=labels, most=most
    )


def flown(scenario: rho.Scenario, each: Sequence[float]) -> rho.Plan:
    """Return vehicles with constant accelerations along x, found with one linearisation."""
    accelerations = np.zeros((len(each), scenario.grid.knots - 1, 3))
    accelerations[:, :, 0] = np.array(each)[:, None]
    return rho.Plan.from_accelerations(scenario, accelerations, rho.Statistics(linearisations=1))


@pytest.fixture
def two() -> rho.Scenario:
    """Return two vehicles with ten steps."""
    ends = np.array([[0.0, 0, 0], [0, 50, 0]])
    return fleet(ends, ends + 5.0, grid=rho.Grid(1.0, 11)).without_separation()


def test_vehicles_stop_independently_and_keep_their_better_plan(two: rho.Scenario) -> None:
    """The second rises at first and stops where it was; the first continues until it is level."""
    script = [[3.0, 5.0], [2.0, 1.0], [2.0, 1.0]]
    improve = ScriptedIterations(two, script)
    plan = iterated(improve, flown(two, [4.0, 4.0]), 1e-6)
    assert improve.planned == [[0, 1], [0], [0]]
    assert plan.statistics.converged
    assert plan.accelerations[0, 0, 0] == 2.0
    assert plan.statistics.linearisations == 1 + 3
    assert plan.statistics.tolerance == 1e-6


def test_an_increase_of_one_uncoupled_vehicle_is_not_adopted(
    two: rho.Scenario,
) -> None:
    plan = iterated(ScriptedIterations(two, [[3.0, 5.0]]), flown(two, [4.0, 4.0]), 1e-6, most=1)
    assert plan.accelerations[:, 0, 0].tolist() == [3.0, 4.0]
    assert not plan.statistics.converged


def test_coupled_vehicles_take_the_plan_that_costs_less_in_total(
    two: rho.Scenario,
) -> None:
    improve = ScriptedIterations(two, [[3.0, 4.5], [4.0, 4.0]])
    plan = iterated(improve, flown(two, [4.0, 4.0]), 1e-6, together=True)
    assert plan.accelerations[:, 0, 0].tolist() == [3.0, 4.5]  # 29.25 is less than 32
    assert improve.planned == [[0, 1], [0, 1]]
    assert plan.statistics.converged


def test_an_increasing_cost_is_rejected_and_counts_as_converged(two: rho.Scenario) -> None:
    for together in (True, False):
        start = flown(two, [4.0, 4.0])
        plan = iterated(ScriptedIterations(two, [[4.1, 4.1]]), start, 1e-6, together=together)
        np.testing.assert_array_equal(plan.accelerations, start.accelerations)
        assert plan.statistics.converged


@pytest.mark.parametrize(("tolerance", "count"), [(0.1, 2), (1e-3, 4)])
def test_the_tolerance_is_relative_to_the_whole_cost(
    two: rho.Scenario, tolerance: float, count: int
) -> None:
    """The cost decreases by 36 %, by 9.8 %, by 4 % and by nothing."""
    script = [[3.2, 3.2], [3.04, 3.04], [2.98, 2.98], [2.98, 2.98]]
    improve = ScriptedIterations(two, script)
    plan = iterated(improve, flown(two, [4.0, 4.0]), tolerance, together=True)
    assert len(improve.planned) == count
    assert plan.statistics.converged


@pytest.mark.parametrize("error", [rho.InfeasibleError({}), rho.SolverError("by rounding")])
def test_a_linearisation_that_fails_by_rounding_returns_the_plan_before_it(
    two: rho.Scenario, error: Exception
) -> None:
    plan = iterated(ScriptedIterations(two, [[3.0, 3.0], error]), flown(two, [4.0, 4.0]), 1e-6)
    assert plan.accelerations[:, 0, 0].tolist() == [3.0, 3.0]
    assert not plan.statistics.converged


class Creeping(Subproblem):
    """Linearisations around accelerations y that return 1 + 0.98 abs(y - 1) [m/s²].

    Args:
        start: first plan.
        refuses: whether references that are not the latest plan have no solution.
    """

    def __init__(self, start: rho.Plan, *, refuses: bool) -> None:
        super().__init__(Problem.of(start.scenario))
        self.last, self.refuses, self.refused = start, refuses, 0

    def solve_around(self, reference: rho.Plan, vehicles: IntArray | None = None) -> rho.Plan:
        """Return the plan of the next linearisation."""
        if self.refuses and reference is not self.last:
            self.refused += 1
            raise rho.InfeasibleError({})
        y = reference.accelerations[:, 0, 0]
        self.last = flown(reference.scenario, (1.0 + 0.98 * np.abs(y - 1.0)).tolist())
        return self.last


def test_references_are_ahead_of_plans_that_creep(two: rho.Scenario) -> None:
    """Around each latest plan, the cost would fall by less than the tolerance after 580 of them."""
    costs = list[float]()
    subproblem, start = Creeping(flown(two, [4.0, 4.0]), refuses=False), flown(two, [4.0, 4.0])
    plan = sequential_convex(
        subproblem, start, 1e-6, progress=lambda text: costs.append(float(text.split()[-2]))
    )
    assert plan.statistics.converged
    assert plan.statistics.linearisations < 150
    assert plan.accelerations[:, 0, 0] == pytest.approx(1.0, abs=1e-4)
    assert plan.cost == pytest.approx(min(costs), rel=1e-5)


def test_a_reference_ahead_without_a_solution_is_replaced_by_the_plan(two: rho.Scenario) -> None:
    start = flown(two, [4.0, 4.0])
    subproblem = Creeping(start, refuses=True)
    plan = sequential_convex(subproblem, start, 1e-6, most=60)
    taken = plan.statistics.linearisations - 1
    assert subproblem.refused > 0
    assert subproblem.refused + taken == 60
    assert plan.accelerations[:, 0, 0] == pytest.approx(1.0 + 3.0 * 0.98**taken)


def _colliding_and_separated() -> tuple[rho.Plan, rho.Plan]:
    """Return a motion of two vehicles that collide, and their plan; each was linearised once."""
    scenario, once = through_the_middle(2), rho.Statistics(linearisations=1)
    return independent(scenario).with_statistics(once), rho.plan(scenario).with_statistics(once)


def test_a_restoration_raises_penalties_until_the_pairs_are_separated() -> None:
    said: list[str] = []
    start, apart = _colliding_and_separated()
    subproblem = Subproblem(Problem.of(start.scenario), rho.decoupled)
    step = ScriptedSteps([start, apart, start])
    plan = restore_feasibility(subproblem, start, step=step, progress=said.append)
    first = step.penalties[0][0]
    assert step.penalties == [(first, 0), (3.0 * first, 1)]
    np.testing.assert_array_equal(plan.accelerations, apart.accelerations)
    assert plan.cost > start.cost
    assert plan.statistics.converged
    assert plan.statistics.linearisations == 3
    assert said == [
        f"linearised 2 times, cost {start.cost:.6g} m²/s⁴, "
        "worst violation 1 m, 2 vehicles violating",
        f"linearised 3 times, cost {apart.cost:.6g} m²/s⁴",
    ]
    step = ScriptedSteps([start, start, apart])
    with pytest.raises(rho.InfeasibleError) as caught:
        restore_feasibility(subproblem, start, step=step, most=2)
    assert caught.value.statistics.linearisations == 3


def test_steps_may_count_as_taken_before_the_first() -> None:
    start, apart = _colliding_and_separated()
    subproblem = Subproblem(Problem.of(start.scenario), rho.decoupled)
    step, later = ScriptedSteps([apart]), ScriptedSteps([start, apart])
    restore_feasibility(subproblem, start, step=step)
    restore_feasibility(subproblem, start, step=later, offset=2)
    first = step.penalties[0][0]
    assert later.penalties == [(9.0 * first, 2), (27.0 * first, 3)]


def test_penalties_of_a_restoration_triple_up_to_a_bound_until_patience_ends() -> None:
    start = independent(through_the_middle(2))
    step = ScriptedSteps(repeat(start))
    subproblem = Subproblem(Problem.of(start.scenario), rho.decoupled)
    with pytest.raises(rho.InfeasibleError, match="separation from v1 at 5 s") as caught:
        restore_feasibility(subproblem, start, step=step)
    assert set(caught.value.conflicts) == {"v0", "v1"}
    penalties = np.array([penalty for penalty, _ in step.penalties])
    numbers = [number for _, number in step.penalties]
    # both vehicles stay in violation
    assert numbers == list(range(1 + PATIENCE))
    np.testing.assert_allclose(penalties[1:11] / penalties[:10], 3.0)
    np.testing.assert_allclose(penalties[11:], 1e5 * penalties[0])
    # the plan's cost per vehicle, and that of 1 m sideways and back at constant 4 d / T²
    known = start.cost / 2 + 21 * (4.0 * 1.0 / 10.0**2) ** 2
    assert penalties[0] == pytest.approx(known)


def test_a_restoration_without_progress_is_given_up() -> None:
    """The sphere is too wide to be passed in time, on both of its sides."""
    scenario = rho.Scenario(
        "late",
        rho.Grid.lasting(5.0, step=0.25),
        [rho.Vehicle("a", rho.State([0, 0, 0]), rho.State([10, 0, 0]))],
        limits=rho.Limits(max_acceleration=1.65),
        obstacles=[rho.Sphere([5, 0.1, 0], 2.0)],
    )
    start, ends = rho.plan(scenario.without_obstacles()), DeadEnds(scenario)
    for _ in range(2):
        with pytest.raises(rho.InfeasibleError) as caught:
            restore_feasibility(
                Subproblem(Problem.of(scenario), rho.decoupled), start, dead_ends=ends
            )
        assert caught.value.statistics.linearisations < PATIENCE
    assert len(ends) == 1  # the second time the dead end is known
    assert not ends.is_near(start)


def test_vehicles_of_zero_cost_have_converged(two: rho.Scenario) -> None:
    improve = ScriptedIterations(two, [[0.0, 0.0]])
    assert iterated(improve, flown(two, [0.0, 0.0]), 1e-6).statistics.converged
    assert len(improve.planned) == 1
