"""Piecewise trajectories: the motions of all vehicles and the error tubes around them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from math import comb

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import Clock
from drake_rho.verification.jerks import Jerks
from drake_rho.verification.steps import Steps, powers_of, without_higher
from drake_rho.verification.tubes import NO_ERRORS, ErrorRadii, Tubes


@dataclasses.dataclass(frozen=True, eq=False)
class PiecewiseTrajectory:
    """Motions in J pieces of time, the same for all vehicles.

    The state at an instant is the initial state of the piece that begins there, and the end of the
    piece before unless the motion jumps.

    Accelerations are constant in each piece; those of smooth motions are polynomials in time.
    """

    scenario: Scenario
    """scenario whose constraints are verified"""
    elapsed: FloatArray
    """instants at which pieces begin and end, since the first knot [s], shape (J + 1,)"""
    durations: FloatArray
    """durations of the pieces [s], shape (J,)"""
    knots: BoolArray
    """flags of instants that are knots, shape (J + 1,)"""
    positions: FloatArray
    """positions at the instants [m], shape (N, J + 1, 3)"""
    velocities: FloatArray
    """velocities at the instants [m/s], shape (N, J + 1, 3)"""
    accelerations: FloatArray
    """accelerations in the pieces, or at their beginnings [m/s²], shape (N, J, 3)"""
    commands: FloatArray
    """commanded accelerations, to which the limits apply [m/s²], shape (N, J, 3)"""
    higher: FloatArray
    """coefficients of positions as polynomials of the time since a piece began, from the third
    power up [m/s³], …, shape (N, J, n, 3); n is 0 where accelerations are constant in pieces"""
    jerks: Jerks
    """jerks of the plan at the knots"""
    tubes: Tubes
    """error tubes around these motions; `NO_ERRORS` if vehicles follow them exactly"""
    jumps: IntArray
    """indices of instants at which the motion jumps to measured states, shape (S,)"""

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        motion: Motion,
        tubes: Tubes = NO_ERRORS,
        jumps: Sequence[int] = (),
    ) -> PiecewiseTrajectory:
        """Return the trajectory of a motion on a scenario's grid, whose steps are the pieces.

        Args:
            scenario: scenario whose constraints are verified.
            motion: motion of all vehicles.
            tubes: error tubes, if vehicles do not follow the motion exactly.
            jumps: knots, from 0, at which the motion jumps to another state.
        """
        grid = scenario.grid
        return cls.of_pieces(
            scenario,
            grid.elapsed,
            np.full(grid.knots - 1, grid.step),
            np.ones(grid.knots, dtype=bool),
            (motion.positions, motion.velocities, motion.accelerations),
            Jerks.of(scenario, motion.accelerations),
            tubes=tubes,
            jumps=jumps,
        )

    @classmethod
    def of_pieces(
        cls,
        scenario: Scenario,
        elapsed: FloatArray,
        durations: FloatArray,
        knots: BoolArray,
        states: tuple[FloatArray, FloatArray, FloatArray],
        jerks: Jerks,
        *,
        commands: FloatArray | None = None,
        tubes: Tubes = NO_ERRORS,
        jumps: Sequence[int] = (),
    ) -> PiecewiseTrajectory:
        """Return the trajectory of motions with constant accelerations in pieces.

        Args:
            scenario: scenario whose constraints are verified.
            elapsed: instants, as the field.
            durations: durations of the pieces, as the field.
            knots: flags of the instants that are knots.
            states: positions, velocities and accelerations, as the fields.
            jerks: jerks of the plan at the knots.
            commands: commanded accelerations, if they are not those of the motion.
            tubes: error tubes, if vehicles do not follow the motion exactly.
            jumps: instants, from 0, at which the motion jumps to another state.
        """
        commands = states[2] if commands is None else commands
        none, at = without_higher(states[2]), np.array(jumps, dtype=np.int64)
        return cls(scenario, elapsed, durations, knots, *states, commands, none, jerks, tubes, at)

    @property
    def is_smooth(self) -> bool:
        """Whether accelerations change during pieces."""
        return bool(self.higher.shape[2] > 0)

    @property
    def has_errors(self) -> bool:
        """Whether vehicles may be off these motions."""
        return self.tubes is not NO_ERRORS

    @cached_property
    def times(self) -> FloatArray:
        """Instants on the scenario's clock [s], shape (J + 1,)."""
        return np.asarray(self.scenario.grid.start + self.elapsed)

    @cached_property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Positions [m] and velocities [m/s] at the ends of the pieces, (N, J, 3) each."""
        if len(self.jumps) == 0:
            return self.positions[:, 1:], self.velocities[:, 1:]
        p, v = np.array(self.positions[:, 1:]), np.array(self.velocities[:, 1:])
        k = self.last_before_jumps
        s, a, higher = self.durations[k, None], self.accelerations[:, k], self.higher[:, k]
        added = powers_of(s[..., None], higher)
        p[:, k] = self.positions[:, k] + s * (self.velocities[:, k] + s / 2.0 * a)
        v[:, k] = self.velocities[:, k] + s * a
        p[:, k] += added.sum(axis=2)
        v[:, k] += np.einsum("njmx,m->njx", added, 3.0 + np.arange(added.shape[2])) / s
        return p, v

    @property
    def last_before_jumps(self) -> IntArray:
        """Indices of the pieces that end at a jump, at most S of them."""
        return self.jumps[self.jumps > 0] - 1

    @cached_property
    def steps(self) -> Steps:
        """Pieces of all vehicles, vehicle by vehicle."""
        return self.steps_of(self.positions, self.velocities, self.accelerations, self.higher)

    def steps_of(
        self, p: FloatArray, v: FloatArray, a: FloatArray, higher: FloatArray | None = None
    ) -> Steps:
        """Return the pieces of other motions on the same instants.

        Args:
            p: positions at the instants, shape (..., J + 1, D).
            v: velocities at the instants, shape (..., J + 1, D).
            a: accelerations in the pieces, shape (..., J, D).
            higher: coefficients of higher powers, if any, shape (..., J, n, D).
        """
        return Steps.of(self.durations[:, None], p, v, a, higher)

    def derivatives(self, order: int) -> Steps:
        """Return velocities (1), accelerations (2) or jerks (3) of smooth motions as curves."""
        return self.steps.derivative(order, np.tile(self.durations, len(self.positions)))

    def each_at(self, vehicles: IntArray, times: FloatArray) -> FloatArray:
        """Return the position of one vehicle at each of M times on the scenario's clock, (M, 3)."""
        times = self.scenario.grid.since_start(times)
        k = Clock.of(self.durations.min()).last_begun(self.elapsed, times)
        k = np.clip(k, 0, len(self.durations) - 1)
        s = (times - self.elapsed[k])[:, None]
        v = self.velocities[vehicles, k]
        velocities = v + s * self.accelerations[vehicles, k]
        positions = self.positions[vehicles, k] + s / 2 * (v + velocities)
        positions += powers_of(s[..., None], self.higher[vehicles, k]).sum(axis=1)
        return np.asarray(positions)

    def cut(self, times: FloatArray) -> PiecewiseTrajectory:
        """Return this trajectory with its pieces cut at times since the first knot [s]."""
        times = times[(times > self.elapsed[0]) & (times < self.elapsed[-1])]
        if len(times) == 0:
            return self
        instants = np.union1d(self.elapsed, times)
        k = np.searchsorted(self.elapsed, instants, side="right") - 1
        knots = (self.elapsed[k] == instants) & self.knots[k]
        k = np.minimum(k, len(self.durations) - 1)  # no piece begins at the last instant
        s = (instants - self.elapsed[k])[:, None]
        lower = [self.positions[:, k], self.velocities[:, k], self.accelerations[:, k] / 2.0]
        c = np.stack([*lower, *np.moveaxis(self.higher[:, k], 2, 0)])
        p, v, a, *higher = (
            np.sum([comb(m, i) * s ** (m - i) * c[m] for m in range(i, len(c))], axis=0)
            for i in range(len(c))
        )
        return dataclasses.replace(
            self,
            elapsed=instants,
            durations=np.diff(instants),
            knots=knots,
            positions=p,
            velocities=v,
            accelerations=2.0 * a[:, :-1],
            commands=2.0 * a[:, :-1] + (self.commands - self.accelerations)[:, k[:-1]],
            higher=np.reshape(higher, (len(higher), *p.shape)).transpose(1, 2, 0, 3)[:, :-1],
            jumps=np.searchsorted(instants, self.elapsed[self.jumps]),
        )

    def moments(self, pieces: IntArray, parts: FloatArray) -> FloatArray:
        """Return times since the first knot [s] from pieces and fractions of them, of one shape."""
        return np.asarray(self.elapsed[pieces] + parts * self.durations[pieces])

    def errors(self, instants: BoolArray | None = None) -> FloatArray:
        """Return ρ_p at all instants, (J + 1,), or at those selected [m]."""
        return self.tubes.at("position", self.times if instants is None else self.times[instants])

    @cached_property
    def errors_over(self) -> FloatArray:
        """Upper bound of ρ_p in each piece [m], shape (J,)."""
        return self.tubes.over("position", self.times[:-1], self.times[1:])

    @cached_property
    def feedback(self) -> FloatArray:
        """Largest feedback ρ_u in each piece [m/s²], shape (J,)."""
        return self.tubes.over("acceleration", self.times[:-1], self.times[1:])

    def errors_of(self, order: int) -> FloatArray:
        """Return the largest error radius of a derivative in each piece, in its unit, (J,).

        Args:
            order: 0 for positions, 1 for velocities, 2 for accelerations, 3 for jerks, which have
                no errors.
        """
        if order == 3:
            return np.zeros(len(self.durations))
        if order == 1:
            return self.tubes.over("velocity", self.times[:-1], self.times[1:])
        return self.feedback if order == 2 else self.errors_over

    def error_radii(self, pieces: IntArray, vehicles: float = 1.0) -> ErrorRadii:
        """Return the error radii of positions in pieces.

        Args:
            pieces: indices of pieces, with repetitions allowed, shape (M,).
            vehicles: number of vehicles whose radii are added: 1, or 2 for a pair.
        """
        return self.tubes.around(self.times[:-1], self.durations, pieces, vehicles)
