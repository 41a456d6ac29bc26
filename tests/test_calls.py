"""Work of one small plan, counted: the number of Python calls does not depend on the machine."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import drake_rho as rho

MOST = 6450
"""Largest number of Python calls for Example 4, planned and verified. Half of its time is theirs,
since its 25 programs are small."""


def _calls(run: Callable[[], object]) -> int:
    """Return the number of Python functions that are called."""
    count, before = 0, sys.getprofile()

    def counted(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal count
        count += event == "call"

    sys.setprofile(counted)
    try:
        run()
    finally:
        sys.setprofile(before)
    return count


def test_a_small_plan_takes_few_python_calls() -> None:
    scenario = rho.load_scenario("paper")

    def planned_and_verified() -> bool:
        return rho.verify(rho.plan(scenario)).ok

    assert planned_and_verified()  # what is computed once is computed here
    assert _calls(planned_and_verified) <= MOST
