"""Random scenes with obstacles that are active for a time: sampled densely, and in other forms."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.sampled import least_clearances
from tests.scenarios import examples, sampled_separation, slow
from tests.shapes import Shape

DURATION, UNIX = 10.0, 1.7e9
AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")


def _shape(rng: np.random.Generator, center: np.ndarray) -> Shape:
    """Return a shape of a random kind around a place."""
    half = rng.uniform(0.4, 1.5, 3)
    kind = rng.integers(4)
    if kind == 0:
        return rho.Sphere(center, half[0])
    if kind == 1:
        return rho.Box(center - half, center + half)
    if kind == 2:
        height = None if half[1] < 0.8 else 2.0 * half[1]
        return rho.Cylinder(center, half[0], height, AXES[rng.integers(3)])
    return rho.Ellipsoid(center, half)


def _obstacle(rng: np.random.Generator, start: float, path: np.ndarray) -> rho.Obstacle:
    """Return an obstacle of a random kind that meets a straight flight, if it is active then."""
    when = rng.uniform(0.1, 0.9)
    meeting, time = start + when * DURATION, rng.uniform(-0.2, 0.9)
    place = path[0] + when * (path[1] - path[0]) + 0.4 * rng.normal(size=3)
    before, after = rng.uniform(-0.8, 0.8, (2, 3))
    first, last = start + time * DURATION, start + (time + rng.uniform(0.02, 0.7)) * DURATION
    active = (first, last) if rng.random() < 0.7 else None
    kind = rng.integers(4)
    if kind == 0 and start < UNIX:
        return rho.Obstacle(_shape(rng, place - meeting * before), velocity=before, active=active)
    if kind == 1:
        places = np.array([place - 3.0 * before, place, place + 3.0 * after])
        track = rho.Track(meeting + np.array([-3.0, 0.0, 3.0]), places, after="rests")
        return rho.Obstacle(_shape(rng, place), track=track, active=active)
    return rho.Obstacle(_shape(rng, place), active=active)


def scene(seed: int) -> rho.Scenario:
    """Return 1 to 3 vehicles among 1 to 4 obstacles, many of them active for a time or moving."""
    rng = np.random.default_rng(seed)
    lanes = [np.array([[0, 4 * i, 2], [12, 4 * i, 2]]) for i in range(rng.integers(1, 4))]
    paths = [lane + rng.uniform(-1, 1, (2, 3)) for lane in lanes]
    scenario = rho.Scenario(
        f"scene {seed}",
        rho.Grid.lasting(DURATION, step=0.5, start=float(rng.choice([0.0, -3.7, UNIX]))),
        [
            rho.Vehicle(f"v{i}", rho.State(one), rho.State(other), radius=rng.uniform(0.0, 0.3))
            for i, (one, other) in enumerate(paths)
        ],
        rho.Limits(max_speed=5.0, max_acceleration=6.0),
        separation=rho.Separation(1.0) if rng.random() < 0.5 else None,
    )
    count = rng.integers(1, 5)
    while len(scenario.obstacles) < count:
        new = _obstacle(rng, scenario.grid.start, paths[rng.integers(len(paths))])
        with suppress(rho.ScenarioError):  # around a start or a goal while it is active
            obstacles = (*scenario.obstacles, new)
            scenario = dataclasses.replace(scenario, obstacles=obstacles)
    return scenario


@pytest.mark.parametrize("seed", [0, 1, 3, 4, *slow(2, *range(5, 60))])
def test_no_instant_of_an_interval_is_missed(seed: int) -> None:
    """Plans and flights of random scenes, sampled at 2001 instants of every interval."""
    scenario = scene(seed)
    for flown in (rho.plan(scenario), rho.plan_rho(scenario, replan_every=3).plan):
        assert rho.verify(flown).ok
        assert least_clearances(flown, 2001).min() >= -2e-6
        assert scenario.separation is None or sampled_separation(flown, 100) >= 1.0 - 1e-6


TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A quarter of a turn about the vertical."""


def _turned(shape: Shape, turn: np.ndarray, shift: np.ndarray) -> Shape:
    """Return a shape in coordinates x' = turn x + shift."""
    if isinstance(shape, rho.Box):
        corners = np.stack([turn @ shape.lower, turn @ shape.upper]) + shift
        return rho.Box(corners.min(axis=0), corners.max(axis=0))
    assert isinstance(shape, rho.Sphere | rho.Cylinder | rho.Ellipsoid)
    turned: Shape = dataclasses.replace(shape, center=turn @ shape.center + shift)
    if isinstance(turned, rho.Cylinder):
        along = int(np.argmax(np.abs(turn[:, AXES.index(turned.axis)])))
        return dataclasses.replace(turned, axis=AXES[along])
    if isinstance(turned, rho.Ellipsoid):
        return dataclasses.replace(turned, semi_axes=np.abs(turn @ turned.semi_axes))
    return turned


