"""Scales and tolerances depend on the task of a vehicle, and not on its position."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.scenarios import random_fleet, random_scenario
from tests.tolerances import TOLERANCE

FAR = (0.1, 1e3, 1e6)
"""Distances by which scenes are moved [m]."""


def moved(scenario: rho.Scenario, by: np.ndarray) -> rho.Scenario:
    """Return the scenario shifted."""

    def state(old: rho.State) -> rho.State:
        return dataclasses.replace(old, position=old.position + by)

    def box(old: rho.Box | None) -> rho.Box | None:
        return None if old is None else rho.Box(old.lower + by, old.upper + by)

    def shape(old: rho.Sphere | rho.Box) -> rho.Sphere | rho.Box:
        if isinstance(old, rho.Box):
            return rho.Box(old.lower + by, old.upper + by)
        return dataclasses.replace(old, center=old.center + by)

    def obstacle(old: rho.Obstacle) -> rho.Obstacle:
        track = old.track
        if track is not None:
            track = dataclasses.replace(track, positions=track.positions + by)
        assert isinstance(old.shape, rho.Sphere | rho.Box)
        return dataclasses.replace(old, shape=shape(old.shape), track=track)

    return dataclasses.replace(
        scenario,
        vehicles=tuple(
            dataclasses.replace(
                each,
                start=state(each.start),
                goal=state(each.goal),
                waypoints=tuple(
                    dataclasses.replace(point, position=point.position + by)
                    for point in each.waypoints
                ),
            )
            for each in scenario.vehicles
        ),
        limits=dataclasses.replace(scenario.limits, position=box(scenario.limits.position)),
        obstacles=tuple(obstacle(each) for each in scenario.bodies),
    )


def hovering(hop: float = 0.0, aside: float = 0.1, **options: object) -> rho.Scenario:
    """Return a vehicle that hovers, and a ball that passes it."""
    at, beside = np.array([0.1, 0.0, 0.0]), 0.1 + aside
    track = rho.Track([0, 4], [[beside, -3, 0], [beside, 3, 0]])
    return rho.Scenario(
        "hover",
        rho.Grid(0.5, 9),
        [rho.Vehicle("v", rho.State(at), rho.State([0.1 + hop, 0, 0]))],
        obstacles=[rho.Obstacle(rho.Sphere([0, 0, 0], 0.3), track=track)],
        **options,  # type: ignore[arg-type]  # of the scenario
    )


SCENES = {
    "random": lambda seed: random_scenario(seed, between_knots=True),
    "fleet": lambda seed: random_fleet(seed, most=3),
    "hover": lambda seed: hovering(aside=0.04 * (seed % 7)),
    "hop": lambda seed: hovering(hop=10.0 ** -(seed % 6)),
    "wind": lambda seed: hovering(disturbance=rho.Disturbance(0.01 * (seed % 5), 0.001)),
    "waypoint": lambda seed: dataclasses.replace(
        hovering(),
        vehicles=(
            rho.Vehicle(
                "v",
                rho.State([0.1, 0, 0]),
                rho.State([0.1, 0, 0]),
                waypoints=[rho.Waypoint(1.0, [0.1, 0.1 * (seed % 4), 0.2], 0.05)],
            ),
        ),
    ),
}


def outcome(scenario: rho.Scenario) -> float | None:
    """Return the cost of the plan, which holds; None if there is none."""
    try:
        plan = rho.plan_convex(scenario) if len(scenario.vehicles) > 3 else rho.plan(scenario)
    except rho.InfeasibleError:
        return None
    assert rho.verify(plan).ok
    return plan.cost


@given(kind=st.sampled_from(sorted(SCENES)), seed=st.integers(0, 200), far=st.sampled_from(FAR))
@example(kind="fleet", seed=156, far=1e3)  # all meet in the middle, where only rounding has a side
@settings(max_examples=10)
def test_a_shifted_scene_has_the_same_plan(kind: str, seed: int, far: float) -> None:
    scenario = SCENES[kind](seed)
    by = far * np.array([1.0, -1.0, 0.3])
    here, there = outcome(scenario), outcome(moved(scenario, by))
    assert (here is None) == (there is None)
    if here is not None:
        size = float(scenario.fleet.lengths.min())
        rounding = 1e-10 * far / size  # rounding of coordinates, relative to the distance flown
        assert there == pytest.approx(here, rel=1e-5 + rounding, abs=1e-9)


@pytest.mark.parametrize("far", [0.0, *FAR])
def test_lengths_do_not_depend_on_coordinates(far: float) -> None:
    for scenario in (hovering(), hovering(hop=0.01)):
        there = moved(scenario, np.full(3, far))
        np.testing.assert_allclose(there.fleet.lengths, scenario.fleet.lengths, rtol=1e-6)


def test_the_length_of_a_vehicle_is_the_distance_of_its_task() -> None:
    free = dataclasses.replace(hovering(), obstacles=())
    assert free.fleet.lengths == pytest.approx([1.0])  # nothing else defines a length
    # the vehicle moves aside by the size of the ball
    assert hovering().fleet.lengths == pytest.approx([0.3])
    past = dataclasses.replace(hovering(aside=0.7), obstacles=hovering(aside=0.7).obstacles)
    assert past.fleet.lengths == pytest.approx([1.0])  # the ball passes at a distance
    assert hovering(hop=2.0).fleet.lengths == pytest.approx([2.0])
    hop = dataclasses.replace(hovering(hop=1e-12), obstacles=())
    at = moved(hop, np.full(3, 1e6))
    assert at.fleet.lengths[0] * TOLERANCE > 8 * 9 * np.finfo(float).eps * 1e6  # rounding is less


@pytest.mark.parametrize("half", [10.0, 1e3, 1e5])
def test_a_wide_ground_is_impenetrable(half: float) -> None:
    ground = rho.Box([-half, -half, -2.5e-4 * half - 1.0], [half, half, -0.02])

    def at(height: float) -> rho.Plan:
        scenario = rho.Scenario(
            "ground",
            rho.Grid(0.5, 9),
            [rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([4, 0, 1]), radius=0.02)],
            obstacles=[ground],
        )
        dip = np.zeros((1, 8, 3))
        dip[0, :, 2] = np.array([-1, -1, 1, 1, 1, 1, -1, -1]) * (1.0 - height)
        dip[0, :, 0] = np.array([1, 1, 1, 1, -1, -1, -1, -1])
        return rho.Plan.from_accelerations(scenario, dip)

    for depth, accepted in ((2e-6, True), (6e-6, False)):
        report = rho.verify(at(-depth))
        (found,) = {each.tolerance for each in report.checks if each.constraint == "obstacle 1"}
        assert found == pytest.approx(TOLERANCE * 4.0)
        assert report.ok == accepted
    plan = rho.plan(at(0.0).scenario)
    assert rho.verify(plan).ok


def test_a_slowly_moving_ground_is_impenetrable() -> None:
    """An obstacle that moves along its surface does not enlarge the scale or the tolerance."""
    deep = rho.Box([-1e5, -1e5, -2e5], [1e5, 1e5, 0.0])
    for speed in (1e-9, 1e-2):
        ground = rho.Obstacle(deep, velocity=[speed, 0, 0])
        vehicle = rho.Vehicle("v", rho.State([0, 0, 0.5]), rho.State([1, 0, 0.5]))
        scenario = rho.Scenario("sinks", rho.Grid(0.5, 9), [vehicle], obstacles=[ground])
        assert scenario.fleet.lengths == pytest.approx([1.0])
        assert scenario.fleet.obstacle_tolerances(deep) == pytest.approx([TOLERANCE])
        with pytest.raises(rho.ScenarioError, match=r"start\.position"):
            dataclasses.replace(
                scenario,
                vehicles=(dataclasses.replace(vehicle, start=rho.State([0, 0, -0.09])),),
            )


def test_unknown_obstacles_define_no_scale() -> None:
    late = dataclasses.replace(hovering().bodies[0], known_from=2.0)
    scenario = dataclasses.replace(hovering(), obstacles=(late,))
    assert scenario.fleet.lengths == pytest.approx([1.0])
