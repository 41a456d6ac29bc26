"""Convex set constraints of requirements (`KeepIn`), on a quantity or a difference of two."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import (
    END_MARGIN,
    Constraint,
    HalfSpaces,
    constrained_knots,
)
from drake_rho.planning.constraints.margins import Margins, PlanMargins
from drake_rho.planning.constraints.norms import KeepInNorm
from drake_rho.planning.constraints.smooth_jerks import Scaled, jerk_factor
from drake_rho.planning.constraints.stretches import with_neighbours
from drake_rho.planning.constraints.worst_instants import worst_instants
from drake_rho.scenario.convex_sets import AROUND_BALL, Balls
from drake_rho.scenario.fields import FloatArray, IntArray, unchecked
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.shapes.quadrics import Sphere

_ACCEPTED = 0.25
"""Violation, in tolerances, up to which no row is added. Each round quarters the violation of a set
with a curved surface, at the knots and again between them, and linked vehicles need many rounds."""

_SOFT_ROUNDS, _SOFT_THRESHOLD = 16, 1e3
"""Rounds that add rows of a soft requirement, and the violation, in tolerances, up to which none is
added: where only violations are penalised, successive solutions differ widely."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInSet(Constraint):
    """Constraint that keeps values x of a quantity, less an offset, in a convex set C.

    The row of a value outside of C is the supporting half-space n · (x - offset) >= r - h(-n),
    with n the inward normal at the nearest point of C, h the support function of C and r the
    margin. For a requirement relative to a vehicle, x is the difference of both.
    """

    requirement: KeepIn
    """requirement on a clock that is 0 at the first knot"""
    members: IntArray
    """indices of its vehicles, ascending, shape (M,)"""
    partner: int | None
    """index of the vehicle from which the difference is taken, if any"""
    grid: Grid
    """grid of the plan"""
    margins: Margins
    """margins of single vehicles"""
    tolerances: FloatArray
    """distances outside C that count as inside, in the quantity's unit, by vehicle, shape (N,)"""
    every_instant: bool
    """whether it applies at every instant, not at the knots only"""
    curved: bool = True
    threshold: float = _ACCEPTED
    """violation, in tolerances, up to which no row is added"""
    roundings: FloatArray
    """bounds on the rounding errors of values, subtracted from the rows' bounds, in the quantity's
    unit, shape (N,): else planes through one point far from the origin may contradict each other"""

    def margin(self, times: FloatArray) -> FloatArray:
        """Return r: the margins of the vehicles plus the deviation of the track, shape (R,)."""
        vehicles = 2.0 if self.coupled else 1.0
        margin: FloatArray = vehicles * self.margins.at(self.quantity, times)
        return margin + self.requirement.deviation

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, neighbours: int = 0
    ) -> HalfSpaces:
        """Return rows of values outside of C, at the knots or at the worst instants between."""
        members = self._concerned(vehicles)
        if len(members) == 0:
            return self.none
        if between:
            who, times = self._worst_between(motion, members)
        else:
            who = np.repeat(members, len(self._instants))
            times = np.tile(self._instants, len(members))
        values = self._values(motion, who, times)
        if self.quantity == "jerk":  # unknown ones are not limited
            known = ~np.isnan(values[:, 0])
            who, times, values = who[known], times[known], values[known]
        offset = self.requirement.offset(times, clock=self.clock)
        distances = self.requirement.set.signed_distance(values - offset)
        if self._velocity_jumps:  # the moving point has another velocity before a corner
            before = self.requirement.offset(times, before=True, clock=self.clock)
            other = self.requirement.set.signed_distance(values - before)
            other = np.where(self.clock.after(times, self._interval[0]), other, -np.inf)
            offset = np.where((other > distances)[:, None], before, offset)
            distances = np.maximum(distances, other)
        violated = distances + self.margin(times) > self.threshold * self.tolerances[who]
        if not violated.any():
            return self.none
        wanted = np.flatnonzero(with_neighbours(violated, who, 0 if between else neighbours))
        outward = np.asarray(self.requirement.set.outward((values - offset)[wanted]))
        rows = self._rows(who[wanted], times[wanted], outward, offset[wanted])
        return rows if np.isinf(self.penalty) else self._with_faces(rows)

    @property
    def is_own_rate(self) -> bool:
        """Whether it always keeps velocities or accelerations of single vehicles in one set."""
        always = self.requirement.active is None and self.requirement.relative_to is None
        return always and self.quantity in ("velocity", "acceleration")

    def as_norm(self) -> KeepInNorm | None:
        """Return the equivalent norm limit if C is a ball; None for any other C."""
        ball = self.requirement.set
        if not isinstance(ball, Sphere) or len(self.margins.grid.elapsed) > self.grid.knots:
            return None
        origins, radii = np.zeros((len(self.tolerances), 3)), np.full(len(self.tolerances), np.inf)
        origins[self.members] = ball.center + self.requirement.offset(np.zeros(1))
        radii[self.members] = ball.radius
        return KeepInNorm(
            kind=self.kind,
            key=self.key,
            name=self.name,
            quantity=self.quantity,
            sets=Balls(origins, self.tolerances, radii),
            times=self.grid.elapsed[constrained_knots(self.quantity)],
            first=int(self.quantity == "velocity"),
            margins=self.margins,
        )

    def faces(self) -> HalfSpaces:
        """Return the rows of the six sides of a box around C, at every instant of `_instants`.

        Sides on which C is unbounded are left out.
        """
        sides = np.concatenate([np.eye(3), -np.eye(3)])
        sides = sides[np.isfinite(np.asarray(self.requirement.set.support(sides)))]
        who, times, outward = (
            each.reshape(-1)
            for each in np.meshgrid(self.members, self._instants, range(len(sides)))
        )
        if len(who) == 0:
            return self.none
        return self._rows(who, times, sides[outward], self.requirement.offset(times))

    def _concerned(self, vehicles: IntArray) -> IntArray:
        """Return the members with a new motion: all of them if the partner has one."""
        if self.partner is not None and self.partner in vehicles:
            return self.members
        return np.intersect1d(self.members, vehicles)

    @property
    def _velocity_jumps(self) -> bool:
        return self.requirement.track is not None and self.requirement.of == "velocity"

    @property
    def _interval(self) -> tuple[float, float]:
        """First and last active time since the first knot [s]."""
        return self.active or (0.0, self.grid.duration)

    @cached_property
    def _instants(self) -> FloatArray:
        """Fixed times of rows, not searched between knots, since the first knot [s], (T,).

        Accelerations have one time for each step that meets the interval. So have jerks, which are
        changes at the beginnings of steps, and one at the last knot; jerks of averages are those at
        knots. Velocities are linear in a step, so that the ends of the interval and corners of the
        track suffice beside the knots. The states at the first and the last knot are given.
        """
        (first, last), h, T = self._interval, self.grid.step, self.grid.duration
        knots = self.margins.grid.elapsed if self.every_instant else self.grid.elapsed
        if self.quantity in ("acceleration", "jerk"):
            begins = self.grid.elapsed[constrained_knots(self.quantity)]
            if self.per_width:
                return np.asarray(begins[self.clock.within(begins, self._interval)])
            return np.asarray(begins[self.clock.meets(begins, begins + h, self._interval)])
        times = knots[self.clock.within(knots, self._interval)]
        if self.every_instant or first == last:
            corners = self.requirement.corners
            corners = np.append(corners, [first, last])
            corners = corners[(corners >= first) & (corners <= last)]
            times = np.union1d(times, self.clock.apart(corners, knots))
        return np.asarray(times[(times > END_MARGIN * h) & (times < T - END_MARGIN * h)])

    def _values(self, motion: Motion, who: IntArray, times: FloatArray) -> FloatArray:
        """Return values of vehicles at times, less the partner's if there is one, (R, 3)."""
        values = motion.each_at(self.quantity, who, times)
        if self.partner is None:
            return values
        return values - motion.each_at(self.quantity, np.full(len(who), self.partner), times)

    def _worst_between(self, motion: Motion, members: IntArray) -> tuple[IntArray, FloatArray]:
        """Return vehicles and worst instants of the pieces of time with violating positions."""
        pieces, steps = self._pieces, motion.accelerations.shape[-2]
        if len(pieces) == 0:
            return members[:0], np.zeros(0)
        states = (motion.positions[:, :steps], motion.velocities[:, :steps], motion.accelerations)
        partner = [0.0] * 3 if self.partner is None else [each[self.partner] for each in states]
        p, v, a = (each[members] - other for each, other in zip(states, partner, strict=True))
        who, times = worst_instants(
            (p, v, a),
            self.grid.step,
            pieces,
            self._distance,
            self.margin((pieces[:, 0] + pieces[:, 1]) / 2.0),
            self.threshold * self.tolerances[members],
            members,
        )
        near = END_MARGIN * self.grid.step  # start and goal are given
        inner = (times > near) & (times < self.grid.duration - near)
        return who[inner], times[inner]

    def _distance(self, x: FloatArray, times: FloatArray) -> FloatArray:
        """Return distances outside C of positions (..., 3), less the partner's, at times (...)."""
        offset = self.requirement.offset(times.reshape(-1)).reshape(x.shape)
        return np.asarray(self.requirement.set.signed_distance(x - offset))

    @cached_property
    def _pieces(self) -> FloatArray:
        """Beginnings and ends of pieces of time with constant margins and velocities, (J, 2)."""
        first, last = self._interval
        if not first < last:
            return np.zeros((0, 2))
        cuts = np.concatenate([self.margins.grid.elapsed, self.requirement.corners, [first, last]])
        cuts = np.unique(cuts[(cuts >= first) & (cuts <= last)])
        pieces = np.stack([cuts[:-1], cuts[1:]], axis=1)
        return np.asarray(pieces[self.clock.after(pieces[:, 1], pieces[:, 0])])

    def _rows(
        self, who: IntArray, times: FloatArray, outward: FloatArray, offset: FloatArray
    ) -> HalfSpaces:
        """Return supporting half-spaces of C.

        Args:
            who: indices of vehicles, shape (R,).
            times: since the first knot [s], shape (R,).
            outward: outward unit normals, shape (R, 3).
            offset: offset of values from C, in the quantity's unit, shape (R, 3).
        """
        support = np.asarray(self.requirement.set.support(outward))
        above = self.margin(times) - support - np.vecdot(outward, offset)
        return HalfSpaces(
            self,
            vehicles=who,
            partners=who if self.partner is None else np.full(len(who), self.partner),
            sides=np.zeros(len(who), dtype=int),
            times=times,
            normals=-outward,
            bounds=above - self.roundings[who],
            tolerances=self.tolerances[who],
        )

    def _with_faces(self, rows: HalfSpaces) -> HalfSpaces:
        """Return rows together with faces of a box around C at their instants, where C is bounded.

        Without these faces, a motion with penalised violations only may move far away in a
        direction that no row bounds yet.
        """
        supports = np.asarray(self.requirement.set.support(AROUND_BALL))
        faces = AROUND_BALL[np.isfinite(supports)]
        every = np.tile(np.arange(len(rows)), len(faces))
        outward = np.repeat(faces, len(rows), axis=0)
        if len(every) == 0:
            return rows
        times = rows.times[every]
        offset = self.requirement.offset(times)
        return rows.union(self._rows(rows.vehicles[every], times, outward, offset))

    def bounds_at(self, rows: HalfSpaces, times: FloatArray) -> FloatArray:
        """Return bounds with the track's offset at other times."""
        if self.requirement.track is None:
            return rows.bounds
        moved = self.requirement.offset(times) - self.requirement.offset(rows.times)
        bounds: FloatArray = rows.bounds + np.vecdot(rows.normals, moved)
        return bounds

    def detail(self, rows: HalfSpaces, names: Sequence[str]) -> str:
        """Return the vehicle that values are relative to, as in ' relative to base'."""
        return "" if self.partner is None else f" relative to {names[self.partner]}"

    def softened(self, penalty: float) -> Self:
        """Return this constraint with a penalty, fewer rounds and a larger threshold."""
        rounds = min(self.rounds, _SOFT_ROUNDS)
        soft = super().softened(penalty)
        return dataclasses.replace(soft, rounds=rounds, threshold=_SOFT_THRESHOLD)


