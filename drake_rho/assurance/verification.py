"""`verify`: every constraint of a scenario, judged from initial states and accelerations alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.assurance.boxes import check_boxes
from drake_rho.assurance.course import Course
from drake_rho.assurance.norms import check_norms
from drake_rho.assurance.notes import notes_on
from drake_rho.assurance.obstacles import check_obstacles
from drake_rho.assurance.report import (
    UNITS,
    Check,
    Column,
    Report,
)
from drake_rho.assurance.separation import check_separation
from drake_rho.assurance.tubes import Tubes
from drake_rho.assurance.waypoints import check_waypoints
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Flight, Plan
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import TOLERANCE, Quantity, Scenario

__all__ = ["Check", "Report", "verify"]


def verify(flown: Plan | Flight) -> Report:
    """Judge every constraint of the scenario that was planned for.

    Positions and velocities are flown anew from the initial states and the accelerations; those
    of the plan are only compared with them ("dynamics"). Obstacles, separation and position boxes
    are examined at the knots and at every instant, by sampling with lower bounds that leave no
    instant out (`drake_rho.assurance.continuous_time`): none is worse than what is told by more
    than a hundredth of the tolerance. A scenario that asks for the knots only (`between_knots`)
    is judged by these, and the other is told beside it. A value that is no number never holds.

    From an obstacle a vehicle keeps its radius, and the deviation of the obstacle's track. One that
    is known later is judged from then on; how close it was before is told in a row of its own.
    All times are on the scenario's clock.

    The arithmetic is that of double precision. A position at the knots is a sum of 2K terms, none
    larger than the largest of the motion's coordinates and its length scale, so with the unit
    roundoff u = 1.1e-16 it is within 4 K u of that; an instant adds a few roundings more. For the
    paper's data that is below 1e-9 m, a millionth of the least tolerance.

    Args:
        flown: a plan, or a flight, of which the whole as flown is judged.

    Returns:
        A report; `report.ok` says whether all holds.
    """
    plan = flown.plan if isinstance(flown, Flight) else flown
    scenario = plan.scenario
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is told as no number
        motion = Motion.from_starts(scenario.fleet, plan.accelerations, scenario.grid.step)
        course = Course.of(scenario, motion, Tubes.around(flown))
        columns = [
            *_check_dynamics(plan, motion),
            *_check_goal(scenario, motion),
            *check_boxes(course, motion.jerks()),
            *check_norms(course),
            *check_waypoints(course),
            *check_obstacles(course),
            *check_separation(course),
        ]
    names = [vehicle.name for vehicle in scenario.vehicles]
    by_vehicle = zip(*(column.checks(names) for column in columns), strict=True)
    checks = tuple(check for checks in by_vehicle for check in checks if check is not None)
    hit = {check.constraint for check in checks if not check.holds}
    seen = flown.sightings if isinstance(flown, Flight) else ()
    sightings = tuple(
        dataclasses.replace(each, avoided=each.avoided and each.obstacle not in hit)
        for each in seen
    )
    return Report(scenario, checks, sightings, notes_on(course))


def _check_dynamics(plan: Plan, motion: Motion) -> Iterator[Column]:
    """(1)-(2): the plan's own positions and velocities are those that are flown."""
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", plan.positions, motion.positions),
        ("velocity", plan.velocities, motion.velocities),
    )
    for quantity, own, flown in pairs:
        differences = np.linalg.norm(own - flown, axis=2)
        k = np.argmax(differences, axis=1)
        largest = _pick(differences, k)
        yield _difference(plan.scenario, "dynamics", quantity, plan.times[k], largest)


def _check_goal(scenario: Scenario, motion: Motion) -> Iterator[Column]:
    """(3): the last knot is the goal. The first is the start by construction."""
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", motion.positions[:, -1], scenario.fleet.goal_positions),
        ("velocity", motion.velocities[:, -1], scenario.fleet.goal_velocities),
    )
    for quantity, reached, wanted in pairs:
        missed = np.linalg.norm(reached - wanted, axis=1)
        times = np.full(len(missed), scenario.grid.end)
        yield _difference(scenario, "goal", quantity, times, missed)


def _difference(
    scenario: Scenario, constraint: str, quantity: Quantity, times: FloatArray, values: FloatArray
) -> Column:
    """Checks of something that should be zero."""
    return Column(
        constraint=constraint,
        parts=[quantity] * len(values),
        times=times,
        values=values,
        limits=np.zeros(len(values)),
        excess=values,
        tolerances=TOLERANCE * scenario.fleet.scale(quantity),
        unit=UNITS[quantity],
    )


def _pick(values: FloatArray, k: IntArray) -> FloatArray:
    """The k[i]-th of each row i."""
    picked: FloatArray = np.take_along_axis(values, k[:, None], axis=1)[:, 0]
    return picked
