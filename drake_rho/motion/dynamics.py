"""Dynamics of a point mass with piecewise constant acceleration: (1)-(2) and (10)-(11).

The acceleration a[k] is constant between two knots, so (1)-(2) also hold for a part of a step:
all results of this module are exact at any time, not only at the knots.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Self, get_args

import numpy as np
import numpy.typing as npt

from drake_rho.motion.polynomials import Polynomials
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.parts import REACHED, Quantity
from drake_rho.scenario.times import steps_begun

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_QUANTITIES = get_args(Quantity)


def roll_out(
    position: FloatArray, velocity: FloatArray, accelerations: FloatArray, step: float
) -> tuple[FloatArray, FloatArray]:
    """Integrate accelerations from a given state by (1) and (2).

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
    """Motion of one vehicle, or of several (leading axes of every array).

    Attributes:
        step: h [s].
        positions: at the knots [m], shape (..., K, 3).
        velocities: at the knots [m/s], shape (..., K, 3).
        accelerations: in the steps [m/s²], shape (..., K-1, 3).
        before: acceleration just before the first knot [m/s²], shape (..., 3); NaN where it is
            unknown, and with it the jerk there.
        after: the same just after the last knot [m/s²], shape (..., 3).
        flown: accelerations of the steps before the first knot that enter the averages [m/s²],
            shape (..., REACHED, 3); None for motions that begin at rest.
    """

    step: float
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    before: FloatArray
    after: FloatArray
    flown: FloatArray | None = None

    @classmethod
    def from_starts(cls, fleet: Fleet, accelerations: FloatArray, step: float) -> Self:
        """Return the motions of a fleet from its starts with `accelerations`, (N, K-1, 3)."""
        p, v = roll_out(fleet.start_positions, fleet.start_velocities, accelerations, step)
        ends = fleet.accelerations_before, fleet.accelerations_after
        return cls(step, p, v, accelerations, *ends, fleet.flown)

    @classmethod
    def in_pieces(
        cls,
        fleet: Fleet,
        accelerations: FloatArray,
        step: float,
        begins: Mapping[int, FloatArray],
    ) -> Self:
        """Return motions of a fleet that restart from given states at some knots.

        The arrays have the states after each such knot; those before follow from the step before.

        Args:
            fleet: with the starts, from which the motions begin unless states are given there.
            accelerations: in the steps [m/s²], shape (N, K-1, 3).
            step: h [s].
            begins: positions [m] and velocities [m/s], shape (N, 6), by knots counted from 0.
        """
        begins = {0: fleet.start_states} | dict(begins)
        knots = [*sorted(begins), accelerations.shape[1]]
        p, v = (np.empty((len(accelerations), knots[-1] + 1, 3)) for _ in range(2))
        for first, last in pairwise(knots):
            start, piece = begins[first], slice(first, last + 1)
            flown = accelerations[:, first:last]
            p[:, piece], v[:, piece] = roll_out(start[:, :3], start[:, 3:], flown, step)
        ends = fleet.accelerations_before, fleet.accelerations_after
        return cls(step, p, v, accelerations, *ends, fleet.flown)

    def with_accelerations(self, accelerations: FloatArray) -> Motion:
        """Return the motions with other accelerations from the same starts."""
        p, v = self.positions[..., 0, :], self.velocities[..., 0, :]
        p, v = roll_out(p, v, accelerations, self.step)
        return Motion(self.step, p, v, accelerations, self.before, self.after, self.flown)

    def with_vehicles(self, vehicles: IntArray, accelerations: FloatArray) -> Motion:
        """Return the motions with other accelerations of some vehicles.

        Args:
            vehicles: increasing indices, shape (P,).
            accelerations: of these vehicles [m/s²], shape (P, K-1, 3).
        """
        if len(vehicles) == len(self.accelerations):
            return self.with_accelerations(accelerations)
        return self.with_parts([(vehicles, accelerations)])

    def with_parts(self, parts: Iterable[tuple[IntArray, FloatArray]]) -> Motion:
        """Return the motions with other accelerations of the vehicles in each part.

        Args:
            parts: vehicles, shape (P,), and their accelerations [m/s²], shape (P, K-1, 3).
        """
        p, v, a = map(np.array, (self.positions, self.velocities, self.accelerations))
        for vehicles, accelerations in parts:
            start = self.positions[vehicles, 0], self.velocities[vehicles, 0]
            p[vehicles], v[vehicles] = roll_out(*start, accelerations, self.step)
            a[vehicles] = accelerations
        return Motion(self.step, p, v, a, self.before, self.after, self.flown)

    def subdivided(self, pieces: int) -> Motion:
        """Return the same motions with each step divided into equal pieces.

        The jerks of the result differ from those of the motion, since accelerations change only at
        the beginnings of whole steps.
        """
        if pieces == 1:
            return self
        if pieces not in self._subdivided:
            self._subdivided[pieces] = self._in_pieces(pieces)
        return self._subdivided[pieces]

    @cached_property
    def _subdivided(self) -> dict[int, Motion]:
        """Motions with divided steps, by the number of pieces: several constraints need them."""
        return {}

    def _in_pieces(self, pieces: int) -> Motion:
        """Return the same motions with each step divided."""
        s = self.step / pieces * np.arange(pieces)[:, None]
        p, v, a = (
            each[..., : self.accelerations.shape[-2], None, :]
            for each in (self.positions, self.velocities, self.accelerations)
        )
        states = [p + s * (v + s / 2.0 * a), v + s * a]
        flat = (*self.accelerations.shape[:-2], -1, 3)
        positions, velocities = (
            np.concatenate([each.reshape(flat), last[..., -1:, :]], axis=-2)
            for each, last in zip(states, (self.positions, self.velocities), strict=True)
        )
        repeated = np.repeat(self.accelerations, pieces, axis=-2)
        ends = self.before, self.after
        return Motion(self.step / pieces, positions, velocities, repeated, *ends, self.flown)

    def of(self, vehicles: IntArray | slice | int) -> Motion:
        """Return the motions of some of the vehicles, or the motion of one."""
        return Motion(
            self.step,
            self.positions[vehicles],
            self.velocities[vehicles],
            self.accelerations[vehicles],
            self.before[vehicles],
            self.after[vehicles],
            None if self.flown is None else self.flown[vehicles],
        )

    def at(self, quantity: Quantity, times: npt.ArrayLike) -> FloatArray:
        """Return the exact position [m], velocity [m/s], acceleration [m/s²] or jerk [m/s³].

        The first or last step is extrapolated to times outside the flight. Accelerations are those
        of the step that contains a time; at a knot, of the step that begins there. Jerks are those
        of the last knot at or before a time, NaN where the acceleration outside the flight is
        unknown.

        Args:
            quantity: one of the four.
            times: since the first knot [s], shape (M,) or a single one.

        Returns:
            Values of shape (..., M, 3).

        Raises:
            ValueError: the quantity is none of the four.
        """
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        return self._at(quantity, times, lambda array, k: array[..., k, :])

    def each_at(self, quantity: Quantity, vehicles: IntArray, times: FloatArray) -> FloatArray:
        """Return `at` for one vehicle per time: indices and times (M,) give values (M, 3)."""
        return self._at(quantity, times, lambda array, k: vectors_of(array, vehicles, k))

    def _at(
        self,
        quantity: Quantity,
        times: FloatArray,
        pick: Callable[[FloatArray, IntArray], FloatArray],
    ) -> FloatArray:
        if quantity not in _QUANTITIES:
            expected = f"one of {', '.join(_QUANTITIES)}"
            raise ValueError(f"quantity: got {quantity!r}, expected {expected}")
        last = self.accelerations.shape[-2] - 1
        k = np.maximum(steps_begun(times, self.step), 0)
        if quantity == "jerk":
            return pick(self.jerks(), np.minimum(k, last + 1))
        k = np.minimum(k, last)
        if quantity == "acceleration":
            return pick(self.accelerations, k)
        s = (times - k * self.step)[:, None]
        if quantity == "position" and not s.any():  # all times are knots, the most frequent case
            return pick(self.positions, k)
        v, a = pick(self.velocities, k), pick(self.accelerations, k)
        velocities: FloatArray = v + s * a
        if quantity == "velocity":
            return velocities
        positions: FloatArray = pick(self.positions, k) + s / 2 * (v + velocities)
        return positions

    def states(self, elapsed: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions [m], velocities [m/s] and accelerations [m/s²], (..., M, 3) each.

        Args:
            elapsed: times since the first knot [s], shape (M,). At knots, positions and velocities
                are those of the arrays.
        """
        p, v, a = (self.at(each, elapsed) for each in ("position", "velocity", "acceleration"))
        knots = self.step * np.arange(self.positions.shape[-2])
        k = np.minimum(np.searchsorted(knots, elapsed), len(knots) - 1)
        there = knots[k] == elapsed
        p[..., there, :] = self.positions[..., k[there], :]
        v[..., there, :] = self.velocities[..., k[there], :]
        return p, v, a

    def polynomials(self) -> Polynomials:
        """Return the motions, arrays (N, ..., 3), as polynomials of degree 2 in every step."""
        p, v, a = self.positions[:, :-1], self.velocities[:, :-1], self.accelerations
        knots: FloatArray = np.float64(self.step) * np.arange(self.positions.shape[1])
        return Polynomials(knots, np.stack([p, v, a / 2], axis=-1))

    @property
    def earlier(self) -> FloatArray:
        """Accelerations of steps before the first knot [m/s²], (N, REACHED, 3); zero at rest."""
        at_rest = np.zeros((len(self.positions), REACHED, 3))
        return at_rest if self.flown is None else self.flown

    def flown_until(self, knot: int) -> FloatArray:
        """Return accelerations before a knot that enter the averages [m/s²], (N, REACHED, 3)."""
        accelerations = np.concatenate([self.earlier, self.accelerations], axis=1)
        return accelerations[:, knot : knot + REACHED]

    def values(self, quantity: Quantity) -> FloatArray:
        """Return a quantity at the knots, (..., K, 3), or accelerations in steps, (..., K-1, 3)."""
        if quantity == "jerk":
            return self.jerks()
        return {
            "position": self.positions,
            "velocity": self.velocities,
            "acceleration": self.accelerations,
        }[quantity]

    def jerks(self) -> FloatArray:
        """Return j[k] (7) at the knots [m/s³], shape (..., K, 3).

        The first is the jerk from the acceleration before the first step, the last that to the
        acceleration after the last step; NaN where this acceleration is unknown.
        """
        ends = self.before[..., None, :], self.after[..., None, :]
        return np.diff(self.accelerations, axis=-2, prepend=ends[0], append=ends[1]) / self.step


def vectors_of(array: FloatArray, vehicles: IntArray, k: IntArray) -> FloatArray:
    """Return array[vehicles, k], shape (M, 3), but five times as fast where M is large.

    Args:
        array: K vectors of every vehicle, shape (N, K, 3).
        vehicles: indices of vehicles, shape (M,).
        k: indices of vectors, none below 0, shape (M,).
    """
    if not array.flags.c_contiguous:
        return array[vehicles, k]
    vectors: FloatArray = array.reshape(-1, 3).take(vehicles * array.shape[1] + k, axis=0)
    return vectors


ORDERS: dict[Quantity, int] = {"position": 2, "velocity": 1, "acceleration": 0}
"""Number of integrations from the acceleration to each quantity."""


def response(quantity: Quantity, step: float, knots: int, times: npt.ArrayLike) -> FloatArray:
    """Return the response of a quantity to one unit of each acceleration, (10)-(11) at any time.

    With the time s since the beginning of step j and its positive part s+, a unit of a[j] adds
    (s+^m - (s - h)+^m) / m! to the position (m = 2), the velocity (m = 1) and, continuous from the
    right, the acceleration (m = 0). Its contribution to the jerk (7) is the difference of two
    accelerations, a step apart, over h. Contributions of the state at the first knot and of the
    accelerations outside of the flight are not included.

    Args:
        quantity: position, velocity, acceleration or jerk.
        step: h [s].
        knots: K.
        times: since the first knot [s], shape (M,).

    Returns:
        The response, in the quantity's unit over m/s², shape (M, K-1).
    """
    h, times = step, np.asarray(times, dtype=np.float64)
    if quantity == "jerk":
        k = step_at(times, h)[:, None] - np.arange(knots - 1)
        jerk: FloatArray = ((k == 0).astype(np.float64) - (k == 1)) / h
        return jerk
    m, s = ORDERS[quantity], times[:, None] - h * np.arange(knots - 1)
    if m == 0:
        acts: FloatArray = (step_at(times, h)[:, None] == np.arange(knots - 1)).astype(np.float64)
        return acts
    # time during which a[j] has acted: s+ - (s - h)+
    acted: FloatArray = np.minimum(np.maximum(s, 0.0), h)
    if m == 1:
        return acted
    position: FloatArray = s  # in place, since there may be many rows
    position -= acted / 2.0
    position *= acted  # equal to the formula above, but without cancellation
    return position


def sparse_response(quantity: Quantity, step: float, knots: int, times: FloatArray) -> csr_array:
    """Return `response` as a sparse array; acceleration and jerk have one or two entries a row."""
    from scipy.sparse import csr_array  # imported here: slow to load

    if quantity not in ("acceleration", "jerk"):
        return csr_array(response(quantity, step, knots, times))
    count, k = len(times), step_at(times, step)
    entries, indices = [np.ones(count)], [np.stack([np.arange(count), k])]
    if quantity == "jerk":
        later, earlier = np.flatnonzero(k < knots - 1), np.flatnonzero(k > 0)
        entries = [np.full(len(later), 1.0 / step), np.full(len(earlier), -1.0 / step)]
        indices = [np.stack([later, k[later]]), np.stack([earlier, k[earlier] - 1])]
    where = np.concatenate(indices, axis=1)
    return csr_array((np.concatenate(entries), tuple(where)), shape=(count, knots - 1))


def step_at(times: FloatArray, step: float) -> IntArray:
    """Return the number of the step, from 0, that contains or begins at each time; not clipped."""
    return steps_begun(times, step)
