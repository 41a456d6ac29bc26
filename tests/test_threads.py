"""Threads: forked processes have pools of their own, and small arithmetic takes one thread."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Callable

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

import drake_rho as rho
from drake_rho.planning.programs import solve
from drake_rho.system.threads import thread_pool
from tests.scenarios import through_the_middle

HUNG = 60
"""Seconds after which a forked process counts as hung."""

FLEET = through_the_middle(3, limits=rho.Limits(max_speed=4.0, max_acceleration=2.0))
"""Vehicles that have to keep apart."""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_plans_as_its_parent(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pool of a parent has no threads in its child, where tasks would wait for ever."""
    monkeypatch.setattr(solve, "_CHUNK", 0)  # every program is solved on the pool
    expected = rho.plan(FLEET).accelerations.tobytes()
    assert thread_pool.cache_info().currsize == 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of Python 3.12: threads are running
        child = os.fork()
    if child == 0:
        signal.alarm(HUNG)
        found = rho.plan(FLEET).accelerations.tobytes()
        os._exit(0 if found == expected else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.parametrize(
    "call",
    [rho.certify, rho.certify_time, rho.diagnose, rho.plan, rho.plan_minimum_time, rho.plan_scp],
)
def test_small_arithmetic_takes_one_thread(call: Callable[..., object]) -> None:
    """More threads would wait for each other; the caller's number is restored afterwards."""
    of_plans = call in (rho.certify, rho.certify_time)
    asked = rho.plan(FLEET) if of_plans else FLEET
    blas, counted = ThreadpoolController().select(user_api="blas"), list[int]()

    def count(_: str) -> None:
        counted.extend(each["num_threads"] for each in blas.info())

    with threadpool_limits(2, user_api="blas"):
        call(asked, progress=count)
        after = [each["num_threads"] for each in blas.info()]
    assert set(counted) == {1}
    assert set(after) == {2}
