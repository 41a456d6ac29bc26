"""Verification of recorded states, also of simulations, against dynamics (1)-(2) and goals (3)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.parts import UNITS
from drake_rho.scenario.records import TOLERANCE, Quantity, Scenario
from drake_rho.scenario.times import Clock
from drake_rho.verification.averages import averaged
from drake_rho.verification.check import Column
from drake_rho.verification.jerks import Jerks
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


def check_planned(plan: Plan, trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Verify that a plan's states obey the dynamics (1)-(2) and reach the goals (3).

    The first knot is the start by construction.

    Args:
        plan: the plan.
        trajectory: trajectory integrated anew from its accelerations, before any smoothing.
    """
    yield from check_flown(trajectory, plan.positions, plan.velocities)
    yield from check_goal(averaged(trajectory), (0.0, 0.0))


def check_flown(
    trajectory: PiecewiseTrajectory,
    positions: FloatArray,
    velocities: FloatArray,
    within: npt.ArrayLike = (0.0, 0.0),
) -> Iterator[Column]:
    """Verify that positions and velocities (N, J + 1, 3) are those of the trajectory.

    Args:
        trajectory: the motion.
        positions: the positions [m].
        velocities: the velocities [m/s].
        within: largest differences [m, m/s], of all vehicles or of each, shape (2,) or (2, N).
    """
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", positions, trajectory.positions),
        ("velocity", velocities, trajectory.velocities),
    )
    for (quantity, own, flown), most in zip(pairs, np.asarray(within), strict=True):
        differences = np.linalg.norm(own - flown, axis=2)
        k, largest = differences.argmax(axis=1), differences.max(axis=1)
        yield _difference(
            trajectory.scenario, "dynamics", quantity, trajectory.times[k], largest, most
        )


def check_start(trajectory: PiecewiseTrajectory, within: npt.ArrayLike) -> Iterator[Column]:
    """Verify that a motion that was not planned here begins at the start.

    Args:
        trajectory: the motion.
        within: allowed distances from the start [m, m/s], as in `check_flown`.
    """
    fleet, times = (
        trajectory.scenario.fleet,
        np.full(len(trajectory.positions), trajectory.times[0]),
    )
    pairs: tuple[tuple[Quantity, FloatArray], ...] = (
        ("position", trajectory.positions[:, 0] - fleet.start_positions),
        ("velocity", trajectory.velocities[:, 0] - fleet.start_velocities),
    )
    for (quantity, missed), most in zip(pairs, np.asarray(within), strict=True):
        away = np.linalg.norm(missed, axis=1)
        yield _difference(trajectory.scenario, "start", quantity, times, away, most)


def check_goal(trajectory: PiecewiseTrajectory, within: npt.ArrayLike) -> Iterator[Column]:
    """Verify that the last state is within distances of the goal, as in `check_flown`."""
    fleet = trajectory.scenario.fleet
    pairs: tuple[tuple[Quantity, FloatArray, BoolArray], ...] = (
        ("position", trajectory.positions[:, -1], fleet.fixed_positions),
        ("velocity", trajectory.velocities[:, -1], fleet.fixed_velocities),
    )
    for (quantity, reached, fixed), most in zip(pairs, np.asarray(within), strict=True):
        missed = np.linalg.norm(fleet.missed(quantity, reached), axis=1)
        times = np.full(len(missed), trajectory.times[-1])
        yield _difference(trajectory.scenario, "goal", quantity, times, missed, most, fixed)


def _difference(
    scenario: Scenario,
    constraint: str,
    quantity: Quantity,
    times: FloatArray,
    values: FloatArray,
    most: FloatArray,
    concerned: BoolArray | None = None,
) -> Column:
    """Return the checks of differences, which may not exceed `most`, of some or all vehicles."""
    limits = most + np.zeros(len(values))
    return Column(
        kind="goals" if constraint == "goal" else "dynamics",
        constraint=constraint,
        parts=[quantity] * len(values),
        times=times,
        values=values,
        limits=limits,
        excess=values - limits,
        tolerances=TOLERANCE * scenario.fleet.scale(quantity),
        errors=limits,
        unit=UNITS[quantity],
        concerned=np.ones(len(values), dtype=bool) if concerned is None else concerned,
    )
