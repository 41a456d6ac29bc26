"""Descriptions of results in one line."""

from __future__ import annotations

import numpy as np
import pytest

import drake_rho as rho


@pytest.fixture(scope="module")
def courier() -> rho.Scenario:
    return rho.load_scenario("courier")


def test_results_are_printed_in_one_line(courier: rho.Scenario) -> None:
    plan, flight = rho.plan(courier), rho.plan_rho(courier)
    results = {
        "<Plan of courier: 1 vehicle, 41 knots, cost ": plan,
        "<Flight of courier: 1 vehicle, 41 knots, 8 windows, cost ": flight,
        "<Window from knot 6: a new plan, cost ": flight.windows[1],
        "<Simulation of courier: 1 vehicle, 41 knots; point mass, ": rho.simulate(courier),
        "<Attack: courier keeps ": rho.attack(courier, plan),
        "<WorstCase: an error of 0.2413, winds from 0 s to 6 s>": rho.worst_case(
            courier, [0, 1, 0], 6.0
        ),
    }
    for begins, result in results.items():
        assert repr(result).startswith(begins)
        assert len(repr(result)) < 120
        assert str(result) == repr(result)


def test_a_window_names_the_plan_it_flies(courier: rho.Scenario) -> None:
    plan = rho.plan(courier)
    assert "rest of the previous plan" in repr(rho.Window(5, plan, plan, "none", kept=True))
    assert "a plan of minimum violation" in repr(rho.Window(5, plan, plan, "none"))
    assert np.isfinite(plan.cost)
