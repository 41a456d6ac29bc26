"""Plans stay what they are: costs of every kind of plan, and verdicts, are kept in `pins.json`."""

from __future__ import annotations

import pytest

from tests.pins import CASES, pin, read

SAME = 1e-6
"""Relative: what another order of additions, or another solver's last digits, may change."""


def test_every_case_is_pinned() -> None:
    assert list(read()) == list(CASES)


@pytest.mark.parametrize("name", CASES)
def test_a_plan_costs_what_it_did_and_is_judged_as_it_was(name: str) -> None:
    kept, found = read()[name], pin(CASES[name]())
    assert found["ok"] == kept["ok"]
    for costs in ("costs", "windows"):
        assert found[costs] == pytest.approx(kept[costs], rel=SAME, abs=1e-9)