def requirements_of(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the constraints of all requirements, except those that have ended."""
    found, names, grid = list[Constraint](), scenario.names, scenario.grid
    for number, asked in enumerate(scenario.requirements, start=1):
        each, local = asked.since(grid).longer(scenario.lead), grid.beginning_at(0.0)
        if (interval := each.interval(local)) is None:
            continue
        own, _ = margins.of(each.quantity)
        tolerances = np.zeros(len(names))
        members = each.members(names)
        tolerances[members] = each.tolerances(scenario.fleet, names)
        inner = each.quantity == "position" and scenario.between_knots
        constraint = KeepInSet(
            kind="requirements",
            key=("requirement", number),
            name=asked.called(number),
            quantity=each.quantity,
            active=interval,
            clock=grid.clock,
            requirement=each,
            members=members,
            partner=each.partner(names),
            coupled=each.leader is not None,
            grid=local,
            margins=own,
            tolerances=tolerances,
            roundings=scenario.fleet.coordinate_errors * (each.quantity == "position"),
            every_instant=scenario.between_knots,
            searches=sys.maxsize * inner,
        )
        factor = jerk_factor(scenario) if each.quantity == "jerk" else None
        if factor is not None:
            constraint = dataclasses.replace(
                constraint,
                requirement=unchecked(each, set=Scaled(each.set, factor)),
                tolerances=factor * tolerances,
                per_width=True,
            )
        found.append(constraint)
    return found
