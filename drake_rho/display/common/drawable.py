"""Motions that can be drawn: a plan, a flight, or the true motion of a flight in wind."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.flown import Flown
from drake_rho.motion.nearest_vehicles import closest_over_time
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario, Separation
from drake_rho.scenario.times import Clock
from drake_rho.scenario.waypoints import in_order

_MAX_PLANNED = 14
"""Largest number of vehicles whose plans are drawn beside their true motion."""
_PER_STEP = 12
"""Samples per step of the closest distance, unless the motion itself has finer steps."""
_SMOOTH_PARTS = 16
"""Steps in which a smooth motion is drawn, per step of the grid."""


class Drawn(Protocol):
    """Protocol of a drawable motion of a scenario's vehicles; every `Plan` satisfies it."""

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        ...

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        ...

    @property
    def positions(self) -> FloatArray:
        """Positions at the knots [m], shape (N, K, 3)."""
        ...

    @property
    def velocities(self) -> FloatArray:
        """Velocities at the knots [m/s], shape (N, K, 3)."""
        ...

    @property
    def jumps(self) -> tuple[int, ...]:
        """Knots, from 0, at which the motion jumps, as that of a flight from measured states."""
        ...

    def motion(self) -> Motion:
        """Return the motion as a function of the time since the first knot."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class TrueMotion:
    """True motion of the vehicles of a simulation.

    The motion has as many steps as the record, of equal length h. For a point mass in a wind of at
    most W that changes within a step, the position error is below W h²/4; at the ends of the step
    it is zero.
    """

    simulation: Simulation
    """recorded simulation"""

    jumps: ClassVar[tuple[()]] = ()

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        return self.simulation.scenario

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        return self.scenario.grid.times

    @property
    def positions(self) -> FloatArray:
        """Positions at the knots [m], shape (N, K, 3)."""
        return self._fine.positions[:, :: self._parts]

    @property
    def velocities(self) -> FloatArray:
        """Velocities at the knots [m/s], shape (N, K, 3)."""
        return self._fine.velocities[:, :: self._parts]

    def motion(self) -> Motion:
        """Return the motion as a function of the time since the first knot."""
        return self._fine

    @property
    def _parts(self) -> int:
        """Number of steps of the motion per step of the grid."""
        return max(1, round((len(self.simulation.times) - 1) / (self.scenario.grid.knots - 1)))

    @cached_property
    def _fine(self) -> Motion:
        record, grid = self.simulation, self.scenario.grid
        step, steps = grid.step / self._parts, self._parts * (grid.knots - 1)
        times = np.asarray(step * np.arange(steps + 1), dtype=np.float64)
        p, v = record.states(grid.start + times)
        a = np.diff(v, axis=1) / step
        fleet = self.scenario.fleet
        return Motion(step, p, v, a, fleet.accelerations_before, fleet.accelerations_after)


@dataclasses.dataclass(frozen=True, eq=False)
class StraightLines:
    """Straight lines from starts through waypoints to goals, of a scenario before it is planned.

    Each vehicle moves along its lines at constant speeds that reach waypoints and goal in time.
    """

    scenario: Scenario
    """scenario to show"""

    kind: ClassVar = "scenario"
    windows: ClassVar[tuple[()]] = ()
    jumps: ClassVar[tuple[()]] = ()
    simulation: ClassVar[None] = None

    @property
    def plan(self) -> Drawn:
        """The lines themselves."""
        return self

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        return self.scenario.grid.times

    @cached_property
    def positions(self) -> FloatArray:
        """Positions at the knots [m], shape (N, K, 3)."""
        grid, lines = self.scenario.grid, []
        for vehicle in self.scenario.vehicles:
            ends = vehicle.start.position, vehicle.goal.position
            if any(each.time is None for each in vehicle.waypoints):  # at a steady speed
                places = np.array(
                    [ends[0], *(each.position for each in vehicle.waypoints), ends[1]]
                )
                gone = np.cumsum([0.0, *np.linalg.norm(np.diff(places, axis=0), axis=1)])
                times = grid.start + grid.duration * gone / max(gone[-1], 1e-300)
            else:
                passed = [one for one in in_order(vehicle) if grid.start < one[0] < grid.end]
                times = np.array([grid.start, *(time for time, _ in passed), grid.end])
                places = np.array([ends[0], *(each.position for _, each in passed), ends[1]])
            lines.append(np.stack([np.interp(grid.times, times, x) for x in places.T], axis=1))
        return np.array(lines)

    @property
    def velocities(self) -> FloatArray:
        """Velocities from each knot to the next, the last one repeated [m/s], shape (N, K, 3)."""
        steps = np.diff(self.positions, axis=1) / self.scenario.grid.step
        return np.concatenate([steps, steps[:, -1:]], axis=1)

    def motion(self) -> Motion:
        """Return the motion as a function of the time since the first knot."""
        still = np.zeros((len(self.positions), self.scenario.grid.knots - 1, 3))
        unknown = np.full((len(still), 3), np.nan)
        states = self.positions, self.velocities
        return Motion(self.scenario.grid.step, *states, still, unknown, unknown)


@dataclasses.dataclass(frozen=True, eq=False)
class Smoothed:
    """Smooth motion of a plan from its first knot to its last, in steps of a fraction of the grid.

    States at the ends of these steps are exact. What is before the first knot and after the last is
    not drawn.
    """

    plan: Plan
    """plan with a smoothing"""

    kind: ClassVar = "plan"
    windows: ClassVar[tuple[()]] = ()
    jumps: ClassVar[tuple[()]] = ()
    simulation: ClassVar[None] = None

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        return self.plan.scenario

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        return self.scenario.grid.times

    @property
    def positions(self) -> FloatArray:
        """Positions at the knots [m], shape (N, K, 3)."""
        return self._fine.positions[:, ::_SMOOTH_PARTS]

    @property
    def velocities(self) -> FloatArray:
        """Velocities at the knots [m/s], shape (N, K, 3)."""
        return self._fine.velocities[:, ::_SMOOTH_PARTS]

    def motion(self) -> Motion:
        """Return the motion as a function of the time since the first knot."""
        return self._fine

    @cached_property
    def _fine(self) -> Motion:
        grid = self.scenario.grid
        step, steps = grid.step / _SMOOTH_PARTS, _SMOOTH_PARTS * (grid.knots - 1)
        states = self.plan.sampled(np.asarray(step * np.arange(steps + 1), dtype=np.float64))
        p, v = states.positions, states.velocities
        unknown = np.full((len(p), 3), np.nan)
        return Motion(step, p, v, np.diff(v, axis=1) / step, unknown, unknown)


def drawn(flown: Flown | StraightLines | Smoothed) -> Drawn:
    """Return the motion to draw: of a flight its plan, of a simulation the true motion.

    Of a plan with a smoothing it is the smooth motion.
    """
    if flown.simulation is not None:
        return TrueMotion(flown.simulation)
    plan = flown.plan
    return Smoothed(plan) if isinstance(plan, Plan) and plan.scenario.smoothing else plan


@dataclasses.dataclass(frozen=True, eq=False)
class Planned:
    """Prediction of a window, and the time for which it was in force."""

    plan: Plan
    """whole prediction"""
    until: float
    """time at which the next window took over, since this plan's first knot [s]"""

    def in_force(self, times: FloatArray) -> BoolArray:
        """Tell at which times since its first knot [s] the plan was in force."""
        return ~Clock.of(self.plan.scenario.grid.step).after(times, self.until)


