"""Simulations as they are judged: the true motion, with nothing around it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.verification.course import Course
from drake_rho.verification.report import Column
from drake_rho.verification.states import check_flown, check_goal

POINT_MASS = "point mass"
"""The plant whose motion follows from what is recorded; that of others is known at the times of the
record only, and between them judged as if accelerations were constant."""

_KNOT = 1e-9
"""Part of a step by which a time may be off a knot and still be that knot."""


def course_of(simulation: Simulation) -> Course:
    """The true motion from each time of the record to the next.

    Point masses are flown anew from the first state by commands and winds. For another plant
    accelerations are those that lead from one recorded position to the next.
    """
    elapsed = np.asarray(simulation.elapsed)
    h = np.diff(elapsed)[:, None]
    p, v, commands, wind = (
        np.moveaxis(each, 0, 1)
        for each in (
            simulation.positions,
            simulation.velocities,
            simulation.commands[:-1],
            simulation.wind[:-1],
        )
    )
    if simulation.plant == POINT_MASS:
        a = commands + wind
        v = np.concatenate([v[:, :1], h * a], axis=1).cumsum(axis=1)
        p = np.concatenate([p[:, :1], h * v[:, :-1] + h**2 / 2 * a], axis=1).cumsum(axis=1)
    else:
        a = 2.0 * (np.diff(p, axis=1) - h * v[:, :-1]) / h**2
    knots = _knots(simulation, elapsed)
    return Course(simulation.scenario, elapsed, h[:, 0], knots, p, v, a, commands)


def _knots(simulation: Simulation, elapsed: FloatArray) -> BoolArray:
    """Which of the times are knots of the grid."""
    passed = elapsed / simulation.scenario.grid.step
    knots: BoolArray = np.abs(passed - np.rint(passed)) <= _KNOT
    return knots


def check_simulated(simulation: Simulation, course: Course) -> Iterator[Column]:
    """The record's states are those that were flown; and goals are within reach of errors."""
    if simulation.plant == POINT_MASS:
        states = (np.moveaxis(each, 0, 1) for each in (simulation.positions, simulation.velocities))
        yield from check_flown(course, *states)
    tube, end = simulation.tubes[-1], simulation.scenario.grid.end
    yield from check_goal(course, (float(tube.position(end)), float(tube.velocity(end))))
