"""How vehicles are drawn: their airframe, their tilt, and their size."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.display.meshcat.airframes import airframes, body
from drake_rho.display.meshcat.animation import Stage
from drake_rho.display.meshcat.poses import headings, lifts, vehicle_poses
from drake_rho.scenario.parts import Airframe
from tests.scenarios import single
from tests.test_animation import crossing


def _kinds(limits: rho.Limits, airframe: Airframe | None = None) -> list[Airframe]:
    """Return the airframes of a vehicle that flies 10 m in 4 s."""
    scenario = single()
    vehicles = (dataclasses.replace(scenario.vehicles[0], airframe=airframe),)
    plan = rho.plan_convex(dataclasses.replace(scenario, vehicles=vehicles))
    limited = dataclasses.replace(plan.scenario, limits=limits)
    return airframes(drawn(rho.Plan.from_accelerations(limited, plan.accelerations)))


def test_the_airframe_is_that_of_the_scenario_or_else_follows_from_the_limits() -> None:
    assert _kinds(rho.Limits()) == ["quadrotor"]  # because it flies slowly
    assert _kinds(rho.Limits(max_speed=120.0)) == ["aircraft"]
    assert _kinds(rho.Limits(velocity=rho.Box([-200.0] * 3, [200.0] * 3))) == ["aircraft"]
    assert _kinds(rho.Limits(max_speed=120.0, max_tilt=0.5)) == ["quadrotor"]
    assert _kinds(rho.Limits(max_speed=120.0), "quadrotor") == ["quadrotor"]
    assert _kinds(rho.Limits(), "aircraft") == ["aircraft"]
    assert set(Stage.of(rho.plan_convex(rho.load_scenario("paper"))).vehicles.kinds) == {"aircraft"}


@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("kind", ["aircraft", "quadrotor"])
def test_a_body_fits_into_its_ball_and_is_mirror_symmetric(kind: Airframe, light: bool) -> None:
    vertices, faces = body(kind, 2.5, light=light)
    assert np.linalg.norm(vertices, axis=0).max() == pytest.approx(2.5)
    assert faces.max() == vertices.shape[1] - 1
    mirrored = {tuple(each) for each in (vertices.T * [1, -1, 1]).round(6) + 0.0}
    assert mirrored == {tuple(each) for each in vertices.T.round(6) + 0.0}
    assert vertices[0].max() > 0.0 > vertices[0].min()


@pytest.mark.parametrize("count", [3, 60])
@pytest.mark.parametrize("separation", [rho.Separation(0.3, 2.0), rho.Separation(0.3, 0.5)])
def test_separated_vehicles_do_not_touch(count: int, separation: rho.Separation) -> None:
    plan = crossing(count, separation=separation)
    stage = Stage.of(plan)
    positions = plan.motion().at("position", stage.playback.times)
    radii = stage.vehicles.radii[:, None] * stage.vehicles.scales
    true = 0.15 * min(1.0, separation.downwash)
    for i in range(count):
        for j in range(i):
            apart = np.linalg.norm(positions[i] - positions[j], axis=1)
            far = apart >= 2.0 * true  # the separation holds
            assert np.all((radii[i] + radii[j] <= apart)[far])
    assert np.all(radii >= true - 1e-12)


def test_no_vehicle_is_drawn_inside_an_obstacle_even_between_frames() -> None:
    flight = rho.plan_rho(rho.load_scenario("paper"))
    stage, (sphere,) = Stage.of(flight), flight.scenario.spheres
    assert "point masses" in stage.vehicles.note
    assert "smaller" in stage.vehicles.note
    times = np.linspace(0.0, 49.0, 20_001)
    offsets = np.linalg.norm(flight.plan.motion().at("position", times) - sphere.center, axis=2)
    left = offsets - sphere.radius
    for each, radius, scales in zip(left, stage.vehicles.radii, stage.vehicles.scales, strict=True):
        drawn = radius * np.interp(times, stage.playback.times, scales)
        # at the surface, or inside within the paper's tolerance, it is drawn almost as a point
        assert np.all(drawn <= np.maximum(each, 0.0) + 2e-3 * radius)
        assert drawn.max() == radius


def test_the_legend_states_magnification_unless_vehicles_are_drawn_to_scale() -> None:
    plan = rho.plan_convex(single())
    for radius, said in ((5.0, ""), (0.05, "times their true size")):
        vehicles = (dataclasses.replace(plan.scenario.vehicles[0], radius=radius),)
        scenario = dataclasses.replace(plan.scenario, vehicles=vehicles, obstacles=())
        stage = Stage.of(rho.Plan.from_accelerations(scenario, plan.accelerations))
        note = stage.vehicles.note
        assert said in note
        assert bool(note) == bool(said)
        np.testing.assert_allclose(stage.vehicles.true, radius)


def test_vehicles_tilt_in_the_direction_of_their_thrust() -> None:
    rng = np.random.default_rng(4)
    velocities, up = rng.normal(size=(2, 3, 7, 3))
    up[..., 2] = 1.0 + np.abs(up[..., 2])
    places = rng.normal(size=(3, 7, 3))
    poses = vehicle_poses(["aircraft", "quadrotor", "aircraft"], places, velocities, up)
    turns = poses[..., :3]
    np.testing.assert_allclose(turns @ np.swapaxes(turns, 2, 3), np.eye(3) + 0.0 * turns, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
    np.testing.assert_array_equal(poses[..., 3], places)
    np.testing.assert_allclose(turns[[0, 2], :, :, 0], headings(velocities)[[0, 2]])
    np.testing.assert_allclose(turns[1, :, :, 2], up[1] / np.linalg.norm(up[1], axis=1)[:, None])
    assert np.all(np.sum(turns[..., 2] * up, axis=2) > 0.0)
    assert np.all(np.sum(turns[1, :, :, 0] * velocities[1] * [1, 1, 0], axis=1) > 0.0)


def test_thrust_is_the_mean_acceleration_of_a_step_plus_gravity() -> None:
    plan = rho.plan_convex(single())
    h, motion = plan.scenario.grid.step, plan.motion()
    lift = lifts(motion, plan.scenario.grid.elapsed[:-1] + h / 2.0, h)
    expected = plan.accelerations + np.array([0.0, 0.0, 9.81])
    expected[..., 2] = np.maximum(expected[..., 2], 9.81 / 2.0)
    np.testing.assert_allclose(lift, expected, atol=1e-9)
