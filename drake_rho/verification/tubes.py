"""Error tubes around plans, flights and simulations, exact at every time.

The planner's margins are constant in each step (`drake_rho.planning.constraints.margins`); the
verifier uses none of them. It uses a tube's radii at single times, which are exact, and two
properties of the tube (`docs/flight.md`):

- the velocity's radius is convex in every sample of the feedback, and the feedback's radius is
  constant there, so both are largest at the ends of samples;
- ρ_p(t) + κ t²/2 is convex in a sample, with κ = ρ_u there. It is convex across samples too, with κ
  the largest ρ_u of them, because every response is continuously differentiable between samples and
  the second derivatives add up. So between two times w apart, ρ_p is above the line through its
  values by κ w²/8 at most.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Final, Self, get_args

import numpy as np

from drake_rho.motion.flown import Planned
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, eq=False)
class Tubes:
    """Sequence of tubes, each valid until the next one begins.

    At the time where one tube follows another, both hold, each for the errors from its own plan:
    constraints are checked there with the greater of the two radii. Where the motion jumps, the
    states after it have the later tube.
    """

    tubes: tuple[ErrorTube, ...]
    begins: FloatArray
    """time from which each tube is valid, on the scenario's clock [s], increasing, shape (T,)"""
    anew: BoolArray
    """whether the motion jumps where each tube begins, shape (T,)"""

    @staticmethod
    def of(flown: Planned) -> Tubes:
        """Return the tube of a plan or those of all windows; `NO_ERRORS` without a disturbance."""
        if flown.flight is None or flown.scenario.disturbance is None:
            return Tubes.of_plan(flown.scenario)
        grid = flown.scenario.grid
        knots = np.array([window.first_knot for window in flown.windows])
        tubes = tuple(tube_of(window.plan.scenario) for window in flown.windows)
        anew = np.isin(knots, flown.plan.jumps)
        return Tubes(tubes, grid.start + grid.elapsed[knots], anew)

    @staticmethod
    def of_plan(scenario: Scenario) -> Tubes:
        """Return the tube of a plan of a scenario; `NO_ERRORS` without a disturbance."""
        if scenario.disturbance is None:
            return NO_ERRORS
        start = np.array([scenario.grid.start])
        return Tubes((tube_of(scenario),), start, np.zeros(1, dtype=bool))

    @property
    def last(self) -> ErrorTube:
        """Tube at the end of the flight."""
        return self.tubes[-1]

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return radii at times on the scenario's clock, in the quantity's unit, shape (M,)."""
        later, earlier = self._number(times), self._number(times, -1)
        earlier = np.where(self.anew[later], later, earlier)
        return np.maximum(*(self._of(quantity, which, times) for which in (later, earlier)))

    def before(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return radii just before times on the scenario's clock, shape (M,)."""
        return self._of(quantity, self._number(times, -1), times)

    def position_in(self, times: FloatArray, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Return ρ_p [m] at times in intervals that have one tube each; arrays of one shape."""
        return self._of("position", self._number((begins + ends) / 2.0), times)

    def over(self, quantity: Quantity, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Return the greatest radii over intervals that have one tube each, shape (M,).

        Exact for velocity and feedback (acceleration), at most 1 % too large for positions.
        """
        numbers, greatest = self._number((begins + ends) / 2.0), np.empty(len(begins))
        for number in np.unique(numbers):
            here = numbers == number
            over = getattr(self.tubes[number], f"{quantity}_over")
            greatest[here] = over(begins[here], ends[here])
        return greatest

    def around(
        self, begins: FloatArray, durations: FloatArray, pieces: IntArray, vehicles: float
    ) -> ErrorRadii:
        """Return the radii of position errors in pieces of time that have one tube each.

        Args:
            begins: beginnings of J pieces on the scenario's clock [s], shape (J,).
            durations: their durations [s], shape (J,).
            pieces: piece of each step, with repetitions allowed, shape (M,).
            vehicles: factor on the radii: 1 for one vehicle, 2 for both vehicles of a pair.
        """
        curvatures = self.over("acceleration", begins, begins + durations) * durations**2

        def radii(steps: IntArray, u: FloatArray) -> FloatArray:
            first, lasts = begins[pieces[steps], None], durations[pieces[steps], None]
            shape = np.broadcast_shapes(first.shape, u.shape)
            ends = (np.broadcast_to(each, shape) for each in (first, first + lasts))
            return vehicles * self.position_in(first + np.clip(u, 0.0, 1.0) * lasts, *ends)

        return ErrorRadii(radii, vehicles * curvatures[pieces])

    def _number(self, times: FloatArray, side: int = 1) -> IntArray:
        """Return the index of the tube valid at each time.

        Where one tube follows another, it is the later one for `side` 1, the earlier one for -1.
        """
        clock = self.tubes[0].grid.clock
        places = (clock.last_begun if side > 0 else clock.last_before)(self.begins, times)
        return np.asarray(np.clip(places, 0, len(self.tubes) - 1))

    def _of(self, quantity: Quantity, numbers: IntArray, times: FloatArray) -> FloatArray:
        radii = np.empty(times.shape)
        for number in np.unique(numbers):
            here = numbers == number
            radii[here] = getattr(self.tubes[number], quantity)(times[here])
        return radii


@dataclasses.dataclass(frozen=True, eq=False)
class ConstantTubes(Tubes):
    """Tubes with the same radii at all times: the largest ones."""

    radii: Mapping[Quantity, float]
    """radii of position [m], velocity [m/s] and feedback [m/s²]"""

    @classmethod
    def with_radii(cls, radii: Mapping[Quantity, float]) -> Self:
        """Return tubes with given radii."""
        return cls((), np.zeros(0), np.zeros(0, dtype=bool), radii)

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return the constant radius at all times."""
        return self.radii[quantity] + np.zeros(times.shape)

    def before(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return the constant radius at all times."""
        return self.at(quantity, times)

    def position_in(self, times: FloatArray, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Return the constant position radius at all times."""
        return self.at("position", times)

    def over(self, quantity: Quantity, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Return the constant radius over all intervals."""
        return self.at(quantity, begins)

    def around(
        self, begins: FloatArray, durations: FloatArray, pieces: IntArray, vehicles: float
    ) -> ErrorRadii:
        """Return the constant position radius in all pieces."""
        radius = vehicles * self.radii["position"]
        return ErrorRadii(lambda _, u: radius + np.zeros(u.shape), np.zeros(len(pieces)))


NO_ERRORS: Final = ConstantTubes.with_radii(dict.fromkeys(get_args(Quantity), 0.0))
"""Tubes of vehicles that follow their motions exactly: of radius zero."""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorRadii:
    """Radii of the balls of errors around positions in steps, for `least_over_time`."""

    radii: Callable[[IntArray, FloatArray], FloatArray]
    """function of steps, shape (P,), and fractions of them, shape (P, S): radii [m], (P, S)"""
    curvatures: FloatArray
    """κ in each step: the radius plus κ u²/2 is convex in u [m per step²], shape (M,)"""

    @classmethod
    def constant(cls, errors: FloatArray) -> Self:
        """Return error radii that are constant in each step, shape (M,)."""
        return cls(lambda steps, u: errors[steps, None] + 0.0 * u, np.zeros(len(errors)))

    def select(self, which: IntArray) -> ErrorRadii:
        """Return the error radii of some of the steps, with repetitions allowed."""
        radii, curvatures = self.radii, self.curvatures[which]
        return ErrorRadii(lambda steps, u: radii(which[steps], u), curvatures)

    def plus_linear(self, begins: FloatArray, ends: FloatArray) -> ErrorRadii:
        """Return these radii plus others that are linear in each step.

        Args:
            begins: additional radii at the beginning of each step [m], shape (M,).
            ends: additional radii at the end of each step [m], shape (M,).
        """

        def radii(steps: IntArray, u: FloatArray) -> FloatArray:
            linear = begins[steps, None] + u * (ends - begins)[steps, None]
            return self.radii(steps, u) + linear

        return ErrorRadii(radii, self.curvatures)
