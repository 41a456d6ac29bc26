"""Windows of a receding horizon among obstacles that are active for an interval of time."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import KINDS, disturbed, winds_for
from tests.sampled import least_clearances
from tests.scenarios import single, slow
from tests.shapes import Shape

SPHERE, CROSSING = rho.Sphere([5.0, 2.2, -0.9], 1.5), rho.Sphere([2.0, 5.0, -1.0], 1.3)
"""On the straight path at 4 s, at rest; and before it moves there."""
TRACK = rho.Track(
    [0, 3, 4, 8], np.array([[2, 5, -1], [4.5, 2.2, -0.9], [5.5, 1.9, -1], [8, -3, -1]])
)
UNIX = 1.7e9


def _zone(
    active: tuple[float, float], shape: Shape = SPHERE, start: float = 0.0, **more: Any
) -> rho.Scenario:
    """Return one vehicle, 8 s from rest to rest, and an obstacle on its straight path."""
    zone = rho.Obstacle(shape, active=(active[0] + start, active[1] + start), **more)
    return single(obstacles=[zone], between_knots=True, grid=rho.Grid(0.5, 17, start))


@cache
def _free() -> rho.Plan:
    """Return the plan without an obstacle."""
    return rho.plan_convex(single(between_knots=True))


def _starts(flight: rho.Flight) -> list[float]:
    """Return the times at which the windows of a flight begin, since its first knot [s]."""
    return [0.5 * window.first_knot for window in flight.windows]


WITHIN = [(3.1, 4.7), (3.26, 3.9), (4.0, 4.5), (4.2, 4.3), (2.0, 6.0)]
"""Begins and ends between knots, between windows, in one step, or at windows."""


@pytest.mark.parametrize("start", [0.0, UNIX])
@pytest.mark.parametrize("active", WITHIN)
def test_flights_keep_clear_at_every_instant_of_the_interval(
    active: tuple[float, float], start: float
) -> None:
    flight = rho.plan_rho(_zone(active, start=start), replan_every=2)
    assert rho.verify(flight).ok
    assert least_clearances(flight.plan)[0] >= -1e-6
    assert not any(window.infeasible for window in flight.windows)
    assert flight.cost > _free().cost * (1.0 + 1e-3)
    for window in flight.windows:
        assert least_clearances(window.plan)[0] >= -1e-6


@pytest.mark.parametrize("active", WITHIN)
def test_a_clock_that_began_long_ago_changes_no_window(active: tuple[float, float]) -> None:
    near, far = (rho.plan_rho(_zone(active, start=start), replan_every=2) for start in (0.0, UNIX))
    for one, other in zip(near.windows, far.windows, strict=True):
        assert other.plan.cost == pytest.approx(one.plan.cost, rel=1e-5)


@pytest.mark.parametrize("active", WITHIN)
def test_windows_that_begin_after_the_interval_fly_as_without_the_obstacle(
    active: tuple[float, float],
) -> None:
    flight, after = rho.plan_rho(_zone(active), replan_every=2), 0
    for begin, window in zip(_starts(flight), flight.windows, strict=True):
        if begin > active[1]:
            rest = rho.plan_convex(window.plan.scenario.without_obstacles())
            np.testing.assert_allclose(window.plan.accelerations, rest.accelerations, atol=1e-9)
            after += 1
    assert after > 0


@pytest.mark.parametrize("active", [(-3.0, -1.0), (-3.0, 0.0), (9.0, 10.0), (0.1, 0.2), (7.9, 30)])
def test_intervals_away_from_the_encounter_change_no_window(active: tuple[float, float]) -> None:
    flight = rho.plan_rho(_zone(active), replan_every=2)
    np.testing.assert_allclose(flight.plan.accelerations, _free().accelerations, atol=1e-8)
    assert rho.verify(flight).ok


@pytest.mark.parametrize("active", [(0.0, 4.2), (3.5, 8.0), (5.0, 8.0)])
def test_flights_cross_before_and_after_the_interval(active: tuple[float, float]) -> None:
    """A wall without end: there is no way round."""
    wall = rho.Box([4.5, -50.0, -50.0], [5.5, 50.0, 50.0])
    flight = rho.plan_rho(_zone(active, wall), replan_every=2)
    assert rho.verify(flight).ok
    assert least_clearances(flight.plan)[0] >= -1e-6


@pytest.mark.parametrize("motion", [{"velocity": [0.7, -0.8, 0.0]}, {"track": TRACK}])
@pytest.mark.parametrize("active", [(2.0, 4.0), (3.3, 3.8), (3.5, 5.1), (4.5, 8.0), (6.0, 9.0)])
def test_what_moves_is_avoided_while_it_is_active(
    motion: dict[str, Any], active: tuple[float, float]
) -> None:
    flight = rho.plan_rho(_zone(active, CROSSING, **motion), replan_every=2)
    assert rho.verify(flight).ok
    assert least_clearances(flight.plan)[0] >= -1e-6
    assert not any(window.infeasible for window in flight.windows)


@pytest.mark.parametrize("known_from", [1.0, 5.5])
@pytest.mark.parametrize("active", [(0.0, 0.8), (0.0, 3.0), (2.0, 7.5), (6.0, 8.0), (20.0, 30.0)])
def test_what_becomes_known_late_is_avoided_from_then_on(
    known_from: float, active: tuple[float, float]
) -> None:
    """Known after the interval, in it or before it, it is told once, and no window is too late."""
    flight = rho.plan_rho(_zone(active, known_from=known_from), replan_every=2)
    (sighting,) = flight.sightings
    assert (sighting.time, sighting.avoided, sighting.planned_for) == (
        np.ceil(known_from),
        True,
        True,
    )
    assert rho.verify(flight).ok
    assert least_clearances(flight.plan)[0] >= -1e-6
    if known_from > active[1]:
        np.testing.assert_allclose(flight.plan.accelerations, _free().accelerations, atol=1e-8)


def test_what_is_around_a_vehicle_when_it_becomes_known_is_left_and_told() -> None:
    flight = rho.plan_rho(_zone((3.0, 8.0), known_from=3.3), replan_every=2)
    (sighting,) = flight.sightings
    assert (sighting.time, sighting.avoided) == (4.0, False)
    assert not rho.verify(flight).ok
    later = [window for window in flight.windows if window.first_knot > 10]
    assert not any(window.infeasible or window.not_avoided for window in later)
    harmless = rho.plan_rho(_zone((0.5, 1.0), known_from=3.3), replan_every=2)
    assert harmless.sightings[0].avoided  # over when the vehicle is inside
    assert rho.verify(harmless).ok


def test_measured_states_are_planned_from_with_the_interval() -> None:
    """States a little beside the plan, in the interval perhaps inside the zone."""
    scenario, rng = _zone((4.2, 5.1)), np.random.default_rng(0)
    horizon = rho.RecedingHorizon(scenario, replan_every=2)
    for knot in horizon.knots:
        off = 0.02 * rng.normal(size=(1, 6)) if knot else 0.0
        horizon.step(horizon.planned(knot) + off, scenario.grid.times[knot])
    for begin, window in zip(_starts(horizon.flight), horizon.flight.windows, strict=True):
        least = least_clearances(window.plan)[0]
        assert least >= -1e-6 or (4.2 <= begin <= 5.1 and window.infeasible)


def _windy(seed: int) -> rho.Scenario:
    """Return a disturbed fleet with zones on its straight paths, active for random intervals."""
    calm, rng = disturbed(seed), np.random.default_rng(seed)
    grid, zones = calm.grid, list[rho.Obstacle]()
    for each in calm.bodies:
        assert isinstance(each.shape, rho.Sphere)
        first = grid.start + rng.uniform(-0.2, 0.8) * grid.duration
        last = first + rng.uniform(0.02, 0.6) * grid.duration
        aside = each.shape.center - [0.0, rng.uniform(1.0, 2.2), 0.5]
        zones.append(rho.Obstacle(rho.Sphere(aside, 1.2), active=(first, last)))
    return dataclasses.replace(calm, obstacles=tuple(zones))


@pytest.mark.parametrize("seed", [*range(3), *slow(*range(3, 36))])
def test_flights_in_wind_keep_clear_in_the_interval(seed: int) -> None:
    scenario = _windy(seed)
    wind = winds_for(scenario, seed)[KINDS[seed % len(KINDS)]]
    flown = rho.simulate(scenario, wind=wind, rng=np.random.default_rng(seed))
    assert rho.verify(flown).ok
    for obstacle in scenario.bodies:
        assert obstacle.active is not None
        assert isinstance(obstacle.shape, rho.Sphere)
        first, last = np.clip(obstacle.active, scenario.grid.start, scenario.grid.end)
        places = flown.at(np.linspace(first, last, 2001)).positions
        if first < last:
            least = np.linalg.norm(places - obstacle.shape.center, axis=-1).min()
            assert least >= obstacle.shape.radius - 1e-6
