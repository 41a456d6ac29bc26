"""How far vehicles can be off their plan: the error's exact reachable sets, balls over time.

The mathematics stands in `docs/flight.md`.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drake_rho.motion.gains import Loop, best_gains, borne, largest_wind
from drake_rho.motion.radii import Pieces, Radii
from drake_rho.motion.sampled_loop import Responses
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.disturbance import Disturbance, Tracking
from drake_rho.scenario.fields import FloatArray, IntArray, locked
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.records import Scenario

_ROUND = 32
"""Steps of which a multiple is computed where some are asked for."""

_SAMPLE = 1e-9
"""Part of a sample by which a time may be short of a sample and still count as that sample."""


class Greatest(NamedTuple):
    """Radii that are not exceeded in pieces of time that follow each other, of shape (M,)."""

    position: FloatArray
    """[m]"""
    velocity: FloatArray
    """[m/s]"""
    acceleration: FloatArray
    """of the feedback [m/s²]"""
    ends: FloatArray
    """those of the position just where pieces begin, and where the last one ends [m], (M + 1,)"""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorTube(metaclass=Described):
    """The radii of the balls in which the errors of position, velocity and feedback stay.

    Any error in its ball is reached by some wind and some errors of the estimate, at that time.

    Raises:
        ValueError: the initial radii are not two finite numbers of at least 0, or the gains are not
            two finite ones, or so unstable that errors grow beyond all numbers within the flight.
    """

    disturbance: Disturbance
    """what there is, and how the feedback is sampled"""
    grid: Grid
    """of the flight, or of a window"""
    gains: tuple[float, float] = (0.0, 0.0)
    """k_p [1/s²] and k_v [1/s]"""
    initial: tuple[float, float] = (0.0, 0.0)
    """largest norms of the errors of position [m] and velocity [m/s] at the first knot"""

    def __post_init__(self) -> None:
        if not _two_finite(self.initial) or min(self.initial) < 0.0:
            expected = "two finite radii, in m and m/s, of at least 0"
            raise ValueError(f"initial: got {self.initial!r}, expected {expected}")
        if not _two_finite(self.gains):
            raise ValueError(
                f"gains: got {self.gains!r}, expected two finite ones, in 1/s² and 1/s"
            )

    def __eq__(self, other: object) -> bool:
        """Whether all numbers are the same; records inside are not usable as keys."""
        return isinstance(other, ErrorTube) and self._numbers == other._numbers

    def __hash__(self) -> int:
        """Of its numbers."""
        return hash(self._numbers)

    @cached_property
    def _numbers(self) -> tuple[float, ...]:
        around, grid = self.disturbance, self.grid
        sizes = around.acceleration, around.position_error, around.velocity_error
        feedback = self.sample, around.delay, *self.gains, *self.initial
        return *sizes, *feedback, grid.start, grid.step, grid.knots

    @property
    def tracking(self) -> Tracking:
        """What a plan under way says of this tube."""
        position, velocity = self.initial
        return Tracking(self.grid.start, self.gains, position, velocity)

    @property
    def sample(self) -> float:
        """δ, the time from one sample of the feedback to the next [s]."""
        return self.disturbance.sample(self.grid)

    @property
    def samples(self) -> int:
        """How many samples there are in the flight."""
        return self.disturbance.samples(self.grid)

    @property
    def sizes(self) -> FloatArray:
        """Wind, errors of the estimate, errors at first, in m/s² (see `sampled_loop`), (5,)."""
        around, square, once = self.disturbance, self.sample**2, self.sample
        errors = around.position_error / square, around.velocity_error / once
        first = self.initial[0] / square, self.initial[1] / once
        return np.array([around.acceleration, *errors, *first])

    @cached_property
    def responses(self) -> Responses:
        """What each cause of an error does to it later."""
        k_p, k_v = self.gains
        scaled = k_p * self.sample**2, k_v * self.sample
        with np.errstate(over="ignore", invalid="ignore"):  # looked for below
            responses = Responses.of(scaled, self.disturbance.delay, self.samples)
        if not np.all(np.isfinite(responses.values)):
            raise ValueError(f"gains: got {self.gains}, expected some with which errors decay")
        return responses

    def position(self, times: npt.ArrayLike) -> FloatArray:
        """ρ_p [m] at times on the scenario's clock [s], any shape.

        Raises:
            ValueError: a time is outside the flight; `velocity` and `acceleration` raise it too.
        """
        return self._at("position", times) * self.sample**2

    def velocity(self, times: npt.ArrayLike) -> FloatArray:
        """ρ_v [m/s] at times on the scenario's clock [s], any shape."""
        return self._at("velocity", times) * self.sample

    def acceleration(self, times: npt.ArrayLike) -> FloatArray:
        """ρ_u [m/s²], that of the feedback, at times on the scenario's clock [s], any shape.

        At a sample it is that of the feedback that begins there.
        """
        return self._at("acceleration", times)

    def position_over(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """The largest ρ_p [m] in pieces of time, never too small, at most 1 % too large.

        Args:
            begins: on the scenario's clock [s], shape (M,).
            ends: not before they begin [s], shape (M,).

        Raises:
            ValueError: a time is outside the flight, or a piece ends before it begins; the other
                two raise it too.
        """
        return self._radii.position_over(self._pieces(begins, ends)) * self.sample**2

    def velocity_over(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """The largest ρ_v [m/s] in pieces of time, exactly; arguments as for `position_over`."""
        return self._radii.velocity_over(self._pieces(begins, ends)) * self.sample

    def acceleration_over(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> FloatArray:
        """The largest ρ_u [m/s²] in pieces of time, exactly; arguments as for `position_over`.

        The feedback that begins where a piece ends is not in it.
        """
        return self._radii.acceleration_over(self._pieces(begins, ends))

    def over_steps(self, first: int, count: int, pieces: int = 1) -> Greatest:
        """Return the greatest radii in steps of the grid, as those of `position_over` and its like.

        They are the same for all tubes that differ in when they begin and end, and are kept: a
        receding horizon has one such tube in every window.

        Args:
            first: step that the first of them is, counted from 0.
            count: of the steps.
            pieces: into how many equal pieces each step is cut.
        """
        steps = _ROUND * math.ceil((first + count) / _ROUND)  # so that few lengths are kept
        like = Grid(self.grid.step, steps + 1)
        known = _greatest(dataclasses.replace(self, grid=like), pieces)
        begin, end = pieces * first, pieces * (first + count)
        return Greatest(
            known.position[begin:end],
            known.velocity[begin:end],
            known.acceleration[begin:end],
            known.ends[begin : end + 1],
        )

    def located(self, times: npt.ArrayLike) -> tuple[IntArray, FloatArray]:
        """The samples, from 0, that times lie in or begin, and the parts of them that have passed.

        The end of the flight is that of its last sample.
        """
        passed = self._passed(times)
        j = np.minimum(np.floor(passed + self._slack).astype(np.int64), self.samples - 1)
        return j, _part(passed - j)

    def _passed(self, times: npt.ArrayLike) -> FloatArray:
        """Times since the first knot, in samples."""
        times = np.asarray(times, dtype=np.float64)
        passed = (times - self.grid.start) / self.sample
        slack = self._slack
        outside = ~((passed >= -slack) & (passed <= self.samples + slack))  # so is a NaN
        if np.any(outside):
            expected = f"a time from {clock_number(self.grid.start)} to {clock_time(self.grid.end)}"
            raise ValueError(f"times: got {times[outside][0]}, expected {expected}")
        return np.asarray(passed)

    def _pieces(self, begins: npt.ArrayLike, ends: npt.ArrayLike) -> Pieces:
        """Pieces of time in samples; one that ends where a sample begins ends in the one before."""
        begins, ends = np.broadcast_arrays(np.atleast_1d(begins), np.atleast_1d(ends))
        first, a = self.located(begins)
        passed = self._passed(ends)
        if np.any(ends < begins):
            i = int(np.argmax(ends < begins))
            raise ValueError(f"ends: got {ends[i]} for {begins[i]}, expected no earlier time")
        last = np.maximum(np.ceil(passed - self._slack).astype(np.int64) - 1, first)
        b = _part(passed - last)
        return Pieces(first, a, last, np.where(first == last, np.maximum(a, b), b))

    @cached_property
    def _slack(self) -> float:
        """Part of a sample that counts as none: what a clock far from zero is rounded to."""
        largest = max(abs(self.grid.start), abs(self.grid.end))
        return max(_SAMPLE, 8.0 * np.finfo(np.float64).eps * largest / self.sample)

    @cached_property
    def _radii(self) -> Radii:
        return Radii(self.responses, self.sizes)

    def _at(self, quantity: Quantity, times: npt.ArrayLike) -> FloatArray:
        """Radii in the units of the loop."""
        return self._radii.at(quantity, *self.located(times))


@checked
def error_tube(
    scenario: Scenario,
    initial: tuple[float, float] | None = None,
    *,
    gains: tuple[float, float] | None = None,
) -> ErrorTube:
    """Return the tube of a scenario's vehicles around any plan, with the best gains for it.

    Without a disturbance there is no feedback, and only an initial error is in the tube. Where the
    disturbance says how a plan is tracked (`Disturbance.tracking`), that is where its gains are
    from and, if no first errors are given, when the tube begins and with which.

    Args:
        scenario: what is asked.
        initial: largest norms of the errors of position [m] and velocity [m/s] at the first knot;
            none if not given, as vehicles begin exactly at their starts.
        gains: k_p [1/s²] and k_v [1/s], to keep those of another tube; searched if not given, so
            that the largest radius of the position is as small as can be while that of the feedback
            is at most its share of the tightest acceleration limit.

    Raises:
        ValueError: the initial radii are not two finite numbers that are not negative.

    Examples:
        >>> scenario = rho.load_scenario("courier")
        >>> tube = rho.error_tube(scenario)
        >>> print(f"{tube.position(scenario.grid.end):.3f} m")
        0.241 m
    """
    disturbance = scenario.disturbance or Disturbance(0.0)
    if (tracked := disturbance.tracking) is not None and gains is None:
        if initial is None:
            return _tracked(disturbance, tracked, scenario.grid)
        gains = tracked.gains
    tube = ErrorTube(disturbance, scenario.grid, gains or (0.0, 0.0), initial or (0.0, 0.0))
    if gains is not None or scenario.disturbance is None:
        return tube
    alpha, beta = best_gains(_loop(scenario, tube))
    return dataclasses.replace(tube, gains=(alpha / tube.sample**2, beta / tube.sample))


def tube_of(scenario: Scenario) -> ErrorTube:
    """Return the tube around a plan of a scenario, which may be under way: `error_tube`, kept.

    It is what planners keep clear of.
    """
    return _known(error_tube(scenario))


def _tracked(around: Disturbance, tracked: Tracking, grid: Grid) -> ErrorTube:
    """Return the tube that began where a plan did that is tracked."""
    before = round((grid.start - tracked.since) / grid.step)
    whole = grid if before == 0 else Grid(grid.step, grid.knots + before, tracked.since)
    return ErrorTube(around, whole, tracked.gains, (tracked.position, tracked.velocity))


@lru_cache(maxsize=64)
def _greatest(tube: ErrorTube, pieces: int) -> Greatest:
    """Return the greatest radii in all steps of a tube's grid, or in equal pieces of them."""
    times = tube.grid.step / pieces * np.arange(pieces * (tube.grid.knots - 1) + 1)
    begins, ends = times[:-1], np.minimum(times[1:], tube.grid.duration)
    times[-1] = tube.grid.duration
    return Greatest(
        locked(tube.position_over(begins, ends)),
        locked(tube.velocity_over(begins, ends)),
        locked(tube.acceleration_over(begins, ends)),
        locked(tube.position(times)),
    )


@lru_cache(maxsize=64)
def _known(tube: ErrorTube) -> ErrorTube:
    """The tube of these numbers that was asked for before, with all that it has computed."""
    return tube


@checked
def largest_disturbance(
    scenario: Scenario, position: float, initial: tuple[float, float] = (0.0, 0.0)
) -> float:
    """The largest W [m/s²] for which the tube's position radius stays within `position` [m].

    All else is as the scenario has it: errors of the estimate, delay, share, or the gains of its
    own `tracking`. Infinite only for an infinite radius; 0 where the errors alone are too much.

    Raises:
        ValueError: the scenario has no disturbance, or the radius is negative or no number.

    Examples:
        >>> print(f"{rho.largest_disturbance(rho.load_scenario('courier'), 0.5):.3f} m/s²")
        0.636 m/s²
    """
    if not position >= 0.0:
        raise ValueError(f"position: got {position}, expected a radius of at least 0 in m")
    if scenario.disturbance is None:
        raise ValueError("scenario.disturbance: got None, expected one to take the feedback from")
    if scenario.disturbance.tracking is not None:
        tube = error_tube(scenario, None if initial == (0.0, 0.0) else initial)
        loop = _loop(scenario, tube)._replace(limit=np.inf)
        return borne(loop, tube.responses, position / tube.sample**2)
    tube = ErrorTube(scenario.disturbance, scenario.grid, initial=initial)
    return largest_wind(_loop(scenario, tube), position / tube.sample**2)


def tightest_acceleration(scenario: Scenario) -> float:
    """The least bound on an acceleration that any vehicle has [m/s²]; infinite if none has one.

    Of the boxes' sides and of the largest norms.
    """
    bounds, norms = scenario.fleet.bounds("acceleration"), scenario.fleet.norms
    sides = [] if bounds is None else [np.abs(bounds.lower), np.abs(bounds.upper)]
    most = [norms["max_acceleration"].most] if "max_acceleration" in norms else []
    return min((float(each.min()) for each in (*sides, *most)), default=np.inf)


def _loop(scenario: Scenario, tube: ErrorTube) -> Loop:
    """What the gains are for."""
    limit = tube.disturbance.share * tightest_acceleration(scenario)
    W, E_p, E_v, r_p, r_v = map(float, tube.sizes)
    return Loop(tube.disturbance.delay, tube.samples, (W, E_p, E_v, r_p, r_v), limit)


def _two_finite(numbers: tuple[float, float]) -> bool:
    """Return whether these are two finite numbers."""
    return np.shape(numbers) == (2,) and all(map(math.isfinite, numbers))


def _part(passed: FloatArray) -> FloatArray:
    """Parts of samples, from 0 to 1; rounded, so that equal ones are known to be equal."""
    clipped = np.minimum(np.maximum(passed, 0.0), 1.0)
    return np.asarray(np.round(clipped, 12), dtype=np.float64)
