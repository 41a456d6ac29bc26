"""Halos show where uncertain obstacles may be, and distances are from there."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.display.common.clearances import least_clearances
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.obstacle_snapshots import approaches, snapshots
from drake_rho.display.common.shape_faces import around
from drake_rho.display.meshcat.obstacles import _halos
from drake_rho.display.meshcat.scene import Scene
from drake_rho.motion.obstacle_clearances import closest
from tests.browser import open_page
from tests.maps import wall_with_gap
from tests.shapes import Shape
from tests.test_animation_obstacles import _open, _seek, _visible

INTRUDER = rho.Obstacle(
    rho.Sphere([9, 1.6, 1], 0.5),
    velocity=[-0.8, 0, 0],
    position_error=0.1,
    velocity_error=0.08,
    seen_at=0.0,
    name="intruder",
)
TRUCK = rho.Obstacle(rho.Box([2, -3, 0], [3, -1, 2]), position_error=0.3, name="truck")
CROWD = rho.Obstacle(rho.Cylinder([7, 3, 1], 0.4), velocity_error=0.1, seen_at=2.0, name="crowd")


def _plan(*bodies: rho.Obstacle, start: float = 0.0) -> rho.Plan:
    """Return a straight flight of 10 s past obstacles."""
    vehicle = rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([10, 0, 1]), radius=0.15)
    grid = rho.Grid.lasting(10.0, step=0.25, start=start)
    scenario = rho.Scenario("halos", grid, [vehicle], obstacles=bodies)
    free = rho.plan_convex(scenario.without_obstacles())
    return rho.Plan.from_accelerations(scenario, free.accelerations)


@pytest.mark.parametrize(
    "shape",
    [
        rho.Sphere([1, 2, 3], 0.7),
        rho.Box([0, 0, 0], [1, 2, 3]),
        rho.Cylinder([1, 1, 1], 0.4, 2.0),
        rho.Ellipsoid([1, 2, 3], [1, 0.5, 0.3]),
        rho.Capsule([0, 0, 0], [1, 1, 0], 0.3),
    ],
)
@pytest.mark.parametrize("distance", [0.01, 0.4, 5.0])
def test_corners_of_halos_are_at_their_distance(shape: Shape, distance: float) -> None:
    corners = np.concatenate(around(shape, distance).faces)
    np.testing.assert_allclose(shape.local_distance(corners), distance, rtol=1e-6)


def test_pictures_have_halos_at_the_instants_that_they_show() -> None:
    plan = _plan(INTRUDER, TRUCK, CROWD)
    shown = snapshots(drawn(plan), plan.scenario.bodies)
    for each in shown:
        if each.number == 1:  # it moves along -x, so that its place tells the time
            time = (9.0 - each.center[0]) / 0.8
            assert each.halo == pytest.approx(0.1 + 0.08 * time)
        elif each.number == 2:
            assert each.halo == 0.3
        else:
            assert 0.3 < each.halo <= 0.8
        lower, upper = each.bounds
        np.testing.assert_allclose((upper - lower)[:2], 2 * (each.shape.extent + each.halo)[:2])
    (line,) = approaches(drawn(plan), plan.scenario.bodies)
    found = least_clearances(drawn(plan), [INTRUDER]).clearances.min()
    assert np.linalg.norm(line[1] - line[0]) == pytest.approx(found + 0.15, abs=1e-6)
    notes = " ".join(text.get_text() for text in rho.paths_figure(plan).texts)
    assert "halos: where obstacles may be" in notes
    certain = dataclasses.replace(TRUCK, position_error=0.0)
    notes = " ".join(text.get_text() for text in rho.paths_figure(_plan(certain)).texts)
    assert "halos" not in notes


def test_distances_are_from_where_it_may_be_and_say_so() -> None:
    plan = _plan(INTRUDER)
    (ax,) = rho.distances_figure(plan).axes
    assert ax.get_ylabel() == "distance from where it may be [m]"
    (curve,) = (line for line in ax.lines if line.get_label() == "v")
    times, values = (np.asarray(data, dtype=float) for data in curve.get_data())
    centers = np.array([9, 1.6, 1]) + times[:, None] * [-0.8, 0, 0]
    away = np.linalg.norm(plan.at(times).positions[0] - centers, axis=1)
    np.testing.assert_allclose(values, away - 0.5 - 0.1 - 0.08 * times, atol=1e-9)
    many = _plan(*[dataclasses.replace(TRUCK, position_error=0.1 * k) for k in range(1, 6)])
    (ax,) = rho.distances_figure(many).axes
    assert ax.get_ylabel() == "clearance from where obstacles may be [m]"
    page = rho.viewer_page(plan)
    told = json.loads(
        re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.S)[0]
    )
    (clear,) = (each for each in told["curves"] if each["title"] == "Least clearance")
    assert "from where obstacles may be, minus the vehicle's radius" in json.dumps(clear)
    assert "halo: where an obstacle may be" in [each["text"] for each in told["legend"]]


def test_reports_note_from_where_distances_are() -> None:
    text = str(rho.verify(_plan(INTRUDER, TRUCK, CROWD)))
    for words in ("(intruder)", "(truck)", "(crowd)"):
        assert f"{words} are from where it may be" in text
    assert "it may be: 0.1 m off, and 0.08 m/s from 0 s on" in text
    assert "it may be: 0.3 m off" in text
    assert "it may be: 0.1 m/s from 2 s on" in text


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_halos_of_the_scene_hold_what_may_be_until_the_next(start: float) -> None:
    growing = dataclasses.replace(TRUCK, velocity_error=0.1, seen_at=start + 2.0)
    timed = dataclasses.replace(growing, active=(start + 3.0, start + 5.0))
    late = dataclasses.replace(growing, known_from=start + 4.0)
    for body, first, last in ((growing, 0.0, 10.0), (timed, 3.0, 5.0), (late, 4.0, 10.0)):
        plan = _plan(body, start=start)
        begins, sizes = np.array(_halos(drawn(plan), body)).T
        ends = np.append(begins[1:], last)
        assert begins[0] == pytest.approx(first, abs=1e-6)
        largest = 0.3 + 0.1 * np.maximum(ends - 2.0, 0.0)
        np.testing.assert_allclose(sizes, largest, atol=1e-6)
    assert _halos(drawn(_plan(TRUCK)), TRUCK) == [(0.0, 0.3)]


def test_maps_have_no_halo() -> None:
    wall = wall_with_gap()
    wall = dataclasses.replace(wall, origin=wall.origin + 5.0 * np.eye(3)[0])
    body = rho.Obstacle(wall, position_error=0.1)
    plan = _plan(body)
    assert _halos(drawn(plan), body) == []
    assert "halos" not in " ".join(text.get_text() for text in rho.paths_figure(plan).texts)
    assert Scene.of(drawn(plan)).size < 40.0


@pytest.mark.slow
def test_halos_grow_in_the_scene() -> None:
    plan = _plan(INTRUDER, TRUCK, CROWD)
    meshcat = rho.animate(plan)
    with open_page() as (page, errors):
        _open(page, meshcat)
        for time in (0.3, 3.0, 5.2, 9.8):
            _seek(page, time)
            for number, body in enumerate((INTRUDER, TRUCK, CROWD), start=1):
                halos = _halos(drawn(plan), body)
                begins = [begin for begin, _ in halos]
                for k, begin in enumerate(begins, start=1):
                    end = begins[k] if k < len(begins) else 99.0
                    seen = _visible(page, "obstacles", str(number), "halo", str(k))
                    assert seen == (begin <= time < end)
        assert errors == []


def test_the_closest_approach_is_while_an_obstacle_is_active_and_to_where_it_may_be() -> None:
    zone = rho.Obstacle(rho.Sphere([5.0, 0.2, 1.0], 1.5), active=(3.0, 5.0))
    plan = _plan(zone)
    assert 3.0 <= closest(plan, plan.scenario.bodies[0]).times[0] <= 5.0
    shape = rho.Box([4.0, 1.2, 0.0], [6.0, 2.4, 2.0])
    grown = rho.Obstacle(shape, position_error=0.2, velocity_error=0.1, seen_at=3.1)
    still = rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([0, 0, 1]))
    scenario = rho.Scenario("still", rho.Grid(0.5, 17), [still], obstacles=[grown])
    waits = rho.Plan.from_accelerations(scenario, np.zeros((1, 16, 3)))
    value = float(shape.signed_distance(np.array([0.0, 0.0, 1.0]))) - 0.2 - 0.1 * (8.0 - 3.1)
    found = closest(waits, scenario.bodies[0])
    assert found.distances[0] == pytest.approx(value, abs=1e-9)
