"""Calls of solvers: answers, fallbacks, and answers that are rejected."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, SolverInterface

import drake_rho as rho
from drake_rho.planning.programs import backend, solve
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.program import DenseProgram, Program, Solution
from drake_rho.planning.programs.solve import solve_side_by_side
from tests.scenarios import box, single
from tests.tolerances import INDEX

SLOW = rho.Limits(velocity=box(1.5))


@pytest.fixture(autouse=True)
def _clarabel_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the usual default solver, on which the order of the fallbacks depends."""
    monkeypatch.setattr(backend, "DEFAULT", ClarabelSolver)


def nearest(value: float) -> DenseProgram:
    """Return a program with one variable: least x² with x at least a value above 0."""
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
    """Return the variable x."""
    return float(solution.x[0])


@pytest.mark.parametrize("chunk", [0, 4, 10**9])
def test_solutions_come_in_the_order_of_the_programs(
    chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The programs are solved here or, in chunks, on threads."""
    monkeypatch.setattr(solve, "_CHUNK", chunk)
    batches = [[1.0, 2.0, 3.0], [], [4.0], [5.0, 6.0, 7.0, 8.0, 9.0]]
    programs = ([nearest(value) for value in batch] for batch in batches)
    found = solve_side_by_side(programs)
    assert [[round(value_of(each), 6) for each in batch] for batch in found] == batches


def test_a_program_without_a_solution_is_distinguished_from_the_others(
    solver: SolverInterface,
) -> None:
    found = solve.solve([nearest(2.0), empty(), nearest(3.0)], Backend(solver))
    assert [each.feasible for each in found] == [True, False, True]
    assert [value_of(found[index]) for index in (0, 2)] == pytest.approx([2.0, 3.0])
    assert {found[index].solver for index in (0, 2)} == {str(solver.solver_id().name())}
    assert all(each.seconds >= 0.0 for each in found)


Attempt = Callable[
    [SolverInterface, str, dict[str, float | int], Sequence[Program]],
    list[Solution | None],
]


def _spoiled(spoil: Callable[[str, int, Solution], Solution | None]) -> tuple[Attempt, list[str]]:
    """Return an attempt that passes answers through `spoil`, and the names of solvers used."""
    used: list[str] = []
    solve_with = solve._solve_with

    def attempt(
        solver: SolverInterface,
        name: str,
        values: dict[str, float | int],
        programs: Sequence[Program],
    ) -> list[Solution | None]:
        how = name + ("" if values else " as it is")
        used.append(how)
        answers = solve_with(solver, name, values, programs)
        return [
            None if answer is None else spoil(how, index, answer)
            for index, answer in enumerate(answers)
        ]

    return attempt, used


def test_only_programs_on_which_a_solver_fails_go_to_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(name: str, index: int, answer: Solution) -> Solution | None:
        return None if name == "Clarabel" and index == 1 else answer

    attempt, used = _spoiled(fail)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    found = solve.solve([nearest(2.0), nearest(3.0), nearest(4.0)])
    assert [value_of(each) for each in found] == pytest.approx([2.0, 3.0, 4.0])
    assert used == ["Clarabel", "Clarabel as it is"]


def _violating(answer: Solution) -> Solution:
    """Return the solution on the wrong side of its rows."""
    return dataclasses.replace(answer, x=0.5 * answer.x)


@pytest.mark.parametrize(
    ("wrong", "solver"),
    [
        ((), "Clarabel"),
        (("Clarabel",), "OSQP"),
    ],
)
def test_programs_with_unsatisfied_rows_are_solved_again_by_another_solver(
    wrong: tuple[str, ...], solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = rho.plan_convex(single(limits=SLOW))
    attempt, used = _spoiled(
        lambda name, _, answer: _violating(answer) if name in wrong else answer
    )
    monkeypatch.setattr(solve, "_solve_with", attempt)
    plan = rho.plan_convex(single(limits=SLOW))
    assert plan.cost == pytest.approx(known.cost, rel=INDEX)
    assert rho.verify(plan).ok
    assert plan.statistics.solver == solver
    assert set(wrong) < set(used)


def test_rows_that_no_solver_satisfies_are_named_in_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attempt, used = _spoiled(lambda name, index, answer: _violating(answer))
    monkeypatch.setattr(solve, "_solve_with", attempt)
    with pytest.raises(rho.SolverError, match="satisfies the velocity box of solo") as caught:
        rho.plan_convex(single(limits=SLOW))
    assert used == ["Clarabel", "OSQP"]
    assert caught.value.statistics.programs == 2


def test_an_almost_solution_is_used_only_where_all_solvers_fail(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def almost(name: str, index: int, answer: Solution) -> Solution | None:
        if name == "OSQP":
            return None if index == 1 else answer
        return dataclasses.replace(answer, exact=False)

    attempt, used = _spoiled(almost)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    found = solve.solve([nearest(2.0), nearest(3.0)])
    assert [(each.solver, each.exact) for each in found] == [("OSQP", True), ("Clarabel", False)]
    assert used == ["Clarabel", "Clarabel as it is", "OSQP"]


@pytest.mark.parametrize("inexact", [3, 100])
def test_an_almost_solution_reveals_missing_rows_but_is_no_answer(
    inexact: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At most three rounds in a row continue from one; then all solvers have failed."""
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


def test_an_almost_solution_that_violates_no_row_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attempt, _ = _spoiled(lambda name, _, answer: dataclasses.replace(answer, exact=False))
    monkeypatch.setattr(solve, "_solve_with", attempt)
    with pytest.raises(rho.SolverError, match="all solvers failed"):
        rho.plan_convex(single(limits=SLOW))


def test_the_next_program_begins_with_the_first_solver_after_a_failure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each retry begins with the first solver again, once rows are satisfied."""
    spoiled = [False]

    def first_only(name: str, index: int, answer: Solution) -> Solution:
        if spoiled[0]:
            return answer
        spoiled[0] = True
        return _violating(answer)

    attempt, used = _spoiled(first_only)
    monkeypatch.setattr(solve, "_solve_with", attempt)
    start = rho.State([0, 0, 0], acceleration=[0, 0, 0])
    limits = rho.Limits(velocity=box(1.8), jerk=box(2.4))
    plan = rho.plan_convex(single(limits=limits, start=start, grid=rho.Grid(0.1, 81)))
    assert rho.verify(plan).ok
    assert used[:2] == ["Clarabel", "OSQP"]
    assert set(used[2:]) == {"Clarabel"}


def test_retries_go_to_another_solver(solver: SolverInterface) -> None:
    given = str(solver.solver_id().name())
    for again in (False, True):
        (found,) = solve.solve([nearest(2.0)], Backend(solver, others_first=again))
        assert value_of(found) == pytest.approx(2.0, rel=INDEX)
        assert (found.solver == given) == (not again)


def test_options_reach_the_chosen_solver() -> None:
    """With one iteration the solver fails, and another finds the plan."""
    scenario = single(limits=rho.Limits(velocity=box(1.5)))
    for solver, option in (("clarabel", "max_iter"), ("osqp", "max_iter")):
        name = {"clarabel": "Clarabel", "osqp": "OSQP"}[solver]
        chosen: Any = solver
        assert rho.plan(scenario, solver=chosen).statistics.solver == name
        few = rho.Options(solver_options={option: 1})
        for planner in (rho.plan, rho.plan_convex):
            plan = planner(scenario, solver=chosen, options=few)
            assert plan.statistics.solver != name
            assert rho.verify(plan).ok
        many = rho.Options(solver_options={option: 40_000})
        assert rho.plan(scenario, solver=chosen, options=many).statistics.solver == name


@pytest.mark.parametrize(
    ("solver", "options", "text"),
    [
        ("clarabel", {"iterations": 3}, "options of Clarabel; .*iterations"),
        ("osqp", {"max_iter": "many"}, "options of OSQP"),
        ("daqp", {"primal_tol": 1e-9}, "none beside DAQP"),
        (None, {"max_iter": 2.5}, "options of Clarabel"),
    ],
)
def test_unknown_options_are_refused(solver: Any, options: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=f"options.solver_options: got .*expected {text}"):
        rho.plan(single(), solver=solver, options=rho.Options(solver_options=options))
