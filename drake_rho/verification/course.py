"""What is judged: motions of all vehicles between instants, and the errors around them."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.verification.steps import Steps
from drake_rho.verification.tubes import Around, Tubes

_INSTANT = 1e-9
"""Part of the shortest piece by which a time may be short of an instant and still be in the piece
that begins there."""


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """Motions whose accelerations are constant in pieces of time, the same for all vehicles."""

    scenario: Scenario
    """what was asked"""
    elapsed: FloatArray
    """instants between which pieces are, since the first knot [s], shape (J + 1,)"""
    durations: FloatArray
    """of the pieces [s], shape (J,)"""
    knots: BoolArray
    """which instants are knots, shape (J + 1,)"""
    positions: FloatArray
    """at the instants [m], shape (N, J + 1, 3)"""
    velocities: FloatArray
    """at the instants [m/s], shape (N, J + 1, 3)"""
    accelerations: FloatArray
    """in the pieces [m/s²], shape (N, J, 3)"""
    commands: FloatArray
    """accelerations that were asked for, on which the limits are [m/s²], shape (N, J, 3)"""
    tubes: Tubes | None = None
    """in which vehicles are anywhere around these motions; None if they are just there"""

    @classmethod
    def of(cls, scenario: Scenario, motion: Motion, tubes: Tubes | None = None) -> Course:
        """The course of a motion on a scenario's grid: pieces are its steps."""
        grid = scenario.grid
        return cls(
            scenario,
            grid.elapsed,
            np.full(grid.knots - 1, grid.step),
            np.ones(grid.knots, dtype=bool),
            motion.positions,
            motion.velocities,
            motion.accelerations,
            motion.accelerations,
            tubes,
        )

    @cached_property
    def times(self) -> FloatArray:
        """The instants on the scenario's clock [s], shape (J + 1,)."""
        return np.asarray(self.scenario.grid.start + self.elapsed)

    @property
    def steps(self) -> Steps:
        """All pieces, vehicle by vehicle."""
        return self.steps_of(self.positions, self.velocities, self.accelerations)

    def steps_of(self, p: FloatArray, v: FloatArray, a: FloatArray) -> Steps:
        """Pieces of what moves in them: arrays of shape (..., J + 1, D), or (..., J, D) for a."""
        return Steps.of(self.durations[:, None], p, v, a)

    def each_at(self, vehicles: IntArray, times: FloatArray) -> FloatArray:
        """Positions of one vehicle at each time on the scenario's clock [m]: (M,) gives (M, 3)."""
        times = times - self.scenario.grid.start
        near = _INSTANT * self.durations.min()
        k = np.searchsorted(self.elapsed, times + near, side="right") - 1
        k = np.clip(k, 0, len(self.durations) - 1)
        s = (times - self.elapsed[k])[:, None]
        v = self.velocities[vehicles, k]
        velocities = v + s * self.accelerations[vehicles, k]
        return np.asarray(self.positions[vehicles, k] + s / 2 * (v + velocities))

    def cut(self, times: FloatArray) -> Course:
        """This course with pieces that end at some times too, since the first knot [s]."""
        times = times[(times > 0.0) & (times < self.elapsed[-1])]
        if len(times) == 0:
            return self
        instants = np.union1d(self.elapsed, times)
        k = np.searchsorted(self.elapsed, instants, side="right") - 1
        knots = (self.elapsed[k] == instants) & self.knots[k]
        k = np.minimum(k, len(self.durations) - 1)  # the last instant begins no piece
        s = (instants - self.elapsed[k])[:, None]
        p, v, a = self.positions[:, k], self.velocities[:, k], self.accelerations[:, k]
        velocities = v + s * a
        return Course(
            self.scenario,
            instants,
            np.diff(instants),
            knots,
            p + s / 2 * (v + velocities),
            velocities,
            a[:, :-1],
            self.commands[:, k[:-1]],
            self.tubes,
        )

    def moments(self, pieces: IntArray, parts: FloatArray) -> FloatArray:
        """Times since the first knot [s], of parts of pieces that have passed, of one shape."""
        return np.asarray(self.elapsed[pieces] + parts * self.durations[pieces])

    def errors(self, instants: BoolArray | None = None) -> FloatArray:
        """ρ_p at the instants, or at some of them [m], shape (J + 1,); zero without tubes."""
        times = self.times if instants is None else self.times[instants]
        return np.zeros(len(times)) if self.tubes is None else self.tubes.at("position", times)

    @cached_property
    def errors_over(self) -> FloatArray:
        """No ρ_p in the pieces is greater [m], shape (J,); zero without tubes."""
        if self.tubes is None:
            return np.zeros(len(self.durations))
        return self.tubes.over("position", self.times[:-1], self.times[1:])

    @cached_property
    def feedback(self) -> FloatArray:
        """ρ_u, the most that a feedback may be in the pieces [m/s²], shape (J,)."""
        if self.tubes is None:
            return np.zeros(len(self.durations))
        return self.tubes.over("acceleration", self.times[:-1], self.times[1:])

    def around(self, pieces: IntArray, vehicles: float = 1.0) -> Around | None:
        """The balls of errors around positions in pieces, any number of times; None without them.

        Args:
            pieces: shape (M,).
            vehicles: the errors of how many count at once: of one, or of both of a pair.
        """
        if self.tubes is None:
            return None
        begins, durations = self.times[:-1][pieces], self.durations[pieces]
        return Around.of(self.tubes, begins, durations, vehicles)
