"""Free times of waypoints and of the end, and how limits and motions change with them.

Replacing a motion's step h0 by h = h0 sqrt(y) divides velocities by sqrt(y), accelerations by y and
jerks by y^1.5, and leaves positions at the knots as they are. For the motion with the step h0, a
limit C of accelerations is therefore y C, and one of velocities s C with s = sqrt(y).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.smooth import SmoothMotion
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.constraints.rows import Form, Rows
from drake_rho.planning.minimum_effort import MinimumEffort, TerminalState
from drake_rho.planning.problem import Problem
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.gates import Gates, is_scale_free
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.records import KeepIn, Scenario
from drake_rho.scenario.smoothing import Smoothing
from drake_rho.scenario.times import steps_lasting
from drake_rho.scenario.waypoints import AllWaypoints


class Change(NamedTuple):
    """Bounds on the changes of times in a program."""

    final: tuple[float, float] = (0.0, 1e6)
    """least and largest y"""
    waypoints: float = 0.0
    """largest change of the time of a free waypoint [s]"""
    curvature: float = 0.0
    """part of `Passing.curvatures` by which changes of waypoint times add to y"""


NO_CHANGE = Change((1.0, 1.0))
"""No change, so that only the effort is minimised."""


@dataclasses.dataclass(frozen=True, eq=False)
class Passing:
    """Waypoints of vehicles, at given or free times."""

    vehicles: IntArray
    """index of the vehicle of each waypoint, in increasing order, shape (W,)"""
    times: FloatArray
    """times since the first knot around which a program is linearised [s], shape (W,)"""
    positions: FloatArray
    """positions [m], shape (W, 3)"""
    within: FloatArray
    """largest distances from these, less margins [m], shape (W,)"""
    given: BoolArray
    """mask of the waypoints whose times are given, and do not change with the step, shape (W,)"""
    least: float
    """least time between two waypoints of a vehicle, and from its start and goal [s]"""
    averaged: Smoothing | None = None
    """moving averages that pass the waypoints; None if motions themselves do"""
    in_proportion: BoolArray = dataclasses.field(default_factory=lambda: np.zeros(1, dtype=bool))
    """mask of the waypoints with times at a constant part of the final time, shape (W,) or (1,)"""
    allowed: FloatArray = dataclasses.field(default_factory=lambda: np.array([[-np.inf, np.inf]]))
    """first and last allowed time of each since the first knot [s], shape (W, 2) or (1, 2), exact
    only in the final time of the linearisation"""
    price: float = np.inf
    """penalty per metre for missing a free waypoint [m/s⁴]; infinite if all have to be passed"""
    gates: Gates | None = None
    """what else is required at waypoints and between them; None for nothing"""

    def __len__(self) -> int:
        """Return the number of waypoints, W."""
        return len(self.vehicles)

    def of(self, mask: BoolArray) -> Passing:
        """Return the waypoints of one vehicle, with index 0.

        Args:
            mask: mask of its waypoints, shape (W,).
        """
        return Passing(
            np.zeros(np.count_nonzero(mask), dtype=int),
            self.times[mask],
            self.positions[mask],
            self.within[mask],
            self.given[mask],
            self.least,
            self.averaged,
            np.broadcast_to(self.in_proportion, mask.shape)[mask],
            np.broadcast_to(self.allowed, (len(mask), 2))[mask],
            self.price,
            self.gates and self.gates.of_vehicles(np.unique(self.vehicles[mask]).tolist()),
        )

    @property
    def is_scale_free(self) -> bool:
        """Whether velocities at waypoints are required to have directions only."""
        return self.gates is None or is_scale_free(self.gates.vehicles)

    def required(self, grid: Grid, names: Sequence[str]) -> tuple[KeepIn, ...]:
        """Return what is required at waypoints besides positions, as `Gates.required`."""
        return () if self.gates is None else self.gates.required(self.times, grid, names)

    @property
    def ends(self) -> list[float]:
        """Times at which waypoints with given times end, with any dwell [s]."""
        return list((self.times + self.dwells)[self.given].tolist())

    @cached_property
    def dwells(self) -> FloatArray:
        """Least times at rest from the times of the waypoints on [s], shape (W,)."""
        return (
            np.zeros(len(self))
            if self.gates is None
            else AllWaypoints.of(self.gates.vehicles).dwells
        )

    @property
    def stops(self) -> IntArray:
        """Indices of free waypoints with a dwell, which begin at knots that programs keep."""
        return np.flatnonzero((self.dwells > 0.0) & ~self.given & ~self.in_proportion)

    def steps_at_rest(self, step: float) -> IntArray:
        """Return the number of steps that last as long as each dwell, shape (W,)."""
        return np.array([steps_lasting(each, step) for each in self.dwells], dtype=int)

    def with_stops_at_knots(self, step: float, steps: int) -> Passing:
        """Return the waypoints with stops at the nearest knots that leave steps to fly between.

        Args:
            step: step of the motion [s].
            steps: number of its steps.
        """
        times, rests = self.times.copy(), self.steps_at_rest(step)
        for vehicle in np.unique(self.vehicles[self.stops]):
            own = self.stops[self.vehicles[self.stops] == vehicle]
            first, last = self._knots_allowed(own, step)
            knots = np.clip(np.rint(times[own] / step), first, np.maximum(first, last)).astype(int)
            low, high = 0, steps
            for i, w in enumerate(own):
                low = knots[i] = max(knots[i], low + _LEG)
                low += rests[w]
            for i, w in reversed(list(enumerate(own))):
                high = knots[i] = min(knots[i], high - _LEG - rests[w])
            times[own] = np.maximum(knots, 1) * step
        return dataclasses.replace(self, times=times) if len(self.stops) > 0 else self

    def _knots_allowed(self, which: IntArray, step: float) -> tuple[FloatArray, FloatArray]:
        """Return the first and the last knot at the allowed times of some waypoints."""
        allowed = np.broadcast_to(self.allowed, (len(self), 2))[which] / step
        return np.ceil(allowed[:, 0] - _AT_KNOT), np.floor(allowed[:, 1] + _AT_KNOT)

    def stops_are_allowed(self, step: float) -> bool:
        """Return whether all stops begin at allowed times."""
        first, last = self._knots_allowed(self.stops, step)
        knots = np.rint(self.times[self.stops] / step)
        return bool(np.all((knots >= first) & (knots <= last)))

    @property
    def in_steps(self) -> BoolArray:
        """Mask of the waypoints whose times stay in their steps in one program, shape (W,).

        These have velocities, whose derivatives jump at the knots.
        """
        if self.gates is None:
            return np.zeros(len(self), dtype=bool)
        every = [own for each in self.gates.vehicles for own in each.waypoints]
        return np.array([each.velocity is not None for each in every], dtype=bool) & self.may_change

    def steps(self, step: float) -> IntArray:
        """Return the index of the step in which each waypoint may move, shape (W,).

        Args:
            step: step of the motion [s].
        """
        return np.floor(self.times / step + _AT_KNOT).astype(int)

    def at_knots(self, step: float) -> IntArray:
        """Return the indices of waypoints that stay in their steps and are at the end of one."""
        off = self.times / step
        near = np.abs(off - np.rint(off)) <= _NEAR_KNOT
        return np.flatnonzero(near & self.in_steps)

    def moved(self, w: int, by: float) -> Passing:
        """Return the waypoints with one at another time, later by some seconds."""
        times = self.times.copy()
        times[w] += by
        return dataclasses.replace(self, times=times)

    def moved_with(self, vehicles: IntArray, times: FloatArray) -> IntArray:
        """Return the index of the waypoint at which vehicles are at times [s]; -1 if at none, (R,).

        Args:
            vehicles: indices of vehicles, shape (R,).
            times: since the first knot [s], shape (R,).
        """
        found = np.full(len(times), -1)
        for w, (vehicle, time) in enumerate(zip(self.vehicles, self.times, strict=True)):
            found[(vehicles == vehicle) & (np.abs(times - time) <= _AT_ONCE * self.least)] = w
        return found

    def rates_of(self, rows: HalfSpaces, motion: Motion) -> tuple[IntArray, FloatArray]:
        """Return the waypoint with which each row moves, and the derivative of its value by time.

        Args:
            rows: rows of one constraint.
            motion: motion around which times change.

        Returns:
            Indices of waypoints, and derivatives along the normals, of shape (R,) each. These are
            zero for rows that do not move.
        """
        at = np.full(len(rows), -1)
        rate = _RATES.get(rows.constraint.quantity)
        if rows.constraint.moves and rate is not None:
            at = self.moved_with(rows.vehicles, rows.times)
        if rate is None or not np.any(at >= 0):
            return at, np.zeros(len(rows))
        times = self._inside(at, rows.times, rate, motion.step)
        along = _values(motion, dataclasses.replace(rows, times=times), rate)
        return at, np.where(at >= 0, along, 0.0)

    def _inside(self, at: IntArray, times: FloatArray, rate: Quantity, step: float) -> FloatArray:
        """Return times with those of waypoints in the middle of their steps, where rates jump."""
        if rate != "acceleration":
            return times
        middles = (self.steps(step) + 0.5) * step
        return np.where(at >= 0, middles[at], times)

    def rates_at(self, sets: KeepInSets, motion: Motion) -> tuple[IntArray, FloatArray]:
        """Return the waypoint with which each value of a vehicle moves, and derivatives (T, 3)."""
        rate, count = _RATES.get(sets.quantity), len(sets.times)
        who = np.full(count, sets.members[0])
        at = self.moved_with(who, sets.times)
        if rate is None:
            return at, np.zeros((count, 3))
        times = self._inside(at, sets.times, rate, motion.step)
        values = motion.each_at(rate, who, times)
        if sets.partner is not None:
            values = values - motion.each_at(rate, np.full(count, sets.partner), times)
        return at, np.where(at[:, None] >= 0, values, 0.0)

    def farthest_from(self, positions: FloatArray) -> FloatArray:
        """Return the largest distance of a waypoint of each vehicle from a position [m], (N,).

        Args:
            positions: positions of the vehicles [m], shape (N, 3).
        """
        farthest = np.zeros(len(positions))
        distances = np.linalg.norm(self.positions - positions[self.vehicles], axis=1)
        np.maximum.at(farthest, self.vehicles, distances)
        return farthest

    @property
    def may_change(self) -> BoolArray:
        """Mask of the waypoints whose times, relative to the final time, are variables, (W,)."""
        changing: BoolArray = ~self.given & ~self.in_proportion & (self.dwells == 0.0)
        return changing

    def lasting(self, duration: float, before: float) -> Passing:
        """Return the waypoints for another final time, with the free times scaled.

        Free times are scaled between the given times around them.

        Args:
            duration: the other final time [s].
            before: final time so far [s].
        """
        factor = duration / before
        times = np.where(self.given, self.times, factor * self.times)
        for i in np.unique(self.vehicles[self.given]):
            own = self.vehicles == i
            known = self.times[own & self.given]
            ends = [0.0, *known, before], [0.0, *known, duration]
            times[own] = np.interp(self.times[own], *ends)
        return dataclasses.replace(self, times=times, least=factor * self.least)

    @property
    def ordered(self) -> IntArray:
        """Indices of waypoints with an ordering constraint: they or their predecessors are free."""
        same = self.vehicles[1:] == self.vehicles[:-1]
        later: IntArray = 1 + np.flatnonzero(same & ~(self.given[1:] & self.given[:-1]))
        return later

    @property
    def is_in_order(self) -> bool:
        """Whether the times of all waypoints are in order, with any dwells between them."""
        gaps = np.diff(self.times) - self.dwells[:-1]
        return bool(np.all(gaps[self.ordered - 1] > 0.0))

    def curvatures(self, duration: float) -> FloatArray:
        """Return estimates of the second derivatives of y by changes of the times [1/s²], (W,).

        Flying a leg in t - d instead of t takes 1 / (1 - d/t) of the speed; at the same largest
        speed, the final time T grows by d + d²/t. So for legs of t and t' before and after a
        waypoint, T grows by d² (1/t + 1/t'), and y by 2 / T times as much. With a largest
        acceleration it is half as much again.

        Args:
            duration: T, the final time [s].
        """
        first = np.diff(self.vehicles, prepend=-1) != 0
        last = np.diff(self.vehicles, append=-1) != 0
        before = self.times - np.where(first, 0.0, np.roll(self.times, 1))
        after = np.where(last, duration, np.roll(self.times, -1)) - self.times
        legs = np.maximum([before, after], self.least)
        values: FloatArray = 4.0 / duration * np.sum(1.0 / legs, axis=0)
        return values

    def axes(self, effort: MinimumEffort) -> Rows:
        """Return rows whose values are the positions less the waypoints, three for each."""
        who, times = np.repeat(self.vehicles, 3), np.repeat(self.times, 3)
        normals = np.tile(np.eye(3), (len(self), 1))
        at, _ = self.states(effort.motion)
        needed = (self.positions - at).reshape(-1)
        none = np.zeros(len(who), dtype=int)
        form = Form(quantity="position", averaged=self.averaged)
        return Rows(form, who, who, none, times, normals, needed, np.zeros(len(who)))

    def states(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Return positions [m] and velocities [m/s] of a motion at the waypoints, (W, 3) each."""
        if self.averaged is not None:
            positions, velocities, _ = SmoothMotion(motion, self.averaged).states(self.times)
            each = np.arange(len(self))
            return positions[self.vehicles, each], velocities[self.vehicles, each]
        return (
            motion.each_at("position", self.vehicles, self.times),
            motion.each_at("velocity", self.vehicles, self.times),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class FreeTime:
    """Solution of a program with a free final time."""

    accelerations: FloatArray
    """accelerations of the motion with the step of the program [m/s²], shape (N, K-1, 3)"""
    factor: float
    """y, the square of the final time over that of the program"""
    root: float
    """s, at most the square root of y"""
    changes: FloatArray
    """changes of the times of the free waypoints, on the program's time scale [s], shape (W,)"""
    solver: str
    """name of the solver"""
    seconds: float
    """time reported by the solver [s]"""
    missed: float = 0.0
    """sum of the distances from missed free waypoints [m]"""


POWERS: dict[Quantity, float] = {"position": 0.0, "velocity": 0.5, "acceleration": 1.0, "jerk": 1.5}
"""Power of y by which time scaling divides the values of a quantity."""

_GROWTH: dict[Quantity, tuple[float, float]] = {
    "position": (0.0, 0.0),
    "velocity": (0.0, 1.0),
    "acceleration": (1.0, 0.0),
}
"""Growth of limits with y and with s, except for those of jerks."""

_AT_ONCE = 1e-3
"""Part of the least time between waypoints in which rows are at a waypoint."""

_LEG = 2
"""Least number of steps from rest to rest elsewhere."""

_NEAR_KNOT = 1e-3
"""Part of a step within which a waypoint counts as stopped by a knot when a search has ended."""

_AT_KNOT = 1e-6
"""Part of a step within which a waypoint is at a knot."""

_RATES: dict[Quantity, Quantity] = {"position": "velocity", "velocity": "acceleration"}
"""Derivatives by time of quantities that are continuous."""

_PART = 1e-6
"""Relative change of a time for finite differences of bounds."""


def powers(scenario: Scenario) -> Mapping[Quantity, float]:
    """Return the power of y by which time scaling divides the values of each quantity.

    With a smoothing, a jerk is the change of an acceleration over the width of an average, which
    stays the same.
    """
    return POWERS if scenario.smoothing is None else {**POWERS, "jerk": POWERS["acceleration"]}


def bound_rates(rows: HalfSpaces) -> FloatArray:
    """Return the derivatives of bounds by y at y = 1, due to moving obstacles and tracks, (R,)."""
    constraint, times = rows.constraint, rows.times
    later = constraint.bounds_at(rows, times * (1.0 + _PART))
    earlier = constraint.bounds_at(rows, times * (1.0 - _PART))
    rates: FloatArray = (later - earlier) / (4.0 * _PART)  # t grows with the root of y
    return rates


@dataclasses.dataclass(frozen=True, eq=False)
class TimeScaling:
    """Derivatives of limits and of minimum-effort motions by y and s."""

    by_y: Motion
    """derivative of minimum-effort motions by y"""
    by_s: Motion
    """derivative of minimum-effort motions by s"""
    growth: Mapping[Quantity, tuple[float, float]]
    """growth of limits with y and with s"""
    lower: tuple[float, float]
    """growth of lower limits of velocities above zero with y and with s"""

    @classmethod
    def around(cls, problem: Problem) -> Self:
        """Return the scaling of a program that is linearised at the step of a problem.

        Velocities at both ends grow with the square root of y, which is linearised at y = 1, and
        accelerations before the start and after the goal with y.
        """
        by_y = _derivative(problem, velocities=0.5, outside=1.0)
        by_s = _derivative(problem, velocities=0.0, outside=0.0)
        growth = _growth(problem, (1.5, 0.0))  # linearised at y = 1
        return cls(by_y, by_s, growth, (0.5, 0.0))  # s <= sqrt(y) would allow lower velocities

    @classmethod
    def relaxed(cls, problem: Problem, chord: float) -> Self:
        """Return the scaling of a relaxation, in which no motion is lost.

        Args:
            problem: problem in the longest final time.
            chord: slope of the chord of y^1.5, by which limits of jerks grow.
        """
        by_y = _derivative(problem, velocities=0.0, outside=1.0)
        by_s = _derivative(problem, velocities=1.0, outside=0.0)
        return cls(by_y, by_s, _growth(problem, (chord, 0.0)), _GROWTH["velocity"])

    def growth_of(self, constraint: Constraint) -> tuple[float, float]:
        """Return the growth of a constraint's limit with y and with s."""
        return self.lower if constraint.is_gate else self.growth[constraint.quantity]

    def of_bounds(self, rows: HalfSpaces) -> FloatArray:
        """Return the derivatives of bounds on changes of motions by y and s, shape (R, 2)."""
        derivatives = np.outer(rows.bounds, self.growth_of(rows.constraint))
        if rows.constraint.quantity == "velocity":
            above = (rows.bounds > 0.0) | rows.constraint.is_gate  # both sides of a value agree
            derivatives[above] = np.outer(rows.bounds[above], self.lower)
        derivatives[:, 0] += bound_rates(rows)
        for column, motion in enumerate((self.by_y, self.by_s)):
            derivatives[:, column] -= _values(motion, rows)
        return derivatives

    def of_positions(self, vehicles: IntArray, times: FloatArray) -> FloatArray:
        """Return the derivatives of positions by y and s at times [s], shape (R, 3, 2)."""
        both = (each.each_at("position", vehicles, times) for each in (self.by_y, self.by_s))
        return np.stack(list(both), axis=2)

    def accelerations(self, y: float, s: float) -> FloatArray:
        """Return the changes of minimum-effort accelerations for y and s [m/s²], (N, K-1, 3)."""
        changes: FloatArray = (y - 1.0) * self.by_y.accelerations
        return changes + (s - 1.0) * self.by_s.accelerations


def _growth(problem: Problem, jerk: tuple[float, float]) -> Mapping[Quantity, tuple[float, float]]:
    """Return the growth of limits; with a smoothing, limits of jerks grow like accelerations."""
    smooth = problem.scenario.smoothing is not None
    return {**_GROWTH, "jerk": _GROWTH["acceleration"] if smooth else jerk}


def _values(motion: Motion, rows: HalfSpaces, quantity: Quantity | None = None) -> FloatArray:
    """Return the values of a motion that rows bound, or of another quantity, shape (R,)."""
    quantity = quantity or rows.constraint.quantity
    values = motion.each_at(quantity, rows.vehicles, rows.times)
    if rows.constraint.coupled:
        values = values - motion.each_at(quantity, rows.partners, rows.times)
    along: FloatArray = np.vecdot(rows.normals, values)
    return along


def _derivative(problem: Problem, *, velocities: float, outside: float) -> Motion:
    """Return the derivative of minimum-effort motions by y or s, at y = s = 1.

    Args:
        problem: the problem.
        velocities: derivative of given velocities at the start and the goal, relative to them.
        outside: derivative of given accelerations before the start and after the goal.
    """
    fleet, grid = problem.scenario.fleet, problem.scenario.grid
    first, last = velocities * fleet.start_velocities, velocities * fleet.goal_velocities
    terminal = TerminalState(grid)
    values, _ = terminal.values(last - first, -grid.duration * first)
    accelerations = terminal.rows.T @ values
    p, v = roll_out(np.zeros_like(first), first, accelerations, grid.step)
    ends = outside * fleet.accelerations_before, outside * fleet.accelerations_after
    return Motion(grid.step, p, v, accelerations, *ends)
