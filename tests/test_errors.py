"""Exceptions reach other processes unchanged."""

from __future__ import annotations

import functools
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver

import drake_rho as rho
from drake_rho.planning.programs import backend, solve
from drake_rho.planning.scp import group_programs
from tests.scenarios import box, single, slow, through_the_middle
from tests.written import from_yaml

BAD: list[Callable[[], object]] = [
    lambda: rho.Grid(float("nan"), 5),
    lambda: rho.State(np.zeros(4)),
    lambda: rho.Scenario(name="x"),  # type: ignore[call-arg]  # tested
    lambda: rho.load_scenario("nowhere"),
    lambda: from_yaml("]"),
    lambda: from_yaml("{name: {a: [1, 2]}, grid: {step: 1, knots: 2}, vehicles: []}"),
    lambda: rho.load("nowhere"),
    lambda: rho.load(__file__),
]


@pytest.mark.parametrize("fail", BAD)
def test_a_pickled_error_has_the_same_message(fail: Callable[[], object]) -> None:
    with pytest.raises(rho.DrakeRhoError) as caught:
        fail()
    copy = pickle.loads(pickle.dumps(caught.value))  # noqa: S301  # own
    assert type(copy) is type(caught.value)
    assert str(copy) == str(caught.value)
    assert repr(copy.__dict__) == repr(caught.value.__dict__)


def test_a_value_that_cannot_be_pickled_becomes_its_text() -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Grid(["s"] * 3 + [lambda: 0], 5)  # type: ignore[arg-type]  # tested
    copy = pickle.loads(pickle.dumps(caught.value))  # noqa: S301  # own
    assert (copy.field, str(copy)) == ("grid.step", str(caught.value))


def test_errors_come_back_from_another_process(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        for work, error in ((rho.load_scenario, rho.ScenarioError), (rho.load, rho.PlanFileError)):
            with pytest.raises(error, match=r"nowhere.*No such file"):
                pool.submit(work, str(tmp_path / "nowhere")).result()


WEAK = single(limits=rho.Limits(acceleration=box(0.5)))
"""A problem without a plan for any reference."""

WALLED = single(
    goal=rho.State([10, 0, 0]),
    limits=rho.Limits(rho.Box([-1, -1, -1], [11, 1, 1]), acceleration=box(5)),
    obstacles=(rho.Sphere([5, 0.1, 0], 2.0),),
)
"""A corridor filled by a sphere."""

CROWDED = through_the_middle(2, grid=rho.Grid(5.0, 3))
"""With two steps the only motion from rest to rest passes through the middle together."""

FAILURES: dict[str, Callable[[], object]] = {
    "limits": functools.partial(rho.plan_convex, WEAK, steps=[0.25]),
    "obstacle": functools.partial(rho.plan_convex, WALLED),
    "way round": functools.partial(rho.plan, WALLED),
    "fleet": functools.partial(rho.plan, CROWDED),
    "window": functools.partial(rho.plan_rho, WALLED),
}


def _solver_error(monkeypatch: pytest.MonkeyPatch) -> rho.SolverError:
    """Return the error of solvers that may not iterate."""
    for options in ("_CLARABEL", "_CLARABEL_AGAIN", "_OSQP"):
        monkeypatch.setattr(solve, options, {"max_iter": 1})
    slow = single(limits=rho.Limits(velocity=box(1.5)))
    with pytest.raises(rho.SolverError) as caught:
        rho.plan_convex(slow, solver=ClarabelSolver())
    return caught.value


def _error(name: str, monkeypatch: pytest.MonkeyPatch) -> rho.InfeasibleError | rho.SolverError:
    """Return the error of a real failure."""
    if name == "solver":
        return _solver_error(monkeypatch)
    with pytest.raises(rho.InfeasibleError) as caught:
        FAILURES[name]()
    return caught.value


@pytest.mark.parametrize(
    "name", [*(each for each in FAILURES if each != "fleet"), *slow("fleet"), "solver"]
)
def test_the_error_of_a_failure_is_plain_data(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error can be printed, compared and pickled without a solver."""
    error = _error(name, monkeypatch)
    monkeypatch.setattr(group_programs, "solve_all", None)
    monkeypatch.setattr(solve, "solve_side_by_side", None)
    monkeypatch.setattr(solve, "solve", None)
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301  # own
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert len(str(error)) > 20
    assert copy.statistics == error.statistics
    if isinstance(error, rho.InfeasibleError):
        assert isinstance(copy, rho.InfeasibleError)
        for field in ("conflicts", "obstacles", "steps_tried", "scenario"):
            assert getattr(copy, field) == getattr(error, field)
        assert copy.about_linearisation == error.about_linearisation
        assert (copy.reference is None) == (error.reference is None)
        if error.reference is not None and copy.reference is not None:
            np.testing.assert_array_equal(
                copy.reference.accelerations, error.reference.accelerations
            )


def test_a_pickled_error_can_be_explained() -> None:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(WALLED)
    copy = pickle.loads(pickle.dumps(caught.value))  # noqa: S301  # own
    assert rho.infeasible_subset(copy) == rho.infeasible_subset(caught.value)


def _raise(error: Exception) -> None:
    raise error


@pytest.mark.slow
def test_failures_come_back_from_another_process_unchanged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(backend, "DEFAULT", ClarabelSolver)  # the other process uses this default
    errors = [_error(name, monkeypatch) for name in ("limits", "obstacle", "solver")]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        for error in errors:
            with pytest.raises(type(error)) as caught:
                pool.submit(_raise, error).result()
            assert str(caught.value) == str(error)
        with pytest.raises(rho.InfeasibleError) as caught:  # raised there by itself
            pool.submit(rho.plan_convex, WALLED).result()
    assert str(caught.value) == str(errors[1])
