"""Convex programs of groups of coupled vehicles, with the rows of a working set."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import SMALL_FLEET
from drake_rho.planning.constraints.base import HalfSpaces, about
from drake_rho.planning.constraints.rows import Rows, groups_of
from drake_rho.planning.errors import SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Accuracy, Backend
from drake_rho.planning.programs.program import Answers
from drake_rho.planning.programs.solve import solve_all
from drake_rho.planning.scp.curved_sets import CurvedSets
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from drake_rho.scenario.fields import FloatArray, IntArray, unchecked

_MAX_INEXACT = 3
"""Largest number of consecutive rounds that may continue from an inexact solution."""


class GroupPrograms:
    """Programs of single vehicles and of coupled groups, with their last solutions.

    Args:
        problem: the problem to solve.
        backend: the solver of programs without cones, and its settings.
        curved: the choice between cones and tangent planes for each vehicle.

    Attributes:
        motion: the motion of all vehicles in the latest solutions.
        working: the working set of rows.
    """

    def __init__(self, problem: Problem, backend: Backend, curved: CurvedSets) -> None:
        count = len(problem)
        self.motion = problem.effort.motion
        self.working = WorkingSet(RowKeys(count, problem.scenario.grid))
        self._problem, self._curved = problem, curved
        # smaller fleets are solved to full accuracy at once
        accuracy: Accuracy = "quick" if count > SMALL_FLEET else "full"
        self._backend = unchecked(backend, accuracy=accuracy)
        self._inexact = np.zeros(count, dtype=int)
        self._unsatisfied, self._retried = list[HalfSpaces](), False
        self._solved, self._solver_name, self._solver_seconds = 0, "", 0.0

    def fly(self, vehicles: IntArray, accelerations: FloatArray) -> None:
        """Set the accelerations of some vehicles [m/s²], shape (V, K-1, 3)."""
        self.motion = self.motion.with_vehicles(vehicles, accelerations)

    def statistics(self, *, linearisations: int = 0) -> Statistics:
        """Return counts and times of all solves so far."""
        return Statistics(
            programs=self._solved,
            rows=len(self.working),
            linearisations=linearisations,
            solver=self._solver_name,
            solver_seconds=self._solver_seconds,
        )

    def with_groups(self, vehicles: IntArray) -> IntArray:
        """Return the vehicles of all groups to which the given vehicles belong."""
        if not self.working.coupled:
            return vehicles
        labels = self._labels()
        return np.flatnonzero(np.isin(labels, labels[vehicles]))

    def add(self, parts: Sequence[HalfSpaces]) -> IntArray:
        """Add rows; return the vehicles with new or still unsatisfied rows, increasing."""
        self._unsatisfied = []
        affected = np.zeros(len(self._inexact), dtype=bool)
        for rows in parts:
            new, unsatisfied = self.working.enter(rows, self.motion)
            affected[new.vehicles] = True
            if len(unsatisfied) > 0:
                unsatisfied = unsatisfied.select(self._inexact[unsatisfied.vehicles] == 0)
                self._unsatisfied += [unsatisfied] * (len(unsatisfied) > 0)
                affected[unsatisfied.vehicles] = True
        return affected.nonzero()[0]

    def forget_unsatisfied(self) -> None:
        """Forget the unsatisfied rows; rows may be violated until a solve includes them."""
        self._unsatisfied = []

    def _labels(self) -> IntArray:
        """Return the number of each vehicle's group, shape (N,)."""
        coupled = [part for part in self.working.rows.values() if part.constraint.coupled]
        return groups_of(len(self._problem.effort.changes.units), coupled)

    def solve(self, vehicles: IntArray) -> list[int]:
        """Solve the programs of vehicles and their groups; return the infeasible vehicles."""
        vehicles = self.with_groups(vehicles)
        plain, conic, answers = vehicles, vehicles[self._curved.as_cones[vehicles]], list[Answers]()
        if len(conic) > 0:
            conic = self.with_groups(conic)
            plain = np.setdiff1d(vehicles, conic)
        if len(plain) > 0:
            try:
                answers = self._solve_rows(plain)
            except SolverError:
                cut = self._curved.cut_by_planes(plain)
                if len(cut) == 0:
                    raise
                self._curved.to_cones(cut)  # where there is no slack, tangent planes cost digits
                return self.solve(vehicles)
        if len(conic) > 0:
            answers += self._solve_conic(conic)
        solved = list(map(self._record, answers))
        vehicles = np.concatenate([feasible for feasible, _ in solved])
        found = self._problem.effort.goals.met_by(
            np.concatenate([own for _, own in solved]), vehicles
        )
        order = vehicles.argsort()
        self.fly(vehicles[order], found[order])
        every = np.concatenate([each.groups.reshape(-1) for each in answers])
        if len(every) == len(vehicles):
            return []
        infeasible: list[int] = np.setdiff1d(every, vehicles).tolist()
        return infeasible

    def _solve_rows(self, vehicles: IntArray) -> list[Answers]:
        """Solve the programs of vehicles whose rows involve no cones."""
        backend = self._backend
        if self._retry():
            backend = dataclasses.replace(backend, others_first=True)
        effort = self._problem.effort
        rows = about(effort.motion, self.working.of(vehicles, len(self._problem)))
        answers = solve_all(effort.changes, rows, backend)
        for each in answers:
            if False in each.feasible.tolist():
                return self._proved(answers, rows, backend)
        return answers

    def _proved(
        self, answers: list[Answers], rows: Sequence[Rows], backend: Backend
    ) -> list[Answers]:
        """Return answers, of which those that prove nothing are found in another way."""
        doubtful = [~(each.feasible | each.exact) for each in answers]
        if not any(flags.any() for flags in doubtful):
            return answers
        kept, again = list[Answers](), np.zeros(len(self._problem), dtype=bool)
        for each, flags in zip(answers, doubtful, strict=True):
            again[each.groups[flags]] = True
            if not flags.all():
                kept.append(each.select(~flags))
        own = [part.select(again[part.vehicles]) for part in rows]
        reduced = dataclasses.replace(backend, reduced=True)
        return kept + solve_all(self._problem.effort.changes, own, reduced)

    def _solve_conic(self, vehicles: IntArray) -> list[Answers]:
        """Solve programs with cones; store the equivalent tangent planes in the working set."""
        labels, answers = self._labels(), list[Answers]()
        curved = self._curved
        for label in np.unique(labels[vehicles]):
            group = np.flatnonzero(labels == label)
            rows = self.working.of(group, len(labels))
            rows = [part for part in rows if part.constraint.key not in curved.sets]
            found = curved.cones.solve(group, rows, [*curved.sets.values()], rough=curved.soft)
            for tangents, _ in found.tangents:
                self.working.exchange(group, tangents)
            if not (found.exact or curved.soft):
                curved.back_to_planes(group)  # planes at an inexact solution lead to an exact one
                answers += self._solve_rows(group)
                continue
            answers.append(found.answers(group, self.working.of(group, len(labels))))
        return answers

    def check_inexact(self, solved: IntArray, violating: IntArray) -> None:
        """Check that every vehicle with an inexact solution has new rows to be solved with.

        The solutions of an infeasible program grow with every round until infeasibility can be
        proved, and solvers may miss their tolerances on the way. Such solutions violate further
        rows, and with these a solver can succeed.

        Raises:
            SolverError: an inexact solution violates no further row, or further rows did not help.
        """
        rounds = self._inexact[solved]
        if not rounds.any():
            return
        stuck = np.setdiff1d(solved[rounds > 0], self.with_groups(violating))
        if len(stuck) > 0 or rounds.max() > _MAX_INEXACT:
            raise SolverError("all solvers failed numerically", self.statistics())

    def _record(self, answers: Answers) -> tuple[IntArray, FloatArray]:
        """Record answers; return the vehicles with a solution and their accelerations."""
        self.working.record(answers)
        self._solved += len(answers.groups)
        self._solver_name = answers.solver
        self._solver_seconds += answers.seconds
        for group, exact in zip(answers.groups, answers.exact.tolist(), strict=True):
            self._inexact[group] = 0 if exact else self._inexact[group] + 1
        u, groups = answers.accelerations[answers.feasible], answers.groups[answers.feasible]
        units = self._problem.effort.changes.units[groups].max(axis=1)
        vehicles = groups.reshape(-1)
        scales = units.repeat(groups.shape[1]) * self._problem.effort.changes.factors[vehicles]
        a = scales[:, None, None] * u.reshape(-1, *u.shape[2:])
        return vehicles, a + self._problem.effort.motion.accelerations[vehicles]

    def _retry(self) -> bool:
        """Return whether rows are unsatisfied, so that other solvers solve once again.

        Raises:
            SolverError: they have done so already.
        """
        if self._unsatisfied and self._retried:
            rows = self._unsatisfied[0]
            name = self._problem.scenario.vehicles[rows.vehicles[0]].name
            raise SolverError(
                f"no solver satisfies the {rows.constraint.name} of {name}", self.statistics()
            )
        self._retried = len(self._unsatisfied) > 0
        self._unsatisfied = []
        return self._retried
