"""Record of a simulated flight in wind: true states, wind and commands."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from drake_rho.motion.flight import Flight, Sighting, Window
from drake_rho.motion.plan import Plan, summary
from drake_rho.motion.samples import Samples, times_of
from drake_rho.motion.scenario_tube import error_tube, tube_of
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described, ShownInNotebooks
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray, read_only
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, eq=False)
class Simulation(ShownInNotebooks, metaclass=Described):
    """Simulated flight of a scenario with a receding horizon and feedback.

    Command and wind are constant from each time to the next, so the motion of a point mass is
    known at every instant: its acceleration is the sum of both.

    Raises:
        ValueError: the times do not increase, or an array has a shape that does not match the times
            and the scenario, or a value that is not finite.
    """

    flight: Flight
    """planned windows; `flight.plan` joins the plan of each until the next one, and equals the
    flown motion only without wind"""
    times: FloatArray
    """times on the scenario's clock, from its first knot to its last [s], shape (M,)"""
    positions: FloatArray
    """true positions [m], shape (M, N, 3)"""
    velocities: FloatArray
    """true velocities [m/s], shape (M, N, 3)"""
    wind: FloatArray
    """acceleration by wind from each time to the next, the last one repeated [m/s²], shape
    (M, N, 3)"""
    commands: FloatArray
    """commanded accelerations, the sum of planned ones and feedback, from each time to the next,
    the last one repeated [m/s²], shape (M, N, 3)"""
    plant: str = "point mass"
    """simulated plant: a point mass, or the name of one that follows the commands less exactly"""
    elapsed: FloatArray | None = None
    """times since the first knot [s], shape (M,), exact even if a clock far from 0 rounds `times`;
    computed from these if not given"""
    lost: BoolArray | None = None
    """whether the measurement of each vehicle at each sample of the feedback was lost, shape
    (J, N); None if none was"""
    headings: FloatArray | None = None
    """true headings, counted from the x axis anticlockwise [rad], shape (M, N), without jumps of a
    whole turn; None if none were commanded"""
    commanded_headings: FloatArray | None = None
    """commanded headings [rad], shape (M, N); None if none were"""

    def __post_init__(self) -> None:
        times = read_only(self.times)
        if times.ndim != 1 or len(times) < 2 or not np.all(np.diff(times) > 0.0):
            expected_times = "two or more increasing times"
            raise ValueError(f"times: got shape {times.shape}, expected {expected_times}")
        object.__setattr__(self, "times", times)
        elapsed = read_only(times - times[0] if self.elapsed is None else self.elapsed)
        if elapsed.shape != times.shape or not np.all(np.diff(elapsed) > 0.0):
            increasing = f"increasing times of shape {times.shape}"
            raise ValueError(f"elapsed: got shape {elapsed.shape}, expected {increasing}")
        object.__setattr__(self, "elapsed", elapsed)
        if self.lost is not None:
            lost = np.array(self.lost, dtype=bool)
            if lost.ndim != 2 or lost.shape[1] != len(self.scenario.vehicles):
                each = f"one for each sample and of {len(self.scenario.vehicles)} vehicles"
                raise ValueError(f"lost: got shape {lost.shape}, expected {each}")
            lost.setflags(write=False)
            object.__setattr__(self, "lost", lost if lost.any() else None)
        expected = (len(times), len(self.scenario.vehicles), 3)
        for name in ("positions", "velocities", "wind", "commands"):
            array = read_only(getattr(self, name))
            if array.shape != expected:
                raise ValueError(f"{name}: got shape {array.shape}, expected {expected}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: got values that are not finite, expected finite ones")
            object.__setattr__(self, name, array)
        for name in ("headings", "commanded_headings"):
            self._check_headings(name, getattr(self, name))

    def _check_headings(self, name: str, given: FloatArray | None) -> None:
        """Check headings: given for all times and vehicles, or true and commanded ones not at all.

        Raises:
            ValueError: they are not.
        """
        if (self.headings is None) != (self.commanded_headings is None):
            raise ValueError("headings: got true or commanded ones alone, expected both or none")
        if given is not None:
            array, expected = read_only(given), self.positions.shape[:2]
            if array.shape != expected or not np.isfinite(array).all():
                wanted = f"finite ones of shape {expected}"
                raise ValueError(f"{name}: got shape {array.shape}, expected {wanted}")
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        """Return '<Simulation of courier: 1 vehicle, 41 knots; point mass, 2003 times>'."""
        return f"<Simulation of {summary(self.scenario)}; {self.plant}, {len(self.times)} times>"

    @property
    def scenario(self) -> Scenario:
        """The flown scenario."""
        return self.flight.scenario

    @property
    def kind(self) -> Literal["simulation"]:
        """Kind of the record."""
        return "simulation"

    @property
    def simulation(self) -> Simulation:
        """The simulation itself."""
        return self

    @property
    def plan(self) -> Plan:
        """Motion planned by the windows, each until the next, with jumps where they begin."""
        return self.flight.plan

    @property
    def windows(self) -> tuple[Window, ...]:
        """Windows of the flight, in the order of time."""
        return self.flight.windows

    @property
    def sightings(self) -> tuple[Sighting, ...]:
        """Obstacles that became known during the flight, in the order of time."""
        return self.flight.sightings

    @property
    def cost(self) -> float:
        """Performance index (13) of the planned accelerations [m²/s⁴]."""
        return self.flight.cost

    @property
    def statistics(self) -> Statistics:
        """Planning statistics of all windows together."""
        return self.flight.statistics

    @cached_property
    def tube(self) -> ErrorTube:
        """Error tube around a plan that is flown from start to end, without a new window."""
        return error_tube(self.scenario)

    @cached_property
    def accelerations(self) -> FloatArray:
        """True mean accelerations from each time to the next [m/s²], shape (M-1, N, 3)."""
        passed = np.diff(self._since_start)[:, None, None]
        return read_only(np.diff(self.velocities, axis=0) / passed)

    @cached_property
    def tracking_difference(self) -> FloatArray:
        """Largest deviation of each plant's acceleration from its command [m/s²], shape (N,).

        It is the largest norm of true acceleration less command and wind; for a point mass it is
        only rounding. `disturbance.acceleration` has to include it beside the wind.
        """
        deviations = self.accelerations - self.commands[:-1] - self.wind[:-1]
        return read_only(np.linalg.norm(deviations, axis=2).max(axis=0))

    @property
    def heading_errors(self) -> FloatArray | None:
        """Deviations of true headings from commanded ones [rad], shape (M, N); None without any."""
        if self.headings is None or self.commanded_headings is None:
            return None
        turns = self.headings - self.commanded_headings
        return np.abs(np.remainder(turns + np.pi, 2.0 * np.pi) - np.pi)

    def headings_at(self, elapsed: FloatArray) -> FloatArray | None:
        """Return true headings at times since the first knot [rad], (N, T); None without any."""
        if self.headings is None:
            return None
        return np.array([np.interp(elapsed, self._since_start, each) for each in self.headings.T])

    @checked
    def at(self, times: npt.ArrayLike, vehicle: str | None = None) -> Samples:
        """Return true positions, velocities and accelerations at times.

        Args:
            times: times on the scenario's clock [s], shape (T,), or a single one.
            vehicle: name of one vehicle; all vehicles if not given.

        Returns:
            A record with arrays of shape (N, T, 3), or (T, 3) for one vehicle. Accelerations are
            the mean ones from each recorded time to the next.

        Raises:
            ValueError: a time is outside the flight, or there is no such vehicle.
        """
        index = None if vehicle is None else self.scenario.index_of(vehicle)
        samples = self.sampled(times_of(self.scenario.grid, times))
        return samples if index is None else samples.of(index)

    def sampled(self, elapsed: FloatArray) -> Samples:
        """Return the true states at times since the first knot [s]."""
        times = self.scenario.grid.start + elapsed
        m = np.searchsorted(self._since_start, elapsed, side="right") - 1
        a = self.accelerations[np.clip(m, 0, len(self.times) - 2)]
        return Samples(self.scenario.names, times, *self.states(times), np.moveaxis(a, 0, 1))

    def states(self, times: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return true positions [m] and velocities [m/s] at times on the scenario's clock [s].

        Between two recorded times the position is the cubic Hermite interpolant, which is exact
        for constant accelerations.

        Args:
            times: shape (T,), or a single one.

        Returns:
            Two arrays of shape (N, T, 3).
        """
        times, record = self._elapsed_at(times), self._since_start
        m = np.clip(np.searchsorted(record, times, side="right") - 1, 0, len(record) - 2)
        length = (record[m + 1] - record[m])[:, None, None]
        s = (times - record[m])[:, None, None] / length
        p, q = self.positions[m], self.positions[m + 1]
        v, w = length * self.velocities[m], length * self.velocities[m + 1]
        b, c = 3.0 * (q - p) - 2.0 * v - w, 2.0 * (p - q) + v + w
        found = p + s * (v + s * (b + s * c)), (v + s * (2.0 * b + s * 3.0 * c)) / length
        return np.swapaxes(found[0], 0, 1), np.swapaxes(found[1], 0, 1)

    def nominal(self, quantity: Quantity, times: npt.ArrayLike | None = None) -> FloatArray:
        """Return the values planned by the window in force at each time.

        Args:
            quantity: position [m], velocity [m/s], acceleration [m/s²] or jerk [m/s³].
            times: on the scenario's clock [s], shape (T,), or a single one; the recorded times if
                not given.

        Returns:
            Values of shape (T, N, 3).
        """
        elapsed, h = self._elapsed_at(times), self.scenario.grid.step
        values = np.empty((len(elapsed), len(self.scenario.vehicles), 3))
        in_force = self._window_at(elapsed)
        for number in np.unique(in_force):
            window, here = self.windows[number], in_force == number
            found = window.plan.motion().at(quantity, elapsed[here] - h * window.first_knot)
            values[here] = np.moveaxis(found, 0, 1)
        return values

    def errors(self, quantity: Quantity = "position") -> FloatArray:
        """Return the norms of deviations from the plan in force, in m or m/s, shape (M, N).

        The deviation of the commanded acceleration is the feedback [m/s²].
        """
        true = {
            "position": self.positions,
            "velocity": self.velocities,
            "acceleration": self.commands,
        }
        _check_quantity(quantity)
        return np.asarray(np.linalg.norm(true[quantity] - self.nominal(quantity), axis=2))

    def radii(self, quantity: Quantity = "position") -> FloatArray:
        """Return upper bounds of `errors`, in the same units, shape (M,).

        They are the radii of the tube around the plan in force.
        """
        _check_quantity(quantity)
        values, in_force = np.empty(len(self.times)), self._window_at(self._since_start)
        for number in np.unique(in_force):
            here = in_force == number
            values[here] = getattr(self.tubes[number], quantity)(self.times[here])
        return values

    @cached_property
    def tubes(self) -> tuple[ErrorTube, ...]:
        """Error tubes around the plans of all windows."""
        tubes: list[ErrorTube] = []
        for window in self.windows:
            tube = tube_of(window.plan.scenario)
            same = bool(tubes) and (tube.grid, tube.initial) == (tubes[-1].grid, tubes[-1].initial)
            tubes.append(tubes[-1] if same else tube)
        return tuple(tubes)

    def in_force(self, times: npt.ArrayLike) -> IntArray:
        """Return the number, from 0, of the window in force at each time, shape (T,).

        At the beginning of a window, that window is in force.
        """
        return self._window_at(self._elapsed_at(times))

    @property
    def _since_start(self) -> FloatArray:
        """The field `elapsed`, which is not None after initialisation."""
        assert self.elapsed is not None  # noqa: S101  # set by __post_init__
        return self.elapsed

    def _window_at(self, elapsed: FloatArray) -> IntArray:
        """Return the number of the window in force at times since the first knot [s], (T,)."""
        grid = self.scenario.grid
        knots = np.array([window.first_knot for window in self.windows])
        return np.maximum(grid.clock.last_begun(grid.step * knots, elapsed), 0)

    def _elapsed_at(self, times: npt.ArrayLike | None) -> FloatArray:
        """Return times since the first knot [s], shape (T,), for times on the scenario's clock.

        None stands for the recorded times.
        """
        if times is None:
            return self._since_start
        return np.atleast_1d(np.asarray(times, dtype=np.float64)) - self.scenario.grid.start


def _check_quantity(quantity: str) -> None:
    """Check that a quantity has errors and radii: jerks have none."""
    if quantity not in ("position", "velocity", "acceleration"):
        expected = "position, velocity or acceleration"
        raise ValueError(f"quantity: got {quantity!r}, expected {expected}")
