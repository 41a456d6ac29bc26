"""The motion to draw: of a plan, flight, simulation, trajectories, or a scenario not yet planned.

`drawn` turns each of these into one record, `Drawn`, for figures, Meshcat and the page.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import singledispatch

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.deviations import Deviations
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading, directions_of, headings_of
from drake_rho.motion.nearest_vehicles import closest_over_time
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario, Separation, Vehicle
from drake_rho.scenario.times import Clock
from drake_rho.scenario.waypoints import in_order

_MAX_PLANNED = 14
"""Largest number of vehicles whose plans are drawn beside their true motion."""
_PER_STEP = 12
"""Samples per step of the closest distance, unless the motion itself has finer steps."""
_SMOOTH_PARTS = 16
"""Steps in which a smooth motion is drawn, per step of the grid."""


@dataclasses.dataclass(frozen=True, eq=False)
class Drawn:
    """Motion of all vehicles of a scenario, with its plans and commands."""

    kind: str
    """kind of the drawn record: scenario, plan, flight, simulation or trajectories"""
    scenario: Scenario
    """scenario of the motion"""
    whole: Motion
    """motion from the first knot to the last, in steps of the grid or of equal parts of them"""
    stepwise: Motion
    """planned motion, in steps of the grid, before any smoothing"""
    jumps: tuple[int, ...] = ()
    """knots after the first one at which the motion jumps, as in a flight from measured states"""
    windows: tuple[Prediction, ...] = ()
    """predictions of the windows of a flight"""
    simulation: Simulation | None = None
    """simulation whose true motion this is, if any"""
    measured: Deviations | None = None
    """measured samples of a flight, drawn beside its motion, if any"""

    def motion(self) -> Motion:
        """Return the motion as a function of the time since the first knot."""
        return self.whole

    def headings(self, times: FloatArray, heading: Heading | None = None) -> FloatArray | None:
        """Return headings at times since the first knot [rad], shape (N, M); None without any.

        They are those given, or else the true ones of a simulation that was flown with some.

        Raises:
            ValueError: a given one is invalid.
        """
        if heading is None:
            return None if self.simulation is None else self.simulation.headings_at(times)

        def states(part: FloatArray) -> tuple[FloatArray, FloatArray]:
            return self.whole.at("position", part), self.whole.at("velocity", part)

        span = 0.0, float(self.whole.step) * self.whole.accelerations.shape[1]
        return headings_of(states, span, times, directions_of(self.scenario.names, heading))

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        return self.scenario.grid.times

    @property
    def positions(self) -> FloatArray:
        """Positions at the knots [m], shape (N, K, 3)."""
        return self.whole.positions[:, :: self._parts]

    @property
    def velocities(self) -> FloatArray:
        """Velocities at the knots [m/s], shape (N, K, 3)."""
        return self.whole.velocities[:, :: self._parts]

    @property
    def _parts(self) -> int:
        """Number of steps of the motion per step of the grid."""
        return round(self.scenario.grid.step / self.whole.step)

    @property
    def commands(self) -> tuple[FloatArray, FloatArray]:
        """Commanded accelerations, which are constant in steps.

        Times at which the steps begin and end [s], shape (S + 1,), and accelerations [m/s²], shape
        (N, S, 3).
        """
        if (record := self.simulation) is not None:
            return record.times, np.swapaxes(record.commands[:-1], 0, 1)
        steps = np.arange(self.whole.accelerations.shape[1] + 1)
        return self.scenario.grid.start + self.whole.step * steps, self.whole.accelerations

    @property
    def jerks(self) -> FloatArray:
        """Jerks of the planned motion at the knots [m/s³], shape (N, K, 3), NaN where unknown."""
        return self.stepwise.jerks()

    @property
    def planned(self) -> tuple[Prediction, ...]:
        """Predictions to draw beside the true motion of a simulation, which differs from them.

        There are none for many vehicles, whose lines would be indistinguishable.
        """
        few = len(self.scenario.vehicles) <= _MAX_PLANNED
        return self.windows if self.simulation is not None and few else ()

    def closest_two(self, separation: Separation) -> CloseApproaches:
        """Return the distance of the closest two vehicles over time, with its exact minima."""
        per_step = max(1, round(_PER_STEP / self._parts))
        return closest_over_time(self.whole, separation, per_step=per_step)


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of a window, and the part of the flight in which it is in force."""

    shown: Drawn
    """whole prediction"""
    first: int
    """knot of the flight at which it begins"""
    last: int
    """knot of the flight at which the next window takes over, or the last one"""
    braking: Drawn | None
    """braking motion of its contingency, if it has one"""

    @property
    def begin(self) -> float:
        """Time at which it begins, since the flight's first knot [s]."""
        return self.shown.scenario.grid.step * self.first

    def in_force(self, times: FloatArray) -> BoolArray:
        """Return whether it is in force at times since the prediction's first knot [s]."""
        step = self.shown.scenario.grid.step
        return ~Clock.of(step).after(times, step * (self.last - self.first))


