"""Scenarios that were once too hard: no path was found, or solvers failed."""

from __future__ import annotations

from pathlib import Path

import pytest

import drake_rho as rho
from tests.scenarios import slow

CASES = sorted((Path(__file__).parent / "cases").glob("*.yaml"))
FAST = ("forward_only", "head_on_past_a_sphere")
"""Those that are solved in less than a second."""


@pytest.mark.parametrize(
    "path",
    [one for each in CASES for one in ([each] if each.stem in FAST else slow(each))],
    ids=lambda path: path.stem,
)
def test_a_case_that_one_linearisation_does_not_solve_has_a_plan(path: Path) -> None:
    scenario = rho.load_scenario(path)
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    assert caught.value.about_linearisation
    plan = rho.plan(scenario, options=rho.Options(max_iterations=5))
    assert rho.verify(plan).ok
