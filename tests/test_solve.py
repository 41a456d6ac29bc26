"""The call of a solver: what it answers, who takes over, and what is not believed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, SolverInterface

import drake_rho as rho
from drake_rho.planning.programs import backend, solve
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.dense import DenseProgram, Program
from drake_rho.planning.programs.solution import Solution
from drake_rho.planning.programs.solve import solve_side_by_side
from tests.scenarios import box, single
from tests.tolerances import INDEX

SLOW = rho.Limits(velocity=box(1.5))


@pytest.fixture(autouse=True)
def _clarabel_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the suite runs with, this is about who follows whom after the usual default."""
    monkeypatch.setattr(backend, "DEFAULT", ClarabelSolver)


def nearest(value: float) -> DenseProgram:
    """Return the least x² with x at least a value above 0, in one variable: x is the value."""
    return _hard([[1.0]], [value])


def empty() -> DenseProgram:
    """Return a program without a solution."""
    return _hard([[1.0], [-1.0]], [1.0, 0.0])


def _hard(matrix: list[list[float]], needed: list[float]) -> DenseProgram:
    count = len(needed)
    return DenseProgram(
        np.array(matrix), np.array(needed), np.full(count, np.inf), np.zeros(count, dtype=int)
    )


def value_of(solution: Solution) -> float:
    """X."""
    return float(solution.x[0])


