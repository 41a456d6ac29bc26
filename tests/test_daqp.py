"""DAQP beside Drake's solvers: the same programs have the same answers and the same proofs."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.optimize import nnls

import drake_rho as rho
from drake_rho.planning.programs import daqp
from drake_rho.planning.programs import reduced as program
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.dual import contradiction, is_optimal
from drake_rho.planning.programs.program import DenseProgram, Solution
from drake_rho.planning.programs.solve import solve
from tests.arrays import FloatArray
from tests.scenarios import box, random_fleet, random_scenario, single, slow, through_the_middle
from tests.test_cli import run
from tests.tolerances import MOTION, ROUNDING

COST = 1e-8
"""Relative, for costs by DAQP and by Clarabel."""

seeds = st.integers(0, 2**32 - 1)


def _rows(rng: np.random.Generator, count: int, size: int) -> FloatArray:
    """Return random rows of length one."""
    rows = rng.normal(size=(count, size))
    unit: FloatArray = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return unit


def _plain(rng: np.random.Generator) -> DenseProgram:
    """Return hard rows that some point satisfies."""
    matrix = _rows(rng, int(rng.integers(1, 40)), int(rng.integers(2, 25)))
    inside = rng.normal(size=matrix.shape[1])
    needed = matrix @ inside - rng.exponential(0.3, len(matrix))
    return DenseProgram(matrix, needed, np.full(len(needed), np.inf), np.zeros(len(needed), int))


def _degenerate(rng: np.random.Generator) -> DenseProgram:
    """Return a program with more active rows than variables, some equal or almost parallel."""
    start = _plain(rng)
    size = start.matrix.shape[1]
    apex, normals = 2.0 * _rows(rng, 1, size)[0], _rows(rng, 2 * size, size)
    normals[normals @ apex < 0.0] *= -1.0
    near = normals[:3] + 1e-7 * _rows(rng, 3, size)
    matrix = np.concatenate([normals, normals[:4], near, start.matrix])
    touching = matrix[: -len(start.matrix)] @ apex
    needed = np.concatenate([touching, np.minimum(start.needed, start.matrix @ apex)])
    return DenseProgram(matrix, needed, np.full(len(needed), np.inf), np.zeros(len(needed), int))


def _soft(rng: np.random.Generator) -> DenseProgram:
    """Return contradicting rows, most of them soft with a slack each."""
    start = _plain(rng)
    count, size = start.matrix.shape
    matrix = np.concatenate([start.matrix, _rows(rng, count, size)])
    needed = np.concatenate([start.needed, rng.normal(0.5, 0.5, count)])
    soft = np.repeat([False, True], count)
    penalties = np.where(soft, 10.0 ** rng.uniform(-2.0, 3.0, 2 * count), np.inf)
    return DenseProgram(matrix, needed, penalties, np.arange(2 * count))


def _shared(rng: np.random.Generator) -> DenseProgram:
    """Return contradicting rows with slacks that several rows share."""
    own = _soft(rng)
    soft = np.isfinite(own.penalties)
    slacks = rng.integers(0, max(1, int(soft.sum()) // 3), len(soft))
    common = 10.0 ** rng.uniform(-2.0, 3.0, len(soft))
    return DenseProgram(own.matrix, own.needed, np.where(soft, common[slacks], np.inf), slacks)


FAMILIES = {"plain": _plain, "degenerate": _degenerate, "soft": _soft, "shared": _shared}


def _cost(program: DenseProgram, x: FloatArray) -> float:
    """Return the cost of x: its squared norm, and for each slack the largest violation."""
    missing = np.maximum(program.needed - program.matrix @ x, 0.0)
    worst: dict[int, float] = {}
    for row in np.flatnonzero(np.isfinite(program.penalties)).tolist():
        slack = int(program.slacks[row])
        worst[slack] = max(worst.get(slack, 0.0), float(program.penalties[row] * missing[row]))
    return float(x @ x) + sum(worst.values())


def _bound(program: DenseProgram, y: FloatArray) -> float:
    """Return the lower bound of the cost by weak duality, for y >= 0 within the slacks' weights."""
    return float(y @ program.needed - 0.25 * np.sum((program.matrix.T @ y) ** 2))


