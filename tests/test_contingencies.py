"""Contingencies of windows: motions that brake to rest, clear of all that is known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import slow
from tests.test_cli import run

ACCELERATION, SPEED = 3.0, 3.0
TOLERANCE = 1e-6


def scene(
    *obstacles: rho.Obstacle,
    disturbance: rho.Disturbance | None = None,
    velocity: float = SPEED,
    count: int = 1,
) -> rho.Scenario:
    """Return vehicles that fly along x, side by side, at a constant speed if nothing is there."""
    vehicles = [
        rho.Vehicle(
            f"v{i}",
            rho.State([0, 1.5 * i, 1], [velocity, 0, 0]),
            rho.State([12, 1.5 * i, 1], [velocity, 0, 0]),
            radius=0.2,
        )
        for i in range(count)
    ]
    return rho.Scenario(
        "corridor",
        rho.Grid.lasting(12.0 / velocity, step=0.2),
        vehicles,
        rho.Limits(max_acceleration=ACCELERATION),
        obstacles,
        separation=rho.Separation(0.4) if count > 1 else None,
        disturbance=disturbance,
    )


def wall(at: float, known_from: float) -> rho.Obstacle:
    """Return a wall across the corridor."""
    return rho.Obstacle(rho.Box([at, -40, -40], [at + 0.5, 40, 40]), known_from=known_from)


def stop_of(window: rho.Window) -> rho.Plan:
    assert window.contingency is not None
    return window.contingency


def fly(scenario: rho.Scenario, *, contingencies: bool = False) -> rho.Flight:
    return rho.plan_rho(scenario, replan_every=4, fallback=None, contingencies=contingencies)


def test_a_contingency_follows_its_plan_and_then_brakes_as_hard_as_the_limit_allows() -> None:
    flight = fly(scene(), contingencies=True)
    for window in flight.windows[:-1]:
        stop = stop_of(window)
        assert rho.verify(stop).ok
        np.testing.assert_array_equal(stop.accelerations[:, :4], window.plan.accelerations[:, :4])
        assert np.abs(stop.velocities[:, -1]).max() <= TOLERANCE
        # v² / 2a, rounded up to whole steps of the least braking time that is even
        braked = stop.positions[0, -1, 0] - stop.positions[0, 4, 0]
        assert SPEED**2 / (2 * ACCELERATION) - TOLERANCE <= braked <= 1.8 + TOLERANCE
        assert stop.scenario.grid.end >= flight.scenario.grid.end - TOLERANCE


def test_windows_have_none_unless_asked() -> None:
    assert all(
        window.contingency is None and not window.no_contingency for window in fly(scene()).windows
    )


@pytest.mark.parametrize("count", [1, *slow(3)])
@pytest.mark.parametrize("known_from", [0.7, 1.5])
def test_what_is_seen_late_is_not_touched_where_a_contingency_is_flown(
    count: int, known_from: float
) -> None:
    scenario = scene(wall(9.0, known_from), count=count)
    without, flight = fly(scenario), fly(scenario, contingencies=True)
    assert without.plan.positions[..., 0].max() > 9.0  # the least violation goes through it
    assert any(window.stopping for window in flight.windows)
    times = np.linspace(scenario.grid.start, scenario.grid.end, 4000)
    assert flight.at(times).positions[..., 0].max() <= 9.0 - 0.2 + TOLERANCE
    assert not any(window.not_avoided for window in flight.windows)
    stopped = next(window for window in flight.windows if window.stopping)
    assert stopped.infeasible
    assert "contingency" in repr(stopped)


def test_what_was_declared_before_a_wall_is_seen_stays_clear_of_it_if_it_can() -> None:
    flight = fly(scene(wall(9.0, 1.0)), contingencies=True)
    number = next(i for i, each in enumerate(flight.windows) if each.stopping)
    before, window = flight.windows[number - 1 : number + 1]
    rest = stop_of(before).tail(window.first_knot - before.first_knot)
    np.testing.assert_allclose(stop_of(window).positions, rest.positions, atol=1e-9)


def test_a_wall_too_close_to_brake_leaves_the_reason() -> None:
    flight = fly(scene(wall(5.0, 1.5)), contingencies=True)
    missing = [window for window in flight.windows if window.no_contingency]
    assert missing
    assert all(window.contingency is None for window in missing)
    assert any(window.not_avoided for window in missing)


def test_moving_obstacles_are_known_to_contingencies_until_the_flight_would_end() -> None:
    """A vehicle that waits must not wait where something known comes past."""
    mover = rho.Obstacle(rho.Sphere([5.0, -8.0, 1.0], 0.5), velocity=[0, 2.5, 0])
    flight = fly(scene(mover), contingencies=True)
    for window in flight.windows:
        if (stop := window.contingency) is not None:
            grid = stop.scenario.grid
            times = np.linspace(grid.start, grid.end, 3000)
            centers = np.array([5.0, -8.0, 1.0]) + times[:, None] * np.array([0, 2.5, 0])
            away = np.linalg.norm(stop.at(times).positions[0] - centers, axis=1)
            assert away.min() >= 0.7 - TOLERANCE
        else:
            assert window.no_contingency


def test_waypoints_do_not_keep_vehicles_from_braking_but_standing_requirements_hold() -> None:
    plain = scene()
    vehicle = dataclasses.replace(
        plain.vehicles[0], waypoints=(rho.Waypoint(3.0, [9.0, 0.3, 1.0], within=0.1),)
    )
    floor = rho.KeepIn(rho.HalfSpace([0, 0, -1.0], -0.9))
    scenario = dataclasses.replace(plain, vehicles=(vehicle,), requirements=(floor,))
    for window in fly(scenario, contingencies=True).windows:
        assert rho.verify(stop_of(window)).ok
        assert stop_of(window).positions[..., 2].min() >= 0.9 - TOLERANCE


@pytest.mark.parametrize("known_from", [0.7, 1.5])
def test_in_wind_a_contingency_stays_clear_with_its_tube(known_from: float) -> None:
    around = rho.Disturbance(0.3, position_error=0.01, velocity_error=0.02, feedback_every=0.1)
    scenario = scene(wall(9.0, known_from), disturbance=around)
    horizon = rho.RecedingHorizon(scenario, replan_every=4, fallback=None, contingencies=True)
    wind = rho.winds.constant(scenario, [1, 0, 0])
    flown = rho.simulate(horizon, wind=wind, rng=np.random.default_rng(1))
    assert any(window.stopping for window in flown.windows)
    assert flown.positions[..., 0].max() <= 9.0 - 0.2 + TOLERANCE
    assert (flown.errors() <= flown.radii()[:, None] + 1e-9).all()


def test_a_flight_goes_on_from_a_stop_where_there_is_a_plan_again() -> None:
    """A door that closes for a while, seen late: the vehicle waits and flies on."""
    door = dataclasses.replace(wall(6.0, 0.7), active=(0.0, 2.4))
    plain = scene(door, velocity=1.5)
    flight = fly(plain, contingencies=True)
    assert rho.verify(flight).ok or any(window.stopping for window in flight.windows)
    np.testing.assert_allclose(flight.plan.positions[:, -1, 0], 12.0, atol=1e-4)


def test_contingencies_are_in_files(tmp_path: Path) -> None:
    flight = fly(scene(wall(5.0, 1.5)), contingencies=True)
    rho.save(flight, tmp_path / "flight.npz")
    loaded = rho.load(tmp_path / "flight.npz")
    for mine, theirs in zip(flight.windows, loaded.windows, strict=True):
        assert mine.no_contingency == theirs.no_contingency
        assert mine.stopping == theirs.stopping
        assert (mine.contingency is None) == (theirs.contingency is None)
        if mine.contingency is not None:
            np.testing.assert_array_equal(stop_of(mine).positions, stop_of(theirs).positions)
            assert rho.verify(stop_of(theirs)).ok


def test_random_contingencies_stop_clear_of_all_that_is_known() -> None:
    rng = np.random.default_rng(7)
    declared = 0
    for _ in range(6):
        spheres = [
            rho.Obstacle(
                rho.Sphere([rng.uniform(3, 9), rng.uniform(-1, 3), 1.0], rng.uniform(0.2, 0.6)),
                velocity=[0, rng.uniform(-0.5, 0.5), 0],
                known_from=rng.uniform(-1.0, 2.0),
            )
            for _ in range(3)
        ]
        try:
            flight = fly(scene(*spheres, count=2), contingencies=True)
        except (rho.InfeasibleError, rho.ScenarioError):
            continue
        for window in flight.windows:
            stop = window.contingency
            assert (stop is None) == bool(window.no_contingency)
            if stop is None:
                continue
            declared += 1
            grid = stop.scenario.grid
            x = stop.at(np.linspace(grid.start, grid.end, 1500))
            assert np.linalg.norm(x.accelerations, axis=2).max() <= ACCELERATION * (1 + 1e-5)
            assert np.linalg.norm(x.positions[0] - x.positions[1], axis=1).min() >= 0.4 - 1e-5
            for each in spheres:
                if each.known_from <= grid.start:
                    drift = x.times[:, None] * np.asarray(each.velocity)
                    away = each.shape.signed_distance(x.positions - drift)
                    assert away.min() >= 0.2 - 1e-5
    assert declared > 20


def test_contingencies_are_drawn_beside_predictions() -> None:
    flight, without = fly(scene(), contingencies=True), fly(scene())
    notes = [
        [text.get_text() for text in rho.paths_figure(each).texts] for each in (flight, without)
    ]
    assert any("contingencies" in text for text in notes[0])
    assert not any("contingencies" in text for text in notes[1])
    assert rho.animate(flight).HasPath("/flight/contingencies")
    assert not rho.animate(without).HasPath("/flight/contingencies")


def test_reports_and_the_command_line_tell_of_contingencies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = scene(wall(9.0, 1.5))
    rho.save_scenario(scenario, tmp_path / "late.yaml")
    output = str(tmp_path / "late.npz")
    words = ("fly", str(tmp_path / "late.yaml"), "--replan-every", "4", "--method", "convex")
    _, out, err = run(capsys, monkeypatch, *words, "--contingencies", "-o", output)
    assert "contingency:" in out + err
    assert any(window.stopping for window in rho.load(output).windows)
    horizon = rho.RecedingHorizon(scenario, replan_every=4, fallback=None, contingencies=True)
    assert any("brakes to rest" in note for note in rho.verify(rho.simulate(horizon)).notes)


def test_a_receding_horizon_is_simulated_with_its_own_options_only() -> None:
    horizon = rho.RecedingHorizon(scene())
    with pytest.raises(ValueError, match="replan_every: got 2, expected none"):
        rho.simulate(horizon, replan_every=2)
    with pytest.raises(ValueError, match="disturbance: got one"):
        rho.simulate(horizon, disturbance=rho.Disturbance(0.1))
