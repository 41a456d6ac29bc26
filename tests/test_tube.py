"""The tube is exact: brute force, known answers, and invariances."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.loop import Loop, fine_times, fly, summed_responses
from tests.scenarios import box, single
from tests.tolerances import ROUNDING

seeds = st.integers(0, 2**32 - 1)
SECONDS = 0.1
DEADBEAT = (1.0 / SECONDS**2, 1.5 / SECONDS)
"""Gains that take any error to zero in two samples of SECONDS."""


def scenario_of(
    disturbance: rho.Disturbance | None,
    grid: rho.Grid | None = None,
    limits: rho.Limits | None = None,
) -> rho.Scenario:
    return dataclasses.replace(
        single(grid=grid or rho.Grid(0.5, 17), limits=limits), disturbance=disturbance
    )


def random_tube(seed: int, dropouts: int = 0) -> tuple[rho.ErrorTube, Loop]:
    """Return a tube with every cause of errors and random stable gains, and its loop.

    Every second seed has feedback without a prediction, unless measurements may be lost.
    """
    predicted = dropouts > 0 or seed % 2 == 0
    rng = np.random.default_rng(seed)
    sample, delay = 10 ** rng.uniform(-2, 1), int(rng.integers(0, 4))
    knots, parts = int(rng.integers(3, 9)), int(rng.integers(1, 5))
    samples = (knots - 1) * parts
    while True:
        slower = 1 if predicted else 1 + delay
        omega, zeta = rng.uniform(0.02, 1.4 / slower), rng.uniform(0.2, 2.0)
        alpha, beta = omega**2, 2 * zeta * omega + omega**2 / 2
        loop = Loop((alpha / sample**2, beta / sample), sample, delay, samples, predicted)
        if loop.is_stable():
            break
    W = 10 ** rng.uniform(-2, 1)
    E_p, E_v, r_p, r_v = W * rng.uniform(0, 2, 4) * (rng.random(4) < 0.7) * sample
    E_p, r_p = E_p * sample, r_p * sample
    around = rho.Disturbance(W, E_p, E_v, sample, delay, dropouts=dropouts, prediction=predicted)
    grid = rho.Grid(sample * parts, knots, rng.uniform(-5, 5))
    return rho.error_tube(scenario_of(around, grid), (r_p, r_v), gains=loop.gains), loop


def sizes_of(tube: rho.ErrorTube) -> tuple[float, float, float, float, float]:
    given = tube.disturbance
    return given.acceleration, given.position_error, given.velocity_error, *tube.initial


@given(seed=seeds)
@settings(max_examples=13)
def test_radii_equal_sums_by_brute_force(seed: int) -> None:
    """Sums over fractions of a sample are below the integrals, by the square of the fraction."""
    tube, loop = random_tube(seed)
    for parts in (4, 8, 32):
        times = tube.grid.start + fine_times(loop, parts)
        radii = tube.position(times), tube.velocity(times), tube.acceleration(times[:-1:parts])
        for known, found in zip(summed_responses(loop, parts, sizes_of(tube)), radii, strict=True):
            assert np.all(known <= found * (1.0 + ROUNDING) + ROUNDING * found.max())
            np.testing.assert_allclose(known, found, rtol=0, atol=found.max() / parts**2)
            if parts == 32:
                np.testing.assert_allclose(known, found, rtol=0.01, atol=1e-9 * found.max())


def test_without_feedback_wind_drives_half_w_t_squared() -> None:
    tube = rho.error_tube(scenario_of(rho.Disturbance(0.7)), gains=(0.0, 0.0))
    t = np.linspace(0.0, 8.0, 101)
    np.testing.assert_allclose(tube.position(t), 0.7 * t**2 / 2, rtol=ROUNDING, atol=1e-12)
    np.testing.assert_allclose(tube.velocity(t), 0.7 * t, rtol=ROUNDING, atol=1e-12)
    assert not tube.acceleration(t).any()


def test_without_feedback_initial_errors_propagate() -> None:
    tube = rho.error_tube(scenario_of(rho.Disturbance(0.0)), (0.3, 0.2), gains=(0.0, 0.0))
    t = np.linspace(0.0, 8.0, 101)
    np.testing.assert_allclose(tube.position(t), 0.3 + 0.2 * t, rtol=ROUNDING)
    np.testing.assert_allclose(tube.velocity(t), 0.2, rtol=ROUNDING)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_until_the_first_measurement_arrives_nothing_acts(delay: int) -> None:
    around = rho.Disturbance(1.0, 0.01, 0.02, SECONDS, delay)
    tube = rho.error_tube(scenario_of(around), gains=(4.0, 3.0))
    before = np.linspace(0.0, delay * SECONDS, 31)
    np.testing.assert_allclose(tube.position(before), before**2 / 2, rtol=ROUNDING, atol=1e-15)
    samples = SECONDS * np.arange(10)
    assert np.array_equal(tube.acceleration(samples) > 0.0, np.arange(10) >= delay)
    first = 4.0 * 0.01 + 3.0 * 0.02 + 4.0 * 0.0 if delay == 0 else None
    if first is not None:
        assert tube.acceleration(0.0) == pytest.approx(first)


def test_radii_of_deadbeat_gains_are_known() -> None:
    tube = rho.error_tube(scenario_of(rho.Disturbance(1.0, feedback_every=SECONDS)), gains=DEADBEAT)
    later = SECONDS * np.arange(2, 80)
    np.testing.assert_allclose(tube.position(later), SECONDS**2, rtol=ROUNDING)
    np.testing.assert_allclose(tube.velocity(later), 2 * SECONDS, rtol=ROUNDING)
    np.testing.assert_allclose(tube.acceleration(later), 3.0, rtol=ROUNDING)
    between = np.linspace(0.2, 8.0, 8001)
    np.testing.assert_allclose(tube.position(between), SECONDS**2, rtol=ROUNDING)
    assert tube.position(np.linspace(0.0, 0.2, 999)).max() <= SECONDS**2 * (1.0 + ROUNDING)
    assert SECONDS**2 <= tube.position_over(0.0, 8.0)[0] <= 1.01 * SECONDS**2


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_radii_of_deadbeat_gains_with_a_prediction_are_known(delay: int) -> None:
    around = rho.Disturbance(1.0, feedback_every=SECONDS, delay=delay, prediction=True)
    tube = rho.error_tube(scenario_of(around), gains=DEADBEAT)
    later, peak = SECONDS * np.arange(2 + delay, 80), (1 + delay) * (2 + delay) / 2 * SECONDS**2
    np.testing.assert_allclose(tube.position(later), peak, rtol=ROUNDING)
    np.testing.assert_allclose(tube.velocity(later), 2 * (1 + delay) * SECONDS, rtol=ROUNDING)
    np.testing.assert_allclose(tube.acceleration(later), 3 + 2 * delay, rtol=ROUNDING)
    assert tube.position(np.linspace(0.0, 8.0, 8001)).max() <= peak * (1.0 + ROUNDING)


@given(seed=seeds)
@settings(max_examples=13)
def test_radii_are_linear_in_the_bounds_and_scale_with_units(seed: int) -> None:
    tube, _ = random_tube(seed)
    grid, around, (r_p, r_v) = tube.grid, tube.disturbance, tube.initial
    times = np.linspace(grid.start, grid.end, 57)
    p, v, u = tube.position(times), tube.velocity(times), tube.acceleration(times)
    length, time = 3.7, 0.23
    other = rho.ErrorTube(
        rho.Disturbance(
            around.acceleration * length / time**2,
            around.position_error * length,
            around.velocity_error * length / time,
            tube.sample * time,
            around.delay,
            prediction=around.prediction,
        ),
        rho.Grid(grid.step * time, grid.knots, grid.start * time),
        (tube.gains[0] / time**2, tube.gains[1] / time),
        (r_p * length, r_v * length / time),
    )
    for found, known in (
        (other.position(times * time), p * length),
        (other.velocity(times * time), v * length / time),
        (other.acceleration(times * time), u * length / time**2),
    ):
        np.testing.assert_allclose(found, known, rtol=1e-6, atol=1e-9 * known.max())


@given(seed=seeds, field=st.sampled_from(["acceleration", "position_error", "velocity_error"]))
@settings(max_examples=13)
def test_larger_bounds_make_no_radius_smaller(seed: int, field: str) -> None:
    tube, _ = random_tube(seed)
    around = dataclasses.replace(
        tube.disturbance, **{field: 0.1 + 2.0 * getattr(tube.disturbance, field)}
    )
    more = dataclasses.replace(tube, disturbance=around)
    times = np.linspace(tube.grid.start, tube.grid.end, 57)
    for quantity in ("position", "velocity", "acceleration"):
        was, now = getattr(tube, quantity)(times), getattr(more, quantity)(times)
        assert np.all(now >= was * (1.0 - ROUNDING))
        # estimates have an effect if feedback acts in time, on them and by accelerations
        acts = tube.samples > around.delay + 1
        if acts or (field == "acceleration" and quantity != "acceleration"):
            assert now.max() > was.max()


@given(seed=seeds)
@settings(max_examples=13)
def test_bounds_over_time_are_never_too_small_and_at_most_a_hundredth_too_large(seed: int) -> None:
    tube, _ = random_tube(seed)
    rng = np.random.default_rng(seed)
    start, end, sample = tube.grid.start, tube.grid.end, tube.sample
    begins = rng.uniform(start, end, 40)
    lengths = 10 ** rng.uniform(-6, 1, 40) * sample
    begins[:10] = start + sample * rng.integers(0, tube.samples, 10)  # as planners do
    lengths[:5] = sample * rng.integers(0, 3, 5)
    begins[10:13] = start
    ends = np.minimum(begins + lengths, end)
    for quantity, most in (("position", 1.01), ("velocity", 1.0), ("acceleration", 1.0)):
        bounds = getattr(tube, f"{quantity}_over")(begins, ends)
        for begin, stop, bound in zip(begins, ends, bounds, strict=True):
            inside = np.linspace(begin, stop, 600, endpoint=quantity != "acceleration")
            samples = start + sample * np.arange(tube.samples + 1)
            within = samples[(samples > begin) & (samples < stop - 1e-9 * sample)]
            true = getattr(tube, quantity)(np.concatenate([inside, within])).max()
            room = 1e-6 if quantity == "position" else 1e-8  # error of 600 instants
            assert true * (1.0 - 1e-9) <= bound <= true * (most + room) + 1e-15


@given(seed=seeds)
@settings(max_examples=10)
def test_random_errors_stay_in_the_tube(seed: int) -> None:
    tube, loop = random_tube(seed)
    rng = np.random.default_rng(seed)
    flights, parts = 60, 5
    times = fine_times(loop, parts)

    def ball(count: int, radius: float) -> np.ndarray:
        """Return vectors up to a length, most of the full length, some constant in time."""
        x = rng.normal(size=(count, flights, 3))
        x[:, : flights // 2] = x[:1, : flights // 2]
        norms = np.linalg.norm(x, axis=-1, keepdims=True)
        return np.asarray(radius * x / norms * np.minimum(1.0, rng.uniform(0.5, 2, norms.shape)))

    W, E_p, E_v, r_p, r_v = sizes_of(tube)
    J = loop.samples
    causes = ball(len(times) - 1, W), ball(J, E_p), ball(J, E_v), ball(1, r_p)[0], ball(1, r_v)[0]
    p, v, u = (np.linalg.norm(each, axis=-1).max(axis=1) for each in fly(loop, times, *causes))
    clock = tube.grid.start + times
    assert np.all(p <= tube.position(clock) * (1.0 + ROUNDING) + 1e-12)
    assert np.all(v <= tube.velocity(clock) * (1.0 + ROUNDING) + 1e-12)
    assert np.all(u <= tube.acceleration(clock[:-1:parts]) * (1.0 + ROUNDING) + 1e-12)


def test_radii_of_a_long_flight_converge_and_need_a_disturbance() -> None:
    grid = rho.Grid(0.5, 2001)
    tube = rho.error_tube(
        scenario_of(rho.Disturbance(1.0, feedback_every=SECONDS), grid), gains=DEADBEAT
    )
    assert tube.position(1000.0) == pytest.approx(0.01)
    assert tube.position_over([3.0, 999.0], [999.0, 1000.0]) == pytest.approx(0.01, rel=0.01)
    calm = rho.error_tube(scenario_of(None))
    assert calm.gains == (0.0, 0.0)
    assert not calm.position(np.linspace(0.0, 8.0, 99)).any()
    assert calm.position_over([0.0], [8.0]) == 0.0


def test_times_have_any_shape_and_lie_in_the_flight() -> None:
    tube = rho.error_tube(scenario_of(rho.Disturbance(1.0)), gains=(1.0, 1.0))
    assert tube.position(np.zeros((2, 3))).shape == (2, 3)
    assert tube.position(8.0).shape == ()
    assert tube.acceleration(8.0) == tube.acceleration(7.9)
    for time in (-0.1, 8.1, np.nan):
        with pytest.raises(ValueError, match="expected a time from 0 to 8 s"):
            tube.position(time)
    with pytest.raises(ValueError, match="ends: got"):
        tube.position_over([2.0], [1.0])
    for initial in ((-1.0, 0.0), (np.nan, 0.0), (1.0,)):
        with pytest.raises(ValueError, match="initial: got"):
            rho.error_tube(scenario_of(None), initial)  # type: ignore[arg-type]  # tested


def test_invalid_gains_are_refused() -> None:
    scenario = scenario_of(rho.Disturbance(1.0), rho.Grid(0.5, 2000))
    with pytest.raises(ValueError, match="gains: got"):
        rho.error_tube(scenario, gains=(np.nan, 0.0))
    with pytest.raises(ValueError, match="expected gains with which errors decay"):
        rho.error_tube(scenario, gains=(1.0, 50.0)).position(1.0)


def test_own_limits_count_for_the_share() -> None:
    limits = rho.Limits(acceleration=rho.Box([-9.0] * 3, [8.0, 7.0, 6.0]), max_acceleration=5.0)
    around = rho.Disturbance(1.0, feedback_every=SECONDS, share=0.4)
    scenario = scenario_of(around, limits=limits)
    weaker = dataclasses.replace(scenario.vehicles[0], limits=rho.Limits(acceleration=box(4.0)))
    for vehicle, most in ((scenario.vehicles[0], 2.0), (weaker, 1.6)):
        tube = rho.error_tube(dataclasses.replace(scenario, vehicles=(vehicle,)))
        assert 0.99 * most < tube.acceleration_over(0.0, 8.0)[0] <= most
