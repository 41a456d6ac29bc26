"""Time limits: the best result so far, or one error that describes the progress."""

from __future__ import annotations

import dataclasses
import math
import pickle
import signal
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.cli.console import stopping_early
from drake_rho.cli.failures import status_of
from drake_rho.planning.call import time_limit
from drake_rho.planning.call.time_limit import check_time, seconds_left, stoppable, within_time
from drake_rho.planning.call.work_limit import count_work, within_work, work_left
from drake_rho.planning.minimum_effort import MinimumEffort

HURRY = rho.Scenario(
    "hurry",
    rho.Grid.lasting(5.0, step=0.25),
    [rho.Vehicle("a", rho.State([0, 0, 1]), rho.State([10, 1, 2]), radius=0.2)],
    limits=rho.Limits(max_acceleration=2.0),
    obstacles=[rho.Sphere([5, 1.2, 1.7], 1.0)],
)


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Let time run out after a number of checks of the clock, whatever the speed of the machine."""

    def after(looks: int) -> None:
        left = [looks]

        def seconds() -> float:
            left[0] -= 1
            return float(left[0])

        monkeypatch.setattr(time_limit, "seconds_left", seconds)

    return after


def test_bounds_on_work_nest_and_count_in_the_outer_ones() -> None:
    assert work_left() == math.inf
    with within_work(math.inf):
        count_work(5.0)
        check_time()
    with within_work(10.0):
        with within_work(100.0):
            assert work_left() == 10.0
        with within_work(4.0):
            count_work(4.0)
            with pytest.raises(rho.OutOfTimeError):
                check_time()
        assert work_left() == 6.0
        check_time()


def test_limits_nest_and_end_with_their_blocks() -> None:
    assert seconds_left() == math.inf
    check_time()
    with within_time(100.0):
        with within_time(1000.0):
            assert 90.0 < seconds_left() <= 100.0
        with within_time(1.0):
            assert seconds_left() <= 1.0
        assert seconds_left() > 90.0
        with within_time(None), stoppable() as stop:
            check_time()
            stop()
            with pytest.raises(rho.OutOfTimeError):
                check_time()
        check_time()
    assert seconds_left() == math.inf


@pytest.mark.parametrize("looks", [1, 20, 50, 70, 90])
def test_a_plan_cut_short_holds_and_says_so(ends: Callable[[int], None], looks: int) -> None:
    ends(looks)
    try:
        plan = rho.plan(HURRY)
    except rho.OutOfTimeError:
        assert looks <= 20
        return
    assert looks >= 50
    assert rho.verify(plan).ok
    statistics = plan.statistics
    if statistics.cut:
        assert not statistics.converged
        assert statistics.last_fall is None or statistics.last_fall > 1e-9


def test_more_time_is_no_worse_and_an_infinite_limit_is_none(
    ends: Callable[[int], None],
) -> None:
    whole, costs = rho.plan(HURRY), []
    for looks in (50, 70, 90, 10_000):
        ends(looks)
        plan = rho.plan(HURRY, options=rho.Options(time_limit=1e6))
        costs.append(plan.cost)
    assert np.all(np.diff(costs) <= 0.0)
    assert not plan.statistics.cut
    assert plan.cost == pytest.approx(whole.cost, rel=1e-9)
    assert whole.statistics.last_fall is not None
    assert whole.statistics.last_fall < 1e-6


def test_the_error_without_a_result_names_the_interrupted_step() -> None:
    said: list[str] = []
    with pytest.raises(rho.OutOfTimeError) as caught:
        rho.plan(HURRY, options=rho.Options(time_limit=1e-9), progress=said.append)
    assert caught.value.time_limit == 1e-9
    assert "the time limit of 1e-09 s was over before there was an answer" in str(caught.value)
    assert caught.value.statistics.seconds > 0.0
    again = pickle.loads(pickle.dumps(caught.value))  # noqa: S301  # our own
    assert str(again) == str(caught.value)
    impossible = dataclasses.replace(HURRY, limits=rho.Limits(max_acceleration=0.1))
    with pytest.raises(rho.OutOfTimeError, match="looking for the least time"):
        rho.shortest_plan(impossible, options=rho.Options(time_limit=1e-9))
    with pytest.raises(rho.OutOfTimeError):
        rho.diagnose(HURRY, time_limit=1e-9)
    with pytest.raises(rho.OutOfTimeError):
        rho.plan_convex(HURRY, options=rho.Options(time_limit=1e-9))


def test_a_flight_cut_short_keeps_its_plan(ends: Callable[[int], None]) -> None:
    ends(80)
    flight = rho.plan_rho(HURRY, replan_every=4)
    assert rho.verify(flight).ok
    assert flight.statistics.cut
    assert [window.kept for window in flight.windows] == sorted(
        window.kept for window in flight.windows
    )
    assert flight.windows[-1].kept
    assert "before there was an answer" in flight.windows[-1].infeasible


def test_a_certificate_cut_short_has_at_least_the_bound_of_minimum_effort() -> None:
    plan = rho.plan(HURRY)
    certificate = rho.certify(plan, time_limit=1e-9)
    effort = float(np.sum(MinimumEffort.of(HURRY).motion.accelerations ** 2))
    assert certificate.cut
    assert not certificate.is_globally_optimal
    assert certificate.lower_bound == pytest.approx(effort, rel=1e-6)
    assert "time was up" in str(certificate)
    whole = rho.certify(plan, time_limit=1e6)
    assert not whole.cut
    assert effort < whole.lower_bound <= plan.cost * (1.0 + 1e-9)


def test_a_diagnosis_cut_short_reports_what_is_known(ends: Callable[[int], None]) -> None:
    impossible = dataclasses.replace(HURRY, limits=rho.Limits(max_acceleration=0.5))
    ends(300)
    cut = rho.diagnose(impossible)
    assert cut.cut
    assert "not everything was tried to the end" in str(cut)
    assert set(cut.conflicts) == {"a"}


def test_the_shortest_plan_so_far_holds(ends: Callable[[int], None]) -> None:
    ends(30)
    cut = rho.shortest_plan(HURRY)
    assert cut.statistics.cut
    ends(10**9)
    whole = rho.shortest_plan(HURRY)
    assert not whole.statistics.cut
    assert rho.verify(cut).ok
    assert rho.verify(whole).ok
    assert whole.scenario.grid.duration <= cut.scenario.grid.duration <= HURRY.grid.duration


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_a_limit_is_positive(value: float) -> None:
    with pytest.raises(ValueError, match="time_limit: got"):
        rho.Options(time_limit=value)
    plan = rho.plan(HURRY)
    calls: list[Any] = [
        lambda: rho.certify(plan, time_limit=value),
        lambda: rho.diagnose(HURRY, time_limit=value),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="time_limit: got"):
            call()


def test_ctrl_c_on_the_command_line_stops_once_and_then_ends() -> None:
    before = signal.getsignal(signal.SIGINT)
    with stopping_early():
        check_time()
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(rho.OutOfTimeError):
            check_time()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == before
    check_time()


def test_a_first_window_out_of_time_names_the_limit_of_the_horizon() -> None:
    horizon = rho.RecedingHorizon(HURRY, options=rho.Options(time_limit=1e-9))
    with pytest.raises(rho.OutOfTimeError, match="the time limit of 1e-09 s was over"):
        horizon.step(HURRY.fleet.start_states, HURRY.grid.start)


def test_ctrl_c_that_a_package_turns_into_another_error_is_reported_as_ctrl_c(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """pybind11 does this where Ctrl-C arrives while a module of Drake is imported."""

    def command(cause: BaseException | None) -> int:
        raise ImportError("initialization failed") from cause

    assert status_of(partial(command, KeyboardInterrupt())) == 130
    assert capsys.readouterr().err == "drake-rho: interrupted\n"
    with pytest.raises(ImportError, match="initialization failed"):
        status_of(partial(command, None))
