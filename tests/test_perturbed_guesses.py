"""Perturbed references: fleets whose paths all meet, and vehicles whose path is too long."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.planners import plan as best
from drake_rho.planning.planners.bends import SPREADS, spread
from drake_rho.planning.scp.sequential_convex import restored
from drake_rho.planning.scp.subproblem import Subproblem
from tests.scenarios import independent


def crowd(n: int = 48, duration: float = 6.8, distance: float = 0.32) -> rho.Scenario:
    """Return vehicles that all meet in the centre of a circle, with little time to spare."""
    return rho.circle_swap(
        n,
        radius=0.22 * n,
        duration=duration,
        step=0.2,
        height=1.5,
        limits=rho.Limits(acceleration=rho.Box([-3] * 3, [3] * 3)),
        separation=rho.Separation(distance),
    )


def test_vehicles_that_meet_at_one_point_are_separated() -> None:
    scenario = crowd()
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    again = rho.plan(scenario)
    np.testing.assert_array_equal(plan.accelerations, again.accelerations)


def test_a_restoration_without_success_restarts_from_perturbed_guesses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = crowd(20, 9.0, 0.4)
    begun: list[rho.Plan] = []

    def in_vain(reference: rho.Plan, subproblem: Subproblem, *args: Any, **named: Any) -> rho.Plan:
        begun.append(reference)
        if len(begun) <= 2:
            raise InfeasibleError({"v0": ("separation from v1",)}, scenario=scenario)
        return restored(reference, subproblem, *args, **named)

    monkeypatch.setattr(best, "restored", in_vain)
    assert rho.verify(rho.plan(scenario)).ok
    start, *bent = begun
    assert len(bent) == 2
    for number, reference in enumerate(bent):
        wanted = spread(start, number).accelerations
        np.testing.assert_array_equal(reference.accelerations, wanted)


@pytest.mark.parametrize("number", range(SPREADS))
def test_a_perturbed_fleet_keeps_its_ends_and_separates_vehicles_midway(number: int) -> None:
    plan = independent(crowd(20, 9.0, 0.4))
    bent = spread(plan, number)
    aside = np.linalg.norm(bent.positions - plan.positions, axis=2)
    assert aside[:, [0, -1]].max() < 0.02 * aside.max()  # up to the order of the steps
    assert 0.4 < np.sort(aside.max(axis=1))[10] < 3.0

    def nearest(positions: np.ndarray) -> float:
        apart = np.linalg.norm(positions[:, None] - positions, axis=2)
        return float(np.median(np.sort(apart, axis=1)[:, 1]))

    middle = plan.positions.shape[1] // 2
    assert nearest(bent.positions[:, middle]) > 2.0 * nearest(plan.positions[:, middle])
