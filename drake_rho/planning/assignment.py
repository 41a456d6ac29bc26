"""Which vehicle goes where, when the goals may be exchanged: the least total effort."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.planning.minimum_effort import TerminalState
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes import TOLERANCE


def assign_goals(scenario: Scenario) -> Scenario:
    """The scenario with its goals exchanged so that the total cost (13) is least.

    The cost of a vehicle and a goal, position and velocity, is that of the motion of least effort
    between the two, in closed form. Obstacles, limits, waypoints and separation are not looked at:
    with any of them another exchange may have the better plan. Names, limits, radii and waypoints
    stay with the vehicles. None is given a goal that is too close to an obstacle for its radius.

    Raises:
        ScenarioError: a vehicle's own position or velocity box does not hold the goal it is given,
            or there is a single step and it does not take the vehicles to all the goals.
    """
    from scipy.optimize import linear_sum_assignment  # slow to load, so only where needed

    try:
        chosen = linear_sum_assignment(_efforts(scenario))[1]
    except ValueError:  # too many of the pairs are infinite
        expected = "more knots: a single step does not take the vehicles to the goals"
        raise ScenarioError("grid.knots", scenario.grid.knots, expected) from None
    goals = [vehicle.goal for vehicle in scenario.vehicles]
    vehicles = tuple(
        dataclasses.replace(vehicle, goal=goals[index])
        for vehicle, index in zip(scenario.vehicles, chosen, strict=True)
    )
    return dataclasses.replace(scenario, vehicles=vehicles)


def _efforts(scenario: Scenario) -> FloatArray:
    """Least cost from every start (rows) to every goal [m²/s⁴], shape (N, N); infinite for none.

    The accelerations of least norm that meet (12) are combinations of orthonormal rows, so the cost
    is the sum of squares of their coefficients. These are linear in goal less start: a point for
    each start and each goal, the cost their squared distance.
    """
    from scipy.spatial.distance import cdist  # slow to load, so only where needed

    fleet, terminal, T = scenario.fleet, TerminalState(scenario.grid), scenario.grid.duration
    starts, start_rests = terminal.values(
        fleet.start_velocities, fleet.start_positions + T * fleet.start_velocities
    )
    goals, goal_rests = terminal.values(fleet.goal_velocities, fleet.goal_positions)
    count = len(starts)
    efforts: FloatArray = cdist(
        starts.reshape(count, -1), goals.reshape(count, -1), metric="sqeuclidean"
    )
    missed = cdist(start_rests, goal_rests, metric="chebyshev")
    efforts[missed > TOLERANCE * fleet.lengths.max()] = np.inf
    efforts[fleet.radii[:, None] > _clearances(scenario)] = np.inf
    return efforts


def _clearances(scenario: Scenario) -> FloatArray:
    """What is free around every goal at the end [m], shape (N,)."""
    least, goals = np.full(len(scenario.vehicles), np.inf), scenario.fleet.goal_positions
    for obstacle in scenario.bodies:
        x = goals - obstacle.centers(np.array([scenario.grid.end]))
        free = obstacle.shape.signed_distance(x) - obstacle.deviation + obstacle.shape.tolerance
        least = np.minimum(least, free)
    return least
