"""Programs of groups of vehicles with the rows of a working set: solved, and looked over."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import SMALL_FLEET
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.errors import SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.parallel import Answers, solve_all
from drake_rho.planning.programs.rows import about, groups_of
from drake_rho.planning.programs.solve import MAX_RETRIES
from drake_rho.planning.scp.curved_sets import CurvedSets
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_MAX_INEXACT = 3
"""Rounds in a row that may go on from a solution that is almost one."""


class GroupPrograms:
    """Programs of vehicles, and of groups of them that rows couple, and their last solutions.

    Args:
        problem: to be solved.
        backend: solves programs of rows alone.
        curved: which sets are in as cones.

    Attributes:
        motion: of all vehicles, the solutions so far.
        working: the rows that are in.
    """

    def __init__(self, problem: Problem, backend: Backend, curved: CurvedSets) -> None:
        self.motion = problem.effort.motion
        self.working = WorkingSet(RowKeys(len(problem), problem.scenario.grid))
        self._problem, self._backend, self._curved = problem, backend, curved
        self._inexact = np.zeros(len(problem), dtype=int)
        self._lost, self._retries = list[HalfSpaces](), 0
        self._solved, self._solver_name, self._solver_seconds = 0, "", 0.0

    def statistics(self, *, linearisations: int = 0) -> Statistics:
        """Return counts and times of the work so far."""
        return Statistics(
            programs=self._solved,
            rows=len(self.working),
            linearisations=linearisations,
            solver=self._solver_name,
            solver_seconds=self._solver_seconds,
        )

    @property
    def are_coupled(self) -> bool:
        """Whether any row couples vehicles."""
        return any(part.constraint.coupled for part in self.working.rows.values())

    def with_groups(self, vehicles: IntArray) -> IntArray:
        """Return some vehicles and those that rows couple them to."""
        if not self.are_coupled:
            return vehicles
        labels = self._labels()
        return np.flatnonzero(np.isin(labels, labels[vehicles]))

    def add(self, rows: HalfSpaces) -> BoolArray:
        """Put rows in; return whose are new, or were in and are not kept, shape (N,)."""
        about = np.zeros(len(self._problem), dtype=bool)
        new, lost = self.working.enter(rows, self.motion)
        if len(lost) > 0:
            lost = lost.select(self._inexact[lost.vehicles] == 0)
            self._lost += [lost] * (len(lost) > 0)
        about[new.vehicles] = about[lost.vehicles] = True
        return about

    def forget_lost(self) -> None:
        """Note that rows that are in may be violated now: nothing was solved with them yet."""
        self._lost = []

    def _labels(self) -> IntArray:
        """Return the number of each vehicle's group, shape (N,)."""
        coupled = [part for part in self.working.rows.values() if part.constraint.coupled]
        return groups_of(len(self._problem.effort.units), coupled)

    def solve(self, vehicles: IntArray) -> list[int]:
        """Solve the programs of vehicles that have rows; return those without a solution."""
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
                self._curved.to_cones(cut)  # tangent planes where there is no room take digits
                return self.solve(vehicles)
        if len(conic) > 0:
            answers += self._solve_conic(conic)
        solved = list(map(self._take, answers))
        vehicles = np.concatenate([whose for whose, _ in solved])
        found = self._problem.effort.goals.met_by(
            np.concatenate([own for _, own in solved]), vehicles
        )
        order = np.argsort(vehicles)
        self.motion = self.motion.with_vehicles(vehicles[order], found[order])
        every = np.concatenate([each.groups.reshape(-1) for each in answers])
        if len(every) == len(vehicles):
            return []
        infeasible: list[int] = np.setdiff1d(every, vehicles).tolist()
        return infeasible

    def _solve_rows(self, vehicles: IntArray) -> list[Answers]:
        """Solve programs of rows alone."""
        count = len(self._problem)
        quick = count > SMALL_FLEET  # others are planned to the last digit
        backend = dataclasses.replace(
            self._backend,
            accuracy="quick" if quick else "full",
            others_first=self._retry() > 0,
        )
        rows = about(self._problem.effort.motion, self.working.of(vehicles, count))
        return solve_all(self._problem.effort.changes, rows, backend)

    def _solve_conic(self, vehicles: IntArray) -> list[Answers]:
        """Solve programs with curved sets as they are; keep tangent planes that say the same."""
        labels, answers = self._labels(), list[Answers]()
        curved = self._curved
        for label in np.unique(labels[vehicles]):
            group = np.flatnonzero(labels == label)
            rows = self.working.of(group, len(labels))
            rows = [part for part in rows if not part.constraint.curved]
            found = curved.cones.solve(group, rows, curved.sets, rough=curved.soft)
            for tangents, _ in found.tangents:
                self.working.exchange(group, tangents)
            if not (found.exact or curved.soft):
                curved.back_to_planes(group)  # planes where the almost solution is lead to one
                answers += self._solve_rows(group)
                continue
            answers.append(found.answers(group, self.working.of(group, len(labels))))
        return answers

    def check_inexact(self, solved: IntArray, broken: BoolArray) -> None:
        """See that whoever has almost a solution has other rows to be solved with.

        Where nothing can be met, solutions grow with every round before it can be proved, and no
        solver may reach its tolerances; they break other rows, with which it can.

        Raises:
            SolverError: someone has none, or they were no help.
        """
        rounds = self._inexact[solved]
        if not rounds.any():
            return
        left = np.setdiff1d(solved[rounds > 0], self.with_groups(np.flatnonzero(broken)))
        if len(left) > 0 or rounds.max() > _MAX_INEXACT:
            raise SolverError("all solvers failed numerically", self.statistics())

    def _take(self, answers: Answers) -> tuple[IntArray, FloatArray]:
        """Note answers; return vehicles that have a solution, and their accelerations."""
        self.working.solved(answers)
        self._solved += len(answers.groups)
        self._solver_name = answers.solver
        self._solver_seconds += answers.seconds
        for group, exact in zip(answers.groups, answers.exact.tolist(), strict=True):
            self._inexact[group] = 0 if exact else self._inexact[group] + 1
        u, groups = answers.accelerations[answers.feasible], answers.groups[answers.feasible]
        units = self._problem.effort.units[groups].max(axis=1)
        vehicles = groups.reshape(-1)
        a = np.repeat(units, groups.shape[1])[:, None, None] * u.reshape(-1, *u.shape[2:])
        return vehicles, a + self._problem.effort.motion.accelerations[vehicles]

    def _retry(self) -> int:
        """Return how often the last rows were in a program that did not keep them."""
        if not self._lost:
            self._retries = 0
        elif self._retries == MAX_RETRIES:
            lost = self._lost[0]
            who = self._problem.scenario.vehicles[lost.vehicles[0]].name
            raise SolverError(
                f"the solvers do not keep the {lost.constraint.name} of {who}", self.statistics()
            )
        else:
            self._retries += 1
        self._lost = []
        return self._retries
