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

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Quantity, State


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

    def at(self, quantity: Quantity, times: npt.ArrayLike) -> FloatArray:
        """Exact position [m], velocity [m/s] or jerk [m/s³] at `times` [s].

        Times outside the flight follow its first or last step. Jerk is known at the knots that
        begin a step: its value at a time is that of the nearest of them.

        Args:
            quantity: which of the three.
            times: since the first knot, shape (M,) or a single one.

        Returns:
            Values of shape (..., M, 3).

        Raises:
            ValueError: the quantity is none of the three.
        """
        if quantity not in RESPONSES:
            raise ValueError(f"quantity: got {quantity!r}, expected one of {', '.join(RESPONSES)}")
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        last = self.accelerations.shape[-2] - 1
        if quantity == "jerk":
            return self._jerks()[..., np.clip(np.rint(times / self.step).astype(int), 0, last), :]
        k = np.clip((times / self.step).astype(int), 0, last)
        s = (times - k * self.step)[:, None]
        v, a = self.velocities[..., k, :], self.accelerations[..., k, :]
        velocities: FloatArray = v + s * a
        if quantity == "velocity":
            return velocities
        positions: FloatArray = self.positions[..., k, :] + s / 2 * (v + velocities)
        return positions

    def _jerks(self) -> FloatArray:
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


RESPONSES: dict[Quantity, Callable[[float, int, npt.ArrayLike], FloatArray]] = {
    "position": position_response,
    "velocity": velocity_response,
    "jerk": jerk_response,
}
"""The response of each quantity that `Motion.at` knows."""
