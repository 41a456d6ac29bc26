"""Scenarios that were once too hard: no path was found, or solvers failed."""

from __future__ import annotations

from pathlib import Path

import pytest

import drake_rho as rho

CASES = sorted((Path(__file__).parent / "cases").glob("*.yaml"))


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_a_case_that_one_linearisation_does_not_solve_has_a_plan(path: Path) -> None:
    scenario = rho.load_scenario(path)
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    assert caught.value.about_linearisation
    plan = rho.plan(scenario, options=rho.Options(max_iterations=5))
    assert rho.verify(plan).ok
