"""The one planning loop: solve, look for broken constraints, add their rows, solve again.

It begins with the motions of least index that reach the goals, which are known in closed form.
Everything else enters as a row when a motion breaks it. When nothing is broken the answer is that
of the full programs, because every row left out holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Statistics
from drake_rho.planning.constraints import WORST, Constraint, Listed
from drake_rho.planning.errors import SolverError
from drake_rho.planning.frame import Frame
from drake_rho.planning.halfspaces import HalfSpaces, near
from drake_rho.planning.program import Batch, groups_of, programs_of
from drake_rho.planning.solve import Solution, solve
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario

MAX_ROUNDS = 50
"""Bound on the rounds. Every round adds rows, and after the first few a growing neighbourhood of
them, so that all of a constraint's rows are in long before."""

_PIECES = 4
"""In the first round the worst row of each quarter of a broken stretch enters, in the next that
of each eighth, and so on: neighbours ask for nearly the same, and a small program is a fast one."""

_PATIENCE = 3
"""Rounds in which only broken rows are added. Most scenarios need no more; where an active
stretch creeps along the knots, as jerk does, neighbours then come too, twice as many each round."""


class Search:
    """The programs of a block of vehicles on their way to a solution, and in the end with it.

    Attributes:
        vehicles: the block, neighbouring indices, shape (B,).
        accelerations: of the latest solutions [m/s²], shape (B, K-1, 3).
        rows: the rows in the programs, for each constraint that has some.
        infeasible: vehicles found to have no solution.
    """

    def __init__(self, scenario: Scenario, frame: Frame, vehicles: IntArray) -> None:
        self.vehicles = vehicles
        self.accelerations = np.array(frame.free.accelerations[vehicles])
        self.rows: dict[str, HalfSpaces] = {}
        self.infeasible: list[int] = vehicles[frame.hopeless[vehicles]].tolist()
        self._scenario, self._frame = scenario, frame
        self._kept: list[int] = []
        self._present: dict[int, BoolArray] = {}  # by the identity of a constraint
        self._held: list[Constraint] = []
        self._kept_alive: list[Constraint] = []  # so that no other gets the identity of one
        self._solutions: list[Solution] = []
        self._solved: dict[int, tuple[Batch, int, Solution]] = {}

    def keep(self, mask: BoolArray, accelerations: FloatArray) -> None:
        """Have some vehicles fly given accelerations; arguments are of all vehicles."""
        own = self.vehicles[mask[self.vehicles]]
        self.accelerations[own - self.vehicles[0]] = accelerations[own]
        self._kept = own.tolist()

    def run(self, constraints: Sequence[Constraint], solver: SolverInterface | None = None) -> None:
        """Go on until nothing is broken, or everything left has no solution.

        Raises:
            SolverError: the solvers fail numerically.
        """
        self._kept_alive += constraints
        new = [each for each in constraints if not any(each is held for held in self._held)]
        pending = self.vehicles
        if self.infeasible or self._kept:
            pending = np.setdiff1d(pending, self.infeasible + self._kept)
        for number in range(MAX_ROUNDS):
            pending = self._add_broken(constraints if number else new, pending, number)
            if len(pending) == 0:
                self._held = list(constraints)
                return
            pending = self._with_groups(pending)  # whose solutions change with theirs
            infeasible = self._solve(pending, solver)
            if infeasible:
                self.infeasible += infeasible
                pending = np.setdiff1d(pending, infeasible)
        raise SolverError(f"rows were still broken after {MAX_ROUNDS} rounds")

    @property
    def statistics(self) -> Statistics:
        """What it took so far; wall time is not counted here."""
        return Statistics(
            programs=len(self._solutions),
            rows=sum(map(len, self.rows.values())),
            solver=self._solutions[-1].solver if self._solutions else "",
            solver_seconds=sum(solution.seconds for solution in self._solutions),
        )

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """The rows in a vehicle's program and their multipliers y >= 0, constraint by constraint.

        For rows of length one and the index in units squared, as the program is written. Where
        rows couple the vehicle to others, those of the whole group are given.
        """
        if vehicle not in self._solved:
            return []
        batch, index, solution = self._solved[vehicle]
        group = self.group(vehicle)
        rows = [part.select(np.isin(part.vehicles, group)) for part in self.rows.values()]
        y = np.maximum(solution.result.GetDualSolution(batch.rows[index]), 0.0)
        y *= batch.lengths[index]
        return list(zip(rows, np.split(y, np.cumsum(list(map(len, rows)))[:-1]), strict=True))

    def group(self, vehicle: int) -> IntArray:
        """The vehicles that share a vehicle's program, itself among them."""
        if vehicle not in self._solved:
            return np.array([vehicle])
        batch, index, _ = self._solved[vehicle]
        own: IntArray = batch.groups[index]
        return own

    def rows_of(self, vehicle: int) -> list[HalfSpaces]:
        """The rows in a vehicle's program, constraint by constraint, in the program's order."""
        return [rows.of(vehicle) for rows in self.rows.values()]

    def _motion(self, vehicles: IntArray) -> Motion:
        latest = self.accelerations[vehicles - self.vehicles[0]]
        return self._frame.free.of(vehicles).with_accelerations(latest)

    def _solve(self, vehicles: IntArray, solver: SolverInterface | None) -> list[int]:
        """Solve the programs of `vehicles`, all of which have rows; say which have no solution."""
        rows = list(self.rows.values())
        if len(vehicles) < len(self.vehicles):
            wanted = np.zeros(len(self._frame.units), dtype=bool)
            wanted[self._with_groups(vehicles)] = True
            rows = [part.select(wanted[part.vehicles]) for part in rows]
        batches = programs_of(self._frame, rows)
        answers = iter(solve([each for batch in batches for each in batch.programs], solver))
        infeasible: list[int] = []
        for batch in batches:
            solutions = list(islice(answers, len(batch.programs)))
            self._solutions += solutions
            feasible = np.array([solution.feasible for solution in solutions])
            infeasible += batch.groups[~feasible].reshape(-1).tolist()
            self._take(batch, feasible, solutions)
        return infeasible

    def _take(self, batch: Batch, feasible: BoolArray, solutions: Sequence[Solution]) -> None:
        """Keep the solutions of a batch."""
        frame, (_, size) = self._frame, batch.groups.shape
        u = batch.solutions([each.result for each in solutions], frame.grid.knots - 1)[feasible]
        units = frame.units[batch.groups[feasible]].max(axis=1)
        vehicles = batch.groups[feasible].reshape(-1)
        a = frame.free.accelerations[vehicles]
        a = a + np.repeat(units, size)[:, None, None] * u.reshape(-1, *u.shape[2:])
        self.accelerations[vehicles - self.vehicles[0]] = frame.reaching_goals(a, vehicles)
        for index, group in enumerate(batch.groups.tolist()):
            for vehicle in group:
                self._solved[vehicle] = batch, index, solutions[index]

    def _with_groups(self, vehicles: IntArray) -> IntArray:
        """The vehicles and those that rows couple them to."""
        if not any(part.coupled for part in self.rows.values()):
            return vehicles
        labels = groups_of(len(self._frame.units), list(self.rows.values()))
        return np.flatnonzero(np.isin(labels, labels[vehicles]))

    def _add_broken(
        self, constraints: Sequence[Constraint], vehicles: IntArray, number: int
    ) -> IntArray:
        """Add the rows that the motions of `vehicles` break, and say whose were broken.

        The instants between knots are looked at where nothing is broken at the knots.

        Raises:
            SolverError: a row that is in a program does not hold.
        """
        motion = self._motion(vehicles)
        broken = np.zeros(len(self._frame.units), dtype=bool)
        for constraint in constraints:
            if isinstance(constraint, Listed):
                self._add_listed(constraint, vehicles, number, broken)
            else:
                self._add_knots(constraint, motion, vehicles, number, broken)
        here = ~broken[vehicles]
        if np.any(here):
            some = motion if np.all(here) else motion.of(np.flatnonzero(here))
            found = (each.broken_between(some, vehicles[here]) for each in constraints)
            for rows in found:
                if rows is not None and len(rows) > 0:
                    self._add(rows)
                    broken[rows.vehicles] = True
        return np.flatnonzero(broken)

    def _add_knots(
        self,
        constraint: Constraint,
        motion: Motion,
        vehicles: IntArray,
        number: int,
        broken: BoolArray,
    ) -> None:
        """Add rows of one constraint at the knots, and mark in `broken` whose they are."""
        margins = constraint.margins(motion, vehicles)
        if margins is None or not np.any(mask := margins < -WORST):
            return
        local = vehicles - self.vehicles[0]
        shape = (len(self.vehicles), *margins.shape[1:])
        known = self._present.setdefault(id(constraint), np.zeros(shape, dtype=bool))
        present = known[local]
        if np.any(present & (margins < -1.0)):
            first = int(np.argwhere(present & (margins < -1.0))[0, 0])
            raise self._not_kept(constraint.name, vehicles[first])
        mask &= ~present
        reach = self._reach(number)
        if reach > 0:
            which, sides, knots = np.nonzero(near(mask, reach) & ~present)
        else:
            which, sides, knots = np.nonzero(mask)
            follows = (np.diff(knots) == 1) & (np.diff(sides) == 0) & (np.diff(which) == 0)
            worst = _worst_of_pieces(follows, margins[which, sides, knots], _PIECES * 2**number)
            which, sides, knots = which[worst], sides[worst], knots[worst]
        if len(which) == 0:
            return
        known[local[which], sides, knots] = True
        self._add(constraint.rows(vehicles[which], sides, constraint.times[knots]))
        broken[vehicles[which]] = True

    def _add_listed(
        self, constraint: Listed, vehicles: IntArray, number: int, broken: BoolArray
    ) -> None:
        """The same for a constraint whose rows are listed."""
        here = constraint.of_block(self.vehicles)
        rows = here.every
        if number >= here.rounds:
            return
        asked = np.zeros(len(self._frame.units), dtype=bool)
        asked[self._with_groups(vehicles)] = True
        motion = self._frame.free.with_some(self.vehicles, self.accelerations)
        margins = rows.margins(motion) / rows.tolerances
        present = self._present.setdefault(id(constraint), np.zeros(len(rows), dtype=bool))
        lost = asked[rows.vehicles] & present & (margins < -1.0)
        if np.isinf(rows.price) and np.any(lost):
            raise self._not_kept(constraint.name, rows.vehicles[np.argmax(lost)])
        new = np.flatnonzero(asked[rows.vehicles] & ~present & (margins < -WORST))
        if self._reach(number) == 0:
            follows = (np.diff(new) == 1) & (np.diff(rows.times[new]) > 0.0)
            new = new[_worst_of_pieces(follows, margins[new], _PIECES * 2**number)]
        if here.likely is not None and number == 0:
            new = np.union1d(new, np.flatnonzero(here.likely & asked[rows.vehicles]))
        if len(new) == 0:
            return
        present[new] = True
        self._add(rows.select(new))
        broken[rows.vehicles[new]] = True

    def _reach(self, number: int) -> int:
        """How many neighbours of broken rows are added with them in a round."""
        coupled = any(part.coupled for part in self.rows.values())
        patience = 0 if coupled else _PATIENCE  # a round of a large group is dear
        return int(2 ** max(0, number - patience) // 2)

    def _not_kept(self, name: str, vehicle: int) -> SolverError:
        who = self._scenario.vehicles[vehicle].name
        return SolverError(f"the solver does not keep the {name} of {who}")

    def _add(self, rows: HalfSpaces) -> None:
        known = self.rows.get(rows.name)
        self.rows[rows.name] = rows if known is None else HalfSpaces.joined([known, rows])


def _worst_of_pieces(follows: BoolArray, margins: FloatArray, pieces: int) -> IntArray:
    """Of every broken stretch the worst row of each of its pieces, as indices.

    Args:
        follows: whether each row but the first belongs to the same stretch as that before it.
        margins: of all broken rows, stretch by stretch, shape (R,).
        pieces: into how many each stretch is cut.
    """
    if len(margins) <= 1:
        return np.arange(len(margins))
    first = np.flatnonzero(np.append(True, ~follows))
    length = np.diff(np.append(first, len(margins)))
    place = np.arange(len(margins)) - np.repeat(first, length)
    piece = np.repeat(np.arange(len(first)) * pieces, length)
    piece += place * pieces // np.maximum(np.repeat(length, length), pieces)
    order = np.lexsort((margins, piece))
    worst: IntArray = order[np.append(True, np.diff(piece[order]) != 0)]
    return worst
