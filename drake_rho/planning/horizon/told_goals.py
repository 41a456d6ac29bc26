"""Goals as told, as places that windows can be drawn towards, and whether vehicles are there."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.horizon.places_of_rest import largest_radius
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.parts import State
from drake_rho.scenario.records import Scenario

_CLEARLY = 1.0 + 1e-3
"""Factor on the margin by which vehicles aim at the inside of a goal that is a set."""


def places_of_goals(scenario: Scenario, flight: Scenario, remaining: Plan | None) -> FloatArray:
    """Return the positions that vehicles are to reach [m], (N, 3).

    Those without a goal stop: where the plan in force arrives or ends or, before there is one,
    where they do with least effort. Arguments are those of `RollingHorizon._orders`.
    """
    fleet, goals, margin = scenario.fleet, flight.fleet.goal_positions, largest_radius(scenario)
    if margin > 0.0 and not flight.fleet.given_positions.all():
        goals = np.array(
            [
                _inside(each.goal, own, margin)
                for each, own in zip(flight.vehicles, goals, strict=True)
            ]
        )
    anywhere = [each.goal.position is None for each in flight.vehicles]
    if not any(anywhere):
        return goals
    stops = fleet.start_positions + scenario.grid.duration / 2.0 * fleet.start_velocities
    if remaining is not None:
        stops = remaining.positions[:, -1].copy()
        for i, vehicle in enumerate(remaining.scenario.vehicles):
            stops[i] = vehicle.waypoints[-1].position if vehicle.waypoints else stops[i]
    return np.where(np.array(anywhere)[:, None], stops, goals)


def is_at(goal: State | Goal, place: FloatArray, margin: float, tolerance: float) -> bool:
    """Return whether a place (3,) is at a goal or, with a margin [m], in its set."""
    if isinstance(goal.position, np.ndarray):
        return float(np.linalg.norm(place - goal.position)) <= tolerance
    beyond = None if goal.position is None else goal.position.signed_distance(place)
    return beyond is None or float(beyond) <= tolerance - margin


def _inside(goal: State | Goal, nominal: FloatArray, margin: float) -> FloatArray:
    """Return the nominal place (3,) of a goal, inside by a margin [m] if it is a set."""
    if goal.position is None or isinstance(goal.position, np.ndarray):
        return nominal
    inner: FloatArray = nominal - _CLEARLY * margin * goal.position.outward(nominal)
    return inner if float(goal.position.signed_distance(inner)) <= -margin else nominal
