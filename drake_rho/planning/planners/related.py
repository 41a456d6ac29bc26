"""Related scenarios: a plan of one is a reference, or even a plan, of the other.

From rest to rest among obstacles at rest, a motion can be flown more slowly, or the vehicle can
wait at its goal. A plan for one duration therefore gives plans for all longer ones. A plan stays
valid with fewer obstacles, looser limits or fewer vehicles.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Scenario

_SAME = 1e-9
"""Relative difference below which two time steps, or two positions, count as equal."""


def can_be_slower(scenario: Scenario) -> bool:
    """Return whether a plan for one duration can be stretched in time to any longer duration.

    This holds from rest to rest if every box of velocity, acceleration and jerk contains zero: a
    larger step stretches the motion in time, which leaves its path unchanged and shrinks its
    derivatives towards zero. Limits on norms never prevent it: they are convex sets that contain
    rest and hovering, and therefore all values between these and a value inside. Waypoints, and
    obstacles that move, grow or are active for a part of the flight prevent it, since their times
    are fixed. So does a disturbance, since errors grow with the duration, and a requirement, unless
    it is always active for positions at rest.
    """
    for each in scenario.requirements:
        whenever = each.active is None and each.between is None
        if each.of != "position" or not whenever or each.track is not None:
            return False
    bodies, grid = scenario.bodies_in_flight, scenario.grid
    steady = all(not body.changes and body.is_always_active(grid) for body in bodies)
    if scenario.disturbance is not None or not steady:
        return False
    for vehicle in scenario.vehicles:
        limits = scenario.limits_of(vehicle)
        if vehicle.waypoints or not (vehicle.start.is_at_rest and vehicle.goal.is_at_rest):
            return False
        for box in (limits.velocity, limits.acceleration, limits.jerk):
            if box is not None and (np.any(box.lower > 0.0) or np.any(box.upper < 0.0)):
                return False
    return True


def changes_with_time(scenario: Scenario) -> bool:
    """Return whether any constraint on positions changes with time."""
    steady = (each.is_steady for each in scenario.bodies)
    whenever = (each.active is None and each.track is None for each in scenario.required)
    return not all(steady) or not all(whenever)


def is_steady(scenario: Scenario) -> bool:
    """Return whether no constraint depends on time, and motions begin and end at rest."""
    return (
        not changes_with_time(scenario)
        and scenario.disturbance is None
        and scenario.fleet.are_at_rest
    )


def of_each_alone(scenario: Scenario) -> Scenario:
    """Return the relaxed scenario with the constraints of single vehicles only, at any time.

    These are limits, and requirements with sets that do not change with time. Every plan satisfies
    them, but a motion that satisfies them need not be a plan.
    """
    own = (each for each in scenario.requirements if each.active is None and each.between is None)
    return dataclasses.replace(
        scenario,
        obstacles=(),
        separation=None,
        disturbance=None,
        requirements=tuple(each for each in own if each.relative_to is None),
        smoothing=None,
    )


def rescaled(scenario: Scenario, factor: float) -> Scenario:
    """Return the scenario with `factor` times its duration, the same knots and the same start time.

    Obstacles keep their motion on the clock.
    """
    grid = Grid(scenario.grid.step * factor, scenario.grid.knots, scenario.grid.start)
    return scenario.ending_with(grid)


def time_scaled_plan(plan: Plan, scenario: Scenario) -> Plan:
    """Return a plan's motion, scaled in time to a scenario with the same vehicles and knots."""
    slower = scenario.grid.step / plan.scenario.grid.step
    velocities, accelerations = plan.velocities / slower, plan.accelerations / slower**2
    return Plan(scenario, plan.positions, velocities, accelerations)


def fitted(plan: Plan, scenario: Scenario) -> Plan:
    """Return the motion of a plan, fitted to the vehicles and the duration of a scenario.

    If the plan has more vehicles than the scenario, those of the same names are selected. If the
    scenario lasts longer, a motion from rest to rest is scaled in time on the same number of knots,
    or held at its end on additional knots of the same step. Any other plan is returned unchanged.
    """
    names = [vehicle.name for vehicle in plan.scenario.vehicles]
    required = [vehicle.name for vehicle in scenario.vehicles]
    if len(required) < len(names) and set(required) <= set(names):
        plan = plan.only(np.array([names.index(name) for name in required]))
    grid, own = scenario.grid, plan.scenario.grid
    if len(required) != len(plan.positions) or not _is_from_rest(plan, scenario):
        return plan
    slower, more = grid.step / own.step, grid.knots - own.knots
    if more == 0 and slower > 1.0 + _SAME:
        return time_scaled_plan(plan, scenario)
    if more > 0 and abs(slower - 1.0) <= _SAME:
        rest = np.zeros((len(required), more, 3))
        return Plan(
            scenario,
            np.concatenate([plan.positions, rest + plan.positions[:, -1:]], axis=1),
            np.concatenate([plan.velocities, rest], axis=1),
            np.concatenate([plan.accelerations, rest], axis=1),
        )
    return plan


def _is_from_rest(plan: Plan, scenario: Scenario) -> bool:
    """Return whether a plan begins at a scenario's starts, at rest, and ends at rest."""
    away: FloatArray = plan.positions[:, 0] - scenario.fleet.start_positions
    lengths, speeds = scenario.fleet.lengths, np.abs(plan.velocities[:, [0, -1]])
    there = np.all(np.abs(away) <= _SAME * lengths[:, None])
    return bool(there and np.all(speeds <= 1e-6 * lengths[:, None, None] / scenario.grid.duration))
