"""Keep-in constraints: supporting half-spaces of convex sets where a motion is outside.

Norms, waypoints and requirements are all of this one kind (`limits`): a quantity of vehicles, or
its difference from that of another vehicle, stays in a convex set at some times.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.smooth import averaged
from drake_rho.planning.constraints.base import Constraint, HalfSpaces, with_neighbours
from drake_rho.planning.constraints.margins import Margins
from drake_rho.planning.constraints.worst_instants import worst_instants
from drake_rho.scenario.convex_sets import ConvexSets
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.times import END_MARGIN, EXACT, Clock
from drake_rho.system.table import Table

_SOFT_ROUNDS = 16
"""Limit on the rounds that add tangent planes of soft sets. Where only violations are penalised,
successive solutions differ widely, and their tangent planes converge slowly."""

_SOFT_THRESHOLD = 1e3
"""Violation of a soft set, in tolerances, up to which no further tangent plane is added."""


@dataclasses.dataclass(frozen=True, eq=False)
class LocalValues(Table):
    """Values of a quantity, relative to the places of their vehicles' sets."""

    vehicles: IntArray
    """indices of the vehicles in increasing order, shape (R,)"""
    times: FloatArray
    """times since the first knot [s], shape (R,)"""
    values: FloatArray
    """values less the places, in the quantity's unit, shape (R, 3)"""
    places: FloatArray
    """places of the sets, in the quantity's unit, shape (R, 3)"""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInSets(Constraint):
    """Constraint that keeps values x of a quantity in convex sets C, at some times.

    The row of a value outside of C is the supporting half-space n · x >= r - h(-n). Here n is the
    inward normal at the point of C nearest to x, h is the support function of C and r the margin.
    For a ball of radius R around c the half-space is n · (x - c) >= r - R. For a constraint
    relative to a vehicle, x is the difference of both.

    Each round adds the tangent planes of all values outside, and divides the excess by at least
    four: between two tangent planes at an angle of 2 φ the relative excess is at most φ² / 2, and
    the next tangent plane halves the angle. For a single point, the ball of radius zero, each plane
    is orthogonal to the active ones, so that three suffice if no other constraint interferes.
    """

    sets: ConvexSets
    """sets C of all vehicles"""
    members: IntArray
    """indices of the constrained vehicles, ascending, shape (M,)"""
    times: FloatArray
    """times since the first knot [s] of values that are not searched for, shape (T,), or (N, 1) if
    vehicles have times of their own"""
    knots: slice | None = None
    """indices of the values of a motion that are at `times`; None if these need not be knots"""
    partner: int | None = None
    """index of the vehicle from which the difference is taken, if any"""
    margins: Margins
    """margins of single vehicles"""
    roundings: FloatArray
    """bounds on the rounding errors of values, by which rows and cones are wider, in the quantity's
    unit, shape (N,): else planes through points far from the origin, or late on a clock, may
    contradict each other"""
    curved: bool = True
    active: tuple[float, float] | None = None
    """first and last active time since the first knot [s]; None if it is always active"""
    clock: Clock = EXACT
    """clock by which instants are compared with the active interval"""
    as_cone: bool = True
    """true if its sets can enter programs as second-order cones instead of rows"""
    shift: FloatArray | None = None
    """changes of the values of a single vehicle by changes of `times` in a program, in the
    quantity's unit, shape (T, 3); None for none"""

    def margin(self, times: FloatArray) -> FloatArray:
        """Return r at times since the first knot [s], in the quantity's unit, shape (R,)."""
        vehicles = 2.0 if self.coupled else 1.0
        margin: FloatArray = vehicles * self.margins.at(self.quantity, times)
        return margin + self.sets.deviation

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, neighbours: int = 0
    ) -> HalfSpaces:
        """Return rows of values outside of C, at the given times or at the worst between knots."""
        local = self.values_between(motion, vehicles) if between else self.values(motion, vehicles)
        distances = self.sets.signed_distance(local.vehicles, local.values)
        violated = distances + self.margin(local.times) > self._accepted[local.vehicles]
        if not violated.any():
            return self.none
        marked = with_neighbours(violated, local.vehicles, 0 if between else neighbours)
        local = local.select(np.flatnonzero(marked))
        outward = self.sets.outward(local.vehicles, local.values)
        rows = self.rows(local.vehicles, local.times, outward, local.places)
        return rows if np.isinf(self.penalty) else self._with_faces(rows)

    @cached_property
    def _accepted(self) -> FloatArray:
        """Violations up to which no row is added, in the quantity's unit, shape (N,)."""
        return np.asarray(self.threshold * self.sets.tolerances)

    def values(self, motion: Motion, vehicles: IntArray) -> LocalValues:
        """Return the values at the given times, sorted by vehicle.

        Args:
            motion: the motion of all vehicles.
            vehicles: increasing indices of vehicles with a new motion, shape (P,).
        """
        own = self._concerned(vehicles)
        if self.times.ndim > 1:
            own = own[np.isfinite(self.times[own, 0])]
            who, times = own, self.times[own, 0]
        else:
            who, times = np.repeat(own, len(self.times)), np.tile(self.times, len(own))
        if self.knots is None:
            values = self._at(motion, who, times)
        else:
            motion = motion.subdivided(self.margins.pieces)
            values = motion.values(self.quantity)[own, self.knots].reshape(-1, 3)
        if self.shift is not None and len(values) == len(self.shift):
            values = values + self.shift
        local = self._placed(who, times, values)
        if self.given_end is not None:
            own = local.vehicles
            partners = own if self.partner is None else np.full(len(own), self.partner)
            local = local.select(~self.given_end.includes(own, partners, local.times))
        if self.quantity != "jerk":
            return local
        return local.select(~np.isnan(values[:, 0]))  # unknown ones are not limited

    def _concerned(self, vehicles: IntArray) -> IntArray:
        """Return the members whose values change: all of them if the partner's motion is new."""
        if len(vehicles) == len(self.roundings) or self.partner in vehicles:
            return self.members
        return np.intersect1d(self.members, vehicles, assume_unique=True)

    def _at(self, motion: Motion, who: IntArray, times: FloatArray) -> FloatArray:
        """Return values of vehicles at times, less the partner's if there is one, (R, 3)."""
        values = averaged(motion, self.averaged).each_at(self.quantity, who, times)
        if self.partner is None:
            return values
        return values - motion.each_at(self.quantity, np.full(len(who), self.partner), times)

    def _placed(self, who: IntArray, times: FloatArray, values: FloatArray) -> LocalValues:
        """Return values less the places of their sets: of both places, where the sets jump."""
        places = self.sets.offset(times, clock=self.clock)
        if not self.sets.jumps:
            return LocalValues(who, times, values - places, places)
        late = self.clock.after(times, self._interval[0])
        before = self.sets.offset(times[late], before=True, clock=self.clock)
        places = np.concatenate([places, before])
        which = np.append(np.arange(len(who)), np.flatnonzero(late))
        local = LocalValues(who[which], times[which], values[which] - places, places)
        return local.select(np.lexsort((local.times, local.vehicles)))

    @property
    def _interval(self) -> tuple[float, float]:
        """First and last active time since the first knot [s]."""
        return self.active or (0.0, self._duration)

    @property
    def _duration(self) -> float:
        return float(self.margins.grid.duration)

    def values_between(self, motion: Motion, vehicles: IntArray) -> LocalValues:
        """Return the positions at the worst instants of pieces of time with violations."""
        members, pieces = self._concerned(vehicles), self._pieces
        steps = motion.accelerations.shape[-2]
        if len(pieces) == 0 or len(members) == 0:
            return self._placed(members[:0], np.zeros(0), np.zeros((0, 3)))
        states = (motion.positions[:, :steps], motion.velocities[:, :steps], motion.accelerations)
        partner = [0.0] * 3 if self.partner is None else [each[self.partner] for each in states]
        p, v, a = (each[members] - other for each, other in zip(states, partner, strict=True))
        who, times = worst_instants(
            (p, v, a),
            motion.step,
            pieces,
            self._distances,
            self.margin((pieces[:, 0] + pieces[:, 1]) / 2.0),
            self._accepted[members],
            members,
            exactly=self.prices is not None,  # the slack is measured
        )
        near = END_MARGIN * motion.step  # start and goal are given
        inner = (times > near) & (self.open_end | (times < self._duration - near))
        who, times = who[inner], times[inner]
        return self._placed(who, times, self._at(motion, who, times))

    def _distances(self, who: IntArray, x: FloatArray, times: FloatArray) -> FloatArray:
        """Return distances outside C of positions (P, S, 3), less the partner's, at times (P, S).

        Args:
            who: indices of the vehicles, shape (P,).
            x: positions [m].
            times: since the first knot [s].
        """
        places = self.sets.offset(times.reshape(-1))
        every = np.repeat(who, times.shape[1])
        distances = self.sets.signed_distance(every, x.reshape(-1, 3) - places)
        return distances.reshape(times.shape)

    @cached_property
    def _pieces(self) -> FloatArray:
        """Beginnings and ends of pieces of time with constant margins and velocities, (J, 2)."""
        first, last = self._interval
        if not first < last:
            return np.zeros((0, 2))
        cuts = np.concatenate([self.margins.grid.elapsed, self.sets.corners, [first, last]])
        cuts = np.unique(cuts[(cuts >= first) & (cuts <= last)])
        pieces = np.stack([cuts[:-1], cuts[1:]], axis=1)
        return np.asarray(pieces[self.clock.after(pieces[:, 1], pieces[:, 0])])

    def rows(
        self, who: IntArray, times: FloatArray, outward: FloatArray, places: FloatArray
    ) -> HalfSpaces:
        """Return supporting half-spaces of C.

        Args:
            who: indices of vehicles, shape (R,).
            times: since the first knot [s], shape (R,).
            outward: outward unit normals, shape (R, 3).
            places: places of the sets, in the quantity's unit, shape (R, 3).
        """
        supports = self.sets.support(who, outward) + np.vecdot(outward, places)
        rows = HalfSpaces(
            self,
            vehicles=who,
            partners=who if self.partner is None else np.full(len(who), self.partner),
            sides=np.zeros(len(who), dtype=int),
            times=times,
            normals=-outward,
            bounds=self.margin(times) - supports - self.roundings[who],
            tolerances=self.sets.tolerances[who],
        )
        return rows if self.given_end is None else self.given_end.without(rows)

    @property
    def is_own_rate(self) -> bool:
        """Whether fixed sets always limit the velocities or accelerations of single vehicles."""
        fixed = self.active is None and self.partner is None and len(self.sets.corners) == 0
        return fixed and self.quantity in ("velocity", "acceleration")

    @property
    def is_on_leg(self) -> bool:
        """Whether fixed sets limit the velocities of single vehicles at or between waypoints."""
        fixed = self.moves and self.partner is None and len(self.sets.corners) == 0
        return fixed and self.quantity == "velocity"

    def faces(self) -> HalfSpaces:
        """Return the rows of a bounding box of C at all `times`."""
        sides = np.concatenate([np.eye(3), -np.eye(3)])
        who, times = (
            np.repeat(self.members, len(self.times)),
            np.tile(self.times, len(self.members)),
        )
        return self._around(who, times, np.repeat(sides[:, None], len(who), axis=1))

    def _with_faces(self, rows: HalfSpaces) -> HalfSpaces:
        """Return rows together with the faces of a polyhedron around the set.

        Without these faces, a motion with penalised violations only may move far away in a
        direction that no tangent plane bounds yet.
        """
        return rows.union(self._around(rows.vehicles, rows.times, self.sets.around(rows.vehicles)))

    def _around(self, who: IntArray, times: FloatArray, outward: FloatArray) -> HalfSpaces:
        """Return the rows of F directions at each of R instants, where C is bounded."""
        every = np.tile(np.arange(len(who)), len(outward))
        outward = outward.reshape(-1, 3)
        bounded = np.isfinite(self.sets.support(who[every], outward))
        every, outward = every[bounded], outward[bounded]
        return self.rows(who[every], times[every], outward, self.sets.offset(times[every]))

    def bounds_at(self, rows: HalfSpaces, times: FloatArray) -> FloatArray:
        """Return bounds with the places of the sets at other times."""
        moved = self.sets.offset(times) - self.sets.offset(rows.times)
        bounds: FloatArray = rows.bounds + np.vecdot(rows.normals, moved)
        return bounds

    def detail(self, rows: HalfSpaces, names: Sequence[str]) -> str:
        """Return the vehicle that values are relative to, as in ' relative to base'."""
        return "" if self.partner is None else f" relative to {names[self.partner]}"

    def softened(self, penalty: float) -> Self:
        """Return this constraint with a penalty, fewer rounds and the threshold of soft sets."""
        soft = super().softened(penalty)
        rounds = min(self.rounds, _SOFT_ROUNDS)
        return dataclasses.replace(soft, rounds=rounds, threshold=_SOFT_THRESHOLD)
