"""The worst case reaches the tube, in a simulation without code of the tube."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.loop import Loop, fly
from tests.scenarios import single
from tests.test_tube import random_tube, scenario_of, sizes_of

QUANTITIES = ("position", "velocity", "acceleration")


def flown_case(tube: rho.ErrorTube, loop: Loop, case: rho.WorstCase, time: float) -> dict[str, Any]:
    """Return errors at `time` and before, with the wind evaluated as by a simulator."""
    samples = loop.sample * np.arange(loop.samples + 1)
    others = np.concatenate([case.switching_times, [time]]) - tube.grid.start
    times = np.sort(np.concatenate([samples, others]))
    times = times[np.append(True, np.diff(times) > 1e-9 * loop.sample)]
    times = np.concatenate([times[:1] * 0.0, times[1:]])
    for k, near in enumerate(times):  # samples are exact
        j = round(near / loop.sample)
        times[k] = samples[j] if abs(near - samples[j]) < 1e-8 * loop.sample else near
    still = np.zeros((1, 3))
    wind = np.array([case(t + tube.grid.start, still, still)[0] for t in times[:-1]])
    p, v, u = fly(
        loop,
        times,
        wind,
        case.position_errors,
        case.velocity_errors,
        case.first_position,
        case.first_velocity,
        case.lost,
    )
    at = int(np.argmin(np.abs(times - (time - tube.grid.start))))
    j = min(int((time - tube.grid.start) / loop.sample + 1e-9), loop.samples - 1)
    found = {"position": p[at], "velocity": v[at], "acceleration": u[j]}
    clock = tube.grid.start + times
    worst = [
        np.linalg.norm(p, axis=1) / np.maximum(tube.position(clock), 1e-300),
        np.linalg.norm(v, axis=1) / np.maximum(tube.velocity(clock), 1e-300),
        np.linalg.norm(u, axis=1)
        / np.maximum(tube.acceleration(samples[:-1] + tube.grid.start), 1e-300),
    ]
    return {**found, "all": np.concatenate(worst), "wind": wind}


@pytest.mark.parametrize("seed", range(50))
def test_the_radius_is_attained_and_never_exceeded(seed: int) -> None:
    tube, loop = random_tube(1000 + seed)
    rng = np.random.default_rng(seed)
    quantity = QUANTITIES[seed % 3]
    first = loop.delay * loop.sample if quantity == "acceleration" else 0.0
    time = tube.grid.start + rng.uniform(min(first, 0.9 * tube.grid.duration), tube.grid.duration)
    if seed % 5 == 0:  # at a sample
        time = tube.grid.start + loop.sample * round((time - tube.grid.start) / loop.sample)
    direction = rng.normal(size=3)
    scenario = scenario_of(tube.disturbance, tube.grid)
    case = rho.worst_case(scenario, direction, time, quantity, tube=tube)  # type: ignore[arg-type]
    flown = flown_case(tube, loop, case, time)
    radius = float(getattr(tube, quantity)(time))
    assert case.radius == radius
    reached = flown[quantity] @ direction / np.linalg.norm(direction)
    assert 0.999 * radius <= reached <= radius * (1.0 + 1e-9)
    assert reached == pytest.approx(radius, rel=1e-6)
    assert flown["all"].max() <= 1.0 + 1e-9
    W, E_p, E_v, r_p, r_v = sizes_of(tube)
    for values, most in (
        (flown["wind"], W),
        (case.position_errors, E_p),
        (case.velocity_errors, E_v),
        (case.first_position, r_p),
        (case.first_velocity, r_v),
    ):
        assert np.linalg.norm(values, axis=-1).max() <= most * (1.0 + 1e-12)


def test_the_worst_wind_acts_on_every_vehicle_until_its_time() -> None:
    scenario = scenario_of(rho.Disturbance(0.5))
    case = rho.worst_case(scenario, [0, 0, 2], 4.3)
    np.testing.assert_allclose(case(1.0, np.zeros((3, 3)), np.zeros((3, 3)))[:, 2], 0.5)
    assert not case(4.3, np.zeros((3, 3)), np.zeros((3, 3))).any()
    assert not case(-1.0, np.zeros((3, 3)), np.zeros((3, 3))).any()


def test_invalid_worst_cases_are_refused() -> None:
    scenario = scenario_of(rho.Disturbance(0.5))
    for direction in ([0, 0, 0], [1, 0], [np.nan, 0, 0]):
        with pytest.raises(ValueError, match="direction: got"):
            rho.worst_case(scenario, direction, 1.0)
    with pytest.raises(ValueError, match="times: got"):
        rho.worst_case(scenario, [1, 0, 0], 9.0)
    with pytest.raises(ValueError, match="quantity: got 'jerk'"):
        rho.worst_case(scenario, [1, 0, 0], 1.0, "jerk")


def _winds(scenario: rho.Scenario) -> list[Any]:
    return [
        rho.winds.none(),
        rho.winds.constant(scenario, [1, 2, 3]),
        rho.winds.gust(scenario, [0, -1, 0], begin=1.0, duration=3.0),
        rho.winds.coloured_noise(scenario, np.random.default_rng(4), intensity=1.5),
        rho.winds.coloured_noise(scenario, np.random.default_rng(4), correlation=1000.0),
        rho.worst_case(scenario, [1, 1, 0], 5.0, "velocity"),
    ]


def test_no_wind_exceeds_the_strongest_and_each_acts_on_every_vehicle() -> None:
    scenario = scenario_of(rho.Disturbance(0.7))
    still = np.zeros((1, 3))
    for wind in _winds(scenario):
        blown = np.array([wind(t, still, still) for t in np.linspace(-1.0, 10.0, 1200)])
        assert blown.shape == (1200, 1, 3)
        assert np.linalg.norm(blown, axis=-1).max() <= 0.7 * (1.0 + 1e-12)


def test_a_gust_is_one_minus_a_cosine() -> None:
    scenario = scenario_of(rho.Disturbance(0.8))
    wind = rho.winds.gust(scenario, [0, 3, 0], begin=1.0, duration=4.0)
    still = np.zeros((2, 3))
    for time, part in ((0.0, 0.0), (1.0, 0.0), (2.0, 0.5), (3.0, 1.0), (4.0, 0.5), (6.0, 0.0)):
        expected = np.tile([0.0, 0.8 * part, 0.0], (2, 1))
        np.testing.assert_allclose(wind(time, still, still), expected, atol=1e-15)


def test_coloured_noise_has_its_correlation_and_is_reproducible() -> None:
    """The correlation of a Gauss-Markov process over a time s is exp(-s / τ)."""
    scenario = scenario_of(rho.Disturbance(1.0), rho.Grid(0.5, 8001))
    still = np.zeros((1, 3))
    values = []
    for count in (40_000, 1000):
        wind = rho.winds.coloured_noise(
            scenario, np.random.default_rng(1), correlation=2.0, intensity=0.1
        )
        values.append(np.array([wind(0.1 * k, still, still)[0] for k in range(count)]))
    np.testing.assert_array_equal(values[0][:1000], values[1])
    x = values[0]
    assert x.std() == pytest.approx(0.1, rel=0.1)
    for lag, seconds in ((10, 1.0), (20, 2.0), (40, 4.0)):
        found = np.mean(x[lag:] * x[:-lag]) / np.mean(x * x)
        assert found == pytest.approx(np.exp(-seconds / 2.0), abs=0.08)


def test_invalid_winds_are_refused() -> None:
    scenario = scenario_of(rho.Disturbance(1.0))
    with pytest.raises(ValueError, match=r"scenario\.disturbance: got None"):
        rho.winds.constant(single(), [1, 0, 0])
    with pytest.raises(ValueError, match="direction: got"):
        rho.winds.constant(scenario, [0, 0, 0])
    with pytest.raises(ValueError, match="duration: got"):
        rho.winds.gust(scenario, [1, 0, 0], begin=0.0, duration=0.0)
    with pytest.raises(ValueError, match="correlation: got"):
        rho.winds.coloured_noise(scenario, np.random.default_rng(1), correlation=-1.0)
