"""Earliest arrival of each vehicle at its goal, then rest."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.scp.least_time import LeastTime
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.bisection import least_count


def as_soon_as_each_can(
    together: Timed, alone: FloatArray, least: LeastTime, progress: Progress | None
) -> Timed:
    """Return a motion with the earliest arrivals found.

    The latest arrival does not change. The knot of every other arrival is bisected around the
    motions of all other vehicles, beginning with the vehicle of the shortest least time.

    Args:
        together: motion in which all arrive at the last knot.
        alone: least time of each vehicle [s], shape (N,).
        least: search for motions in a given final time.
        progress: called with each arrival found.
    """
    steps = together.accelerations.shape[1]
    best = dataclasses.replace(together, resting=np.full(len(alone), steps))
    first = np.ceil(alone / together.step * (1.0 - 1e-9)).astype(int)
    with least.or_cut():
        for number in np.argsort(first, kind="stable").tolist():

            def arrives(knot: int, number: int = number) -> bool:
                nonlocal best
                found = least.at_same_times(_arriving(best, number, knot))
                best = found or best
                return found is not None

            arrival = least_count(arrives, max(int(first[number]), 1) - 1, steps)
            name = together.scenario.vehicles[number].name
            tell(progress, f"{name} arrives after {arrival * together.step:.6g} s")
    return dataclasses.replace(best, converged=together.converged)


def _arriving(timed: Timed, number: int, knot: int) -> Timed:
    """Return a reference with an earlier arrival of one vehicle.

    Its positions are passed faster, and its free waypoints keep their normalised times.
    """
    assert timed.resting is not None  # noqa: S101  # every vehicle arrives somewhere
    resting = timed.resting.copy()
    faster, resting[number] = resting[number] / knot, knot
    passing, positions = timed.passing, timed.motion.positions.copy()
    sooner = passing.lasting(timed.duration / faster, timed.duration)
    times = np.where(passing.vehicles == number, sooner.times, passing.times)
    elapsed = timed.grid.elapsed
    earlier = np.minimum(elapsed * faster, elapsed[-1])
    positions[number] = timed.motion.of(slice(number, number + 1)).at("position", earlier)[0]
    scenario, motion = timed.problem.scenario, timed.motion
    reference = Plan(scenario, positions, motion.velocities, motion.accelerations)
    return dataclasses.replace(
        timed,
        passing=dataclasses.replace(passing, times=times),
        reference=reference,
        rows=(),
        resting=resting,
    )
