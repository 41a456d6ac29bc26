"""Arguments of public functions: a wrong type raises one error before any work is done."""

import inspect
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, get_type_hints

import numpy as np
import pytest
from pydrake.solvers import (
    ClarabelSolver,
    CsdpSolver,
    GurobiSolver,
    MobyLcpSolver,
    ScsSolver,
    SolverInterface,
)

import drake_rho as rho
from drake_rho.scenario.arguments import checked, kinds_of
from tests.scenarios import single, through_the_middle

EMPTY = single()
STRAIGHT = rho.plan(EMPTY)
FREE = [
    *(name for name in rho.__all__ if inspect.isfunction(getattr(rho, name))),
    *("winds.constant", "winds.gust", "winds.coloured_noise"),
]
"""Public functions by name."""

ASKS_FOR_A_SOLVER: list[Callable[..., object]] = [
    rho.plan,
    rho.plan_scp,
    rho.plan_convex,
    rho.plan_rho,
    rho.RecedingHorizon,
    rho.diagnose,
    rho.shortest_plan,
    lambda scenario, solver: rho.scp_step(STRAIGHT, solver=solver),
    lambda scenario, solver: rho.certify(STRAIGHT, solver=solver),
    lambda scenario, solver: rho.infeasible_subset(
        rho.InfeasibleError({"solo": ("for a test",)}), solver=solver
    ),
]


def _public(name: str) -> Callable[..., object]:
    found: Any = rho
    for part in name.split("."):
        found = getattr(found, part)
    return found  # type: ignore[no-any-return]  # one of the functions above


@pytest.mark.parametrize("name", FREE)
def test_every_argument_of_a_public_function_is_checked(name: str) -> None:
    function = _public(name)
    parameters = inspect.signature(function).parameters
    for argument in parameters:
        kinds = kinds_of(inspect.unwrap(function))[argument]
        assert not any(kind.has(object()) for kind in kinds)
    if parameters:
        first, required = next(iter(parameters)), inspect.Parameter.empty
        names = [each.name for each in parameters.values() if each.default is required]
        with pytest.raises(TypeError, match=rf"^{first}: got an object of type object, expected "):
            function(**{each: object() for each in [first, *names]})


@pytest.mark.parametrize("name", FREE)
def test_a_checked_function_keeps_its_signature_and_documentation(name: str) -> None:
    function = _public(name)
    assert function.__doc__
    assert list(get_type_hints(function))[:-1] == list(inspect.signature(function).parameters)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            lambda: rho.plan("paper"),  # type: ignore[arg-type]
            "scenario: got 'paper', expected Scenario; rho.load_scenario reads one",
        ),
        (
            lambda: rho.plan(STRAIGHT),  # type: ignore[arg-type]
            "scenario: got an object of type Plan, expected Scenario; it has one as its attribute "
            "`scenario`",
        ),
        (
            lambda: rho.verify(EMPTY),  # type: ignore[arg-type]
            "flown: got an object of type Scenario, "
            "expected Plan, Flight, Simulation or Trajectories",
        ),
        (
            lambda: rho.errors_figure(STRAIGHT),  # type: ignore[arg-type]
            "simulation: got an object of type Plan, expected Simulation",
        ),
        (
            lambda: rho.plan(EMPTY, options={"tolerance": 1e-3}),  # type: ignore[arg-type]
            "options: got an object of type dict, expected Options or None",
        ),
        (
            lambda: rho.certify(rho.simulate(EMPTY)),  # type: ignore[arg-type]
            "flown: got an object of type Simulation, expected Plan or Flight",
        ),
        (
            lambda: rho.plan(EMPTY, solver=rho.Daqp),
            "solver: got the class Daqp, expected a Drake solver, Daqp, 'clarabel', 'daqp', 'osqp' "
            "or None",
        ),
        (
            lambda: rho.plan_rho(EMPTY, fallback="plan"),  # type: ignore[arg-type]
            "fallback: got 'plan', expected a function or None",
        ),
        (
            lambda: rho.plan_convex(EMPTY, steps=0.5),  # type: ignore[arg-type]
            "steps: got 0.5, expected a sequence of numbers",
        ),
        (
            lambda: rho.plan_convex(EMPTY, steps=["0.5"]),  # type: ignore[list-item]
            "steps: got an object of type list, expected a sequence of numbers",
        ),
        (
            lambda: rho.worst_case(EMPTY, "east", 1.0),
            "direction: got 'east', expected numbers",
        ),
        (
            lambda: rho.assign_goals(EMPTY, exact="no"),  # type: ignore[arg-type]
            "exact: got 'no', expected True or False or None",
        ),
        (
            lambda: rho.RecedingHorizon("paper"),  # type: ignore[arg-type]
            "scenario: got 'paper', expected Scenario; rho.load_scenario reads one",
        ),
        (
            lambda: rho.Plan.from_accelerations("paper", np.zeros((1, 2, 3))),  # type: ignore[arg-type]
            "scenario: got 'paper', expected Scenario; rho.load_scenario reads one",
        ),
        (
            lambda: rho.certify_time(STRAIGHT, gap=True),
            "gap: got True, expected a number",
        ),
        (
            lambda: rho.RecedingHorizon(EMPTY).step([[0] * 6], "now"),  # type: ignore[arg-type]
            "time: got 'now', expected a number",
        ),
        (
            lambda: rho.RecedingHorizon(EMPTY).step([[0] * 6], 0.0, scenario=[1]),  # type: ignore[arg-type]
            "scenario: got an object of type list, expected Scenario or None",
        ),
        (
            lambda: rho.WindyPointMass("paper"),  # type: ignore[arg-type]
            "scenario: got 'paper', expected Scenario; rho.load_scenario reads one",
        ),
    ],
)
def test_the_error_of_a_wrong_type_names_the_expected_one(
    wrong: Callable[[], object], words: str
) -> None:
    with pytest.raises(TypeError, match=f"^{re.escape(words)}$"):
        wrong()


