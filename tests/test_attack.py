"""The attack finds the least clearance that any wind can cause, and flies it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import disturbed, winds_for
from tests.scenarios import box, fleet, single, slow

AROUND = rho.Disturbance(0.3, 0.01, 0.02, feedback_every=0.1, delay=1, share=0.5)


def _least_clearance(simulation: rho.Simulation) -> float:
    """Return the least clearance of a flight at all times, computed by hand, for spheres only."""
    scenario, p = simulation.scenario, simulation.positions
    found = [np.inf]
    for sphere in scenario.spheres:
        found.append(float(np.linalg.norm(p - sphere.center, axis=2).min() - sphere.radius))
    if scenario.separation is not None:
        for i in range(p.shape[1]):
            for j in range(i):
                apart = np.linalg.norm(p[:, i] - p[:, j], axis=1).min()
                found.append(float(apart) - scenario.separation.distance)
    return min(found)


@pytest.mark.parametrize("seed", [*range(3), *slow(*range(3, 8))])
def test_no_wind_leaves_less_clearance_and_the_attack_attains_its_bound(seed: int) -> None:
    scenario = disturbed(200 + seed)
    plan = rho.plan(scenario)
    attack = rho.attack(scenario, plan)
    assert attack.clearance == pytest.approx(attack.bound, abs=1e-6)
    assert _least_clearance(attack.simulation) == pytest.approx(attack.bound, abs=1e-6)
    assert attack.bound < attack.planned
    for wind in winds_for(scenario, seed).values():
        flown = rho.simulate(plan, wind=wind, rng=np.random.default_rng(seed))
        assert _least_clearance(flown) >= attack.bound - 1e-9


@pytest.mark.parametrize("speed", [*slow(10.0), 100.0])
def test_the_closer_of_two_passes_counts_even_between_samples(speed: float) -> None:
    scenario = single(grid=rho.Grid(1.0, 9), goal=rho.State([8.0, 0.0, 0.0]), between_knots=True)
    scenario = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.05, feedback_every=0.25))
    plan = rho.plan(scenario)
    at = plan.motion().at("position", np.array([3.0, 5.01]))[0][:, 0]
    places = [
        [at[0], -3.0 * speed, 0.41],  # past the vehicle at 3 s, at a sample
        [at[0], 0.9 * speed, 0.41],
        [at[1], 0.91 * speed, 0.4],  # and closer at 5.01 s, on the way back
        [at[1], -2.99 * speed, 0.4],
    ]
    ball = rho.Obstacle(rho.Sphere([0, 0, 0], 0.1), track=rho.Track([0, 3.9, 4.1, 8], places))
    scenario = dataclasses.replace(scenario, obstacles=(ball,))
    attack = rho.attack(scenario, plan)
    times = np.linspace(0.0, 8.0, 800_001)
    motion = plan.motion().at("position", times)[0]
    apart = np.linalg.norm(motion - ball.centers(times), axis=1) - 0.1
    least = float((apart - rho.error_tube(scenario).position(times)).min())
    assert attack.bound <= least
    assert attack.bound == pytest.approx(least, abs=1e-6)
    assert attack.clearance == pytest.approx(attack.bound, abs=1e-6)


def test_a_plan_with_margins_survives_the_attack_and_one_without_collides() -> None:
    """Without wind the plan just clears a sphere on its straight path."""
    calm = single(obstacles=[rho.Sphere([5.0, 2.0, -0.8], 1.0)], between_knots=True)
    calm = dataclasses.replace(calm, limits=rho.Limits(acceleration=box(4.0)))
    windy = dataclasses.replace(calm, disturbance=AROUND)
    hit, missed = rho.attack(windy, rho.plan(calm)), rho.attack(windy, rho.plan(windy))
    radius = float(rho.error_tube(windy).position(hit.time))
    assert hit.constraint == "obstacle 1"
    assert hit.clearance == pytest.approx(-radius, rel=0.02)
    assert missed.clearance >= -1e-6
    assert missed.clearance <= 0.02 * radius  # no more clearance is left than required


def test_two_vehicles_are_driven_together_and_one_out_of_its_box() -> None:
    scenario = fleet(
        [[0, 0, 0], [0, 2, 0]],
        [[10, 0, 0], [10, 2, 0]],
        separation=rho.Separation(1.0, 2.0),
        limits=rho.Limits(acceleration=box(4.0)),
    )
    scenario = dataclasses.replace(scenario, disturbance=AROUND)
    plan, tube = rho.plan(scenario), rho.error_tube(scenario)
    attack = rho.attack(scenario, plan)
    assert (attack.constraint, attack.vehicles) == ("separation", ("v0", "v1"))
    most = tube.position(np.linspace(0.0, 10.0, 2001)).max()
    assert attack.bound == pytest.approx(1.0 - 2.0 * most, abs=1e-6)
    assert attack.clearance == pytest.approx(attack.bound, abs=1e-6)
    np.testing.assert_allclose(attack.wind.directions, [[0, 1, 0], [0, -1, 0]], atol=1e-12)

    limits = rho.Limits(position=rho.Box([-9, -3, -1], [12, 2.5, 7]), acceleration=box(4.0))
    boxed = rho.attack(dataclasses.replace(scenario, limits=limits), plan)
    assert (boxed.constraint, boxed.vehicles) == ("position box", ("v1",))
    assert boxed.bound == pytest.approx(0.5 - most, abs=1e-6)
    assert boxed.clearance == pytest.approx(boxed.bound, abs=1e-6)
    np.testing.assert_allclose(boxed.wind.directions, [[0, 0, 0], [0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize("seed", [1, *slow(0, 2, 3)])
def test_the_attack_on_everything_finds_the_tightest_constraint(seed: int) -> None:
    """The attack on everything is the worst of those on each obstacle and each pair separately."""
    rng = np.random.default_rng(seed)
    many = fleet(
        rng.uniform([0, 0, 0], [1, 9, 2], (5, 3)) + np.arange(5)[:, None] * [0, 9, 0],
        rng.uniform([8, 0, 0], [9, 9, 2], (5, 3)) + np.arange(5)[::-1, None] * [0, 9, 0],
        limits=rho.Limits(acceleration=box(8.0)),
        obstacles=[rho.Sphere([4.5, 9.0 * k + 4.0, 1.0], 0.7) for k in range(5)],
    )
    many = dataclasses.replace(many, disturbance=AROUND)
    plan = rho.plan_convex(dataclasses.replace(many, obstacles=(), separation=None))
    alone = [
        rho.attack(dataclasses.replace(many, obstacles=(each,), separation=None), plan).bound
        for each in many.obstacles
    ]
    alone.append(rho.attack(dataclasses.replace(many, obstacles=()), plan).bound)
    assert rho.attack(many, plan).bound == pytest.approx(min(alone), abs=1e-9)


def test_only_knots_are_attacked_if_the_scenario_constrains_only_knots() -> None:
    scenario = single(obstacles=[rho.Sphere([5.0, 2.0, 0.5], 1.0)], between_knots=False)
    scenario = dataclasses.replace(scenario, disturbance=AROUND)
    plan = rho.plan(scenario)
    attack = rho.attack(scenario, plan)
    assert attack.time in scenario.grid.times
    everywhere = rho.attack(dataclasses.replace(scenario, between_knots=True), plan)
    assert everywhere.bound < attack.bound


def test_moving_obstacles_of_other_shapes_are_attacked_at_their_positions() -> None:
    moving = rho.Obstacle(rho.Box([-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]), track=rho.Track(
        [0.0, 3.123, 8.0], [[5.0, 6.0, -1.0], [5.0, 3.5, -1.0], [9.0, 9.0, -1.0]]
    ))  # fmt: skip
    scenario = single(obstacles=[moving], between_knots=True)
    scenario = dataclasses.replace(scenario, disturbance=AROUND)
    attack = rho.attack(scenario, rho.plan(scenario))
    centre = moving.centers(np.array([attack.time]))[0]
    m = int(np.argmin(np.abs(attack.simulation.times - attack.time)))
    beyond = np.maximum(np.abs(attack.simulation.positions[m, 0] - centre) - 0.5, 0.0)
    assert np.linalg.norm(beyond) == pytest.approx(attack.clearance, abs=1e-9)
    assert attack.clearance == pytest.approx(attack.bound, abs=1e-6)


def test_scenarios_that_cannot_be_attacked_are_refused_by_name() -> None:
    scenario = dataclasses.replace(single(), disturbance=AROUND)
    plan = rho.plan(scenario)
    with pytest.raises(ValueError, match=r"^scenario\.disturbance: got None"):
        rho.attack(single(), plan)
    with pytest.raises(ValueError, match=r"^scenario: got nothing to keep clear of"):
        rho.attack(scenario, plan)
    with pytest.raises(ValueError, match=r"^scenario\.disturbance: got .* not under way"):
        rho.attack(rho.plan_rho(scenario).windows[1].plan.scenario, plan)
    many = disturbed(3)
    with pytest.raises(ValueError, match=r"^plan: got one for 1 on "):
        rho.attack(many, plan)
