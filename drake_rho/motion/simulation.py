"""The record of a flight in wind: where the vehicles truly were, and what was commanded."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
import numpy.typing as npt

from drake_rho.motion.plan import Flight, told
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.tube import ErrorTube, error_tube, tube_of
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray, locked
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, eq=False)
class Simulation(metaclass=Described):
    """What came of a scenario when it was flown with a receding horizon and feedback.

    Between two times the command and the wind are constant, so that the motion of a point mass is
    known at every instant: its acceleration is the sum of both.

    Raises:
        ValueError: the times do not rise, or an array has another shape than they and the scenario
            ask for, or a value that is no finite number.
    """

    flight: Flight
    """the windows, which are what was to be flown; `flight.plan` repeats their accelerations from
    the start, so that it is what was flown only where there was no wind"""
    times: FloatArray
    """on the scenario's clock, from its first knot to its last [s], shape (M,)"""
    positions: FloatArray
    """true positions [m], shape (M, N, 3)"""
    velocities: FloatArray
    """true velocities [m/s], shape (M, N, 3)"""
    wind: FloatArray
    """from each time to the next, the last one repeated [m/s²], shape (M, N, 3)"""
    commands: FloatArray
    """accelerations commanded, planned and feedback together, from each time to the next, the last
    one repeated [m/s²], shape (M, N, 3)"""
    plant: str = "point mass"
    """what was flown: a point mass, or the name of a plant that follows the commands less well"""
    elapsed: FloatArray | None = None
    """times since the first knot [s], shape (M,): exact, where a clock far from 0 rounds `times`;
    taken from these if not given"""

    def __post_init__(self) -> None:
        times = locked(self.times)
        if times.ndim != 1 or len(times) < 2 or not np.all(np.diff(times) > 0.0):
            raise ValueError(f"times: got shape {times.shape}, expected two or more rising times")
        object.__setattr__(self, "times", times)
        elapsed = locked(times - times[0] if self.elapsed is None else self.elapsed)
        if elapsed.shape != times.shape or not np.all(np.diff(elapsed) > 0.0):
            rising = f"rising times of shape {times.shape}"
            raise ValueError(f"elapsed: got shape {elapsed.shape}, expected {rising}")
        object.__setattr__(self, "elapsed", elapsed)
        expected = (len(times), len(self.scenario.vehicles), 3)
        for name in ("positions", "velocities", "wind", "commands"):
            array = locked(getattr(self, name))
            if array.shape != expected:
                raise ValueError(f"{name}: got shape {array.shape}, expected {expected}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: got numbers that are not finite, expected finite ones")
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        """As in '<Simulation of courier: 1 vehicle, 41 knots; point mass, 2003 times>'."""
        return f"<Simulation of {told(self.scenario)}; {self.plant}, {len(self.times)} times>"

    @property
    def scenario(self) -> Scenario:
        """What was asked."""
        return self.flight.scenario

    @property
    def statistics(self) -> Statistics:
        """What planning took in all windows together."""
        return self.flight.statistics

    @cached_property
    def tube(self) -> ErrorTube:
        """Around a plan that is flown from the start to the end, without a new window."""
        return error_tube(self.scenario)

    @cached_property
    def accelerations(self) -> FloatArray:
        """True accelerations, the mean from each time to the next [m/s²], shape (M-1, N, 3)."""
        passed = np.diff(self._since_start)[:, None, None]
        return locked(np.diff(self.velocities, axis=0) / passed)

    @cached_property
    def tracking_difference(self) -> FloatArray:
        """By how much each plant did not do as commanded, at most [m/s²], shape (N,).

        The norm of true acceleration less command and wind; only rounding for a point mass. What is
        allowed for it belongs into `disturbance.acceleration`, beside the wind.
        """
        left = self.accelerations - self.commands[:-1] - self.wind[:-1]
        return locked(np.linalg.norm(left, axis=2).max(axis=0))

    def states(self, times: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """True positions [m] and velocities [m/s] at times on the scenario's clock [s].

        Between two times of the record they follow the cubics with the positions and velocities at
        both: exact for constant accelerations.

        Args:
            times: shape (T,), or one.

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
        """What was planned then by the window in force.

        Args:
            quantity: position [m], velocity [m/s], acceleration [m/s²] or jerk [m/s³].
            times: on the scenario's clock [s], shape (T,), or one; those of the record if not
                given.

        Returns:
            Values of shape (T, N, 3).
        """
        elapsed, h = self._elapsed_at(times), self.scenario.grid.step
        values = np.empty((len(elapsed), len(self.scenario.vehicles), 3))
        in_force = self._window_at(elapsed)
        for number in np.unique(in_force):
            window, here = self.flight.windows[number], in_force == number
            found = window.plan.motion().at(quantity, elapsed[here] - h * window.first_knot)
            values[here] = np.moveaxis(found, 0, 1)
        return values

    def errors(self, quantity: Quantity = "position") -> FloatArray:
        """How far the vehicles were off the plan in force, in m or m/s, shape (M, N).

        Of the acceleration it is the feedback [m/s²].
        """
        true = {
            "position": self.positions,
            "velocity": self.velocities,
            "acceleration": self.commands,
        }
        if quantity not in true:
            expected = "position, velocity or acceleration"
            raise ValueError(f"quantity: got {quantity!r}, expected {expected}")
        return np.asarray(np.linalg.norm(true[quantity] - self.nominal(quantity), axis=2))

    def radii(self, quantity: Quantity = "position") -> FloatArray:
        """The most that `errors` could have been, in the same units, shape (M,).

        Radii of the tube around the plan in force.
        """
        if quantity not in ("position", "velocity", "acceleration"):
            expected = "position, velocity or acceleration"
            raise ValueError(f"quantity: got {quantity!r}, expected {expected}")
        values, in_force = np.empty(len(self.times)), self._window_at(self._since_start)
        for number in np.unique(in_force):
            here = in_force == number
            values[here] = getattr(self.tubes[number], quantity)(self.times[here])
        return values

    @cached_property
    def tubes(self) -> tuple[ErrorTube, ...]:
        """The tube around the plan of each window."""
        tubes: list[ErrorTube] = []
        for window in self.flight.windows:
            tube = tube_of(window.plan.scenario)
            again = bool(tubes) and (tube.grid, tube.initial) == (tubes[-1].grid, tubes[-1].initial)
            tubes.append(tubes[-1] if again else tube)
        return tuple(tubes)

    def in_force(self, times: npt.ArrayLike) -> IntArray:
        """The number, from 0, of the window that is flown at each time, shape (T,).

        Where a window begins it is that one.
        """
        return self._window_at(self._elapsed_at(times))

    @property
    def _since_start(self) -> FloatArray:
        """`elapsed`, which is there by now."""
        assert self.elapsed is not None  # noqa: S101  # set when made
        return self.elapsed

    def _window_at(self, elapsed: FloatArray) -> IntArray:
        """The window in force at times since the first knot [s], shape (T,)."""
        grid = self.scenario.grid
        knots = np.array([window.first_knot for window in self.flight.windows])
        passed = (elapsed + grid.rounding) / grid.step
        return np.asarray(np.maximum(np.searchsorted(knots, passed, side="right") - 1, 0))

    def _elapsed_at(self, times: npt.ArrayLike | None) -> FloatArray:
        """Times of the clock since the first knot [s], shape (T,); those of the record for None."""
        if times is None:
            return self._since_start
        return np.atleast_1d(np.asarray(times, dtype=np.float64)) - self.scenario.grid.start
