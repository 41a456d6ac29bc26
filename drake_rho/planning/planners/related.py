"""Related scenarios: a plan of one is a reference for another, or a plan of it.

From rest to rest among what stands still, a motion can be flown slower, or the vehicle can wait
where it ends, so that a plan for one duration gives one for every longer one. Fewer obstacles,
looser limits and fewer vehicles leave a plan what it is.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Obstacle, Scenario

_SAME = 1e-9
"""Part of a step, or of a motion's scale, by which what is the same may differ."""


def can_be_slower(scenario: Scenario) -> bool:
    """Return whether a plan for one duration can be flown slower for any longer one.

    That is so from rest to rest if no box keeps a vehicle from being slow: with the step, every
    motion can be stretched in time, which leaves its path and makes its derivatives smaller. Limits
    on norms never do: they are convex sets in which rest and hovering are, so that what is between
    these and a value inside is inside. Waypoints have times of their own, which are not stretched,
    as have obstacles that move; and errors grow with the time that a disturbance has for it.
    """
    if scenario.disturbance is not None or not all(body.is_steady for body in scenario.bodies):
        return False
    for vehicle in scenario.vehicles:
        limits = scenario.limits_of(vehicle)
        moving = np.any(vehicle.start.velocity) or np.any(vehicle.goal.velocity)
        pushed = vehicle.start.acceleration is not None and np.any(vehicle.start.acceleration)
        if moving or pushed or vehicle.waypoints:
            return False
        for box in (limits.velocity, limits.acceleration, limits.jerk):
            if box is not None and (np.any(box.lower > 0.0) or np.any(box.upper < 0.0)):
                return False
    return True


def rescaled(scenario: Scenario, factor: float) -> Scenario:
    """Return the scenario with `factor` times its duration, on as many knots, from the same time.

    Obstacles move as they did, on the clock. One that would be known only after the end is known
    at the end: there the goals are clear of it, so that it asks for nothing more.
    """
    grid = Grid(scenario.grid.step * factor, scenario.grid.knots, scenario.grid.start)
    obstacles = tuple(
        dataclasses.replace(each, known_from=min(each.known_from, grid.end))
        if isinstance(each, Obstacle)
        else each
        for each in scenario.obstacles
    )
    return dataclasses.replace(scenario, obstacles=obstacles).on_grid(grid)


def paced(plan: Plan, scenario: Scenario) -> Plan:
    """Return the motion of a plan at the pace of a scenario of the same vehicles and knots."""
    slower = scenario.grid.step / plan.scenario.grid.step
    velocities, accelerations = plan.velocities / slower, plan.accelerations / slower**2
    return Plan(scenario, plan.positions, velocities, accelerations)


def fitted(plan: Plan, scenario: Scenario) -> Plan:
    """Return the motion of a plan for the vehicles of a scenario, and for as long as it lasts.

    Of more vehicles than there are, those of the same names are taken. Where the scenario lasts
    longer, a motion from rest to rest is stretched on as many knots, or held where it ends on more
    of the same step. What fits in neither way is returned as it is.
    """
    names = [vehicle.name for vehicle in plan.scenario.vehicles]
    asked = [vehicle.name for vehicle in scenario.vehicles]
    if len(asked) < len(names) and set(asked) <= set(names):
        plan = plan.only(np.array([names.index(name) for name in asked]))
    grid, own = scenario.grid, plan.scenario.grid
    if len(asked) != len(plan.positions) or not _is_from_rest(plan, scenario):
        return plan
    slower, more = grid.step / own.step, grid.knots - own.knots
    if more == 0 and slower > 1.0 + _SAME:
        return paced(plan, scenario)
    if more > 0 and abs(slower - 1.0) <= _SAME:
        rest = np.zeros((len(asked), more, 3))
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