def _elsewhere(
    scenario: rho.Scenario, turn: np.ndarray, shift: np.ndarray, later: float
) -> rho.Scenario:
    """Return a scenario in other coordinates, x' = turn x + shift, at another time."""
    obstacles = []
    for each in scenario.bodies:
        velocity, track = each.velocity, each.track
        back = shift
        if velocity is not None:  # whose shape is given at time 0
            velocity = turn @ velocity
            back = shift - later * velocity
        if track is not None:
            places = track.positions @ turn.T + shift
            track = rho.Track(track.times + later, places, after=track.after)
        active = each.active and (each.active[0] + later, each.active[1] + later)
        assert isinstance(each.shape, Shape)  # the scenes have no maps
        shape = _turned(each.shape, turn, back)
        obstacles.append(rho.Obstacle(shape, velocity=velocity, track=track, active=active))
    vehicles = [
        rho.Vehicle(
            each.name,
            rho.State(turn @ each.start.position + shift),
            rho.State(turn @ each.goal.position + shift),
            radius=each.radius,
        )
        for each in scenario.vehicles
    ]
    grid = dataclasses.replace(scenario.grid, start=scenario.grid.start + later)
    return dataclasses.replace(
        scenario, grid=grid, vehicles=tuple(vehicles), obstacles=tuple(obstacles)
    )


@given(
    seed=st.integers(0, 59),
    shift=st.tuples(*[st.floats(-50.0, 50.0)] * 3),
    later=st.floats(-500.0, 500.0),
    turned=st.booleans(),
)
@examples(few=4, many=15)
def test_plans_do_not_depend_on_place_time_and_direction(
    seed: int, shift: tuple[float, float, float], later: float, turned: bool
) -> None:
    scenario, turn = scene(seed), TURN if turned else np.eye(3)
    moved = rho.plan(_elsewhere(scenario, turn, np.array(shift), later))
    assert rho.verify(moved).ok
    assert moved.cost == pytest.approx(rho.plan(scenario).cost, rel=1e-5)


@given(seed=st.integers(0, 59), order=st.permutations(range(4)))
@examples(few=4, many=10)
def test_plans_do_not_depend_on_the_order_of_obstacles(seed: int, order: list[int]) -> None:
    scenario = scene(seed)
    known = scenario.obstacles
    others = tuple(known[number] for number in order if number < len(known))
    other = rho.plan(dataclasses.replace(scenario, obstacles=others))
    assert other.cost == pytest.approx(rho.plan(scenario).cost, rel=1e-5)


@given(
    seed=st.integers(0, 59),
    before=st.floats(0.0, 1e3),
    after=st.floats(0.0, 1e3),
    late=st.booleans(),
)
@pytest.mark.slow
@settings(max_examples=10)
def test_intervals_that_cover_the_flight_or_miss_it_change_no_digit(
    seed: int, before: float, after: float, late: bool
) -> None:
    scenario, grid = scene(seed), scene(seed).grid
    steady = [dataclasses.replace(each, active=None) for each in scenario.bodies]
    always = tuple(each for each in steady if _keeps_ends_free(scenario, each))
    covering = (grid.start - before, grid.end + after)
    missing = (grid.end + 1.0, grid.end + 2.0 + after)
    if late:
        missing = (grid.start - 2.0 - before, grid.start - 1.0)
    every = [dataclasses.replace(each, active=covering) for each in always]
    never = [dataclasses.replace(each, active=missing) for each in steady]
    timed = dataclasses.replace(scenario, obstacles=(*every, *never))
    try:
        known = rho.plan(dataclasses.replace(scenario, obstacles=always))
    except rho.InfeasibleError:
        with pytest.raises(rho.InfeasibleError):
            rho.plan(timed)
        return
    np.testing.assert_array_equal(rho.plan(timed).accelerations, known.accelerations)


def _keeps_ends_free(scenario: rho.Scenario, obstacle: rho.Obstacle) -> bool:
    """Return whether a scenario may have an obstacle: it is around no start and no goal."""
    with suppress(rho.ScenarioError):
        dataclasses.replace(scenario, obstacles=(obstacle,))
        return True
    return False
