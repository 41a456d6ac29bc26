"""Random flights with late plans, lost measurements and obstacles seen late, by dense samples."""

from __future__ import annotations

import pytest

from benchmarks.flight_closed_loop import VIOLATED
from benchmarks.flight_late import Late, late

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def flights() -> list[Late]:
    return [late(number) for number in (0, 3, 11, 21, 58, 75)]


def test_nothing_is_broken_while_a_contingency_or_a_plan_is_declared(flights: list[Late]) -> None:
    assert sum(each.flown for each in flights) > 10
    for each in flights:
        assert each.promised <= VIOLATED
        assert each.in_contingencies <= VIOLATED
        assert each.over_tube <= 1.0 + 1e-6
        assert each.off_tube == 0


def test_every_window_has_a_contingency_or_the_reason(flights: list[Late]) -> None:
    for each in flights:
        assert each.windows == each.declared + each.reasons
        assert each.both == 0


def test_samples_see_what_windows_without_either_break(flights: list[Late]) -> None:
    """In scene 3 a vehicle cannot avoid what is seen right ahead."""
    assert any(each.elsewhere > VIOLATED and each.without_plan > 0 for each in flights)
