"""The point mass with piecewise-constant acceleration: equations (1)-(2) and (10)-(11).

Between two knots the acceleration a[k] is constant, so (1)-(2) hold for a part of a step too:
everything here is exact at any time, not only at the knots.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Self

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.parts import Quantity, State


def acceleration_before(start: State) -> FloatArray:
    """The acceleration given just before the first knot [m/s²], shape (3,); NaN if it is free."""
    return np.full(3, np.nan) if start.acceleration is None else start.acceleration


def roll_out(
    position: FloatArray, velocity: FloatArray, accelerations: FloatArray, step: float
) -> tuple[FloatArray, FloatArray]:
    """Fly `accelerations` from a given state, by (1) and (2).

    Args:
        position: p[1] [m], shape (..., 3).
        velocity: v[1] [m/s], shape (..., 3).
        accelerations: a[1..K-1] [m/s²], shape (..., K-1, 3).
        step: h [s].

    Returns:
        Positions [m] and velocities [m/s] at the knots, each of shape (..., K, 3).
    """
    h, a = step, accelerations
    v = np.concatenate([velocity[..., None, :], h * a], axis=-2).cumsum(axis=-2)
    moves = h * v[..., :-1, :] + h**2 / 2 * a
    p = np.concatenate([position[..., None, :], moves], axis=-2).cumsum(axis=-2)
    return p, v


@dataclasses.dataclass(frozen=True)
class Motion:
    """The motion of one vehicle, or of several at once (leading axes of every array).

    Attributes:
        step: h [s].
        positions: at the knots [m], shape (..., K, 3).
        velocities: at the knots [m/s], shape (..., K, 3).
        accelerations: in the steps [m/s²], shape (..., K-1, 3).
        before: acceleration just before the first knot [m/s²], shape (..., 3); NaN where the first
            acceleration is free of it, so that the first knot has no jerk.
    """

    step: float
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    before: FloatArray

    @classmethod
    def from_start(cls, start: State, accelerations: FloatArray, step: float) -> Self:
        """The motion of one vehicle that flies `accelerations`, shape (K-1, 3), from `start`."""
        p, v = roll_out(start.position, start.velocity, accelerations, step)
        return cls(step, p, v, accelerations, acceleration_before(start))

    @classmethod
    def from_starts(cls, fleet: Fleet, accelerations: FloatArray, step: float) -> Self:
        """The motions of a scenario's vehicles that fly `accelerations`, shape (N, K-1, 3)."""
        p, v = roll_out(fleet.start_positions, fleet.start_velocities, accelerations, step)
        return cls(step, p, v, accelerations, fleet.accelerations_before)

    def with_accelerations(self, accelerations: FloatArray) -> Motion:
        """The motions that fly other accelerations from the same starts."""
        p, v = self.positions[..., 0, :], self.velocities[..., 0, :]
        p, v = roll_out(p, v, accelerations, self.step)
        return Motion(self.step, p, v, accelerations, self.before)

    def with_some(self, vehicles: IntArray, accelerations: FloatArray) -> Motion:
        """The same motions, but for some vehicles that fly other accelerations."""
        if len(vehicles) == len(self.accelerations):
            return self.with_accelerations(accelerations)
        every = np.array(self.accelerations)
        every[vehicles] = accelerations
        return self.with_accelerations(every)

    def of(self, vehicles: IntArray | slice) -> Motion:
        """The motions of some of the vehicles."""
        return Motion(
            self.step,
            self.positions[vehicles],
            self.velocities[vehicles],
            self.accelerations[vehicles],
            self.before[vehicles],
        )

    def at(self, quantity: Quantity, times: npt.ArrayLike) -> FloatArray:
        """Exact position [m], velocity [m/s], acceleration [m/s²] or jerk [m/s³] at `times` [s].

        Times outside the flight follow its first or last step. Acceleration and jerk are known at
        the knots that begin a step: their value at a time is that of the nearest of them.

        Args:
            quantity: which of the four.
            times: since the first knot, shape (M,) or a single one.

        Returns:
            Values of shape (..., M, 3).

        Raises:
            ValueError: the quantity is none of the four.
        """
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        return self._at(quantity, times, lambda array, k: array[..., k, :])

    def each_at(self, quantity: Quantity, vehicles: IntArray, times: FloatArray) -> FloatArray:
        """The same of one vehicle at each time: arrays of shape (M,) give values (M, 3)."""
        return self._at(quantity, times, lambda array, k: array[vehicles, k])

    def _at(
        self,
        quantity: Quantity,
        times: FloatArray,
        pick: Callable[[FloatArray, IntArray], FloatArray],
    ) -> FloatArray:
        if quantity not in RESPONSES:
            raise ValueError(f"quantity: got {quantity!r}, expected one of {', '.join(RESPONSES)}")
        last = self.accelerations.shape[-2] - 1
        if quantity in ("acceleration", "jerk"):
            k = np.minimum(np.maximum(np.rint(times / self.step).astype(int), 0), last)
            return pick(self.accelerations if quantity == "acceleration" else self.jerks(), k)
        k = np.minimum(np.maximum((times / self.step).astype(int), 0), last)
        s = (times - k * self.step)[:, None]
        v, a = pick(self.velocities, k), pick(self.accelerations, k)
        velocities: FloatArray = v + s * a
        if quantity == "velocity":
            return velocities
        positions: FloatArray = pick(self.positions, k) + s / 2 * (v + velocities)
        return positions

    def jerks(self) -> FloatArray:
        """j[k] (7) at the knots that begin a step [m/s³], shape (..., K-1, 3)."""
        a = self.accelerations
        before = np.where(np.isnan(self.before), a[..., 0, :], self.before)
        return np.diff(a, axis=-2, prepend=before[..., None, :]) / self.step


