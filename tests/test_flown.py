"""What plans, flights and simulations have in common."""

from __future__ import annotations

import dataclasses

import pytest

import drake_rho as rho
from tests.disturbed import disturbed

SIMULATION = rho.simulate(disturbed(1), replan_every=8)
Flown = rho.Plan | rho.Flight | rho.Simulation

FLOWN: list[Flown] = [SIMULATION.plan, SIMULATION.flight, SIMULATION]


@pytest.mark.parametrize("flown", FLOWN, ids=lambda flown: flown.kind)
def test_the_same_motion_was_planned(flown: Flown) -> None:
    assert flown.kind == type(flown).__name__.lower()
    assert flown.plan is SIMULATION.plan
    assert flown.scenario is SIMULATION.scenario
    assert (flown.cost, flown.statistics) == (SIMULATION.plan.cost, SIMULATION.plan.statistics)


@pytest.mark.parametrize("flown", FLOWN, ids=lambda flown: flown.kind)
def test_what_there_is_not_is_none_or_empty(flown: Flown) -> None:
    planned, simulated = flown.kind == "plan", flown.kind == "simulation"
    assert flown.flight is (None if planned else SIMULATION.flight)
    assert flown.windows == (() if planned else SIMULATION.flight.windows)
    assert flown.sightings == (() if planned else SIMULATION.flight.sightings)
    assert flown.simulation is (SIMULATION if simulated else None)


@pytest.mark.parametrize("flown", FLOWN, ids=lambda flown: flown.kind)
def test_the_common_names_are_no_fields(flown: Flown) -> None:
    fields = {field.name for field in dataclasses.fields(flown)}
    assert not fields & {"kind", "simulation", "sightings", "cost"}
    assert ("windows" in fields) == (flown.kind == "flight")
