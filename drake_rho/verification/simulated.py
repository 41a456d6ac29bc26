"""Verification of simulations: the true motion, without an error tube."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.times import Clock
from drake_rho.verification.check import Column
from drake_rho.verification.jerks import Jerks
from drake_rho.verification.states import check_flown, check_goal
from drake_rho.verification.trajectory import PiecewiseTrajectory

POINT_MASS = "point mass"
"""Plant whose motion follows exactly from the record. Other plants are known at the recorded times
only; between them accelerations are taken as constant."""


def trajectory_of(simulation: Simulation) -> PiecewiseTrajectory:
    """Return the true motion, with a piece from each recorded time to the next.

    The motion of a point mass is integrated anew from the first state, commands and winds. For
    other plants, constant accelerations connect consecutive recorded positions.
    """
    plan, elapsed = simulation.plan, np.asarray(simulation.elapsed)
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
    knots, jerks = _knots(simulation, elapsed), Jerks.of(plan.scenario, plan.accelerations)
    return PiecewiseTrajectory.of_pieces(
        simulation.scenario, elapsed, h[:, 0], knots, (p, v, a), jerks, commands=commands
    )


def _knots(simulation: Simulation, elapsed: FloatArray) -> BoolArray:
    """Return flags of the times that are knots of the grid."""
    step = simulation.scenario.grid.step
    return Clock.of(step).same(elapsed, step * np.rint(elapsed / step))


def check_simulated(simulation: Simulation, trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Verify that the record obeys the dynamics and ends within the tube's radii from the goals."""
    if simulation.plant == POINT_MASS:
        states = (np.moveaxis(each, 0, 1) for each in (simulation.positions, simulation.velocities))
        yield from check_flown(trajectory, *states)
    tube, end = simulation.tubes[-1], simulation.scenario.grid.end
    yield from check_goal(trajectory, (float(tube.position(end)), float(tube.velocity(end))))