def velocity_response(step: float, knots: int, times: npt.ArrayLike) -> FloatArray:
    """What one unit of each acceleration adds to the velocity: (10) at any time.

    v(t) = v[1] + sum over j of response[t, j] a[j].

    Args:
        step: h [s].
        knots: K.
        times: since the first knot [s], shape (M,).

    Returns:
        The response [s], shape (M, K-1): how long a[j] has acted at t.
    """
    return np.clip(_since_start_of_steps(step, knots, times), 0.0, step)


def position_response(step: float, knots: int, times: npt.ArrayLike) -> FloatArray:
    """What one unit of each acceleration adds to the position: (11) at any time.

    p(t) = p[1] + t v[1] + sum over j of response[t, j] a[j]. With s the time since step j began,
    the response is s²/2 inside the step and h s - h²/2 after it.

    Args:
        step: h [s].
        knots: K.
        times: since the first knot [s], shape (M,).

    Returns:
        The response [s²], shape (M, K-1).
    """
    s = np.maximum(_since_start_of_steps(step, knots, times), 0.0)
    acted = np.minimum(s, step)
    response: FloatArray = acted * (s - acted / 2)
    return response


def _since_start_of_steps(step: float, knots: int, times: npt.ArrayLike) -> FloatArray:
    return np.asarray(times, dtype=np.float64)[:, None] - step * np.arange(knots - 1)


def jerk_response(step: float, knots: int, times: npt.ArrayLike) -> FloatArray:
    """What one unit of each acceleration adds to the jerk (7) at a knot.

    j[k] = (a[k] - a[k-1]) / h; the acceleration before the first knot is no part of it.

    Args:
        step: h [s].
        knots: K.
        times: of knots, since the first one [s], shape (M,).

    Returns:
        The response [1/s], shape (M, K-1).
    """
    k = np.rint(np.asarray(times) / step)[:, None]
    steps = np.arange(knots - 1)
    own, previous = (steps == k).astype(np.float64), (steps == k - 1).astype(np.float64)
    response: FloatArray = (own - previous) / step
    return response


def acceleration_response(step: float, knots: int, times: npt.ArrayLike) -> FloatArray:
    """What one unit of each acceleration adds to the acceleration at a knot: 1 to its own.

    Args:
        step: h [s].
        knots: K.
        times: of knots, since the first one [s], shape (M,).

    Returns:
        The response [1], shape (M, K-1).
    """
    k = np.rint(np.asarray(times) / step)[:, None]
    response: FloatArray = (np.arange(knots - 1) == k).astype(np.float64)
    return response


RESPONSES: dict[Quantity, Callable[[float, int, npt.ArrayLike], FloatArray]] = {
    "position": position_response,
    "velocity": velocity_response,
    "acceleration": acceleration_response,
    "jerk": jerk_response,
}
"""The response of each quantity that `Motion.at` knows."""