@pytest.mark.parametrize("chunk", [0, 4, 10**9])
def test_solutions_come_in_the_order_of_the_programs(
    chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether they are solved here or, in chunks, on threads."""
    monkeypatch.setattr(solve, "_CHUNK", chunk)
    batches = [[1.0, 2.0, 3.0], [], [4.0], [5.0, 6.0, 7.0, 8.0, 9.0]]
    asked = ([nearest(value) for value in batch] for batch in batches)
    found = solve_side_by_side(asked)
    assert [[round(value_of(each), 6) for each in batch] for batch in found] == batches


def test_a_program_without_a_solution_is_told_from_those_that_have_one(
    solver: SolverInterface,
) -> None:
    found = solve.solve([nearest(2.0), empty(), nearest(3.0)], Backend(solver))
    assert [each.feasible for each in found] == [True, False, True]
    assert [value_of(found[index]) for index in (0, 2)] == pytest.approx([2.0, 3.0])
    assert {each.solver for each in found} == {str(solver.solver_id().name())}
    assert all(each.seconds >= 0.0 for each in found)


Attempt = Callable[
    [SolverInterface, dict[str, float | int], Sequence[Program]],
    list[Solution | None],
]


def _spoiled(spoil: Callable[[str, int, Solution], Solution | None]) -> tuple[Attempt, list[str]]:
    """Attempts of which each answer goes through `spoil`, and the names of who was asked."""
    asked: list[str] = []
    solve_with = solve._solve_with

    def attempt(
        solver: SolverInterface,
        values: dict[str, float | int],
        programs: Sequence[Program],
    ) -> list[Solution | None]:
        name = str(solver.solver_id().name()) + ("" if values else " as it is")
        asked.append(name)
        answers = solve_with(solver, values, programs)
        return [
            None if answer is None else spoil(name, index, answer)
            for index, answer in enumerate(answers)
        ]

    return attempt, asked


def test_only_programs_on_which_a_solver_fails_go_to_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(name: str, index: int, answer: Solution) -> Solution | None:
        return None if name == "Clarabel" and index == 1 else answer

    attempt, asked = _spoiled(fail)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    found = solve.solve([nearest(2.0), nearest(3.0), nearest(4.0)])
    assert [value_of(each) for each in found] == pytest.approx([2.0, 3.0, 4.0])
    assert asked == ["Clarabel", "Clarabel as it is"]


def _off(answer: Solution) -> Solution:
    """A solution on the wrong side of its rows."""
    return dataclasses.replace(answer, x=0.5 * answer.x)


@pytest.mark.parametrize(
    ("wrong", "solver"),
    [
        ((), "Clarabel"),
        (("Clarabel",), "OSQP"),
    ],
)
def test_rows_that_are_in_and_not_kept_are_solved_again_by_another(
    wrong: tuple[str, ...], solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = rho.plan_convex(single(limits=SLOW))
    attempt, asked = _spoiled(lambda name, _, answer: _off(answer) if name in wrong else answer)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    plan = rho.plan_convex(single(limits=SLOW))
    assert plan.cost == pytest.approx(known.cost, rel=INDEX)
    assert rho.verify(plan).ok
    assert plan.statistics.solver == solver
    assert set(wrong) < set(asked)


def test_rows_that_no_solver_keeps_are_an_error_that_names_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attempt, asked = _spoiled(lambda name, index, answer: _off(answer))
    monkeypatch.setattr(solve, "_solve_with", attempt)
    with pytest.raises(rho.SolverError, match="do not keep the velocity box of solo") as caught:
        rho.plan_convex(single(limits=SLOW))
    assert asked == ["Clarabel", "OSQP"]
    assert caught.value.statistics.programs == 2


def test_what_is_almost_a_solution_comes_last_and_only_where_all_fail(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def almost(name: str, index: int, answer: Solution) -> Solution | None:
        if name == "OSQP":
            return None if index == 1 else answer
        return dataclasses.replace(answer, exact=False)

    attempt, asked = _spoiled(almost)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    found = solve.solve([nearest(2.0), nearest(3.0)])
    assert [(each.solver, each.exact) for each in found] == [("OSQP", True), ("Clarabel", False)]
    assert asked == ["Clarabel", "Clarabel as it is", "OSQP"]


@pytest.mark.parametrize("inexact", [3, 100])
def test_almost_a_solution_shows_missing_rows_but_is_no_answer(
    inexact: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Up to three rounds in a row go on from one; then all solvers have failed."""
    limits = rho.Limits(max_thrust=9.9)
    known, left = rho.plan_convex(single(limits=limits)), [inexact]

    def almost(name: str, index: int, answer: Solution) -> Solution | None:
        left[0] -= name == "Clarabel"
        if left[0] < 0:
            return answer
        return dataclasses.replace(answer, exact=False) if name == "Clarabel" else None

    attempt, _ = _spoiled(almost)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    if inexact > 3:
        with pytest.raises(rho.SolverError, match="all solvers failed") as caught:
            rho.plan_convex(single(limits=limits))
        assert caught.value.statistics.programs == 4
        return
    plan = rho.plan_convex(single(limits=limits))
    assert plan.cost == pytest.approx(known.cost, rel=INDEX)
    assert rho.verify(plan).ok


def test_almost_a_solution_that_breaks_no_row_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    attempt, _ = _spoiled(lambda name, _, answer: dataclasses.replace(answer, exact=False))
    monkeypatch.setattr(solve, "_solve_with", attempt)
    with pytest.raises(rho.SolverError, match="all solvers failed"):
        rho.plan_convex(single(limits=SLOW))


def test_one_attempt_that_is_off_is_not_held_against_the_next_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each retry begins with the first solver again, once rows are kept."""
    spoiled = [False]

    def first_only(name: str, index: int, answer: Solution) -> Solution:
        if spoiled[0]:
            return answer
        spoiled[0] = True
        return _off(answer)

    attempt, asked = _spoiled(first_only)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    start = rho.State([0, 0, 0], acceleration=[0, 0, 0])
    limits = rho.Limits(velocity=box(1.8), jerk=box(1.0))
    plan = rho.plan_convex(single(limits=limits, start=start, grid=rho.Grid(0.1, 81)))
    assert rho.verify(plan).ok
    assert asked[:2] == ["Clarabel", "OSQP"]
    assert set(asked[2:]) == {"Clarabel"}


def test_retries_go_to_another_solver(solver: SolverInterface) -> None:
    given = str(solver.solver_id().name())
    for again in (False, True):
        (found,) = solve.solve([nearest(2.0)], Backend(solver, others_first=again))
        assert value_of(found) == pytest.approx(2.0, rel=INDEX)
        assert (found.solver == given) == (not again)