def _one(program: Any, solver: Any = None) -> Solution:
    (found,) = solve([program], Backend(solver))
    return found


@pytest.mark.parametrize("family", ["plain", "degenerate", "soft"])
@given(seed=seeds)
@settings(max_examples=20)
def test_a_solution_meets_the_bound_that_its_multipliers_prove(family: str, seed: int) -> None:
    """A solution that is feasible and costs its lower bound needs no other solver to confirm it."""
    program = FAMILIES[family](np.random.default_rng(seed))
    found = _one(program, rho.Daqp())
    x, y = found.x[: program.matrix.shape[1]], found.multipliers()
    assert found.feasible
    hard = np.isinf(program.penalties)
    assert np.all((program.matrix @ x - program.needed)[hard] >= -ROUNDING * (1 + np.abs(x).max()))
    assert np.all(y >= -ROUNDING * np.abs(y).max())
    for slack in np.unique(program.slacks[~hard]):
        own = ~hard & (program.slacks == slack)
        assert y[own].sum() <= program.penalties[own][0] * (1 + COST)
    cost = _cost(program, x)
    assert cost == pytest.approx(_bound(program, y), rel=COST, abs=COST)


@pytest.mark.parametrize("family", FAMILIES)
@given(seed=seeds)
@settings(max_examples=13)
def test_clarabel_finds_the_same_for_the_same_program(family: str, seed: int) -> None:
    program = FAMILIES[family](np.random.default_rng(seed))
    ours, theirs = _one(program, rho.Daqp()), _one(program, ClarabelSolver())
    size = program.matrix.shape[1]
    assert theirs.solver == "Clarabel"
    x, known = ours.x[:size], theirs.x[:size]
    np.testing.assert_allclose(x, known, atol=10 * MOTION * max(1.0, np.abs(known).max()))


@pytest.mark.parametrize("family", ["plain", "degenerate", "soft"])
def test_daqp_itself_solves_them(family: str) -> None:
    """Falling back to Clarabel is the exception, for nearly parallel rows at most."""
    rngs = map(np.random.default_rng, range(100))
    by = [_one(FAMILIES[family](rng), rho.Daqp()).solver for rng in rngs]
    assert by.count("DAQP") >= 95


@given(seed=seeds)
@settings(max_examples=13)
def test_hard_rows_are_solved_like_lawson_and_hanson(seed: int) -> None:
    program = _plain(np.random.default_rng(seed))
    found = _one(program, rho.Daqp())
    stacked = np.concatenate([program.matrix.T, program.needed[None]])
    weights, _ = nnls(stacked, np.append(np.zeros(len(stacked) - 1), 1.0))
    left = stacked @ weights - np.append(np.zeros(len(stacked) - 1), 1.0)
    np.testing.assert_allclose(found.x, -left[:-1] / left[-1], atol=1e-7)


@pytest.mark.parametrize("softened", [False, True])
@given(seed=seeds)
@settings(max_examples=13)
def test_a_program_without_a_solution_comes_with_the_proof(softened: bool, seed: int) -> None:
    """The proof is a vector y >= 0 with M' y = 0 and b · y > 0, zero for soft rows."""
    rng = np.random.default_rng(seed)
    start = (_soft if softened else _plain)(rng)
    hard = np.isinf(start.penalties)
    mixed = rng.exponential(size=hard.sum()) @ start.matrix[hard]
    length = float(np.linalg.norm(mixed))
    against = -mixed[None] / length
    some = np.linalg.lstsq(start.matrix[hard], start.needed[hard])[0]
    needed = float((against @ some)[0]) + 10.0 + 10.0 * np.abs(some).max()
    program = DenseProgram(
        np.concatenate([start.matrix, against]),
        np.append(start.needed, needed),
        np.append(start.penalties, np.inf),
        np.append(start.slacks, len(hard)),
    )
    ours, theirs = _one(program, rho.Daqp()), _one(program)
    assert ours.feasible == theirs.feasible
    if ours.feasible:  # no weights combine to that row: a distant point is feasible
        return
    y = ours.multipliers()
    assert ours.solver == "DAQP"
    assert np.all(y >= 0.0)
    assert np.all(y[np.isfinite(program.penalties)] <= ROUNDING * y.max())
    assert np.abs(program.matrix.T @ y).max() < 1e-7 * y.max()
    assert program.needed @ y > 0.0


