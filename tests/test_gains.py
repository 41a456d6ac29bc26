"""The search for gains, compared with known bounds and a dense search, and its constraints."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import tracked
from tests.loop import Loop
from tests.scenarios import box, single, slow

SECONDS = 0.1


def scenario_of(
    disturbance: rho.Disturbance, limit: float | None = None, knots: int = 17
) -> rho.Scenario:
    limits = None if limit is None else rho.Limits(acceleration=box(limit))
    return dataclasses.replace(
        single(grid=rho.Grid(0.5, knots), limits=limits), disturbance=disturbance
    )


def peaks(tube: rho.ErrorTube) -> tuple[float, float]:
    """Return the largest radius of the position, sampled densely, and that of the feedback."""
    times = np.linspace(tube.grid.start, tube.grid.end, 16 * tube.samples + 1)
    return float(tube.position(times).max()), float(tube.acceleration(times).max())


@pytest.mark.parametrize("limit", [20.0, None])
def test_the_peak_is_close_to_the_lower_bound_of_sampled_feedback(limit: float | None) -> None:
    """No feedback can answer the wind of the last sample, which alone drives δ² W / 2."""
    scenario = scenario_of(rho.Disturbance(1.0, feedback_every=SECONDS), limit)
    peak, _ = peaks(rho.error_tube(scenario))
    assert 1.0 <= peak / (SECONDS**2 / 2) <= 2.05


@pytest.mark.parametrize("delay", [*slow(0, 1), 2])
@pytest.mark.parametrize("error", [*slow(0.0), 1.0])
@pytest.mark.parametrize("limit", [*slow(3.0, None), 6.0])
def test_no_gains_of_a_dense_grid_are_better(delay: int, error: float, limit: float | None) -> None:
    around = rho.Disturbance(1.0, 0.001 * error, 0.05 * error, SECONDS, delay)
    scenario = scenario_of(around, limit, knots=9)
    tube = rho.error_tube(scenario)
    peak, feedback = peaks(tube)
    most = np.inf if limit is None else 0.5 * limit
    assert feedback <= most
    least = np.inf
    for omega, zeta in itertools.product(np.geomspace(0.02, 1.4, 25), np.geomspace(0.3, 6.0, 20)):
        gains = omega**2 / SECONDS**2, (2 * zeta * omega + omega**2 / 2) / SECONDS
        if gains[1] * SECONDS < 2.0 and Loop(gains, SECONDS, delay, 1).is_stable():
            found = peaks(rho.error_tube(scenario, gains=gains))
            least = min(least, found[0] if found[1] <= most else np.inf)
    assert peak <= 1.01 * least


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("initial", [*slow((0.0, 0.0)), (0.3, 0.2)])
def test_the_feedback_respects_its_share_and_is_stable(
    share: float, initial: tuple[float, float]
) -> None:
    around = rho.Disturbance(1.0, 0.01, 0.02, SECONDS, 1, share)
    for limit in (0.5, 2.0, 5.0):
        scenario = scenario_of(around, limit)
        tube = rho.error_tube(scenario, initial)
        assert tube.acceleration_over(0.0, 8.0)[0] <= share * limit
        if tube.gains != (0.0, 0.0):
            assert Loop(tube.gains, SECONDS, 1, 1).is_stable()
        assert tube.gains == rho.error_tube(scenario, initial).gains


def test_a_larger_share_shorter_samples_and_less_delay_are_no_worse() -> None:
    around = rho.Disturbance(1.0, feedback_every=SECONDS, delay=1, share=0.3)
    peak = peaks(rho.error_tube(scenario_of(around, 6.0)))[0]
    for better in ({"share": 0.6}, {"delay": 0}, {"feedback_every": SECONDS / 5}):
        other = dataclasses.replace(around, **better)
        assert peaks(rho.error_tube(scenario_of(other, 6.0)))[0] < 0.9 * peak


def test_with_hardly_any_feedback_the_tube_grows() -> None:
    around = rho.Disturbance(1.0, share=1e-12)
    tube = rho.error_tube(scenario_of(around, 1e-6))
    assert tube.position(8.0) == pytest.approx(8.0**2 / 2, rel=1e-3)
    short, long = (
        rho.error_tube(scenario_of(rho.Disturbance(1.0, feedback_every=SECONDS), 1.6, knots))
        for knots in (41, 81)
    )  # 0.8 m/s² of feedback against wind of 1 m/s²: the rest drives it ever further away
    assert 0.1 * short.grid.duration**2 <= short.position(20.0) < 0.5 * short.grid.duration**2
    assert long.position(40.0) > 2.0 * short.position(20.0)


def test_without_wind_and_initial_errors_there_is_no_feedback() -> None:
    for nothing in (rho.Disturbance(0.0), rho.Disturbance(0.0, 0.1, 0.1)):
        tube = rho.error_tube(scenario_of(nothing))
        assert tube.gains == (0.0, 0.0)
        assert not tube.position([0.0, 8.0]).any()


def test_an_initial_error_decays_even_if_it_is_the_peak() -> None:
    tube = rho.error_tube(scenario_of(rho.Disturbance(0.0, feedback_every=SECONDS)), (1.0, 0.0))
    assert tube.position_over(0.0, 8.0)[0] <= 1.01
    assert tube.position(8.0) < 1e-3


@pytest.mark.parametrize("radius", [*slow(0.03, 1.0), 0.1])
@pytest.mark.parametrize(
    ("delay", "limit"),
    [
        (0, None),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0, 4.0), (1, None), (1, 4.0))),
    ],
)
def test_the_tube_of_the_largest_disturbance_just_fits(
    delay: int, limit: float | None, radius: float
) -> None:
    around = rho.Disturbance(1.0, 0.001, 0.01, SECONDS, delay)
    scenario = scenario_of(around, limit, knots=5)
    most = rho.largest_disturbance(scenario, radius)
    if most == 0.0:
        calm = dataclasses.replace(around, acceleration=0.02)
        assert peaks(rho.error_tube(scenario_of(calm, limit, knots=5)))[0] > radius
        return
    for part, fits in ((0.98, True), (1.02, False)):
        wind = dataclasses.replace(around, acceleration=part * most)
        tube = rho.error_tube(scenario_of(wind, limit, knots=5))
        assert (peaks(tube)[0] <= radius) == fits


@pytest.mark.parametrize("seed", [*range(2), *slow(*range(2, 12))])
def test_the_largest_disturbance_is_never_too_large(seed: int) -> None:
    rng = np.random.default_rng(seed)
    step, knots = float(rng.choice([0.1, 0.25, 0.5])), int(rng.integers(5, 30))
    around = rho.Disturbance(
        0.1,
        float(rng.choice([0.0, 0.01])),
        float(rng.choice([0.0, 0.02])),
        step / int(rng.choice([1, 2, 5])),
        int(rng.integers(0, 3)),
    )
    limits = rho.Limits(max_acceleration=float(rng.uniform(1.0, 6.0)))
    scenario = single(grid=rho.Grid(step, knots), limits=limits)
    scenario = dataclasses.replace(scenario, disturbance=around)
    radius = float(10.0 ** rng.uniform(-1.0, 0.5))
    most = rho.largest_disturbance(scenario, radius)
    if most > 0.0:
        windy = dataclasses.replace(
            scenario, disturbance=dataclasses.replace(around, acceleration=most)
        )
        times = np.linspace(0.0, scenario.grid.end, 20_001)
        assert rho.error_tube(windy).position(times).max() <= radius * (1.0 + 1e-12)


def test_the_largest_disturbance_without_bounds_or_with_too_small_ones() -> None:
    scenario = scenario_of(rho.Disturbance(1.0, 0.1, 0.1), 2.0)
    assert rho.largest_disturbance(scenario, np.inf) == np.inf
    assert rho.largest_disturbance(scenario, 1e-9, initial=(0.1, 0.0)) == 0.0
    with pytest.raises(ValueError, match=r"scenario\.disturbance"):
        rho.largest_disturbance(single(), 1.0)
    for radius in (-1.0, np.nan):
        with pytest.raises(ValueError, match="position: got"):
            rho.largest_disturbance(scenario, radius)


def _table(delay: str) -> list[list[float]]:
    """Return the rows of a table of peaks in docs/flight_results.md, delay first."""
    text = (Path(__file__).parent.parent / "docs" / "flight_results.md").read_text()
    rows = text.split(rf"| {delay} | $1.2 W$: $\rho_p$ |")[1].split("\n\n")[0].splitlines()[2:]
    return [[float(cell) for cell in row.strip("| ").split("|")] for row in rows]


@pytest.mark.parametrize(
    ("row", "predicted"),
    [
        (_table("delay")[0], True),
        *(pytest.param(row, True, marks=pytest.mark.slow) for row in _table("delay")[1:]),
        *((row, False) for row in _table("delay, no prediction")),
    ],
)
def test_the_documented_table_is_true_for_any_sample_and_wind(
    row: list[float], predicted: bool
) -> None:
    sample, W = 0.04, 0.3
    delay, found = int(row[0]), list[float]()
    for taken in (1.2, 1.5, 2.0, 3.0, None):
        limits = rho.Limits(max_acceleration=None if taken is None else 2.0 * taken * W)
        chosen = None if predicted else False
        around = rho.Disturbance(
            W, feedback_every=sample, delay=delay, share=0.5, prediction=chosen
        )
        scenario = single(grid=rho.Grid(0.4, 51), limits=limits)
        tube = rho.error_tube(dataclasses.replace(scenario, disturbance=around))
        assert tube.measurements.predicted == predicted
        peak, feedback = peaks(tube)
        found += [peak / (sample**2 * W), tube.velocity_over(0.0, 20.0)[0] / (sample * W)]
    np.testing.assert_allclose(found[::2], row[1:-1:2], rtol=0.02)
    np.testing.assert_allclose(found[1::2], row[2:-1:2], rtol=0.06)  # these radii are not minimised
    assert feedback / W == pytest.approx(row[-1], rel=0.02)


def test_the_largest_disturbance_for_given_gains() -> None:
    own = rho.error_tube(scenario_of(rho.Disturbance(0.3, feedback_every=SECONDS), 1.0)).gains
    weak = (0.3 * own[0], 0.3 * own[1])
    tracking = tracked(0.0, weak, 0.01, 0.0)
    around = rho.Disturbance(0.3, 0.001, 0.0, SECONDS, tracking=tracking)
    scenario = scenario_of(around, 1.0)
    most = rho.largest_disturbance(scenario, 0.4)
    for part, fits in ((1.0, True), (1.001, False)):
        windy = dataclasses.replace(around, acceleration=part * most)
        assert (peaks(rho.error_tube(scenario_of(windy, 1.0)))[0] <= 0.4 * (1 + 1e-9)) == fits
