"""States of planned or flown motions at sample times, as written to tables and documents."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.motion.flown import Flown
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import LARGEST, FloatArray, IntArray
from drake_rho.scenario.parts import SAME_TIME
from drake_rho.scenario.records import Grid

RATES = (0.0, 1000.0)
"""Range of sample rates [1/s], from above the first to the second inclusive: clocks of autopilots
and of drone shows count milliseconds."""


@dataclasses.dataclass(frozen=True, eq=False)
class Samples:
    """States of N vehicles at M times."""

    names: tuple[str, ...]
    """names of the vehicles"""
    times: FloatArray
    """times on the scenario's clock, increasing [s], shape (M,)"""
    positions: FloatArray
    """positions [m], shape (N, M, 3)"""
    velocities: FloatArray
    """velocities [m/s], shape (N, M, 3)"""
    accelerations: FloatArray
    """accelerations that begin at each time, 0 at the end of the flight [m/s²], shape (N, M, 3)"""

    @property
    def states(self) -> FloatArray:
        """Positions, velocities and accelerations side by side, shape (N, M, 9)."""
        return np.concatenate([self.positions, self.velocities, self.accelerations], axis=-1)

    def by_vehicle(self) -> Iterator[tuple[str, FloatArray]]:
        """Iterate over the vehicles' names and states, each of shape (M, 9)."""
        yield from zip(self.names, self.states, strict=True)


def check_rate(rate: float | None) -> None:
    """Check a sample rate [1/s]; None stands for a format's own rate.

    Raises:
        ValueError: the rate is outside `RATES`.
    """
    if rate is not None and not RATES[0] < rate <= RATES[1]:  # also true for NaN
        expected = f"above {RATES[0]:g} and up to {RATES[1]:g} samples a second"
        raise ValueError(f"rate: got {rate:g}, expected {expected}")


def sample(flown: Flown, elapsed: FloatArray) -> Samples:
    """Return the states at some times since the first knot [s], shape (M,).

    States at knots equal those of the plan to the last digit. From the last knot on, positions and
    velocities remain constant and accelerations are zero. For a flight, the states are those of
    the flown plan; for a simulation, those of the true motion.

    Raises:
        ValueError: a number is so large that it would be rejected when read again.
    """
    scenario = flown.scenario
    known = np.minimum(elapsed, scenario.grid.elapsed[-1])
    if flown.simulation is not None:
        p, v, a = _true(flown.simulation, known)
    else:
        p, v, a = _planned(flown.plan, known)
    ended = elapsed >= scenario.grid.elapsed[-1] - SAME_TIME * scenario.grid.step
    names = tuple(vehicle.name for vehicle in scenario.vehicles)
    a = np.where(ended[:, None], 0.0, a)
    if not all(np.all(np.abs(each) <= LARGEST) for each in (p, v, a)):
        raise ValueError(
            f"{scenario.name}: got states beyond {LARGEST:g}, expected those of a flight"
        )
    return Samples(names, scenario.grid.start + elapsed, p, v, a)


def _planned(plan: Plan, elapsed: FloatArray) -> tuple[FloatArray, ...]:
    motion, knots = plan.motion(), plan.scenario.grid.elapsed
    p, v, a = (motion.at(each, elapsed) for each in ("position", "velocity", "acceleration"))
    k = np.minimum(np.searchsorted(knots, elapsed), len(knots) - 1)
    there = knots[k] == elapsed
    p[:, there], v[:, there] = plan.positions[:, k[there]], plan.velocities[:, k[there]]
    return p, v, a


def _true(simulation: Simulation, elapsed: FloatArray) -> tuple[FloatArray, ...]:
    times = simulation.scenario.grid.start + elapsed
    m = np.searchsorted(np.asarray(simulation.elapsed), elapsed, side="right") - 1
    a = simulation.accelerations[np.clip(m, 0, len(simulation.times) - 2)]
    return *simulation.states(times), np.moveaxis(a, 0, 1)


def evenly(grid: Grid, rate: float) -> FloatArray:
    """Return times since the first knot at a rate [1/s], followed by the end [s], shape (M,)."""
    count = int(grid.duration * rate * (1.0 + SAME_TIME))
    times = np.arange(count + 1) / rate
    return np.append(times[times < grid.elapsed[-1] - SAME_TIME * grid.step], grid.elapsed[-1])


def with_knots(grid: Grid, rate: float | None) -> tuple[FloatArray, IntArray]:
    """Return the times of all knots and, if a rate is given [1/s], times at that rate as well.

    Returns:
        Times since the first knot [s], shape (M,), and the indices of the knots, shape (K,).
    """
    knots = grid.elapsed
    if rate is None:
        return knots, np.arange(len(knots))
    times = evenly(grid, rate)
    nearest = np.clip(np.rint(times / grid.step).astype(np.int64), 0, len(knots) - 1)
    times = np.union1d(times[np.abs(times - knots[nearest]) > SAME_TIME * grid.step], knots)
    return times, np.searchsorted(times, knots)


def knots_among(grid: Grid, times: FloatArray) -> IntArray:
    """Return the indices of the knots, shape (K,), among times on the scenario's clock.

    Args:
        grid: of the scenario.
        times: increasing [s], shape (M,).

    Raises:
        ValueError: a knot is not among the times.
    """
    if len(times) == 0:
        raise ValueError(f"no time, expected every knot, the first at {grid.start:g} s")
    after = np.clip(np.searchsorted(times, grid.times), 1, max(1, len(times) - 1))
    pair = np.stack([after - 1, np.minimum(after, len(times) - 1)])
    nearer = np.argmin(np.abs(times[pair] - grid.times), axis=0)
    found: IntArray = pair[nearer, np.arange(len(nearer))]
    missing = np.abs(times[found] - grid.times) > grid.rounding
    if np.any(missing):
        k = int(np.argmax(missing))
        raise ValueError(f"no sample at knot {k + 1}, {grid.times[k]:g} s, expected every knot")
    return found