def planned(shown: Drawn) -> list[Planned]:
    """Return the predictions to draw beside a true motion.

    There are some only for a simulation, whose motion differs from the plans, and only of a few
    vehicles, so that the lines can be told apart.
    """
    if not isinstance(shown, TrueMotion) or len(shown.scenario.vehicles) > _MAX_PLANNED:
        return []
    grid, windows = shown.scenario.grid, shown.simulation.windows
    ends = [*(window.first_knot for window in windows[1:]), grid.knots - 1]
    return [
        Planned(window.plan, grid.step * (end - window.first_knot))
        for window, end in zip(windows, ends, strict=True)
    ]


def closest_two(shown: Drawn, separation: Separation) -> CloseApproaches:
    """Return the distance of the closest two vehicles over time, with its exact minima."""
    motion = shown.motion()
    parts = round(shown.scenario.grid.step / motion.step)
    return closest_over_time(motion, separation, per_step=max(1, round(_PER_STEP / parts)))


def planned_jerks(shown: Drawn) -> FloatArray:
    """Return the jerks of the plan that is flown at its knots [m/s³], shape (N, K, 3).

    The first is no number where the acceleration before it is unknown, and so is the last.
    """
    if isinstance(shown, Smoothed):
        return shown.plan.motion().jerks()
    flown = shown.simulation.plan if isinstance(shown, TrueMotion) else shown
    return flown.motion().jerks()


def commands(shown: Drawn) -> tuple[FloatArray, FloatArray]:
    """Return the piecewise constant commanded accelerations.

    Returns:
        Times at which the pieces begin and end [s], shape (S + 1,), and accelerations [m/s²],
        shape (N, S, 3).
    """
    if isinstance(shown, TrueMotion):
        record = shown.simulation
        return record.times, np.swapaxes(record.commands[:-1], 0, 1)
    times = shown.times
    if isinstance(shown, Smoothed):
        count = (len(times) - 1) * _SMOOTH_PARTS + 1
        times = np.linspace(times[0], times[-1], count)
    return times, shown.motion().accelerations
