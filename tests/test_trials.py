"""Fleets of the benchmarks: planned as campaigns, verified, and resumed."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho

pytest.importorskip("benchmarks")  # a source archive has the tests without them

from benchmarks import fleets
from benchmarks.fleet_b1 import scenario
from tests.studies import own

FOUR = [partial(scenario, 4, seed) for seed in range(3)]


@pytest.mark.slow
def test_a_campaign_of_fleets_gives_the_same_plans_as_single_calls(
    request: pytest.FixtureRequest,
) -> None:
    if request.config.getoption("--solver") != "clarabel":
        pytest.skip("other processes use the usual default solver")

    def twice(plan: rho.Plan) -> float:
        return 2.0 * plan.cost

    for trial, make in zip(fleets.attempts(FOUR, "four", bound=twice), FOUR, strict=True):
        alone = fleets.attempt(make(), bound=twice)
        assert trial.counts
        assert (trial.name, trial.vehicles, trial.index) == (alone.name, 4, alone.index)
        assert trial.sampled == alone.sampled
        assert trial.bound == 2.0 * rho.plan_scp(make()).cost


@pytest.mark.slow
def test_an_interrupted_campaign_of_fleets_resumes(tmp_path: Path) -> None:
    first = fleets.attempts(FOUR[:2], "four", stores=tmp_path)
    again = fleets.attempts(FOUR, "four", stores=tmp_path)
    assert list(map(str, again[:2])) == list(map(str, first))  # NaN equals nothing
    assert len(list(tmp_path.glob("four, *.sqlite"))) == 1


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        pytest.param("late", "error: TimeoutError: not done in 0 s", marks=pytest.mark.slow),
        ("separation", "separation of v"),
    ],
)
def test_plans_that_do_not_hold_do_not_count(wrong: str, words: str) -> None:
    (trial,) = fleets.attempts(FOUR[1:2], "wrong", partial(own, wrong=wrong))
    assert not trial.counts
    assert trial.fault.startswith(words)
    assert (trial.sampled is None) == np.isnan(trial.index) == (wrong == "late")


def test_positional_arguments_of_planners_are_refused() -> None:
    with pytest.raises(ValueError, match="expected one whose arguments have names"):
        fleets.attempts(FOUR, "four", partial(rho.plan_scp, FOUR[0]()))
