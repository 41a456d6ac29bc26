"""Exchange of goals between vehicles, as the command `assign` reports it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True)
class AssignedGoal:
    """Goal assigned to a vehicle."""

    vehicle: str
    """name of the vehicle"""
    goal_of: str
    """name of the vehicle that had this goal before"""
    goal_m: list[float]
    """position of the goal: x, y and z"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Assigned:
    """Goals assigned to the vehicles of a scenario."""

    scenario: str
    """name of the scenario"""
    effort: float
    """least cost with the goals exchanged, without other constraints"""
    effort_before: float
    """least cost with the original goals, without other constraints"""
    vehicles: list[AssignedGoal]
    """goal of each vehicle"""
    file: str | None
    """path of the saved scenario; None if it was not saved"""


def assigned(
    scenario: Scenario, given: Sequence[int], efforts: tuple[float, float], file: str | None
) -> Assigned:
    """Return the record of an assignment of goals.

    Args:
        scenario: the scenario with the original goals.
        given: for each vehicle, the index of the vehicle whose goal it receives.
        efforts: least costs before and after the exchange [m²/s⁴].
        file: path of the saved scenario; None if it was not saved.
    """
    before, after = efforts
    vehicles = [
        AssignedGoal(vehicle.name, other.name, other.goal.position.tolist())
        for vehicle, other in zip(
            scenario.vehicles, (scenario.vehicles[index] for index in given), strict=True
        )
    ]
    return Assigned(
        scenario=scenario.name,
        effort=after,
        effort_before=before,
        vehicles=vehicles,
        file=file,
    )
