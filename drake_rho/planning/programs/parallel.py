"""Blockwise solution of the programs of many vehicles, in this process or in others."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from drake_rho.planning.constraints.rows import Rows
from drake_rho.planning.minimum_effort import Changes
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.dense import Program
from drake_rho.planning.programs.groups import each_of, groups_of
from drake_rho.planning.programs.reduced import Batch, programs_of
from drake_rho.planning.programs.solution import Solution
from drake_rho.planning.programs.solve import solve, solve_side_by_side
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.system.threads import single_threaded_blas

_BLOCK = 128
"""Number of vehicles in a block: tens of milliseconds of work. It does not depend on the number of
workers, so that plans are equal to the last digit."""


@dataclasses.dataclass(frozen=True, eq=False)
class Answers:
    """Solutions of the programs of groups with equal numbers of vehicles and of rows."""

    groups: IntArray
    """indices of the vehicles, shape (B, G)"""
    accelerations: FloatArray
    """u in units, shape (B, G, K-1, 3); meaningless if there is no solution"""
    feasible: BoolArray
    """whether there is a solution; if false, infeasibility is proved, shape (B,)"""
    exact: BoolArray
    """whether the solution meets the solver's tolerances, shape (B,)"""
    weights: Sequence[Callable[[], FloatArray]]
    """multipliers of each program's rows, as in `Solution`"""
    lengths: FloatArray
    """factors by which `weights` become those of rows of length one, shape (B, R)"""
    solver: str
    """name of the solver of the last program"""
    seconds: float
    """time reported by the solvers [s]"""

    def multipliers(self, index: int) -> FloatArray:
        """Return the multipliers y >= 0 of one group's rows, scaled to length one, shape (R,)."""
        y: FloatArray = np.maximum(self.weights[index](), 0.0) * self.lengths[index]
        return y

    def sent(self) -> Answers:
        """Return the answers in a picklable form."""
        found = [partial(np.asarray, weights()) for weights in self.weights]
        return dataclasses.replace(self, weights=found)


@dataclasses.dataclass(frozen=True, eq=False)
class _Block:
    """Block of vehicles in a picklable form."""

    changes: Changes
    rows: Sequence[Rows]
    backend: Backend

    def batches(self) -> Iterator[Batch]:
        dense = self.backend.is_dense and not self.changes.free  # DAQP: no linear ones
        return programs_of(self.changes, self.rows, dense=dense)

    @single_threaded_blas()
    def solved(self) -> list[Answers]:
        """Solve all programs of the block in sequence."""
        answers = list[Answers]()
        for batch in self.batches():
            found = solve(batch.programs, self.backend)
            answers.append(_answers(batch, found, self.changes.grid.knots - 1).sent())
        return answers


def solve_all(
    changes: Changes, rows: Sequence[Rows], backend: Backend | None = None
) -> list[Answers]:
    """Write and solve the programs of all vehicles that have rows.

    Answers do not depend on the process that computes them, to the last digit.

    Args:
        changes: the changes of minimum-effort motions that rows refer to.
        rows: the rows, constraint by constraint.
        backend: if not given, Clarabel in this process, to full accuracy.

    Raises:
        SolverError: the solvers fail numerically.
    """
    backend = backend or Backend()
    executor, here = backend.executor, backend.here()
    blocks = [_Block(changes, own, here) for own in _in_blocks(len(changes.units), rows)]
    if executor is not None and len(blocks) > 1:
        found = [executor.submit(_Block.solved, block) for block in blocks]
        return [answers for each in found for answers in each.result()]
    batches = list[Batch]()

    def written() -> Iterator[Sequence[Program]]:
        for block in blocks:
            for batch in block.batches():
                batches.append(batch)
                yield batch.programs

    answers = solve_side_by_side(written(), here)
    steps = changes.grid.knots - 1
    return [_answers(*each, steps) for each in zip(batches, answers, strict=True)]


def _in_blocks(vehicles: int, rows: Sequence[Rows]) -> Iterator[Sequence[Rows]]:
    """Yield the rows of blocks of about `_BLOCK` vehicles; rows of a group are in one block."""
    has_rows = np.zeros(vehicles, dtype=bool)
    for part in rows:
        has_rows[part.vehicles] = True
    if has_rows.sum() <= _BLOCK:
        yield rows
        return
    groups = groups_of(vehicles, [part for part in rows if part.form.coupled])
    sizes = np.bincount(groups, has_rows)
    numbers = ((np.cumsum(sizes) - sizes) // _BLOCK).astype(int)[groups]
    for _, own in each_of(np.unique(numbers[has_rows]), numbers, rows):
        yield own


def _answers(batch: Batch, solutions: list[Solution], steps: int) -> Answers:
    return Answers(
        batch.groups,
        batch.accelerations(solutions, steps),
        np.array([solution.feasible for solution in solutions]),
        np.array([solution.exact for solution in solutions]),
        [solution.multipliers for solution in solutions],
        batch.lengths,
        solutions[-1].solver,
        sum(solution.seconds for solution in solutions),
    )
