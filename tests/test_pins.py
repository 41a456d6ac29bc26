"""Costs, times and reports of plans of every kind do not change; `pins.json` holds them."""

from __future__ import annotations

import pytest

from tests.pins import CASES, pin, read
from tests.scenarios import slow

LONG = (
    "past a shape: box",
    "past a wall",
    "limit: max_speed",
    "limit: max_thrust",
    "limit: max_tilt",
    "fleet: through a door",
    "fleet: 3 past a moving box",
)
"""Cases that take about a second each."""

SAME = 1e-6
"""Relative change by another order of additions, or another solver's last digits."""


def test_every_case_is_pinned() -> None:
    assert list(read()) == list(CASES)


@pytest.mark.parametrize(
    "name", [one for each in CASES for one in (slow(each) if each in LONG else [each])]
)
def test_a_plan_has_its_pinned_costs_and_report(name: str) -> None:
    kept, found = read()[name], pin(CASES[name]())
    assert found["ok"] == kept["ok"]
    for values in ("costs", "windows", "duration"):
        assert found[values] == pytest.approx(kept[values], rel=SAME, abs=1e-9)
    assert found["checks"] == pytest.approx(kept["checks"], rel=1e-4, abs=1e-4)
