"""What is raised reaches other processes as it was."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.scenario.files import scenario_from_yaml

BAD: list[Callable[[], object]] = [
    lambda: rho.Grid(float("nan"), 5),
    lambda: rho.State(np.zeros(4)),
    lambda: rho.Scenario(name="x"),  # type: ignore[call-arg]  # tested
    lambda: rho.load_scenario("nowhere"),
    lambda: scenario_from_yaml("]"),
    lambda: scenario_from_yaml("{name: {a: [1, 2]}, grid: {step: 1, knots: 2}, vehicles: []}"),
    lambda: rho.load("nowhere"),
    lambda: rho.load(__file__),
]


@pytest.mark.parametrize("fail", BAD)
def test_an_error_that_was_pickled_says_the_same(fail: Callable[[], object]) -> None:
    with pytest.raises(rho.DrakeRhoError) as caught:
        fail()
    copy = pickle.loads(pickle.dumps(caught.value))  # noqa: S301  # own
    assert type(copy) is type(caught.value)
    assert str(copy) == str(caught.value)
    assert repr(copy.__dict__) == repr(caught.value.__dict__)


def test_a_value_that_cannot_be_pickled_becomes_what_is_said_of_it() -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Grid(["s"] * 3 + [lambda: 0], 5)  # type: ignore[arg-type]  # tested
    copy = pickle.loads(pickle.dumps(caught.value))  # noqa: S301  # own
    assert (copy.field, str(copy)) == ("grid.step", str(caught.value))


def test_errors_come_back_from_another_process(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        for work, error in ((rho.load_scenario, rho.ScenarioError), (rho.load, rho.PlanFileError)):
            with pytest.raises(error, match=r"nowhere.*No such file"):
                pool.submit(work, str(tmp_path / "nowhere")).result()
