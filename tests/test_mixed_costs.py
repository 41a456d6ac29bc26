"""Random scenes that mix costs, goals, gates and soft limits with every other requirement."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import drake_rho as rho
from tests.judged import violations
from tests.mixed_costs import quiet
from tests.scenarios import slow

PLANNERS: dict[str, Callable[[rho.Scenario], rho.Plan | rho.Flight]] = {
    "plan": rho.plan,
    "plan_rho": lambda scenario: rho.plan_rho(scenario, replan_every=4),
}


@pytest.mark.filterwarnings("ignore::drake_rho.DrakeRhoWarning")
@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize(
    "seed", [*range(8), 181, *(one for each in range(8, 40) for one in slow(each))]
)
def test_plans_hold_by_dense_samples(planner: str, seed: int) -> None:
    scene = quiet(seed)
    try:
        found = PLANNERS[planner](scene.scenario)
    except rho.ScenarioError as error:
        if "penalty" not in error.field:  # which is refused beside waypoints without a time
            raise
        return
    except (rho.InfeasibleError, rho.SolverError):
        if scene.is_certain and planner == "plan":  # windows may find that they cannot go on
            raise
        return
    assert rho.verify(found).ok
    assert violations(found.plan) == []


@pytest.mark.filterwarnings("ignore::drake_rho.DrakeRhoWarning")
@pytest.mark.parametrize("seed", [*range(3), *(one for each in range(3, 20) for one in slow(each))])
def test_no_known_motion_costs_less_than_the_bound(seed: int) -> None:
    """The motion that a scene is drawn around is a plan of it, which the bound is for as well."""
    scene = quiet(seed)
    scenario = scene.known.scenario
    if scenario.smoothing is not None:
        return
    try:
        certificate = rho.certify(scene.known)
    except (rho.InfeasibleError, rho.SolverError):
        return
    priced = scene.known.cost + rho.verify(scene.known).price
    assert certificate.lower_bound <= priced * (1.0 + 1e-6)