def test_errors_of_call_syntax_are_those_of_python() -> None:
    with pytest.raises(TypeError, match=r"^plan\(\) missing 1 required positional argument"):
        rho.plan()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"^plan\(\) got an unexpected keyword argument 'solvr'"):
        rho.plan(EMPTY, solvr="daqp")  # type: ignore[call-arg]


def test_all_number_types_are_accepted_and_generators_are_not_consumed() -> None:
    @checked
    def given(
        number: float, whole: int, flag: bool, numbers: list[float], path: str | None = None
    ) -> list[float]:
        return list(numbers)

    read = (float(each) for each in range(3))
    assert given(np.float32(2), np.int64(3), np.True_, read) == [0.0, 1.0, 2.0]  # type: ignore[arg-type]
    assert given(2, 3, True, np.ones(2)) == [1.0, 1.0]  # type: ignore[arg-type]
    for wrong in ({"number": "2"}, {"whole": None}, {"flag": 1}, {"numbers": "12"}, {"path": 1}):
        right: dict[str, Any] = {"number": 1.0, "whole": 1, "flag": True, "numbers": []}
        with pytest.raises(TypeError, match=rf"^{next(iter(wrong))}: got "):
            given(**{**right, **wrong})


@pytest.mark.parametrize("asks", ASKS_FOR_A_SOLVER)
@pytest.mark.parametrize(
    ("solver", "words"),
    [
        (
            "gurobi",
            "solver: got 'gurobi', expected a Drake solver, Daqp, 'clarabel', 'daqp', 'osqp'",
        ),
        (GurobiSolver(), "solver: got Gurobi, expected one available and enabled"),
        (MobyLcpSolver(), "solver: got Moby LCP, expected one for quadratic programs"),
        (CsdpSolver(), "solver: got CSDP, expected one for quadratic programs"),
    ],
)
def test_an_unavailable_solver_is_refused_even_where_no_program_is_solved(
    asks: Callable[..., object], solver: object, words: str
) -> None:
    if isinstance(solver, SolverInterface) and _is_licensed(solver):
        pytest.skip("this machine has a licence")
    with pytest.raises(ValueError, match=re.escape(words)):
        asks(EMPTY, solver=solver)


def _is_licensed(solver: SolverInterface) -> bool:
    return bool(solver.available() and solver.enabled()) and isinstance(solver, GurobiSolver)


@pytest.mark.parametrize(
    ("word", "name"), [("clarabel", "Clarabel"), ("daqp", "DAQP"), ("osqp", "OSQP")]
)
def test_solvers_can_be_given_by_name(word: Any, name: str) -> None:
    scenario = single(limits=rho.Limits(max_speed=2.0))
    for planned in (
        rho.plan(scenario, solver=word),
        rho.plan_convex(scenario, solver=word),
        rho.plan_rho(scenario, solver=word, replan_every=8).windows[0].plan,
    ):
        assert planned.statistics.solver == name
    with ThreadPoolExecutor(2) as executor:
        assert rho.plan(scenario, solver=word, executor=executor).statistics.solver == name
    assert rho.plan(scenario, solver=ScsSolver()).statistics.solver != name


@pytest.mark.parametrize("coupling", [rho.coupled, rho.decoupled, rho.grouped])
def test_couplings_can_be_given_by_name(coupling: Any) -> None:
    scenario = through_the_middle(3)
    by_word = rho.plan(scenario, coupling=coupling.name, solver=ClarabelSolver())
    itself = rho.plan_scp(scenario, coupling=coupling, solver=ClarabelSolver())
    np.testing.assert_array_equal(by_word.accelerations, itself.accelerations)
    with pytest.raises(
        ValueError, match=r"^coupling: got 'group', expected Coupling, 'coupled', 'decoupled', 'gr"
    ):
        rho.plan(scenario, coupling="group")  # type: ignore[arg-type]
