"""Programs moved from window to window, and in few variables, equal full ones built anew."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.planning.constraints.base import about, with_neighbours
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs import reduced as program
from drake_rho.planning.programs.reduced import programs_of, rows_of
from drake_rho.planning.programs.solve import solve
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.subproblem import plan_around
from tests.scenarios import box, random_scenario, scenarios, single
from tests.tolerances import MOTION

seeds = st.integers(0, 2**32 - 1)


def _fresh(scenario: rho.Scenario) -> rho.Scenario:
    """Return the same scenario created and checked anew, without cached values."""

    def state(old: rho.State) -> rho.State:
        return rho.State(old.position, old.velocity, old.acceleration)

    vehicles = [
        dataclasses.replace(old, start=state(old.start), goal=state(old.goal))
        for old in scenario.vehicles
    ]
    grid = rho.Grid(scenario.grid.step, scenario.grid.knots, scenario.grid.start)
    return dataclasses.replace(scenario, grid=grid, vehicles=tuple(vehicles))


@given(seed=seeds)
@settings(max_examples=13)
def test_a_later_window_is_planned_like_a_fresh_scenario(seed: int) -> None:
    """Windows reuse goals, bounds and states in arrays; a scenario created anew does not."""
    scenario = random_scenario(seed, between_knots=bool(seed % 2))
    try:
        flight = rho.plan_rho(scenario, replan_every=1 + seed % 6, fallback=None)
    except rho.InfeasibleError:
        return
    for window in flight.windows:
        if window.infeasible:
            continue
        fresh = _fresh(window.plan.scenario)
        assert fresh == window.plan.scenario
        around = (
            plan_around(Problem.of(fresh.without_obstacles()), None) if fresh.obstacles else None
        )
        plan = rho.plan_convex(fresh, reference=around)
        largest = max(1e-12, np.abs(plan.accelerations).max())
        np.testing.assert_allclose(
            window.plan.accelerations, plan.accelerations, atol=MOTION * largest
        )


@given(scenario=scenarios())
@settings(max_examples=13)
def test_the_reduced_form_has_the_same_solution(scenario: rho.Scenario) -> None:
    """The same rows in all accelerations, with states beside them, have the same solution."""
    problem = Problem.of(scenario)
    try:
        reference = rho.plan_convex(scenario.without_obstacles())
        solved = CuttingPlanes(problem)
        solved.keep_to(problem.linearized(reference))
    except rho.InfeasibleError:
        return
    rows = list(solved.working.rows.values())
    if not rows:
        return
    effort = MinimumEffort.of(scenario)
    steps = scenario.grid.knots - 1
    for form in ({"_FEW": 10_000}, {"_FEW": 0, "_SPARSE": 0}):
        with pytest.MonkeyPatch.context() as patched:
            for name, value in form.items():
                patched.setattr(program, name, value)
            batches = list(programs_of(effort.changes, about(effort.motion, rows)))
        assert all((batch.basis is None) == ("_SPARSE" in form) for batch in batches)
        for batch in batches:
            vehicles = batch.groups[:, 0]
            u = batch.accelerations(solve(batch.programs), steps)[:, 0]
            found = (
                effort.motion.accelerations[vehicles]
                + effort.changes.units[vehicles, None, None] * u
            )
            known = solved.motion.accelerations[vehicles]
            np.testing.assert_allclose(found, known, atol=MOTION * np.abs(known).max())


def test_multipliers_do_not_depend_on_the_form() -> None:
    limits = rho.Limits(
        position=rho.Box([-1, -1, -3], [10.2, 6, 1]), velocity=box(1.6), jerk=box(2)
    )
    problem = Problem.of(single(limits=limits, start=rho.State([0, 0, 0], [1.5, 0, 0])))
    found = []
    for few in (10_000, 0):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(program, "_FEW", few)
            patched.setattr(program, "_SPARSE", 0)
            solved = CuttingPlanes(problem)
            solved.keep_to(problem.linearized(None))
        effort, multipliers = solved.problem.effort, solved.working.multipliers(0)
        for rows, y in multipliers:
            matrix, needed, _ = rows_of(
                effort.changes, np.zeros(1, dtype=int), about(effort.motion, [rows])
            )
            u = solved.motion.accelerations[0] - effort.motion.accelerations[0]
            slack = matrix @ (u / effort.changes.units[0]).reshape(-1) - needed
            assert np.abs(slack * y).max() < 1e-6
        found.append({rows.constraint.name: float(y.sum()) for rows, y in multipliers})
    assert found[0].keys() == found[1].keys()
    for name, total in found[0].items():
        assert found[1][name] == pytest.approx(total, rel=1e-5)


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "jerk", "position"])
def test_a_limit_that_is_active_at_hundreds_of_knots_holds(kind: str) -> None:
    """With more rows than a small program has, the sparse form gives the same plan."""
    boxes = {"velocity": 1.5, "acceleration": 0.75, "jerk": 1.0, "position": 20.0}
    start = rho.State([0, 0, 0], acceleration=[0, 0, 0])
    bound: Any = {kind: box(boxes[kind])}
    limits = rho.Limits(**bound)
    if kind == "position":  # thrown at a wall
        limits = rho.Limits(position=rho.Box([-1, -1, -3], [10.2, 5, 1]))
        start = rho.State([0, 0, 0], [6, 1, 1])
    fine = single(limits=limits, start=start, grid=rho.Grid(8 / 800, 801), between_knots=True)
    coarse = dataclasses.replace(fine, grid=rho.Grid(8 / 200, 201))
    plan = rho.plan_convex(fine)
    assert rho.verify(plan).ok
    assert plan.statistics.rows > (10 if kind == "position" else 100)
    continuous = plan.cost * fine.grid.step  # the integral of the squared acceleration
    assert continuous == pytest.approx(rho.plan_convex(coarse).cost * coarse.grid.step, rel=0.02)


@pytest.mark.parametrize("reach", [0, 1, 2, 7, 2**60])
def test_neighbours_are_the_rows_within_reach(reach: int) -> None:
    rng = np.random.default_rng(reach % 1000)
    runs = np.repeat([0, 1, 4, 7], [11, 1, 5, 8])
    marked, k = rng.random(len(runs)) < 0.2, np.arange(len(runs))
    close = (np.abs(k[:, None] - k) <= reach) & (runs[:, None] == runs)
    expected = np.any(marked & close, axis=1)
    np.testing.assert_array_equal(with_neighbours(marked, runs, reach), expected)
