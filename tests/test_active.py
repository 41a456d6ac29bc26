"""Obstacles that are active for an interval of time: avoided at every instant of it, only then."""

from __future__ import annotations

import dataclasses
import json
import re
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.disturbed import disturbed
from tests.scenarios import box, single, slow
from tests.shapes import Shape
from tests.tolerances import INDEX

SPHERE = rho.Sphere([5.0, 2.2, -0.9], 1.5)
WALL = rho.Box([4.5, -50.0, -50.0], [5.5, 50.0, 50.0])
_DENSE = 4001


def _zone(
    active: tuple[float, float] | None, shape: Shape = SPHERE, **more: object
) -> rho.Scenario:
    """Return one vehicle, 8 s from rest to rest past an obstacle."""
    zone = rho.Obstacle(shape, active=active, **more)  # type: ignore[arg-type]  # its fields
    return single(obstacles=[zone], between_knots=True)


def _least(plan: rho.Plan, first: float, last: float) -> float:
    """Return the least signed distance from the first obstacle in an interval, sampled [m]."""
    start, end = plan.scenario.grid.start, plan.scenario.grid.end
    times = np.linspace(max(first, start), min(last, end), _DENSE)
    positions = plan.motion().at("position", times - start)
    obstacle = plan.scenario.bodies[0]
    x = positions - obstacle.centers(times)
    return float(obstacle.shape.local_distance(x.reshape(-1, 3)).min())


@cache
def _without_interval() -> tuple[rho.Plan, rho.Plan]:
    """Return the plans of a zone that is always there, and of one that is never."""
    return rho.plan(_zone(None)), rho.plan(_zone((20.0, 30.0)))


@given(first=st.floats(0.0, 7.9), length=st.floats(0.01, 8.0))
@settings(max_examples=25)
def test_it_is_avoided_at_every_instant_of_its_interval(first: float, length: float) -> None:
    scenario = _zone((first, first + length))
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert _least(plan, first, first + length) >= -1e-6
    always, never = _without_interval()
    assert never.cost * (1.0 - INDEX) <= plan.cost <= always.cost * (1.0 + 1e-4)
    free = rho.Plan.from_accelerations(scenario, never.accelerations)
    assert rho.verify(free).ok == (_least(free, first, first + length) >= -1e-6)


@pytest.mark.parametrize("active", [None, (0.0, 8.0), (-5.0, 20.0)])
def test_active_all_the_time_is_as_without_an_interval(active: tuple[float, float] | None) -> None:
    plan, known = rho.plan(_zone(active)), rho.plan(single(obstacles=[SPHERE], between_knots=True))
    np.testing.assert_allclose(plan.accelerations, known.accelerations, atol=1e-9)


def test_both_ends_belong_to_the_interval() -> None:
    """At the knot of an end, also where a rounded clock puts it a little beyond."""
    free = rho.plan(_zone((20.0, 30.0)))
    for active in ((4.0, 4.2), (3.8, 4.0), (3.8, 4.0 - 1e-12), (4.0 + 1e-12, 4.2)):
        scenario = dataclasses.replace(_zone(active), between_knots=False)
        assert not rho.verify(rho.Plan.from_accelerations(scenario, free.accelerations)).ok
        assert rho.verify(rho.plan(scenario)).ok
    outside = dataclasses.replace(_zone((4.01, 4.49)), between_knots=False)
    assert rho.verify(rho.Plan.from_accelerations(outside, free.accelerations)).ok


@pytest.mark.parametrize("active", [(0.0, 4.2), (3.5, 8.0), *slow((2.0, 6.0))])
def test_a_wall_without_end_is_passed_while_it_is_not_there(active: tuple[float, float]) -> None:
    scenario = _zone(active, WALL)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert _least(plan, *active) >= -1e-6
    assert plan.cost > rho.plan(_zone((20.0, 30.0), WALL)).cost


@pytest.mark.slow
def test_a_wall_that_is_always_there_is_not_passed() -> None:
    with pytest.raises(rho.InfeasibleError, match="obstacle 1"):
        rho.plan(_zone((0.0, 8.0), WALL))


def test_on_a_clock_that_began_long_ago_it_is_the_same() -> None:
    long_ago = 1.7e9
    zone = rho.Obstacle(SPHERE, active=(long_ago + 3.0, long_ago + 5.0))
    grid = rho.Grid(0.5, 17, long_ago)
    plan = rho.plan(single(obstacles=[zone], between_knots=True, grid=grid))
    assert rho.verify(plan).ok
    assert plan.cost == pytest.approx(rho.plan(_zone((3.0, 5.0))).cost, rel=1e-6)


def test_what_moves_is_avoided_while_it_is_active() -> None:
    moving = {"velocity": [0.7, -0.8, 0.0]}
    crossing = rho.Sphere([2.0, 5.0, -1.0], 1.3)
    free = rho.plan(_zone((20.0, 30.0), crossing, **moving))
    for active in ((2.0, 4.0), (4.5, 8.0)):
        plan = rho.plan(_zone(active, crossing, **moving))
        assert rho.verify(plan).ok
        assert _least(plan, *active) >= -1e-6
        assert plan.cost >= free.cost * (1.0 - INDEX)


