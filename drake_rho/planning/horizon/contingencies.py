"""Contingencies of windows: motions that brake to rest, clear of all known obstacles.

A contingency follows its window's plan up to the next window, brakes there, and stays at rest until
the end of the flight. It is in the tube of its window's plan, so it can be flown whenever the next
window finds no plan.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.remainders import remainder
from drake_rho.motion.scenario_tube import tracking_of, tube_of
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.programs.backend import Solver
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.parts import State
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.smoothing import largest_accelerations
from drake_rho.verification.holds import first_violation

_TRIED = 12
"""Largest number of braking times that are tried."""

_LONGER = 1.25
"""Factor from one braking time to the next one tried."""

_MOVED, _CLEARLY = 4, 1.02
"""Rounds in which places of rest are moved out of obstacles; and the distance moved, as a multiple
of the missing clearance."""


def contingency(plan: Plan, knot: int, solver: Solver | None = None) -> Plan:
    """Return a motion that follows a plan up to a knot, and then brakes to rest.

    It satisfies all limits and all requirements without an interval, and with the plan's tube keeps
    clear of other vehicles and the obstacles known to the plan. Waypoints, and requirements with an
    interval, belong to the mission and do not apply. Vehicles brake along the plan's paths if
    possible, otherwise straight ahead, in the shortest time found.

    Args:
        plan: plan of a window.
        knot: knot at which braking begins, counted from 0; at least one step before the last.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.

    Returns:
        A plan from the same starts whose goals are the places of rest. It ends no earlier than the
        given one.

    Raises:
        InfeasibleError: no such motion was found.
    """
    failure = InfeasibleError(
        {"all vehicles": ("rest",)}, scenario=plan.scenario, because="no time to brake has a plan"
    )
    for rests, steps in _candidates(plan, knot):
        scenario = _resting(plan, knot, rests, steps)
        try:
            braking = plan_convex(scenario, reference=None, solver=solver)
        except (InfeasibleError, SolverError) as error:
            if isinstance(error, InfeasibleError):
                failure = error
            continue
        still = np.zeros((len(rests), max(plan.scenario.grid.knots - 1 - knot - steps, 0), 3))
        accelerations = np.concatenate([braking.accelerations, still], axis=1)
        count = accelerations.shape[1]
        rest = Plan.from_accelerations(_resting(plan, knot, rests, count), accelerations)
        if (violated := first_violation(rest)) is not None:
            conflicts = {violated.vehicle: (violated.what,)}
            failure = InfeasibleError(conflicts, scenario=scenario, because="braking violates it")
            continue
        if knot == 0:
            return rest
        accelerations = np.concatenate([plan.accelerations[:, :knot], accelerations], axis=1)
        return Plan.from_accelerations(_resting(plan, 0, rests, knot + count), accelerations)
    raise failure


def as_part_of(stop: Plan, scenario: Scenario) -> Plan:
    """Return a contingency as a plan of the rest of a flight, whose goals it misses.

    Args:
        stop: contingency that ends no earlier than the flight.
        scenario: rest of the flight, from the same states.
    """
    steps = scenario.grid.knots - 1
    return Plan.from_accelerations(scenario, stop.accelerations[:, :steps])


def _candidates(plan: Plan, knot: int) -> Iterator[tuple[FloatArray, int]]:
    """Yield places of rest (N, 3), and the number of steps in which vehicles brake to them.

    At a constant speed, the distance covered in n steps is the braking distance of 2n steps.
    """
    scenario, last = plan.scenario, plan.accelerations.shape[1]
    h, v = scenario.grid.step, plan.velocities[:, knot]
    speeds, most = np.linalg.norm(v, axis=1), largest_accelerations(scenario.fleet)
    ahead = max(int((speeds / (2.0 * h * most)).max()), 1)
    for _ in range(_TRIED):
        steps = 2 * ahead
        beyond = max(knot + ahead - last, 0)
        along = plan.positions[:, min(knot + ahead, last)]
        along = along + h * beyond * plan.velocities[:, -1]
        straight = plan.positions[:, knot] + h * ahead * v
        for rests in (along, straight):
            yield _cleared(plan, knot + steps, rests), steps
        ahead = max(ahead + 1, int(_LONGER * ahead))


def _cleared(plan: Plan, knot: int, rests: FloatArray) -> FloatArray:
    """Return places of rest moved out of the obstacles, at their positions at a knot."""
    scenario, grid = plan.scenario, plan.scenario.grid
    time = np.array([knot * grid.step])
    tube = tube_of(_resting(plan, 0, rests, max(knot, grid.knots - 1)))
    required = scenario.fleet.radii + tube.position(grid.start + time)
    for _ in range(_MOVED):
        moved = rests
        for _, body in scenario.avoided:
            x = moved - body.centers(time)[0]
            lacking = required + body.deviation - body.shape.local_distance(x)
            out = np.where(lacking > 0.0, _CLEARLY * lacking, 0.0)
            moved = moved + out[:, None] * body.shape.local_outward(x)
        if np.array_equal(moved, rests):
            break
        rests = moved
    return rests


def _resting(plan: Plan, knot: int, rests: FloatArray, steps: int) -> Scenario:
    """Return the scenario from a knot of a plan to places of rest.

    It has the obstacles that the plan knows, and the plan's feedback.

    Args:
        plan: plan of a window.
        knot: first knot, counted from 0.
        rests: places of rest [m], shape (N, 3).
        steps: number of steps to these places.
    """
    window = plan.scenario
    remaining = remainder(window, plan.motion(), knot)
    grid: Grid = window.grid.from_knot(knot, steps)
    fleet = remaining.fleet.started_at(
        grid,
        vehicles := tuple(
            unchecked(each, goal=State(rest, np.zeros(3)), waypoints=())
            for each, rest in zip(remaining.vehicles, rests, strict=True)
        ),
        remaining.fleet.start_positions,
        remaining.fleet.start_velocities,
        remaining.fleet.accelerations_before,
        [body for _, body in remaining.avoided],
        rests=rests,
    )
    disturbance = window.disturbance
    disturbance = disturbance and unchecked(disturbance, tracking=tracking_of(window))
    known = [number - 1 for number, _ in window.known]
    return remaining.derived(
        grid=grid,
        vehicles=vehicles,
        fleet=fleet,
        disturbance=disturbance,
        requirements=tuple(
            each for each in remaining.requirements if each.active is None and each.between is None
        ),
        obstacles=tuple(remaining.bodies[number] for number in known),
        bodies_in_flight=tuple(remaining.bodies_in_flight[number] for number in known),
        under_way=True,
    )
