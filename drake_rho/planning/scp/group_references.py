"""References for fleets: linearisations in which groups of vehicles are coupled.

Two that are planned apart each yield half of what a reference leaves between them, and leave what
one could gain by the other's giving way. In groups, pairs have one row about their difference, and
only pairs of two groups yield half each. Groups are of those that press most on each other in one
linearisation, and others in the next, so that every pair that presses is in a group by and by. A
group may be one vehicle alone.

What is found is a reference and no plan: it is approximate, and nothing else is taken from it. From
a plan, references cost less and less; from a motion in which pairs are too close, they are further
apart, as rows may be broken at a penalty.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from itertools import count

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.coupling import coupled, decoupled
from drake_rho.planning.constraints.keep_out import EvaluationPoints
from drake_rho.planning.constraints.separation import PAIRS, KeepApart
from drake_rho.planning.errors import SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.group_duals import GroupDuals
from drake_rho.planning.scp.groups import groups_with_multipliers
from drake_rho.planning.scp.row_generation import generate_rows
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

_ROUNDS, _ROUNDS_AT_FIRST = 3, 5
"""In how many rounds broken rows are added: more where no row is known to press. What is broken
after them is so by little: references found in six cost the same to 0.4 %, and take half as long
again."""

_AHEAD = 10
"""Bound on the linearisations from one plan."""

_FURTHER = 0.6
"""Part of a linearisation's step by which the next goes further. With the whole step again, every
other one in large fleets is around a motion of which nothing can be made."""

_WHOLE = 2
"""Times the bound up to which a fleet is one group, and no pair has to wait for its turn."""

_STALE = 0.5
"""What the pressure of a pair counts for that was in a group: others have not had their turn."""

_LIMITS = 1e3
"""Times what breaking a separation costs, for limits and obstacles where that may be broken."""

_ACROSS = ("pairs", "of two groups")
"""Key of the constraint of pairs of two groups."""


class InGroups:
    """Linearisations of a fleet in groups, one around the other.

    Args:
        problem: of a scenario with a separation.
        most: bound on the vehicles of a group; a fleet of up to twice as many is one, unless it is
            1: each by itself.
        backend: as for `GroupDuals`.

    Attributes:
        groups: for each vehicle the number of its group in the next linearisation; None before
            the first one of a fleet that is larger than a group of several.
        converged: whether the last reference fell by less than the tolerance in its last step.
        active: the rows that press in the last linearisation, constraint by constraint; of pairs
            each once, the lower index first.
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
        """Return a motion that costs less than a plan, after some linearisations in groups.

        Args:
            plan: keeps every constraint.
            tolerance: relative fall of the cost in one linearisation at which it is the last.

        Returns:
            A motion around which to linearise; its statistics are of the work here. It costs no
            more than the plan.

        Raises:
            SolverError: the multipliers of a group are not found, or are wrong.
        """
        spent = Statistics()
        best = around = plan.motion()
        cost, self.converged = plan.cost, False
        for number in range(_AHEAD):
            check_time()
            ahead = around is not best
            try:
                after, statistics = self.around(around)
            except SolverError:
                if number == 0:
                    raise
                if not ahead:
                    break
                around = best  # it was too far ahead
                continue
            spent += statistics
            fallen = cost - float(np.sum(after.accelerations**2))
            if number == 0 and fallen < -tolerance * cost:
                raise SolverError("groups: what a plan keeps was found to cost more than it", spent)
            if fallen <= 0.0 and ahead:
                around = best
                continue
            if fallen > 0.0:
                around = after if ahead or number == 0 else _ahead(best, after)
                best, cost = after, cost - fallen
            self.converged = fallen <= tolerance * cost
            if self.converged:
                break
        return Plan.from_motion(self._problem.scenario, best, spent)

    def around(
        self,
        reference: Motion,
        *,
        penalty: float = np.inf,
        one_normal: bool = False,
        vehicles: IntArray | None = None,
        close: CloseApproaches | None = None,
        rounds: int | None = None,
    ) -> tuple[Motion, Statistics]:
        """Solve one linearisation, and find the groups of the next from its multipliers.

        Args:
            reference: around which.
            penalty: cost of each metre by which a pair is too close; limits cost more.
            one_normal: whether each close encounter of the reference gets one direction all along.
            vehicles: which of them are planned, rising indices; the others fly the reference.
            close: as for `pairs_of`.
            rounds: in how many broken rows are added, if that is not for this to decide.
        """
        pairs = self._problem.pairs_around(
            reference,
            coupled,
            penalty=penalty,
            one_normal=one_normal,
            of=vehicles,
            close=close,
        )
        across = dataclasses.replace(
            pairs, key=_ACROSS, coupled=False, responsibility=decoupled.responsibility
        )
        others = [*self._problem.convex, *self._problem.obstacles_around(reference)]
        others = [dataclasses.replace(each, penalty=_LIMITS * penalty) for each in others]
        if self.groups is None:
            self.groups = self._first_groups(pairs)
        effort, planned = self._problem.effort, np.arange(len(self.groups))
        motion = effort.motion
        if vehicles is not None:
            planned = vehicles
            motion = reference.with_vehicles(planned, motion.accelerations[planned])
        program = GroupDuals(effort, self.groups, motion, self._backend)
        rows = _Rows(self._problem.scenario, program, self.groups, across, planned)
        known = {constraint.key: constraint for constraint in (*others, pairs)}
        for active in self.active:
            rows.enter(known[active.constraint.key].renewed(active))
        if rounds is None:
            rounds = _ROUNDS if self.active else _ROUNDS_AT_FIRST
        if len(program) > 0:
            program.solve()
        numbers = count()
        generate_rows(
            lambda: rows.enter_violated([*others, pairs], next(numbers)), program.solve, rounds
        )
        self._note(program, pairs)
        return program.motion, Statistics(
            programs=program.programs, rows=len(program), linearisations=1
        )

    def regroup(self, pairs: CloseApproaches, within: float, most: int) -> None:
        """Make groups of those that are close.

        Args:
            pairs: that are; how much a pair presses is how much closer than `within` it is.
            within: a distance that none of them has [m].
            most: bound on the vehicles of a group, as for the fleet.
        """
        count = len(self._problem)
        self._most, self.groups = _bound(most, count), np.arange(count)
        if len(pairs) > 0:
            self.groups = self._grouped(pairs.one, pairs.other, within - pairs.distances)

    def _first_groups(self, pairs: KeepApart) -> IntArray:
        """Return groups of vehicles whose independent motions violate the separation most."""
        alone = self._problem.effort.motion
        met = pairs.violated_rows(alone, np.arange(len(self._problem)))
        return self._grouped(met.vehicles, met.partners, -met.margins(alone))

    def _note(self, program: GroupDuals, pairs: KeepApart) -> None:
        """Note the active rows, and the next groups: pairs with the largest multiplier sums."""
        assert self.groups is not None  # noqa: S101  # there was a linearisation
        active, pressures = dict[Hashable, HalfSpaces](), list[FloatArray]()
        for rows, multipliers in program.pressing():
            if rows.constraint.key in (PAIRS, _ACROSS):
                first, second = np.sort([rows.vehicles, rows.partners], axis=0)
                rows = dataclasses.replace(rows, constraint=pairs, vehicles=first, partners=second)
                same = self.groups[first] == self.groups[second]
                pressures.append(np.where(same, _STALE, 1.0) * multipliers)
            key = rows.constraint.key
            active[key] = active[key].union(rows) if key in active else rows
        self.active = list(active.values())
        if len(self.groups) > self._most > 1 and PAIRS in active:
            met = active[PAIRS]
            self.groups = self._grouped(met.vehicles, met.partners, np.concatenate(pressures))

    def _grouped(self, one: IntArray, other: IntArray, pressures: FloatArray) -> IntArray:
        """Return groups by the sum of each pair's multipliers."""
        count = len(self._problem)
        pairs, place = np.unique(one * count + other, return_inverse=True)
        sums: FloatArray = np.bincount(place, pressures, minlength=len(pairs)).astype(np.float64)
        return groups_with_multipliers(count, pairs // count, pairs % count, sums, self._most)


def _bound(most: int, count: int) -> int:
    """Return the bound on a group's vehicles in a fleet, which may be all of them."""
    return count if most > 1 and count <= _WHOLE * most else most


def _ahead(before: Motion, after: Motion) -> Motion:
    """Further from one motion to another: costs that fall slowly do so in one direction."""
    accelerations = (1.0 + _FURTHER) * after.accelerations - _FURTHER * before.accelerations
    return after.with_accelerations(accelerations)


class _Rows:
    """The rows of one linearisation, those of pairs written as their groups ask."""

    def __init__(
        self,
        scenario: Scenario,
        program: GroupDuals,
        groups: IntArray,
        across: KeepApart,
        planned: IntArray,
    ) -> None:
        count = len(scenario.vehicles)
        self.program = program
        self._planned, self._is_planned = planned, np.zeros(count, dtype=bool)
        self._is_planned[planned] = True
        self._working = WorkingSet(RowKeys(count, scenario.grid))
        self._groups, self._across, self._gap = groups, across, 1.5 * scenario.grid.step

    def enter_violated(self, constraints: list[Constraint], number: int) -> bool:
        """Put the worst violated rows in; return whether there were any.

        At the knots only in the first round, in which most are broken, and then between them too.
        """
        motion, before = self.program.motion, len(self.program)
        for constraint in constraints:
            for between in (False, True)[: 1 + (number > 0 and constraint.searches > 0)]:
                rows = constraint.violated_rows(motion, self._planned, between=between)
                self.enter(rows.worst(motion, 1 + number // 2, gap=self._gap))
        return len(self.program) > before

    def enter(self, rows: HalfSpaces) -> None:
        """Put in those that are not in yet."""
        if rows.constraint.key == PAIRS:
            inside = self._groups[rows.vehicles] == self._groups[rows.partners]
            inside &= self._is_planned[rows.vehicles] & self._is_planned[rows.partners]
            apart = rows.select(~inside)
            rows = rows.select(inside)
            if len(apart) > 0:
                points = EvaluationPoints(apart.vehicles, apart.partners, apart.times)
                self._enter(self._across.rows(points))
        if len(rows) > 0:
            self._enter(rows)

    def _enter(self, rows: HalfSpaces) -> None:
        rows = rows.select(self._is_planned[rows.vehicles])
        new, _ = self._working.enter(rows, self.program.motion)
        if len(new) > 0:
            self.program.add(new)
