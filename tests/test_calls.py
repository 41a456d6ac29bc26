"""Work of one small plan, counted: the number of Python calls does not depend on the machine."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import pytest

import drake_rho as rho

MOST: dict[Callable[[rho.Scenario], rho.Plan | rho.Flight], int] = {
    rho.plan: 5400,
    rho.plan_rho: 8250,
}
"""Largest numbers of Python calls for Example 4, planned as a whole or in windows, and verified.
Half of its time is theirs, since its programs are small."""


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


@pytest.mark.parametrize("planner", MOST)
def test_small_plans_take_few_python_calls(
    planner: Callable[[rho.Scenario], rho.Plan | rho.Flight],
) -> None:
    scenario = rho.load_scenario("paper")

    def planned_and_verified() -> bool:
        return rho.verify(planner(scenario)).ok

    assert planned_and_verified()  # what is computed once is computed here
    assert _calls(planned_and_verified) <= MOST[planner]
