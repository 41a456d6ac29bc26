"""Deviations of measured states from the planned motion."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.flight import Flight
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray


@dataclasses.dataclass(frozen=True, kw_only=True)
class Deviation(metaclass=Described):
    """Deviation of a vehicle's measured state from the motion planned before."""

    vehicle: str
    """name of the vehicle"""
    time: float
    """time on the scenario's clock [s]"""
    position: float
    """distance between both positions [m]"""
    velocity: float
    """norm of the difference of both velocities [m/s]; NaN if the velocity was not measured"""

    def __str__(self) -> str:
        velocity = "" if np.isnan(self.velocity) else f" and {self.velocity:.3g} m/s"
        return f"{self.position:.3g} m{velocity}"


@dataclasses.dataclass(frozen=True, eq=False)
class Deviations:
    """Measurements during a flight, without those after its end, beside the planned motion."""

    elapsed: FloatArray
    """times since the first knot [s], shape (M,)"""
    positions: FloatArray
    """measured positions [m], shape (N, M, 3); NaN where a vehicle was not seen"""
    velocities: FloatArray
    """measured velocities [m/s], shape (N, M, 3); NaN where they were not measured"""
    from_planned: tuple[FloatArray, FloatArray]
    """norms of differences from planned positions [m] and velocities [m/s], shape (N, M)"""
    later: int
    """number of times after the end of the flight, which are omitted"""

    @classmethod
    def of(cls, flight: Flight) -> Deviations | None:
        """Return the deviations in a flight; None without measurements.

        Where a window began at measured states, the planned motion is that after the jump.
        """
        if (measured := flight.measured) is None:
            return None
        scenario, grid = flight.scenario, flight.scenario.grid
        here = ~grid.clock.after(measured.times, grid.end + scenario.lead)
        elapsed = grid.since_start(measured.times[here])
        p, v = (np.swapaxes(x[here], 0, 1) for x in (measured.positions, measured.velocities))
        planned = flight.sampled(elapsed)
        far = np.linalg.norm(p - planned.positions, axis=2)
        fast = np.linalg.norm(v - planned.velocities, axis=2)
        return cls(elapsed, p, v, (far, fast), int(np.sum(~here)))

    @property
    def seen(self) -> BoolArray:
        """Whether each vehicle was seen at each time, shape (N, M)."""
        return np.asarray(~np.isnan(self.from_planned[0]))


def largest_deviation(flight: Flight | None) -> Deviation | None:
    """Return the largest deviation of measured positions in a flight; None without any."""
    if flight is None or (found := Deviations.of(flight)) is None or not found.seen.any():
        return None
    far, fast = found.from_planned
    i, m = np.unravel_index(np.nanargmax(far), far.shape)
    return Deviation(
        vehicle=flight.scenario.names[i],
        time=float(flight.scenario.grid.start + found.elapsed[m]),
        position=float(far[i, m]),
        velocity=float(fast[i, m]),
    )
