"""Error tubes: exact reachable sets of tracking errors in wind, balls at every time.

`docs/flight.md` contains the mathematics.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drake_rho.motion.radii import Pieces, Radii
from drake_rho.motion.sampled_loop import Measurements, Responses
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.disturbance import Disturbance, Tracking
from drake_rho.scenario.fields import FloatArray, IntArray, read_only
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.times import Clock

_ROUND = 32
"""Cached radii are computed for a multiple of this number of steps."""


class Maximum(NamedTuple):
    """Upper bounds of the radii over M consecutive pieces of time, each of shape (M,)."""

    position: FloatArray
    """radii of the position [m]"""
    velocity: FloatArray
    """radii of the velocity [m/s]"""
    acceleration: FloatArray
    """radii of the feedback [m/s²]"""
    ends: FloatArray
    """radii of the position at the beginnings of the pieces and at the last end [m], (M + 1,)"""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorTube(metaclass=Described):
    """Radii of the balls that contain the errors of position, velocity and feedback.

    The balls are exact: some wind and some estimation errors lead to any error in a ball at its
    time.

    Raises:
        ValueError: the initial radii are not two finite numbers of at least 0, the gains are not
            two finite numbers, or they are so unstable that errors overflow within the flight.
    """

    disturbance: Disturbance
    """bounds of the disturbance, and sampling of the feedback, which predicts the state unless
    `prediction` is false"""
    grid: Grid
    """grid of the flight or of a window"""
    gains: tuple[float, float] = (0.0, 0.0)
    """gains of the feedback, k_p [1/s²] and k_v [1/s]"""
    initial: tuple[float, float] = (0.0, 0.0)
    """largest norms of the errors of position [m] and velocity [m/s] at the first knot"""

    def __post_init__(self) -> None:
        if not _two_finite(self.initial) or min(self.initial) < 0.0:
            expected = "two finite radii, in m and m/s, of at least 0"
            raise ValueError(f"initial: got {self.initial!r}, expected {expected}")
        if not _two_finite(self.gains):
            raise ValueError(
                f"gains: got {self.gains!r}, expected two finite numbers, in 1/s² and 1/s"
            )

    def __eq__(self, other: object) -> bool:
        """Return whether all numbers are equal, so that tubes, unlike records, are keys."""
        return isinstance(other, ErrorTube) and self._numbers == other._numbers

    def __hash__(self) -> int:
        """Return the hash of the numbers."""
        return hash(self._numbers)

    @cached_property
    def _numbers(self) -> tuple[float, ...]:
        bounds, grid = self.disturbance, self.grid
        sizes = bounds.acceleration, bounds.position_error, bounds.velocity_error
        feedback = self.sample, *self.measurements, *self.gains, *self.initial
        return *sizes, *feedback, grid.start, grid.step, grid.knots

    @property
    def tracking(self) -> Tracking:
        """The tube as the `tracking` of a plan under way."""
        position, velocity = self.initial
        predicted = self.measurements.predicted
        return Tracking(self.grid.start, self.gains, position, velocity, predicted)

    @property
    def sample(self) -> float:
        """Time δ from one sample of the feedback to the next [s]."""
        return self.disturbance.sample(self.grid)

    @property
    def samples(self) -> int:
        """Number of feedback samples in the flight."""
        return self.disturbance.samples(self.grid)

    @property
    def measurements(self) -> Measurements:
        """Measurements that the feedback of a sample is computed from."""
        given = self.disturbance
        return Measurements(given.delay, given.dropouts, given.prediction is not False)

    @property
    def sizes(self) -> FloatArray:
        """Sizes of wind, estimation and initial errors [m/s²] (see `sampled_loop`), shape (5,)."""
        bounds, square, once = self.disturbance, self.sample**2, self.sample
        errors = bounds.position_error / square, bounds.velocity_error / once
        initial = self.initial[0] / square, self.initial[1] / once
        return np.array([bounds.acceleration, *errors, *initial])

    @cached_property
    def responses(self) -> Responses:
        """Responses of the error to each of its causes."""
        k_p, k_v = self.gains
        scaled = k_p * self.sample**2, k_v * self.sample
        with np.errstate(over="ignore", invalid="ignore"):  # checked below
            responses = Responses.of(scaled, self.measurements, self.samples)
        if not np.all(np.isfinite(responses.values)):
            raise ValueError(f"gains: got {self.gains}, expected gains with which errors decay")
        return responses

    def position(self, times: npt.ArrayLike) -> FloatArray:
        """Return ρ_p [m] at times on the scenario's clock [s], any shape.

        Raises:
            ValueError: a time is outside the flight; `velocity` and `acceleration` raise it too.
        """
        return self._at("position", times) * self.sample**2

    def velocity(self, times: npt.ArrayLike) -> FloatArray:
        """Return ρ_v [m/s] at times on the scenario's clock [s], any shape."""
        return self._at("velocity", times) * self.sample

    def acceleration(self, times: npt.ArrayLike) -> FloatArray:
        """Return ρ_u [m/s²] at times on the scenario's clock [s], any shape.

        It is the radius of the feedback; at a sample, of the feedback that begins there.
        """
        return self._at("acceleration", times)

    def position_over(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return upper bounds of ρ_p [m] over pieces of time, at most 1 % too large, shape (M,).

        Args:
            begins: beginnings of the pieces on the scenario's clock [s], shape (M,).
            ends: their ends, not before the beginnings [s], shape (M,).

        Raises:
            ValueError: a time is outside the flight, or a piece ends before it begins;
                `velocity_over` and `acceleration_over` raise it too.
        """
        return self._radii.position_over(self._pieces(begins, ends)) * self.sample**2

    def velocity_over(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return the largest ρ_v [m/s] over pieces of time, exactly; see `position_over`."""
        return self._radii.velocity_over(self._pieces(begins, ends)) * self.sample

    def acceleration_over(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """Return the largest ρ_u [m/s²] over pieces of time, exactly; see `position_over`.

        The feedback that begins at the end of a piece does not belong to it.
        """
        return self._radii.acceleration_over(self._pieces(begins, ends))

    def over_steps(self, first: int, count: int, pieces: int = 1) -> Maximum:
        """Return the greatest radii over steps of the grid, as `position_over` and the others do.

        They are cached: tubes that differ only in their beginning and end, as those of the windows
        of a receding horizon, have the same radii.

        Args:
            first: first of the steps, counted from 0.
            count: number of steps.
            pieces: number of equal pieces into which each step is divided.
        """
        steps = _ROUND * math.ceil((first + count) / _ROUND)  # limits the number of cached lengths
        longer = Grid(self.grid.step, steps + 1)
        cached = _greatest(dataclasses.replace(self, grid=longer), pieces)
        begin, end = pieces * first, pieces * (first + count)
        return Maximum(
            cached.position[begin:end],
            cached.velocity[begin:end],
            cached.acceleration[begin:end],
            cached.ends[begin : end + 1],
        )

    def sample_at(self, times: npt.ArrayLike) -> tuple[IntArray, FloatArray]:
        """Return the samples, from 0, that contain times, and the elapsed parts of these samples.

        A sample contains its beginning; the last one also contains the end of the flight.
        """
        passed = self._passed(times)
        j = np.minimum(self._clock.whole(passed), self.samples - 1)
        return j, _part(passed - j)

    def _passed(self, times: npt.ArrayLike) -> FloatArray:
        """Return times since the first knot, in samples."""
        times = np.asarray(times, dtype=np.float64)
        passed = (times - self.grid.start) / self.sample
        outside = ~self._clock.within(passed, (0.0, self.samples))  # true for NaN
        if np.any(outside):
            expected = f"a time from {clock_number(self.grid.start)} to {clock_time(self.grid.end)}"
            raise ValueError(f"times: got {times[outside][0]}, expected {expected}")
        return np.asarray(passed)

    def _pieces(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> Pieces:
        """Return pieces of time in samples. An end between two samples is in the first."""
        begins, ends = np.broadcast_arrays(np.atleast_1d(begins), np.atleast_1d(ends))
        first, a = self.sample_at(begins)
        passed = self._passed(ends)
        if np.any(ends < begins):
            i = int(np.argmax(ends < begins))
            raise ValueError(f"ends: got {ends[i]}, expected no time before {begins[i]}")
        last = np.maximum(self._clock.whole_before(passed), first)
        b = _part(passed - last)
        return Pieces(first, a, last, np.where(first == last, np.maximum(a, b), b))

    @cached_property
    def _clock(self) -> Clock:
        """Clock for comparing times in samples."""
        return Clock.of(1.0, self.grid.start / self.sample, self.grid.end / self.sample)

    @cached_property
    def _radii(self) -> Radii:
        return Radii(self.responses, self.sizes)

    def _at(self, quantity: Quantity, times: npt.ArrayLike) -> FloatArray:
        """Return radii in the units of `sampled_loop`."""
        return self._radii.at(quantity, *self.sample_at(times))


@lru_cache(maxsize=64)
def _greatest(tube: ErrorTube, pieces: int) -> Maximum:
    """Return the greatest radii over all steps of a tube's grid, or over equal pieces of them."""
    times = tube.grid.step / pieces * np.arange(pieces * (tube.grid.knots - 1) + 1)
    begins, ends = times[:-1], np.minimum(times[1:], tube.grid.duration)
    times[-1] = tube.grid.duration
    return Maximum(
        read_only(tube.position_over(begins, ends)),
        read_only(tube.velocity_over(begins, ends)),
        read_only(tube.acceleration_over(begins, ends)),
        read_only(tube.position(times)),
    )


def _two_finite(numbers: tuple[float, float]) -> bool:
    """Return whether a value consists of two finite numbers."""
    return np.shape(numbers) == (2,) and all(map(math.isfinite, numbers))


def _part(passed: FloatArray) -> FloatArray:
    """Return parts of samples, clipped to 0 to 1 and rounded, so that equal parts compare equal."""
    clipped = np.minimum(np.maximum(passed, 0.0), 1.0)
    return np.asarray(np.round(clipped, 12), dtype=np.float64)
