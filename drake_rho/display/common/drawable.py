"""What can be drawn: a plan, a flight, or the true motion of a flight in wind."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Protocol

import numpy as np

from drake_rho.motion.clearance import CloseApproaches, closest_over_time
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Flight, Plan, Window
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario, Separation

Flown = Plan | Flight | Simulation
"""Whatever has been planned or flown."""
_MAX_PLANNED = 14
"""Most vehicles whose plans are drawn beside their true motion."""
_PER_STEP = 12
"""Instants in each step at which the closest two are drawn, if its motion has no finer steps."""


class Drawn(Protocol):
    """Motions of a scenario's vehicles, as they are drawn; every `Plan` is of this form."""

    @property
    def scenario(self) -> Scenario:
        """What was asked."""
        ...

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        ...

    @property
    def positions(self) -> FloatArray:
        """At the knots [m], shape (N, K, 3)."""
        ...

    @property
    def velocities(self) -> FloatArray:
        """At the knots [m/s], shape (N, K, 3)."""
        ...

    def motion(self) -> Motion:
        """At any time since the first knot."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class TrueMotion:
    """Where the vehicles of a simulation truly were.

    The motion has as many steps as the record, of equal length. A point mass in a wind that changes
    within one of them is less than W h²/4 off, with h that length; at its ends nothing is.
    """

    simulation: Simulation
    """what was recorded"""

    @property
    def scenario(self) -> Scenario:
        """What was asked."""
        return self.simulation.scenario

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        return self.scenario.grid.times

    @property
    def positions(self) -> FloatArray:
        """At the knots [m], shape (N, K, 3)."""
        return self._fine.positions[:, :: self._parts]

    @property
    def velocities(self) -> FloatArray:
        """At the knots [m/s], shape (N, K, 3)."""
        return self._fine.velocities[:, :: self._parts]

    def motion(self) -> Motion:
        """At any time since the first knot."""
        return self._fine

    @property
    def _parts(self) -> int:
        """Steps of the motion in each step of the grid."""
        return max(1, round((len(self.simulation.times) - 1) / (self.scenario.grid.knots - 1)))

    @cached_property
    def _fine(self) -> Motion:
        record, grid = self.simulation, self.scenario.grid
        step, steps = grid.step / self._parts, self._parts * (grid.knots - 1)
        times = np.asarray(step * np.arange(steps + 1), dtype=np.float64)
        p, v = record.states(grid.start + times)
        a = np.diff(v, axis=1) / step
        return Motion(step, p, v, a, self.scenario.fleet.accelerations_before)


def drawn(flown: Flown) -> Drawn:
    """The motions that are drawn."""
    if isinstance(flown, Simulation):
        return TrueMotion(flown)
    return flown.plan if isinstance(flown, Flight) else flown


def windows_of(flown: Flown) -> tuple[Window, ...]:
    """The windows by which it was flown; none of a plan."""
    if isinstance(flown, Simulation):
        return flown.flight.windows
    return flown.windows if isinstance(flown, Flight) else ()


@dataclasses.dataclass(frozen=True, eq=False)
class Planned:
    """What a window planned, as long as that was flown."""

    plan: Plan
    """the whole prediction"""
    until: float
    """when the next window took over, since its own first knot [s]"""

    def in_force(self, times: FloatArray) -> BoolArray:
        """Which times since its first knot [s] it was in force at."""
        return times <= self.until + 1e-9 * self.plan.scenario.grid.step


def planned(shown: Drawn) -> list[Planned]:
    """What was to be flown, where that is not what has been: of a simulation of a few vehicles."""
    if not isinstance(shown, TrueMotion) or len(shown.scenario.vehicles) > _MAX_PLANNED:
        return []
    grid, windows = shown.scenario.grid, shown.simulation.flight.windows
    ends = [*(window.first_knot for window in windows[1:]), grid.knots - 1]
    return [
        Planned(window.plan, grid.step * (end - window.first_knot))
        for window, end in zip(windows, ends, strict=True)
    ]


def closest_two(shown: Drawn, separation: Separation) -> CloseApproaches:
    """The closest two vehicles over time, exact, as a curve."""
    motion = shown.motion()
    parts = round(shown.scenario.grid.step / motion.step)
    return closest_over_time(motion, separation, per_step=max(1, round(_PER_STEP / parts)))


def commands(shown: Drawn) -> tuple[FloatArray, FloatArray]:
    """Commanded accelerations, each for a while: when these begin and end, and their values.

    Returns:
        Times [s], shape (S + 1,), and accelerations [m/s²], shape (N, S, 3).
    """
    if isinstance(shown, TrueMotion):
        record = shown.simulation
        return record.times, np.swapaxes(record.commands[:-1], 0, 1)
    if isinstance(shown, Plan):
        return shown.times, shown.accelerations
    return shown.times, shown.motion().accelerations