def test_every_window_knows_what_is_left_of_the_interval() -> None:
    flight = rho.plan_rho(_zone((3.0, 5.0)), replan_every=2)
    assert rho.verify(flight).ok
    assert _least(flight.plan, 3.0, 5.0) >= -1e-6
    late = rho.plan_rho(_zone((3.0, 5.0), known_from=1.0), replan_every=2)
    assert rho.verify(late).ok
    assert late.sightings[0].avoided


def test_disturbed_flights_avoid_it_with_their_errors() -> None:
    calm = disturbed(0)
    first = calm.grid.start + 1.0
    zones = [rho.Obstacle(each.shape, active=(first, first + 2.0)) for each in calm.bodies]
    scenario = dataclasses.replace(calm, obstacles=tuple(zones))
    flight = rho.plan_rho(scenario, replan_every=2)
    assert rho.verify(flight).ok
    rng = np.random.default_rng(0)
    wind = rho.winds.coloured_noise(scenario, rng)
    assert rho.verify(rho.simulate(scenario, wind=wind, rng=rng)).ok


def test_starts_goals_and_waypoints_may_be_inside_while_it_is_not_active() -> None:
    around_start = rho.Sphere([0.0, 0.0, 0.0], 1.0)
    with pytest.raises(rho.ScenarioError, match=r"start\.position.* 1 m in it at 0 s"):
        _zone((0.0, 3.0), around_start)
    plan = rho.plan(_zone((4.0, 8.0), around_start))
    assert rho.verify(plan).ok
    within = rho.Waypoint(2.0, SPHERE.center)
    zone = rho.Obstacle(SPHERE, active=(3.0, 8.0))
    passing = rho.plan(single(obstacles=[zone], waypoints=[within], between_knots=True))
    assert rho.verify(passing).ok


def test_certificates_bound_the_cost_by_rows_of_the_interval() -> None:
    certificate = rho.certify(rho.plan(_zone((3.0, 5.0))))
    assert certificate.is_globally_optimal
    assert certificate.lower_bound <= rho.plan(_zone((3.0, 5.0))).cost * (1.0 + INDEX)
    assert rho.certify(rho.plan(_zone((20.0, 30.0)))).is_globally_optimal


def test_files_keep_it(tmp_path: object) -> None:
    scenario = _zone((3.0, 5.0), name="zone")
    rho.save_scenario(scenario, f"{tmp_path}/zone.yaml")
    assert rho.load_scenario(f"{tmp_path}/zone.yaml") == scenario


@pytest.mark.parametrize(
    "active", [(5, 3), (3, 3), (3,), (0, 1, 2), (np.nan, 4), (0, np.inf), "35", 4.0]
)
def test_what_is_no_interval_is_told(active: object) -> None:
    with pytest.raises(rho.ScenarioError, match="active"):
        rho.Obstacle(SPHERE, active=active)  # type: ignore[arg-type]  # on purpose


def test_figures_and_page_show_when_it_is_active() -> None:
    plan = rho.plan(_zone((3.0, 5.0), name="zone"))
    texts = [text.get_text() for text in rho.distances_figure(plan).axes[0].texts]
    assert texts.count("not active") == 2
    labels = " ".join(text.get_text() for text in rho.paths_figure(plan).axes[0].texts)
    assert "active 3 to 5 s" in labels
    page = rho.viewer_page(plan)
    told = json.loads(
        re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.S)[0]
    )
    curve = next(each for each in told["curves"] if each["title"] == "Least clearance")
    for time, value in zip(curve["times"], curve["values"], strict=True):
        assert (value is None) == (not 3.0 <= time <= 5.0)
    rho.distances_figure(rho.plan(_zone((20.0, 30.0))))  # nothing to measure, nothing to fail


def test_limits_and_intervals_together() -> None:
    scenario = dataclasses.replace(_zone((3.0, 5.0)), limits=rho.Limits(velocity=box(1.6)))
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert np.abs(plan.velocities).max() <= 1.6 * (1.0 + 1e-6)


@pytest.mark.parametrize("before", [3e-7, 1e-8, 0.0])
def test_what_is_active_until_just_before_the_end_applies_to_the_goal(before: float) -> None:
    """Planners take states within a millionth of a step of the ends as given."""
    grid = rho.Grid.lasting(10.0, step=1.0)
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([10, 0, 0]))
    active = (before, 10.0 - before)
    blocked = rho.Obstacle(rho.Sphere([10, 0, 0], 1.0), active=active)
    with pytest.raises(rho.ScenarioError, match=r"goal\.position"):
        rho.Scenario("blocked", grid, [vehicle], obstacles=[blocked])
    required = rho.KeepIn(rho.Box([2, -1, -1], [11, 1, 1]), active=active)
    with pytest.raises(rho.ScenarioError, match=r"start\.position"):
        rho.Scenario("outside", grid, [vehicle], requirements=[required])
