"""How far vehicles can come: who can be met in a window, and the least radius of communication."""

from __future__ import annotations

import numpy as np

from drake_rho.planning.onboard.shared_plan import SharedPlan
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_begun


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
    fastest = float(greatest_speeds(scenario).max())
    if scenario.separation is None or not np.isfinite(fastest):
        expected = "a limit on every vehicle's speed, beside a separation, with a radius"
        raise ScenarioError("limits.max_speed", None, expected)
    size = float(scenario.separation.shape.semi_axes.max())
    return fastest * (3.0 * plans + 2.0 * gap) + size + 2.0 * error


def greatest_speeds(scenario: Scenario) -> FloatArray:
    """Return the speeds that vehicles do not exceed [m/s], (N,); infinite without a limit."""
    fleet, speeds = scenario.fleet, np.full(len(scenario.vehicles), np.inf)
    if (box := fleet.sides("velocity")) is not None:
        speeds = np.linalg.norm(np.maximum(*np.abs(box)), axis=1)
    if "max_speed" in fleet.largest_norms:
        speeds = np.minimum(speeds, fleet.largest_norms["max_speed"])
    return np.asarray(speeds)


def may_be_met(plan: SharedPlan, begin: float, place: FloatArray, within: float) -> bool:
    """Return whether a plan comes within a distance of a place from a time on.

    Between two knots it is no further from the nearer one than the greatest speed allows.

    Args:
        plan: of another vehicle.
        begin: the time [s].
        place: shape (3,) [m].
        within: the distance [m].
    """
    first = int(np.clip(steps_begun(begin - plan.start, plan.step), 0, len(plan.times) - 1))
    away = float(np.linalg.norm(plan.knots[0][first:] - place, axis=1).min())
    return away <= within + plan.step / 2.0 * plan.speed
