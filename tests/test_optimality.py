"""Certificates: valid bounds, tight where the plan is optimal, and silent elsewhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.optimize import minimize

import drake_rho as rho
from drake_rho.analysis.ascent import climbed
from drake_rho.analysis.dual import Dual
from drake_rho.analysis.lagrangian import Proposal
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.scenario.fields import FloatArray
from tests.scenarios import box, scenarios, single
from tests.tolerances import INDEX

BESIDE = rho.Sphere([5.0, 2.6, -1.0], 1.2)


def test_the_converged_plan_of_the_paper_is_globally_optimal(paper: rho.Scenario) -> None:
    proof = rho.certify(rho.plan_scp(paper))
    assert proof.is_globally_optimal
    assert abs(proof.gap) < INDEX
    assert all(abs(each.gap) < INDEX for each in proof.vehicles)
    assert proof.least_eigenvalue > 0.3
    for each in proof.vehicles:
        assert each.stationarity < 1e-4
        assert each.complementarity < 1e-6
    assert "globally optimal" in str(proof)


def test_gaps_of_the_papers_examples_are_known(paper: rho.Scenario) -> None:
    best = rho.plan_scp(paper).cost
    for flown in (rho.plan_convex(paper), rho.plan_rho(paper)):
        proof = rho.certify(flown)
        assert not proof.is_globally_optimal
        assert proof.lower_bound == pytest.approx(best, rel=INDEX)
        assert proof.gap == pytest.approx(1 - best / flown.cost, abs=1e-6)


def test_the_plan_for_every_instant_is_certified_as_optimal(paper: rho.Scenario) -> None:
    careful = dataclasses.replace(paper, between_knots=True)
    assert rho.certify(rho.plan_scp(careful)).is_globally_optimal


def test_without_obstacles_every_plan_is_certified_as_optimal() -> None:
    for limits in (
        rho.Limits(),
        rho.Limits(acceleration=box(0.8)),
        rho.Limits(velocity=box(1.6)),
        rho.Limits(velocity=box(1.8), acceleration=box(1.2)),
    ):
        plan = rho.plan_convex(single(limits=limits))
        assert rho.certify(plan).is_globally_optimal
        worse = rho.Plan.from_accelerations(plan.scenario, 1.01 * plan.accelerations)
        proof = rho.certify(worse)
        assert proof.lower_bound == pytest.approx(plan.cost, rel=INDEX)
        assert proof.gap == pytest.approx(1 - 1 / 1.01**2, abs=1e-6)


def _on_the_other_side() -> tuple[rho.Scenario, rho.Plan, rho.Plan]:
    """Return a scenario with two paths past a sphere, its best plan, and a worse local optimum."""
    scenario = single(obstacles=(BESIDE,))
    other = rho.Sphere([5.0, 1.2, -1.0], 2.4)  # extends beyond the far side of the first
    beyond = rho.plan_scp(single(obstacles=(other,)))
    worse = rho.plan_scp(scenario, reference=dataclasses.replace(beyond, scenario=scenario))
    return scenario, rho.plan_scp(scenario), worse


def test_a_worse_local_optimum_is_not_certified() -> None:
    _, best, worse = _on_the_other_side()
    assert rho.verify(worse).ok
    assert worse.statistics.converged
    assert rho.scp_step(worse).cost == pytest.approx(worse.cost, rel=INDEX)  # it is a local optimum
    assert worse.cost > 1.05 * best.cost
    proof = rho.certify(worse)
    assert not proof.is_globally_optimal
    assert proof.lower_bound <= best.cost * (1 + INDEX)
    assert rho.certify(best).lower_bound <= best.cost * (1 + INDEX)


@pytest.mark.slow
@given(scenario=scenarios())
@settings(max_examples=2)
def test_no_feasible_plan_of_random_restarts_is_below_the_bound(scenario: rho.Scenario) -> None:
    try:
        plan = rho.plan_scp(scenario)
    except rho.InfeasibleError:
        return
    bound = rho.certify(plan).lower_bound
    assert bound <= plan.cost * (1 + INDEX)
    rng = np.random.default_rng(0)
    for _ in range(10):
        noise = rng.normal(size=plan.accelerations.shape) * np.abs(plan.accelerations).max()
        start = rho.Plan.from_accelerations(scenario, plan.accelerations + noise)
        try:
            other = rho.plan_scp(scenario, reference=start)
        except (rho.InfeasibleError, rho.SolverError):  # too random a start to iterate from
            continue
        if rho.verify(other).ok:
            assert other.cost * (1 + INDEX) >= bound


def test_any_multipliers_give_a_bound_unless_they_are_too_large() -> None:
    scenario, best, _ = _on_the_other_side()
    solved = CuttingPlanes(Problem.of(scenario))
    solved.keep_to(Problem.of(scenario).linearized(best))
    proposal = Proposal.of(solved, np.array([0]))
    lagrangian = proposal.lagrangian
    index = best.cost / lagrangian.changes.unit**2
    rng = np.random.default_rng(1)
    for _ in range(200):
        weights = proposal.weights * rng.uniform(0, 1.5, proposal.weights.shape)
        multipliers = proposal.multipliers * rng.uniform(0, 2, proposal.multipliers.shape)
        assert lagrangian.minimum(weights, multipliers).value <= index * (1 + INDEX)
    huge = lagrangian.minimum(1e6 * proposal.weights, proposal.multipliers)
    assert huge.value == -np.inf
    assert huge.curvature < 0


def _proposed() -> Proposal:
    scenario, best, _ = _on_the_other_side()
    solved = CuttingPlanes(Problem.of(scenario))
    solved.keep_to(Problem.of(scenario).linearized(best))
    return Proposal.of(solved, np.array([0]))


def test_the_closed_form_is_the_minimum_with_its_gradient() -> None:
    proposal = _proposed()
    lagrangian = proposal.lagrangian
    weights, multipliers = 0.7 * proposal.weights, proposal.multipliers
    rows, _ = lagrangian.slopes(lagrangian.minimum(weights, multipliers).at)
    for s in range(len(weights)):
        step = 1e-3 * weights.max()
        if weights[s] < step:
            continue
        more = weights + step * (np.arange(len(weights)) == s)
        less = weights - step * (np.arange(len(weights)) == s)
        slope = (
            lagrangian.minimum(more, multipliers).value
            - lagrangian.minimum(less, multipliers).value
        ) / (2 * step)
        assert slope == pytest.approx(rows[s], rel=1e-3, abs=1e-6)


def test_the_dual_function_has_the_derivatives_that_it_tells() -> None:
    proposal = _proposed()
    lagrangian, dual = proposal.lagrangian, Dual(proposal.lagrangian)
    x = dual.inside(proposal.weights, proposal.multipliers)
    here = dual.around(x)
    assert here is not None
    exact = lagrangian.minimum(*dual.given(x))
    assert here.value == pytest.approx(exact.value, rel=1e-9)
    # the determinant of half the Hessian, by its matrix
    half = dual.given(x)[0] / lagrangian.curved.radii / 2.0
    rows, count = lagrangian.curved.responses, len(half)
    logarithm = sum(
        np.linalg.slogdet(np.eye(rows.shape[1]) - (rows.T * half * scales**2) @ rows)[1]
        for scales in lagrangian.curved.scales.T
    )
    assert here.barrier == pytest.approx(np.log(x).sum() + logarithm, rel=1e-9)
    assert count > 0
    step = 1e-5 * float(x.min())
    for n in range(len(x)):
        more, less = (dual.around(x + sign * step * np.eye(len(x))[n]) for sign in (1, -1))
        assert more is not None
        assert less is not None
        for name in ("value", "barrier"):
            slopes = {"value": here.slopes, "barrier": here.barrier_slopes}[name]
            falls = {"value": here.falls, "barrier": here.barrier_falls}[name]
            own = "slopes" if name == "value" else "barrier_slopes"
            slope = (getattr(more, name) - getattr(less, name)) / (2 * step)
            assert slope == pytest.approx(slopes[n], rel=1e-4, abs=1e-4 * abs(slopes).max())
            fall = (getattr(less, own) - getattr(more, own)) / (2 * step)
            np.testing.assert_allclose(fall, falls[n], rtol=1e-4, atol=1e-5 * abs(falls).max())
    assert dual.around(1e6 * x) is None  # not convex
    assert dual.around(-x) is None


def test_the_ascent_reaches_what_a_general_method_reaches_in_the_end() -> None:
    proposal = _proposed()
    lagrangian = proposal.lagrangian
    climb = climbed(lagrangian, proposal.weights, proposal.multipliers)
    found = lagrangian.minimum(climb.weights, climb.multipliers).value
    rng, sizes = np.random.default_rng(3), (len(proposal.weights), len(proposal.multipliers))

    def depth(logarithms: FloatArray) -> float:
        given = np.split(np.exp(logarithms), sizes[:1])
        return min(-lagrangian.minimum(*given).value, 1e9)

    given = np.maximum(np.concatenate([0.5 * proposal.weights, proposal.multipliers]), 1e-3)
    start, best = np.log(given), -np.inf
    for _ in range(3):
        tried = start + 0.1 * rng.normal(size=len(start))
        best = max(best, -minimize(depth, tried, method="L-BFGS-B").fun)
    assert found >= best * (1 - 1e-7)
    assert found == pytest.approx(best, rel=2e-3)
    beyond = np.concatenate(lagrangian.slopes(climb.at))
    assert beyond[len(climb.weights) :].max(initial=0.0) < 1e-3  # convex constraints hold
    assert lagrangian.cost(climb.at) <= found  # the mean of motions costs no more than they do


@pytest.mark.parametrize("knots", [2, 3])
def test_the_only_plan_that_reaches_the_goal_is_optimal(knots: int) -> None:
    moving = rho.State([0, 0, 0], [1, 0, 0])
    goal = rho.State([knots - 1.0, 0, 0], [1, 0, 0]) if knots == 2 else rho.State([1, 2, 3])
    plan = rho.plan_convex(single(grid=rho.Grid(1.0, knots), start=moving, goal=goal))
    assert rho.certify(plan).is_globally_optimal


def test_a_plan_that_violates_its_constraints_is_not_certified() -> None:
    scenario = single(obstacles=(rho.Sphere([5.0, 2.1, -1.0], 2.0),))
    through = rho.plan_convex(scenario.without_obstacles()).accelerations
    for accelerations in (through, np.zeros_like(through)):
        proof = rho.certify(rho.Plan.from_accelerations(scenario, accelerations))
        assert not proof.holds
        assert not proof.is_globally_optimal
        assert proof.gap < 0
        assert "violates its constraints" in str(proof)
    with pytest.raises(ValueError, match="accelerations: got nan"):
        rho.certify(rho.Plan.from_accelerations(scenario, np.full_like(through, np.nan)))


def test_the_separation_of_a_large_fleet_is_named_as_left_out() -> None:
    def fleet(size: int) -> rho.Scenario:
        vehicles = [
            rho.Vehicle(f"v{y}", rho.State([0, y, 0]), rho.State([9, y, 0])) for y in range(size)
        ]
        grid = rho.Grid.lasting(6.0, step=0.5)
        return rho.Scenario("rows", grid, vehicles, separation=rho.Separation(0.5))

    for size, left_out in ((25, ()), (26, ("the separation",))):
        certificate = rho.certify(rho.plan(fleet(size)))
        assert certificate.left_out == left_out
        assert certificate.is_globally_optimal