@singledispatch
def drawn(flown: Flown | Scenario) -> Drawn:
    """Return the motion to draw.

    It is the true motion of a simulation, straight lines from starts through waypoints to goals for
    a scenario, and the smooth motion with smoothing.
    """
    raise NotImplementedError(f"flown: got a {type(flown).__name__}, expected a motion")


@drawn.register
def _(flown: Plan) -> Drawn:
    stepwise, jumps = flown.motion(), tuple(knot for knot in flown.jumps if knot > 0)
    whole = stepwise if flown.scenario.smoothing is None else _in_parts(flown)
    return Drawn("plan", flown.scenario, whole, stepwise, jumps)


@drawn.register
def _(flown: Flight) -> Drawn:
    windows = _predictions(flown.windows, flown.scenario.grid.knots - 1)
    motion, measured = drawn(flown.plan), Deviations.of(flown)
    return dataclasses.replace(motion, kind="flight", windows=windows, measured=measured)


@drawn.register
def _(flown: Simulation) -> Drawn:
    windows = _predictions(flown.windows, flown.scenario.grid.knots - 1)
    motions = _true_motion(flown), flown.plan.motion()
    return Drawn("simulation", flown.scenario, *motions, windows=windows, simulation=flown)


@drawn.register
def _(flown: Trajectories) -> Drawn:
    plan = flown.plan
    return Drawn(flown.kind, plan.scenario, _in_parts(flown), plan.motion())


@drawn.register
def _(flown: Scenario) -> Drawn:
    lines = _straight_lines(flown)
    return Drawn("scenario", flown, lines, lines)


def _predictions(windows: Sequence[Window], end: int) -> tuple[Prediction, ...]:
    """Return the predictions of a flight's windows; the last is in force until its end."""
    lasts = [*(window.first_knot for window in windows[1:]), end]
    return tuple(
        Prediction(
            drawn(window.plan),
            window.first_knot,
            last,
            None if window.braking is None else drawn(window.braking),
        )
        for window, last in zip(windows, lasts, strict=True)
    )


def _in_parts(flown: Plan | Trajectories) -> Motion:
    """Return a smooth motion in parts of steps with exact ends.

    What is before the first knot and after the last is omitted.
    """
    grid = flown.scenario.grid
    step, steps = grid.step / _SMOOTH_PARTS, _SMOOTH_PARTS * (grid.knots - 1)
    states = flown.sampled(np.asarray(step * np.arange(steps + 1), dtype=np.float64))
    p, v = states.positions, states.velocities
    unknown = np.full((len(p), 3), np.nan)
    return Motion(step, p, v, np.diff(v, axis=1) / step, unknown, unknown)


def _true_motion(simulation: Simulation) -> Motion:
    """Return the true motion of a simulation, in equal steps h, as many as its record has.

    For a point mass in a wind of at most W that changes within a step, the position error is below
    W h²/4; at the ends of the step it is zero.
    """
    grid, fleet = simulation.scenario.grid, simulation.scenario.fleet
    parts = max(1, round((len(simulation.times) - 1) / (grid.knots - 1)))
    step, steps = grid.step / parts, parts * (grid.knots - 1)
    times = np.asarray(step * np.arange(steps + 1), dtype=np.float64)
    p, v = simulation.states(grid.start + times)
    a = np.diff(v, axis=1) / step
    return Motion(step, p, v, a, fleet.accelerations_before, fleet.accelerations_after)


def goal_point(vehicle: Vehicle) -> list[FloatArray]:
    """Return the position of a goal in a list; empty for a set, which is drawn, or for none."""
    position = vehicle.goal.position
    return [position] if isinstance(position, np.ndarray) else []


def _straight_lines(scenario: Scenario) -> Motion:
    """Return the motion along straight lines from starts through waypoints to goals.

    Each vehicle moves along its lines at constant speeds that reach waypoints and goal in time.
    """
    grid, lines = scenario.grid, []
    for vehicle, goal in zip(scenario.vehicles, scenario.fleet.goal_positions, strict=True):
        ends = vehicle.start.position, goal
        if any(each.time is None for each in vehicle.waypoints):  # at a steady speed
            places = np.array([ends[0], *(each.position for each in vehicle.waypoints), ends[1]])
            gone = np.cumsum([0.0, *np.linalg.norm(np.diff(places, axis=0), axis=1)])
            times = grid.start + grid.duration * gone / max(gone[-1], 1e-300)
        else:
            passed = [one for one in in_order(vehicle) if grid.start < one[0] < grid.end]
            times = np.array([grid.start, *(time for time, _ in passed), grid.end])
            places = np.array([ends[0], *(each.position for _, each in passed), ends[1]])
        lines.append(np.stack([np.interp(grid.times, times, x) for x in places.T], axis=1))
    p = np.array(lines)
    steps = np.diff(p, axis=1) / grid.step
    v = np.concatenate([steps, steps[:, -1:]], axis=1)  # velocity of the last step once more
    unknown = np.full((len(p), 3), np.nan)
    return Motion(grid.step, p, v, np.zeros_like(steps), unknown, unknown)
