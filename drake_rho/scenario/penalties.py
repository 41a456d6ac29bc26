"""Penalties of soft limits, and where they have no meaning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.obstacles import AnyObstacle
from drake_rho.scenario.parts import Vehicle
from drake_rho.scenario.requirements import KeepIn

NO_COST = "none where the final time is found: there is no cost to weigh it against"
"""Expectation of a penalty where the least time is sought."""

NO_TIMES = "none beside waypoints without a time: the search for times passes every waypoint"
"""Expectation of a penalty where times of waypoints are sought."""

NO_BOUND = "none with bounded_cost, which bounds the cost of accelerations alone"
"""Expectation of a penalty where the cost of windows is bounded."""


def penalties_of(
    vehicles: Sequence[Vehicle],
    obstacles: Sequence[AnyObstacle],
    requirements: Sequence[KeepIn],
) -> dict[str, float]:
    """Return the penalties of a scenario's waypoints, obstacles and requirements, by field."""
    parts = {
        **{
            f"vehicles[{i}].waypoints[{k}]": each
            for i, vehicle in enumerate(vehicles)
            for k, each in enumerate(vehicle.waypoints)
        },
        **{f"obstacles[{i}]": each for i, each in enumerate(obstacles)},
        **{f"requirements[{i}]": each for i, each in enumerate(requirements)},
    }
    found = ((f"{field}.penalty", getattr(each, "penalty", None)) for field, each in parts.items())
    return {field: penalty for field, penalty in found if penalty is not None}


def check_no_penalties(penalties: Mapping[str, float], expected: str) -> None:
    """Check that no limit is soft.

    Args:
        penalties: the penalties of a scenario, by field.
        expected: text of what was expected, for the error.

    Raises:
        ScenarioError: there is a penalty; the error names its field.
    """
    for field, penalty in penalties.items():
        raise ScenarioError(field, penalty, expected)
