"""Least radius of communication: vehicles further apart cannot come into conflict."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Scenario


def least_radius(scenario: Scenario, plans: float, gap: float, error: float) -> float:
    """Return the least radius of communication [m].

    A plan stays within v T of where its vehicle was when it was announced. Of two vehicles that did
    not hear each other, one has not moved further than that since, and its plan leads at most that
    far again; the other's plan leads that far once. Both moved during the gap as well.

    Args:
        scenario: of all vehicles.
        plans: T, longest time from the announcement of a plan to its end [s].
        gap: longest time between two messages heard from a vehicle within the radius [s].
        error: largest distance of a vehicle from its plan [m].

    Raises:
        ScenarioError: the scenario has no separation, or a vehicle no limit on its speed.
    """
    fleet, speeds = scenario.fleet, np.full(len(scenario.vehicles), np.inf)
    if (box := fleet.bounds("velocity")) is not None:
        speeds = np.linalg.norm(np.maximum(np.abs(box.lower), np.abs(box.upper)), axis=1)
    if "max_speed" in fleet.norms:
        speeds = np.minimum(speeds, fleet.norms["max_speed"].limits)
    fastest = float(speeds.max())
    if scenario.separation is None or not np.isfinite(fastest):
        expected = "a limit on every vehicle's speed, beside a separation, with a radius"
        raise ScenarioError("limits.max_speed", None, expected)
    size = float(scenario.separation.shape.semi_axes.max())
    return fastest * (3.0 * plans + 2.0 * gap) + size + 2.0 * error
