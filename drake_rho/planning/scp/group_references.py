"""References for fleets: linearisations in which groups of vehicles are coupled.

Two decoupled vehicles each have half the responsibility for their separation, and neither can gain
from the other's evasion. In a group, a pair has one row for its relative position; only pairs of
different groups are decoupled. Groups form from the pairs with the largest multipliers and change
from one linearisation to the next, so that every pair with active rows is grouped eventually. A
group may be a single vehicle.

The result is an approximate reference to linearise around, not a plan. Starting from a plan,
references cost less and less. Starting from a motion whose pairs are too close, references move
vehicles apart, since rows may be violated at a penalty.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from itertools import count

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.costs import cost_of
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.keep_out import EvaluationPoints
from drake_rho.planning.constraints.separation import PAIRS, KeepApart, coupled, decoupled
from drake_rho.planning.errors import SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.group_duals import GroupDuals
from drake_rho.planning.scp.groups import groups_with_multipliers
from drake_rho.planning.scp.row_generation import generate_rows
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

_ROUNDS, _FIRST_ROUNDS = 3, 5
"""Rounds in which violated rows are added; more at first, when no active row is known. Remaining
violations are small: with six rounds, references cost the same to 0.4 % and take 50 % longer."""

_FURTHER = 0.6
"""Fraction of a linearisation's step by which the next reference is extrapolated. With a whole
step, every other linearisation of large fleets finds no better motion."""

_SINGLE_GROUP = 2
"""Multiple of the bound on groups up to which a fleet is one group, which couples all pairs."""

_REPEATED = 0.5
"""Factor on the multiplier sum of a pair that has just been in a group, so that others follow."""

_LIMIT_PENALTY = 1e3
"""Penalty of limits and obstacles, as a multiple of that of a separation that may be violated."""

_BETWEEN_GROUPS = ("pairs", "of two groups")
"""Key of the constraint of pairs whose vehicles are in different groups."""


class InGroups:
    """Successive linearisations of a fleet in groups.

    Args:
        problem: the problem of a scenario with a separation.
        most: the largest number of vehicles in a group. With 1, vehicles are independent; otherwise
            a fleet of up to twice this number is one group.
        backend: the solver of the dual programs, as for `GroupDuals`.

    Attributes:
        groups: the number of each vehicle's group in the next linearisation; None until the first
            forms groups.
        converged: whether the last step lowered the cost by less than the tolerance.
        active: rows with positive multipliers in the last linearisation, by constraint. Each pair
            occurs once, lower index first.
    """

    def __init__(self, problem: Problem, most: int, backend: Backend | None = None) -> None:
        count = len(problem)
        self._problem, self._most = problem, _bound(most, count)
        self.groups: IntArray | None = None
        if most == 1:
            self.groups = np.arange(count)
        elif self._most == count:
            self.groups = np.zeros(count, dtype=int)
        self._backend, self.converged = backend, False
        self.active = list[HalfSpaces]()

    def reference(self, plan: Plan, tolerance: float) -> Plan:
        """Return a motion that costs no more than a plan, after linearisations in groups.

        Args:
            plan: a plan that satisfies every constraint.
            tolerance: the relative decrease of the cost at which the linearisations have converged.

        Returns:
            A motion to linearise around, with the statistics of these linearisations.

        Raises:
            SolverError: the multipliers of a group are not found, or are wrong.
        """
        spent = Statistics()
        best = point = plan.motion()
        cost, self.converged = plan.cost, False
        for number in range(10):
            check_time()
            extrapolated = point is not best
            try:
                after, statistics = self.solve_around(point)
            except SolverError:
                if number == 0:
                    raise
                if not extrapolated:
                    break
                point = best  # the extrapolation went too far
                continue
            spent += statistics
            fallen = cost - cost_of(self._problem.scenario, after)
            if number == 0 and fallen < -tolerance * cost:
                raise SolverError("groups: a reference costs more than its feasible plan", spent)
            if fallen <= 0.0 and extrapolated:
                point = best
                continue
            if fallen > 0.0:
                point = after if extrapolated or number == 0 else _extrapolated(best, after)
                best, cost = after, cost - fallen
            self.converged = fallen <= tolerance * cost
            if self.converged:
                break
        return Plan.from_motion(self._problem.scenario, best, spent)

    def solve_around(
        self,
        reference: Motion,
        *,
        penalty: float = np.inf,
        one_normal: bool = False,
        vehicles: IntArray | None = None,
        approaches: CloseApproaches | None = None,
        rounds: int | None = None,
    ) -> tuple[Motion, Statistics]:
        """Solve one linearisation, and form the groups of the next from its multipliers.

        Args:
            reference: the motion to linearise around.
            penalty: the cost of each metre by which a pair is too close; limits cost more.
            one_normal: whether each close encounter of the reference has one normal throughout.
            vehicles: indices of the planned vehicles, ascending; others keep the reference.
            approaches: the close approaches of the reference, as for `pairs_of`.
            rounds: the number of rounds that add violated rows; more by default at first
                than later.
        """
        pairs = self._problem.pairs_around(
            reference,
            coupled,
            penalty=penalty,
            one_normal=one_normal,
            of=vehicles,
            close=approaches,
        )
        between = dataclasses.replace(
            pairs, key=_BETWEEN_GROUPS, coupled=False, responsibility=decoupled.responsibility
        )
        others = [*self._problem.convex, *self._problem.obstacles_around(reference)]
        others = [  # references take no account of soft limits
            dataclasses.replace(each, penalty=_LIMIT_PENALTY * penalty)
            for each in others
            if each.prices is None
        ]
        if self.groups is None:
            self.groups = self._first_groups(pairs)
        effort, planned = self._problem.effort, np.arange(len(self.groups))
        motion = effort.motion
        if vehicles is not None:
            planned = vehicles
            motion = reference.with_vehicles(planned, motion.accelerations[planned])
        program = GroupDuals(effort, self.groups, motion, self._backend)
        rows = _Rows(self._problem.scenario, program, self.groups, between, planned)
        known = {constraint.key: constraint for constraint in (*others, pairs)}
        for active in self.active:
            rows.enter(known[active.constraint.key].renewed(active))
        if rounds is None:
            rounds = _ROUNDS if self.active else _FIRST_ROUNDS
        if len(program) > 0:
            program.solve()
        numbers = count()
        generate_rows(
            lambda: rows.enter_violated([*others, pairs], next(numbers)), program.solve, rounds
        )
        self._record(program, pairs)
        return program.motion, Statistics(
            programs=program.programs, rows=len(program), linearisations=1
        )

    def regroup(self, pairs: CloseApproaches, within: float, most: int) -> None:
        """Form groups of vehicles that are close to each other.

        Args:
            pairs: the close approaches; pairs furthest below `within` are grouped first.
            within: a distance greater than that of every pair [m].
            most: the largest number of vehicles in a group, as for the fleet.
        """
        count = len(self._problem)
        self._most, self.groups = _bound(most, count), np.arange(count)
        if len(pairs) > 0:
            self.groups = self._grouped(pairs.one, pairs.other, within - pairs.distances)

    def _first_groups(self, pairs: KeepApart) -> IntArray:
        """Return groups of the vehicles whose independent motions violate the separation most."""
        free = self._problem.effort.motion
        violated = pairs.violated_rows(free, np.arange(len(self._problem)))
        return self._grouped(violated.vehicles, violated.partners, -violated.margins(free))

    def _record(self, program: GroupDuals, pairs: KeepApart) -> None:
        """Record the active rows, and form groups of the pairs with the largest multiplier sums."""
        assert self.groups is not None  # noqa: S101  # set before the linearisation
        active, weighted = dict[Hashable, HalfSpaces](), list[FloatArray]()
        for rows, multipliers in program.active_rows():
            if rows.constraint.key in (PAIRS, _BETWEEN_GROUPS):
                first, second = np.sort([rows.vehicles, rows.partners], axis=0)
                rows = dataclasses.replace(rows, form=pairs, vehicles=first, partners=second)
                same = self.groups[first] == self.groups[second]
                weighted.append(np.where(same, _REPEATED, 1.0) * multipliers)
            key = rows.constraint.key
            active[key] = active[key].union(rows) if key in active else rows
        self.active = list(active.values())
        if len(self.groups) > self._most > 1 and PAIRS in active:
            rows = active[PAIRS]
            self.groups = self._grouped(rows.vehicles, rows.partners, np.concatenate(weighted))

    def _grouped(self, one: IntArray, other: IntArray, weights: FloatArray) -> IntArray:
        """Return groups of the pairs with the largest sums of weights."""
        count = len(self._problem)
        pairs, index = np.unique(one * count + other, return_inverse=True)
        sums: FloatArray = np.bincount(index, weights, minlength=len(pairs)).astype(np.float64)
        return groups_with_multipliers(count, pairs // count, pairs % count, sums, self._most)


def _bound(most: int, count: int) -> int:
    """Return the largest number of vehicles in a group, which may be the whole fleet."""
    return count if most > 1 and count <= _SINGLE_GROUP * most else most


def _extrapolated(before: Motion, after: Motion) -> Motion:
    """Extrapolate a step between two motions, as slow convergence keeps its direction."""
    accelerations = (1.0 + _FURTHER) * after.accelerations - _FURTHER * before.accelerations
    return after.with_accelerations(accelerations)


class _Rows:
    """Rows of one linearisation: pairs are coupled within a group, decoupled between groups."""

    def __init__(
        self,
        scenario: Scenario,
        program: GroupDuals,
        groups: IntArray,
        between: KeepApart,
        planned: IntArray,
    ) -> None:
        count = len(scenario.vehicles)
        self.program = program
        self._planned, self._is_planned = planned, np.zeros(count, dtype=bool)
        self._is_planned[planned] = True
        self._working = WorkingSet(RowKeys(count, scenario.grid))
        self._groups, self._between, self._gap = groups, between, 1.5 * scenario.grid.step

    def enter_violated(self, constraints: list[Constraint], number: int) -> bool:
        """Add the worst violated rows; return whether there were any.

        The first round, in which most rows are violated, searches the knots only; later ones search
        between the knots too.
        """
        motion, before = self.program.motion, len(self.program)
        for constraint in constraints:
            for between in (False, True)[: 1 + (number > 0 and constraint.searches > 0)]:
                rows = constraint.violated_rows(motion, self._planned, between=between)
                self.enter(rows.worst(motion, 1 + number // 2, gap=self._gap))
        return len(self.program) > before

    def enter(self, rows: HalfSpaces) -> None:
        """Add the rows that are not in the program yet."""
        if rows.constraint.key == PAIRS:
            inside = self._groups[rows.vehicles] == self._groups[rows.partners]
            inside &= self._is_planned[rows.vehicles] & self._is_planned[rows.partners]
            outside = rows.select(~inside)
            rows = rows.select(inside)
            if len(outside) > 0:
                points = EvaluationPoints(outside.vehicles, outside.partners, outside.times)
                self._enter(self._between.rows(points))
        if len(rows) > 0:
            self._enter(rows)

    def _enter(self, rows: HalfSpaces) -> None:
        rows = rows.select(self._is_planned[rows.vehicles])
        new, _ = self._working.enter(rows, self.program.motion)
        if len(new) > 0:
            self.program.add(new)
