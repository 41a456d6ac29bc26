"""Generated missions match their definitions: random but reproducible, separated, symmetric."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

import drake_rho as rho
from tests.tolerances import ROUNDING


def draw(n: int, seed: int = 0, **options: Any) -> rho.Scenario:
    """Return random transitions of a seed."""
    return rho.random_transitions(n, np.random.default_rng(seed), **options)


def test_the_defaults_are_those_of_the_benchmark_with_four_cubic_metres() -> None:
    scenario = draw(20)
    room = scenario.limits.position
    assert room is not None
    np.testing.assert_allclose(room.lower, [-0.7937, -0.7937, 0.2], atol=1e-4)
    np.testing.assert_allclose(room.upper, [0.7937, 0.7937, 1.7874], atol=1e-4)
    assert scenario.separation == rho.Separation(0.35, downwash=2.0)
    assert scenario.limits == rho.Limits(position=room, acceleration=rho.Box([-1.0] * 3, [1.0] * 3))
    assert scenario.grid == rho.Grid(0.2, 51)
    assert len(scenario.vehicles) == 20
    assert not np.any(scenario.fleet.start_velocities)
    assert not np.any(scenario.fleet.goal_velocities)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 16), downwash=st.floats(0.3, 3.0))
def test_every_draw_is_in_the_room_and_separated(seed: int, n: int, downwash: float) -> None:
    separation = rho.Separation(0.3, downwash)
    volume = rho.Box([-1.0, 2.0, 0.0], [1.0, 3.0, 3.0])
    fleet = draw(n, seed, volume=volume, separation=separation).fleet
    for positions in (fleet.start_positions, fleet.goal_positions):
        assert np.all((volume.lower <= positions) & (positions <= volume.upper))
        assert np.all(pdist(separation.scaled(positions)) >= 0.3 * (1.0 - ROUNDING))


def test_the_same_seed_draws_the_same_and_the_generator_advances() -> None:
    assert draw(12, 3) == draw(12, 3) != draw(12, 4)
    rng = np.random.default_rng(3)
    first, second = rho.random_transitions(12, rng), rho.random_transitions(12, rng)
    assert first == draw(12, 3) != second


def test_a_draw_is_rejection_sampling_vehicle_by_vehicle() -> None:
    """The twin visits every pair and uses nothing but the same random numbers."""
    scenario = draw(20, 5)
    rng, volume = np.random.default_rng(5), rho.flight_cube(4.0)
    for positions in (scenario.fleet.start_positions, scenario.fleet.goal_positions):
        drawn: list[np.ndarray] = []
        while len(drawn) < 20:
            new = rng.uniform(volume.lower, volume.upper)
            gaps = [np.linalg.norm((new - old) / [1.0, 1.0, 2.0]) for old in drawn]
            if min(gaps, default=1.0) >= 0.35:
                drawn.append(new)
        np.testing.assert_array_equal(positions, drawn)


def test_without_separation_the_draw_fills_the_room_evenly() -> None:
    fleet = draw(4000, separation=None, volume=rho.Box([0.0] * 3, [1.0] * 3)).fleet
    for positions in (fleet.start_positions, fleet.goal_positions):
        np.testing.assert_allclose(positions.mean(axis=0), 0.5, atol=5 * np.sqrt(1 / 12 / 4000))
        np.testing.assert_allclose(positions.var(axis=0), 1 / 12, atol=0.01)


def test_a_thousand_vehicles_have_a_cubic_metre_each() -> None:
    scenario = draw(1000, volume=rho.flight_cube(1000.0), duration=20.0)
    room = scenario.limits.position
    assert room is not None
    np.testing.assert_allclose(room.upper - room.lower, 10.0, rtol=ROUNDING)
    assert room.lower[2] == 0.2
    assert scenario.grid.duration == 20.0


@pytest.mark.slow
def test_too_many_vehicles_are_an_error_that_says_how_many_fit() -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        draw(60)
    assert caught.value.field == "n"
    fitted = int(caught.value.expected.split()[2])
    assert 20 < fitted < 60


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: draw(0), "n"),
        (lambda: draw(2.5), "n"),  # type: ignore[arg-type]  # what is tested
        (lambda: draw(2, step=0.3), "step"),
        (lambda: draw(2, duration=-1.0), "duration"),
        (lambda: rho.flight_cube(0.0), "volume"),
        (lambda: rho.flight_cube(float("nan")), "volume"),
        (lambda: draw(2, limits=rho.Limits(position=rho.Box([5] * 3, [6] * 3))), "scenario."),
        (lambda: rho.circle_swap(0, radius=1.0, duration=1.0, step=0.1), "n"),
        (lambda: rho.circle_swap(3, radius=-1.0, duration=1.0, step=0.1), "radius"),
        (lambda: rho.circle_swap(3, radius=1.0, duration=1.0, step=0.3), "step"),
    ],
)
def test_invalid_arguments_are_refused(make: Callable[[], object], field: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        make()
    assert caught.value.field.startswith(field)


def test_true_is_no_number() -> None:
    with pytest.raises(TypeError, match="n: got True, expected a number"):
        draw(True)


@pytest.mark.parametrize("n", [1, 2, 5, 10])
def test_a_circle_swap_looks_the_same_from_every_vehicle(n: int) -> None:
    limits = rho.Limits(jerk=rho.Box([-30.0] * 3, [30.0] * 3))
    scenario = rho.circle_swap(n, radius=10.0, duration=4.0, step=0.1, height=2.0, limits=limits)
    assert scenario.limits == limits
    starts, goals = scenario.fleet.start_positions, scenario.fleet.goal_positions
    np.testing.assert_allclose(starts[0], [10.0, 0.0, 2.0])
    np.testing.assert_allclose(np.linalg.norm(goals - starts, axis=1), 20.0, rtol=ROUNDING)
    np.testing.assert_allclose(starts + goals, np.tile([0.0, 0.0, 4.0], (n, 1)), atol=1e-12)
    angle = 2.0 * np.pi / n
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    np.testing.assert_allclose(
        np.roll(starts, -1, axis=0)[:, :2], starts[:, :2] @ turn.T, atol=1e-9
    )
    assert not np.any(scenario.fleet.accelerations_before)


def test_neighbours_on_a_circle_that_are_too_close_are_named() -> None:
    chord = 2.0 * 5.0 * np.sin(np.pi / 20)
    options: dict[str, Any] = {"radius": 5.0, "duration": 4.0, "step": 0.1}
    assert rho.circle_swap(20, separation=rho.Separation(chord), **options)
    with pytest.raises(rho.ScenarioError, match=r"start\.position.* from v\d+, not 1\.564345 m"):
        rho.circle_swap(20, separation=rho.Separation(1.01 * chord), **options)
