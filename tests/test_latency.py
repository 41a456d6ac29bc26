"""Windows that are planned ahead, while the previous one is flown."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import slow

EVERY, PER_STEP, STEP = 4, 4, 0.2


def scene(disturbance: rho.Disturbance | None = None, known_from: float = 0.0) -> rho.Scenario:
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State([0, 2 * i, 1]), rho.State([8, 2 * i, 1]), radius=0.2)
        for i in range(2)
    ]
    obstacle = rho.Obstacle(rho.Sphere([4, 0.2, 1], 0.6), known_from=known_from)
    limits = rho.Limits(max_acceleration=4.0, max_speed=5.0)
    grid = rho.Grid.lasting(6.0, step=STEP)
    return rho.Scenario("ahead", grid, vehicles, limits, [obstacle], disturbance=disturbance)


def windy(delay: int = 0, dropouts: int = 0, *, prediction: bool | None = None) -> rho.Disturbance:
    return rho.Disturbance(
        0.2,
        position_error=0.01,
        velocity_error=0.02,
        feedback_every=STEP / PER_STEP,
        delay=delay,
        dropouts=dropouts,
        share=0.4,
        prediction=prediction,
    )


def horizon(scenario: rho.Scenario, latency: float = 0.0) -> rho.RecedingHorizon:
    return rho.RecedingHorizon(scenario, replan_every=EVERY, latency=latency)


def tracking_of(window: rho.Window) -> Any:
    around = window.plan.scenario.disturbance
    assert around is not None
    assert around.tracking is not None
    return around.tracking


def test_in_still_air_nothing_changes() -> None:
    """What is predicted is then what happens."""
    at_once, ahead = (rho.simulate(horizon(scene(), each)) for each in (0.0, 0.6))
    np.testing.assert_allclose(ahead.positions, at_once.positions, atol=1e-6)


@pytest.mark.parametrize("delay", [*slow(0), 2])
@pytest.mark.parametrize("prediction", [True, *slow(False)])
def test_a_window_depends_on_nothing_after_its_planning_has_begun(
    delay: int, prediction: bool
) -> None:
    """Two winds differ from the time at which the second window is planned."""
    scenario, latency, second = scene(windy(delay, prediction=prediction)), 0.45, EVERY * STEP
    begins = second - latency

    def gust(sign: float) -> rho.winds.Wind:
        def wind(time: float, p: FloatArray, v: FloatArray) -> FloatArray:
            return np.full(p.shape, 0.1 if time < begins - 1e-9 else sign * 0.1)

        return wind

    def plans(latency: float) -> list[rho.Plan]:
        found = [rho.simulate(horizon(scenario, latency), wind=gust(sign)) for sign in (1, -1)]
        return [each.windows[1].plan for each in found]

    ahead, at_once = plans(latency), plans(0.0)
    np.testing.assert_array_equal(ahead[0].accelerations, ahead[1].accelerations)
    assert np.abs(at_once[0].accelerations - at_once[1].accelerations).max() > 1e-6
    # but the gust before has been seen
    still = rho.simulate(horizon(scenario, latency), wind=rho.winds.none())
    assert np.abs(ahead[0].positions[:, 0] - still.windows[1].plan.positions[:, 0]).max() > 1e-4


@pytest.mark.parametrize("seed", [2, 3, *slow(0, 1, *range(4, 8))])
def test_the_error_of_the_prediction_is_in_the_tube(seed: int) -> None:
    rng = np.random.default_rng(seed)
    delay, dropouts = int(rng.integers(0, 3)), int(rng.integers(0, 4))
    scenario = scene(windy(delay, dropouts))
    ahead = horizon(scenario, rng.uniform(0.1, 0.8) * EVERY * STEP)
    winds = (
        rho.winds.constant(scenario, rng.normal(size=3)),
        rho.winds.coloured_noise(scenario, rng),
    )
    simulation = rho.simulate(ahead, wind=winds[seed % 2], rng=rng)
    assert rho.verify(simulation).ok
    assert (simulation.errors() <= simulation.radii()[:, None] * (1 + 1e-9) + 1e-12).all()
    assert not any(window.off_tube for window in simulation.windows)
    for window in simulation.windows[1:]:
        tracking = tracking_of(window)
        if window.kept:
            continue
        now = int(np.argmin(np.abs(simulation.times - window.plan.scenario.grid.start)))
        for true, planned, radius in (
            (simulation.positions, window.plan.positions, tracking.position),
            (simulation.velocities, window.plan.velocities, tracking.velocity),
        ):
            away = np.linalg.norm(true[now] - planned[:, 0], axis=1)
            assert away.max() <= radius * (1 + 1e-9)


def test_first_radii_are_those_of_a_tube_from_the_measurement() -> None:
    """With one sample ahead, the feedback of that sample has answered the measurement's errors."""
    scenario = scene(windy())
    ahead = horizon(scenario, STEP / PER_STEP)
    rho.simulate(ahead)
    around, tube = windy(), rho.error_tube(scenario)
    sample = STEP / PER_STEP
    k_p, k_v = tube.gains
    # position error n_p + δ n_v - δ²/2 (k_p m_p + k_v m_v) + wind, all errors aligned
    position = (
        around.position_error * (abs(1 - k_p * sample**2 / 2) + k_p * sample**2 / 2)
        + around.velocity_error * (abs(sample - k_v * sample**2 / 2) + k_v * sample**2 / 2)
        + around.acceleration * sample**2 / 2
    )
    tracking = tracking_of(ahead.windows[1])
    assert tracking.position == pytest.approx(position, rel=1e-9)


