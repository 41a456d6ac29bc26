"""Times are printed with enough digits to distinguish the instants of a flight."""

from __future__ import annotations

import pytest

import drake_rho as rho
from tests.scenarios import single


@pytest.mark.parametrize(
    ("time", "words"),
    [
        (0.0, "0 s"),
        (12.5, "12.5 s"),
        (1.0 / 3.0, "0.333333 s"),
        (-99999.0, "-99999 s"),
        (1.7e9, "1700000000 s"),
        (1.7e9 + 0.25, "1700000000.25 s"),
    ],
)
def test_a_time_is_printed_with_its_digits(time: float, words: str) -> None:
    begins, ends = (
        dict(rho.verify(rho.plan(single(grid=rho.Grid(0.5, 17, start)))).printed().facts)["time"]
        for start in (time, time - 8.0)
    )
    assert begins.startswith(words.removesuffix(" s") + " to ")
    assert ends.endswith(" to " + words)


def test_reports_and_errors_distinguish_times_of_a_distant_clock() -> None:
    scenario = single(grid=rho.Grid(0.5, 17, 1.7e9 + 0.1))
    horizon = rho.RecedingHorizon(scenario)
    horizon.step(scenario.fleet.start_states, scenario.grid.start)
    with pytest.raises(ValueError, match=r"from 1700000000\.6 to 1700000007\.6 s"):
        horizon.step(scenario.fleet.start_states, 0.0)
    assert "1700000008.1" in str(rho.verify(rho.plan(scenario)))
