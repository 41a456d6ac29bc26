"""The error tubes around what is flown, as the judge asks for them: exactly, at every time.

The planner's margins are constant in each step (`drake_rho.planning.constraints.margins`); the
judge uses none of them. It needs of a tube its radii at single times, which are exact, and two of
its properties (`docs/flight.md`):

- the radius of the velocity is convex in every sample of the feedback, and that of the feedback
  constant, so that both are largest at the ends of samples;
- ρ_p(t) + κ t²/2 is convex in a sample with κ = ρ_u there. It is across samples too, with κ the
  largest ρ_u of them: every response is smooth there, so that what bends it is added up. Between
  two times w apart ρ_p is thus above the line through its values by κ w²/8 at most.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Self

import numpy as np

from drake_rho.motion.plan import Flight, Plan
from drake_rho.motion.tube import ErrorTube, tube_of
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity


@dataclasses.dataclass(frozen=True, eq=False)
class Tubes:
    """Tubes that follow one another, each in force until the next one is.

    Where one follows another, errors are in the balls of both, around one plan each: constraints
    are kept there with the greater radius of the two.
    """

    tubes: tuple[ErrorTube, ...]
    begins: FloatArray
    """from when on each is in force, on the scenario's clock [s], rising, shape (T,)"""

    @classmethod
    def around(cls, flown: Plan | Flight) -> Self | None:
        """The tubes around a plan, or around what is flown of each window; None without one."""
        if flown.scenario.disturbance is None:
            return None
        if isinstance(flown, Plan):
            return cls((tube_of(flown.scenario),), np.array([flown.scenario.grid.start]))
        grid = flown.scenario.grid
        knots = np.array([window.first_knot for window in flown.windows])
        tubes = tuple(tube_of(window.plan.scenario) for window in flown.windows)
        return cls(tubes, grid.start + grid.elapsed[knots])

    @property
    def last(self) -> ErrorTube:
        """The tube at the end."""
        return self.tubes[-1]

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Radii at times on the scenario's clock, in the quantity's unit, shape (M,)."""
        return np.maximum(*(self._of(quantity, self._number(times, way), times) for way in (1, -1)))

    def position_in(self, times: FloatArray, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """ρ_p [m] at times in pieces of time that have one tube, all of them of one shape."""
        return self._of("position", self._number((begins + ends) / 2.0), times)

    def over(self, quantity: Quantity, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """No radius is greater in pieces of time that have one tube each, shape (M,).

        Exact for velocity and feedback (acceleration), at most 1 % too large for positions.
        """
        numbers, greatest = self._number((begins + ends) / 2.0), np.empty(len(begins))
        for number in np.unique(numbers):
            here = numbers == number
            over = getattr(self.tubes[number], f"{quantity}_over")
            greatest[here] = over(begins[here], ends[here])
        return greatest

    def _number(self, times: FloatArray, way: int = 1) -> IntArray:
        """Which tube is in force; where one follows another, the later one, or the earlier one."""
        near = self.tubes[0].grid.rounding
        places = np.searchsorted(self.begins, times + way * near, side="right") - 1
        return np.asarray(np.clip(places, 0, len(self.tubes) - 1))

    def _of(self, quantity: Quantity, numbers: IntArray, times: FloatArray) -> FloatArray:
        radii = np.empty(times.shape)
        for number in np.unique(numbers):
            here = numbers == number
            radii[here] = getattr(self.tubes[number], quantity)(times[here])
        return radii


@dataclasses.dataclass(frozen=True, eq=False)
class Around:
    """How large the ball of errors is around positions in steps, for `least_over_time`."""

    radii: Callable[[IntArray, FloatArray], FloatArray]
    """[m], shape (P, S), in steps, shape (P,), at parts of them that have passed, shape (P, S)"""
    bends: FloatArray
    """how much faster a radius grows less slowly, at most [m per step²], shape (M,)"""

    @classmethod
    def of(cls, tubes: Tubes, begins: FloatArray, durations: FloatArray, times: float) -> Self:
        """The balls of steps in time.

        Args:
            tubes: of one vehicle.
            begins: of each step on the scenario's clock [s], shape (M,).
            durations: of each step [s], shape (M,).
            times: how many of the balls count: one, or those of both vehicles of a pair.
        """
        different, which = np.unique(np.stack([begins, durations]), axis=1, return_inverse=True)
        begin, duration = different
        bends = tubes.over("acceleration", begin, begin + duration) * duration**2

        def radii(steps: IntArray, u: FloatArray) -> FloatArray:
            first, lasts = begins[steps, None], durations[steps, None]
            shape = np.broadcast_shapes(first.shape, u.shape)
            ends = (np.broadcast_to(each, shape) for each in (first, first + lasts))
            return times * tubes.position_in(first + u * lasts, *ends)

        return cls(radii, times * bends[which.reshape(-1)])