@pytest.mark.parametrize(
    ("matrix", "needed", "feasible"),
    [
        ([[0.0, 0.0], [1.0, 0.0]], [1.0, 1.0], False),  # 0 >= 1
        ([[1e-30, 0.0], [1.0, 0.0]], [1.0, 1.0], False),
        ([[0.0, 0.0], [1.0, 0.0]], [-1.0, 1.0], True),
        ([[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0], True),  # an equality
        ([[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0 + 1e-6], False),
        ([[1.0, 0.0], [1.0, 0.0], [1.0, 1e-9]], [1.0, 1.0, 1.0], True),
    ],
)
def test_degenerate_rows_are_recognised(
    matrix: list[list[float]], needed: list[float], feasible: bool
) -> None:
    count = len(needed)
    program = DenseProgram(
        np.array(matrix), np.array(needed), np.full(count, np.inf), np.zeros(count, dtype=int)
    )
    found = _one(program, rho.Daqp())
    assert found.feasible is feasible
    if feasible:
        np.testing.assert_allclose(found.x, [1.0, 0.0], atol=1e-8)


def test_no_rows_contradict_each_other() -> None:
    """A program of soft rows alone has no hard ones, and DAQP may give up on it."""
    assert contradiction(np.zeros((0, 2)), np.zeros(0)) is None


def _written() -> MathematicalProgram:
    program = MathematicalProgram()
    x = program.NewContinuousVariables(4)
    program.AddQuadraticCost((x[0] - 3) ** 2 + (x[0] + x[1]) ** 2 + 2 * (x[2] - x[3]) ** 2)
    program.AddLinearEqualityConstraint(x[0] + x[2] == 1.0)
    return program


def test_programs_with_shared_slacks_are_passed_to_clarabel() -> None:
    assert _one(_shared(np.random.default_rng(1)), rho.Daqp()).solver == "Clarabel"


def _linear() -> MathematicalProgram:
    program = MathematicalProgram()
    x = program.NewContinuousVariables(2)
    program.AddLinearCost(x[0] + x[1])
    program.AddBoundingBoxConstraint(1.0, 2.0, x)
    return program


def _conic() -> MathematicalProgram:
    program = MathematicalProgram()
    x = program.NewContinuousVariables(2)
    program.AddQuadraticCost(np.eye(2), np.array([-3.0, 0.0]), x, is_convex=True)
    program.AddLorentzConeConstraint(np.array([1.0, x[0], x[1]]))
    return program


@pytest.mark.parametrize("made", [_written, _linear, _conic])
def test_programs_that_daqp_does_not_support_are_passed_to_clarabel(
    made: Callable[[], MathematicalProgram],
) -> None:
    found = _one(made(), rho.Daqp())
    assert (found.solver, found.feasible) == ("Clarabel", True)


@pytest.mark.parametrize("family", ["plain", "soft"])
@pytest.mark.parametrize("flag", [1, -1, -2, -4])
def test_answers_of_daqp_are_checked(
    family: str, flag: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wrong numbers, and a false report of infeasibility, are passed on to Clarabel."""
    program = FAMILIES[family](np.random.default_rng(3))
    known = _one(program, rho.Daqp())
    package = daqp._package()

    def wrong(*args: Any, **settings: Any) -> Any:
        x, cost, _, info = package.solve(*args, **settings)
        return 0.9 * x, cost, flag, {**info, "lam": -info["lam"]}

    monkeypatch.setattr(daqp, "_package", lambda: SimpleNamespace(solve=wrong))
    found = _one(program, rho.Daqp())
    assert (known.solver, found.solver) == ("DAQP", "Clarabel")
    size = program.matrix.shape[1]
    np.testing.assert_allclose(found.x[:size], known.x[:size], atol=1e-4)


@pytest.mark.parametrize("family", ["plain", "soft"])
def test_all_optimality_conditions_are_checked(family: str) -> None:
    """Violate each by itself: stationarity, both bounds, and complementarity at them."""
    program = FAMILIES[family](np.random.default_rng(1))
    y, most = _one(program, rho.Daqp()).multipliers() / 2.0, program.penalties / 2.0
    gram = program.matrix @ program.matrix.T

    def optimal(y: FloatArray) -> bool:
        return is_optimal(gram @ y - program.needed, program.needed, y, most)

    assert optimal(y)
    free, none = (y > 0.0) & (y < most), y == 0.0
    assert free.any()
    assert none.any()
    for row in (*np.flatnonzero(free), *np.flatnonzero(none)):
        for change in (1e-6, -1e-6):
            other = y.copy()
            other[row] += change
            assert not optimal(other)
    for row in np.flatnonzero(y >= most):  # as if it were worth more, or less, to violate it
        for factor in (1.0 + 1e-6, 1.0 - 1e-6):
            most[row] *= factor
            assert not optimal(y)
            most[row] = program.penalties[row] / 2.0
    assert not optimal(np.full(len(y), np.nan))


def test_without_the_package_the_error_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    daqp._package.cache_clear()
    with pytest.raises(ImportError, match=r"pip install 'drake-rho\[fast\]'"):
        rho.Daqp()
    daqp._package.cache_clear()


def test_the_solver_can_be_sent_to_another_process() -> None:
    assert pickle.loads(pickle.dumps(rho.Daqp())) == rho.Daqp()  # noqa: S301  # own


# Plans equal Clarabel's.

_CURVED = rho.Limits(max_speed=1.9, max_thrust=10.2, max_tilt=0.3)
SCENARIOS: dict[str, Callable[[], rho.Scenario]] = {
    "boxes": lambda: single(limits=rho.Limits(velocity=box(1.8), acceleration=box(1.2))),
    "jerk": lambda: single(
        limits=rho.Limits(velocity=box(1.8), jerk=box(2.4)),
        start=rho.State([0, 0, 0], acceleration=[0, 0, 0]),
        grid=rho.Grid(0.1, 81),
    ),
    "norms": lambda: single(limits=_CURVED, grid=rho.Grid(0.25, 33)),
    "waypoint": lambda: single(waypoints=[rho.Waypoint(3.0, [2.0, 4.0, 1.0], 0.5)]),
    "sphere": lambda: single(obstacles=[rho.Sphere([5, 2.2, -1], 1.5)], between_knots=True),
    "solids": lambda: single(
        obstacles=[rho.Box([2, 0, -2], [4, 1.2, 1]), rho.Cylinder([7, 3, 0], 1.0)],
        between_knots=True,
    ),
    "fleet": lambda: through_the_middle(3),
    "random": lambda: random_scenario(8, tight=True, between_knots=True),
    "random fleet": lambda: random_fleet(2),
}


LONG = ("solids", "random fleet")
"""Scenarios whose plans take more than half a second."""


@pytest.mark.parametrize(
    "name", [one for each in SCENARIOS for one in (slow(each) if each in LONG else [each])]
)
def test_plans_cost_the_same_as_with_clarabel(name: str) -> None:
    scenario = SCENARIOS[name]()
    ours, theirs = (rho.plan(scenario, solver=each) for each in (rho.Daqp(), ClarabelSolver()))
    assert rho.verify(ours).ok
    assert (ours.statistics.solver, theirs.statistics.solver) == ("DAQP", "Clarabel")
    assert ours.statistics.programs > 0
    # an iteration stops where the cost decreases by less than its tolerance
    tolerance = max(COST, 10.0 * (ours.statistics.tolerance or 0.0))
    assert ours.cost == pytest.approx(theirs.cost, rel=tolerance)


@pytest.mark.parametrize("name", ["boxes", "jerk", "norms", "waypoint", "sphere", "random"])
def test_one_linearisation_costs_the_same_to_eight_digits(name: str) -> None:
    scenario = SCENARIOS[name]()
    around = rho.plan_convex(scenario.without_obstacles(), solver=ClarabelSolver())
    ours, theirs = (
        rho.plan_convex(scenario, reference=around, solver=each)
        for each in (rho.Daqp(), ClarabelSolver())
    )
    assert ours.statistics.programs > 0
    assert ours.cost == pytest.approx(theirs.cost, rel=COST)
    largest = np.abs(theirs.accelerations).max()
    np.testing.assert_allclose(ours.accelerations, theirs.accelerations, atol=MOTION * largest)


def test_flights_and_their_windows_cost_the_same(paper: rho.Scenario) -> None:
    ours, theirs = (rho.plan_rho(paper, solver=each) for each in (rho.Daqp(), ClarabelSolver()))
    assert ours.statistics.solver == "DAQP"
    for one, other in zip(ours.windows, theirs.windows, strict=True):
        assert one.plan.cost == pytest.approx(other.plan.cost, rel=COST)


@pytest.mark.parametrize(
    "limits",
    [
        rho.Limits(velocity=box(1.2)),
        rho.Limits(acceleration=box(0.5)),
        *slow(rho.Limits(max_acceleration=0.3)),
        rho.Limits(max_speed=1.2),
        rho.Limits(velocity=rho.Box([-1.2, -0.6, -9.0], [1.2, 0.6, 9.0])),
    ],
)
def test_the_same_subset_is_reported_where_there_is_no_plan(limits: rho.Limits) -> None:
    reported = []
    for solver in (rho.Daqp(), ClarabelSolver()):
        with pytest.raises(rho.InfeasibleError) as caught:
            rho.plan_convex(single(limits=limits), solver=solver)
        reported.append(rho.infeasible_subset(caught.value, solver=solver))
    assert reported[0] == reported[1]
    assert reported[0]["solo"]


@pytest.mark.parametrize("seed", range(12))
def test_the_same_vehicles_are_without_a_plan(seed: int) -> None:
    """Proofs may weigh different rows, but not of different vehicles."""
    scenario, reported = random_scenario(seed, tight=True), []
    for solver in (rho.Daqp(), ClarabelSolver()):
        try:
            rho.plan_convex(scenario, solver=solver)
        except rho.InfeasibleError as error:
            reported.append({name: len(names) > 1 for name, names in error.conflicts.items()})
        else:
            reported.append({})
    assert reported[0] == reported[1]
    assert all(reported[0].values())


def test_every_form_of_a_program_gives_the_same_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """DAQP solves rows in all accelerations, in a basis, and in the sparse form."""
    scenario, costs = SCENARIOS["jerk"](), []
    for few, operations in ((10_000, 1.0), (0, 1e-9), (0, 1e9)):
        monkeypatch.setattr(program, "_FEW", few)
        monkeypatch.setattr(program, "_DENSE", operations)
        costs.append(rho.plan_convex(scenario, solver=rho.Daqp()).cost)
    assert costs == pytest.approx([costs[0]] * 3, rel=COST)


def test_a_solver_that_is_not_installed_is_bad_input(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    daqp._package.cache_clear()
    status, _, err = run(capsys, monkeypatch, "plan", "paper", "--solver", "daqp")
    daqp._package.cache_clear()
    assert status == 2
    assert err == "drake-rho: rho.Daqp() needs the package daqp: pip install 'drake-rho[fast]'\n"
