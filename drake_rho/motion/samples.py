"""States of planned or flown motions at sample times, and the choice of such times."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Grid
from drake_rho.scenario.times import Clock, steps_within

RATES = (0.0, 1000.0)
"""Range of sample rates [1/s], from above the first to the second inclusive: clocks of autopilots
and of drone shows count milliseconds."""

COLUMNS = (
    "vehicle",
    "time [s]",
    *("x [m]", "y [m]", "z [m]"),
    *("vx [m/s]", "vy [m/s]", "vz [m/s]"),
    *("ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]"),
)
"""Column names, in plain ASCII: not every program that reads tables detects the encoding."""


@dataclasses.dataclass(frozen=True, eq=False)
class Samples(metaclass=Described):
    """States of vehicles at times, as returned by `at` of a plan, a flight or a simulation.

    Arrays are of shape (N, T, 3), or (T, 3) for a single vehicle.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> plan.at([0.0, 12.5, 24.5]).positions.shape
        (4, 3, 3)
        >>> plan.at(24.5, vehicle="UAV-1").positions.round(1).tolist()
        [[2789.0, 1535.6, 2126.7]]
    """

    names: tuple[str, ...]
    """names of the vehicles"""
    times: FloatArray
    """times on the scenario's clock [s], shape (T,)"""
    positions: FloatArray
    """positions [m], shape (N, T, 3) or (T, 3)"""
    velocities: FloatArray
    """velocities [m/s], shape (N, T, 3) or (T, 3)"""
    accelerations: FloatArray
    """accelerations that begin at each time [m/s²], shape (N, T, 3) or (T, 3)"""

    def __repr__(self) -> str:
        """Return a text such as '<Samples of 4 vehicles at 3 times>', without arrays."""
        vehicles = self.names[0] if len(self.names) == 1 else f"{len(self.names)} vehicles"
        count = len(self.times)
        return f"<Samples of {vehicles} at {count} time{'s' if count != 1 else ''}>"

    @property
    def states(self) -> FloatArray:
        """Positions, velocities and accelerations side by side, shape (N, T, 9) or (T, 9)."""
        return np.concatenate([self.positions, self.velocities, self.accelerations], axis=-1)

    def columns(self) -> dict[str, list[str] | list[float]]:
        """Return a table with one row per vehicle and time, as columns by name and unit.

        The columns are those of exported CSV files; `pandas.DataFrame(samples.columns())` is the
        same table.
        """
        count = len(self.times)
        named = [name for name in self.names for _ in range(count)]
        numbers = self.states.reshape(-1, 9)
        times = np.tile(self.times, len(self.names))
        table = np.concatenate([times[:, None], numbers], axis=1).T.tolist()
        return dict(zip(COLUMNS, [named, *table], strict=True))

    def by_vehicle(self) -> Iterator[tuple[str, FloatArray]]:
        """Iterate over the vehicles' names and states, each of shape (T, 9)."""
        states = self.states.reshape(len(self.names), len(self.times), 9)
        yield from zip(self.names, states, strict=True)

    def of(self, index: int) -> Samples:
        """Return the samples of one vehicle, arrays of shape (T, 3)."""
        p, v, a = self.positions[index], self.velocities[index], self.accelerations[index]
        return Samples(self.names[index : index + 1], self.times, p, v, a)


def times_of(grid: Grid, times: npt.ArrayLike, lead: float = 0.0) -> FloatArray:
    """Return times since the first knot [s], shape (T,), for times on the scenario's clock.

    Times that equal a knot but for rounding become the knot's.

    Args:
        grid: the grid of the flight.
        times: times on the scenario's clock [s], shape (T,), or a single one.
        lead: time by which the flight begins before the first knot and ends after the last [s].

    Raises:
        ValueError: the times have another shape, or one of them is outside the flight.
    """
    instants = np.asarray(times, dtype=np.float64)
    if instants.ndim > 1:
        raise ValueError(f"times: got shape {instants.shape}, expected (T,) or a single time")
    instants = np.atleast_1d(instants)
    first, last = grid.start - lead, grid.end + lead
    inside = grid.clock.within(instants, (first, last))
    if not inside.all():
        got = instants[np.argmin(inside)]
        expected = f"times of the flight, from {first:.12g} to {last:.12g} s"
        raise ValueError(f"times: got {got:.12g} s, expected {expected}")
    return grid.since_start(instants)


def check_rate(rate: float | None) -> None:
    """Check a sample rate [1/s]; None stands for a format's own rate.

    Raises:
        ValueError: the rate is outside `RATES`.
    """
    if rate is not None and not RATES[0] < rate <= RATES[1]:  # also true for NaN
        expected = f"above {RATES[0]:g} and up to {RATES[1]:g} samples a second"
        raise ValueError(f"rate: got {rate:g}, expected {expected}")


def evenly(grid: Grid, rate: float, lead: float = 0.0) -> FloatArray:
    """Return times since the beginning at a rate [1/s], followed by the end [s], shape (M,).

    Args:
        grid: the grid of the flight.
        rate: times per second [1/s].
        lead: time by which the flight begins before the first knot and ends after the last [s].
    """
    end = float(grid.elapsed[-1]) + 2.0 * lead
    count = steps_within(grid.duration + 2.0 * lead, 1.0 / rate)
    times = np.arange(count + 1) / rate
    return np.append(times[Clock.of(grid.step).before(times, end)], end)


def with_knots(grid: Grid, rate: float | None, lead: float = 0.0) -> tuple[FloatArray, IntArray]:
    """Return the times of all knots and, if a rate is given [1/s], times at that rate as well.

    Args:
        grid: the grid of the flight.
        rate: times per second [1/s], if any.
        lead: time by which the flight begins before the first knot and ends after the last [s].

    Returns:
        Times since the first knot [s], shape (M,), and the indices of the knots, shape (K,).
    """
    knots = grid.elapsed
    if rate is None:
        return knots, np.arange(len(knots))
    times = evenly(grid, rate, lead) - lead
    times = np.union1d(Clock.of(grid.step).apart(times, knots), knots)
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
    missing = ~grid.clock.same(times[found], grid.times)
    if np.any(missing):
        k = int(np.argmax(missing))
        raise ValueError(f"no sample at knot {k + 1}, {grid.times[k]:g} s, expected every knot")
    return found
