"""Sequential convex programming: feasible at every iterate, and never dearer."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from pydrake.solvers import SolverInterface

import drake_rho as rho
from tests.scenarios import scenarios
from tests.tolerances import INDEX


def _iterate(plan: rho.Plan, steps: int, solver: SolverInterface | None = None) -> list[rho.Plan]:
    plans = [plan]
    for _ in range(steps):
        plans.append(rho.scp_step(plans[-1], solver=solver))
    return plans


def test_every_iterate_is_feasible_and_the_cost_does_not_rise(
    paper: rho.Scenario, solver: SolverInterface
) -> None:
    plans = _iterate(rho.plan_convex(paper, solver=solver), 12, solver)
    assert all(rho.verify(plan).ok for plan in plans)
    costs = np.array([plan.cost for plan in plans])
    assert np.all(np.diff(costs) <= 1e-9 * costs[:-1])
    assert costs[-1] < 0.81 * costs[0]


@given(scenario=scenarios())
@settings(max_examples=40)
def test_the_same_on_random_scenarios(scenario: rho.Scenario) -> None:
    assume(scenario.obstacles)
    try:
        plans = _iterate(rho.plan_convex(scenario), 6)
    except rho.InfeasibleError:
        assume(False)
    assert all(rho.verify(plan).ok for plan in plans)
    for before, after in pairwise(plans):
        # the rows are kept to a tenth of the verifier's slack, so the cost to as much
        assert after.cost <= before.cost * (1 + INDEX)


def test_a_converged_plan_is_its_own_linearisations_best(paper: rho.Scenario) -> None:
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
