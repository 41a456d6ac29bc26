"""The plan in force saves programs of the next window, and changes nothing else."""

from __future__ import annotations

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.call.plan_in_force import in_force


@pytest.fixture(scope="module")
def alone() -> rho.Plan:
    """Return the plan of a window in which a sphere is touched between two knots."""
    sphere = rho.Obstacle(rho.Sphere([6.72, 0.3, 0.93], 0.5), velocity=[-0.6, 0.0, 0.1])
    start = rho.State([2.04, 0.27, 0.45], [2.66, 0.0, -0.41])
    scenario = rho.Scenario(
        "window",
        rho.Grid.lasting(2.7, step=0.05),
        [rho.Vehicle("v0", start, rho.State([8.0, 0.0, 1.0]), radius=0.2)],
        obstacles=[sphere],
        between_knots=True,
    )
    return rho.plan_convex(scenario)


def test_instants_at_which_the_plan_in_force_touches_save_programs(alone: rho.Plan) -> None:
    with in_force(alone):
        again = rho.plan_convex(alone.scenario)
    assert 2 * again.statistics.programs <= alone.statistics.programs
    assert again.cost == pytest.approx(alone.cost, rel=1e-8)
    assert rho.verify(again).ok


def test_a_plan_in_force_on_another_grid_changes_nothing(alone: rho.Plan) -> None:
    with in_force(alone.tail(1)):
        again = rho.plan_convex(alone.scenario)
    assert np.array_equal(again.accelerations, alone.accelerations)