def test_a_longer_latency_has_wider_tubes() -> None:
    radii = []
    for latency in (0.0, 0.2, 0.6):
        ahead = horizon(scene(windy()), latency)
        rho.simulate(ahead)
        radii.append(tracking_of(ahead.windows[1]).position)
    assert radii[0] < radii[1] < radii[2]


def test_what_is_seen_late_is_known_one_latency_later() -> None:
    scenario = scene(known_from=1.5)  # before the window that begins at 1.6 s
    learned = {}
    for latency in (0.0, 0.4):
        ahead = horizon(scenario, latency)
        flight = rho.simulate(ahead).flight
        learned[latency] = [each.first_knot for each in flight.windows if each.learned]
    assert learned == {0.0: [2 * EVERY], 0.4: [3 * EVERY]}


def test_what_is_seen_too_late_for_a_window_is_known_at_the_end() -> None:
    (later,) = horizon(scene(known_from=5.9), 0.4).scenario.bodies
    assert later.known_from == scene().grid.end


def test_a_sighting_is_of_when_planning_began() -> None:
    """One that moved on as it was seen is the same, but for errors that have grown since."""
    drone = rho.Obstacle(
        rho.Sphere([4, 5, 1], 0.2), name="d", position_error=0.1, velocity_error=0.3, seen_at=0.0
    )
    seen = dataclasses.replace(scene(), obstacles=(drone,))
    ahead, time = horizon(seen, 0.4), EVERY * STEP
    ahead.step(ahead.planned(0), 0.0)
    moved = drone.seen([4, 5.1, 1], [0, 0.5, 0], time - 0.4)
    now = dataclasses.replace(seen, obstacles=(moved,))
    ahead.step(ahead.planned(EVERY), time, scenario=now)
    (former, again), at = ahead.scenario.bodies, np.array([time, time + 1.0])
    assert again.known_from == time
    np.testing.assert_allclose(again.centers(at)[:, 1], [5.3, 5.8])
    np.testing.assert_allclose(again.uncertainty(at), [0.1 + 0.3 * 0.4, 0.1 + 0.3 * 1.4])
    assert former.active is not None
    assert former.active[1] < time


@pytest.mark.parametrize("latency", [-0.1, 0.81, float("nan"), float("inf")])
def test_a_latency_is_at_most_the_time_between_windows(latency: float) -> None:
    with pytest.raises(ValueError, match=r"latency: got .*, expected 0 to 0\.8 s"):
        horizon(scene(), latency)
    assert horizon(scene(), 0.8).latency == EVERY
    assert horizon(scene(windy()), 0.8).latency == EVERY * PER_STEP


def test_a_horizon_that_has_begun_is_not_simulated() -> None:
    begun = horizon(scene())
    begun.step(begun.planned(0), 0.0)
    with pytest.raises(ValueError, match="got a receding horizon that has windows"):
        rho.simulate(begun)


def test_errors_of_an_obstacle_grow_from_when_it_is_seen_not_from_when_a_plan_knows_it() -> None:
    shape, seen, latency = rho.Sphere([4, 0.2, 1], 0.6), 1.0, 0.6
    late = rho.Obstacle(shape, known_from=seen, position_error=0.1, velocity_error=0.2)
    scenario = dataclasses.replace(scene(windy()), obstacles=(late,))
    (known,) = horizon(scenario, latency).scenario.bodies
    assert known.known_from == pytest.approx(seen + latency)
    times = np.linspace(0.0, 6.0, 25)
    np.testing.assert_allclose(known.uncertainty(times), late.uncertainty(times))


@pytest.mark.parametrize("after", [-0.01, 0.01])
def test_what_is_seen_after_planning_has_begun_is_known_to_the_next_window(after: float) -> None:
    """A latency that is no whole number of samples counts as the next larger one."""
    sample, second = STEP / PER_STEP, EVERY * STEP
    begins = second - 9 * sample
    scenario = scene(windy(), known_from=begins + after)
    simulation = rho.simulate(horizon(scenario, 8.2 * sample), wind=rho.winds.none())
    first = next(k for k, window in enumerate(simulation.windows) if window.learned)
    assert first == (1 if after < 0.0 else 2)


def test_a_flight_tells_what_it_met_before_a_window_knew_of_it() -> None:
    """The sphere is known from 2.2 s on, but to no window that begins before 2.9 s."""
    around = rho.Obstacle(rho.Sphere([4.2, 0, 1], 0.3), known_from=2.2)
    vehicle = rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([8, 0, 1]), radius=0.2)
    limits = rho.Limits(max_acceleration=4.0)
    scenario = rho.Scenario("met", rho.Grid.lasting(4.8, step=STEP), [vehicle], limits, [around])
    late = rho.simulate(horizon(scenario, 0.7)).flight
    assert late.scenario.bodies[0].known_from == 2.2
    away = np.linalg.norm(late.at(np.linspace(2.2, 2.9, 200)).positions[0] - [4.2, 0, 1], axis=1)
    assert away.min() < 0.4
    assert not rho.verify(late).ok
