"""Fleets of hundreds: planned, verified, and invariant."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import box, fleet, mapped
from tests.tolerances import INDEX


@pytest.fixture(scope="module")
def many() -> rho.Scenario:
    """Return 520 vehicles two metres apart that rise by 5 m; neighbours in five places swap."""
    rng = np.random.default_rng(0)
    starts = 2.0 * np.stack(np.meshgrid(np.arange(26), np.arange(20), [0.0]), -1).reshape(-1, 3)
    goals = starts + np.array([0.0, 0.0, 5.0]) + rng.uniform(-0.3, 0.3, starts.shape)
    for one in (10, 110, 212, 314, 418):
        goals[[one, one + 1]] = goals[[one + 1, one]]
    return fleet(starts, goals, grid=rho.Grid(1.0, 9), limits=rho.Limits(acceleration=box(2.0)))


@pytest.fixture(scope="module")
def plan(many: rho.Scenario) -> rho.Plan:
    """Return the best plan of all of them."""
    return rho.plan(many)


def test_more_than_five_hundred_vehicles_are_planned_and_separated(
    many: rho.Scenario, plan: rho.Plan
) -> None:
    assert rho.verify(plan).ok
    independent = rho.plan(many.without_separation())
    assert not rho.verify(dataclasses.replace(independent, scenario=many)).ok
    assert independent.cost < plan.cost < 1.05 * independent.cost
    moved = np.any(np.abs(plan.accelerations - independent.accelerations) > 1e-9, axis=(1, 2))
    assert moved.sum() == 10  # those that swap places, and no other


def test_relabelling_more_than_five_hundred_vehicles_permutes_the_plan(
    many: rho.Scenario, plan: rho.Plan
) -> None:
    order = np.random.default_rng(1).permutation(len(many.vehicles))
    vehicles = tuple(many.vehicles[index] for index in order)
    other = rho.plan(dataclasses.replace(many, vehicles=vehicles))
    assert other.cost == pytest.approx(plan.cost, rel=10 * INDEX)


def test_shifting_more_than_five_hundred_vehicles_costs_the_same(
    many: rho.Scenario, plan: rho.Plan
) -> None:
    other = rho.plan(mapped(many, np.eye(3), np.array([7.0, -3.0, 2.0])))
    # decoupled pairs keep a little more distance than required; how much depends on rounding
    assert other.cost == pytest.approx(plan.cost, rel=1e-4)
