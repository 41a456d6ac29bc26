"""Headings of simulated quadrotors, and of vehicles in scenes and pages."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.browser import open_page
from tests.test_cli import run
from tests.test_headings import flown, same

CLOSE = np.radians(0.5)
"""Largest deviation of a quadrotor's heading from one that turns at no more than 1 rad/s [rad]."""
DRAWN = 1e-3
"""Deviation of noses between the frames of an animation [rad]."""


def turning(steps: int = 2) -> rho.Plan:
    """Return a plan of a turn, slower than headings may turn, in steps of half a second."""
    return flown([[0.0, 1.0, 0.0]] * steps, speed=(2.0, 0.0, 0.0))


def quadrotor(plan: rho.Plan, heading: Any = None) -> rho.Simulation:
    """Return the simulation of a plan by quadrotors in still air."""
    return rho.simulate(plan, plant="quadrotor", heading=heading)


def test_a_heading_of_zero_changes_no_bit_of_the_motion() -> None:
    without, zero = quadrotor(turning(1)), quadrotor(turning(1), 0.0)
    for name in ("positions", "velocities", "commands"):
        np.testing.assert_array_equal(getattr(zero, name), getattr(without, name))
    assert without.headings is None
    assert without.heading_errors is None
    np.testing.assert_array_equal(zero.commanded_headings, 0.0)
    assert zero.headings is not None
    assert np.abs(zero.headings).max() < CLOSE


def test_quadrotors_turn_as_their_plan_and_fly_it_as_well(tmp_path: Path) -> None:
    plan = turning()
    found, plain = quadrotor(plan, "velocity"), quadrotor(plan)
    velocities = plan.at(found.times).velocities[0]
    assert found.headings is not None
    assert found.heading_errors is not None
    assert found.heading_errors.max() < CLOSE
    planned = np.arctan2(velocities[:, 1], velocities[:, 0])
    assert same(found.headings[:, 0], planned, CLOSE + 0.02)  # commands are a step of 0.02 s late
    assert np.ptp(found.headings) > 0.4
    assert np.abs(found.positions - plain.positions).max() < 1e-3
    assert "headings from commanded ones by up to" in str(rho.verify(found))
    rho.save(found, tmp_path / "flown.npz")
    again = rho.load(tmp_path / "flown.npz")
    assert isinstance(again, rho.Simulation)
    np.testing.assert_array_equal(again.headings, found.headings)
    np.testing.assert_array_equal(again.commanded_headings, found.commanded_headings)


def test_an_angle_beyond_half_a_turn_is_held_without_a_jump() -> None:
    found = quadrotor(turning(1), 4.0)
    assert found.headings is not None
    assert np.abs(found.headings - 4.0).max() < CLOSE


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"plant": None, "heading": 1.0}, "heading: got one, expected none with a point mass"),
        ({"plant": "quadrotor", "heading": {"v7": 1.0}}, "heading: got 'v7', expected names"),
        ({"plant": "quadrotor", "heading": [1.0, 2.0]}, "heading: got"),
    ],
)
def test_simulations_refuse_other_headings(given: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        rho.simulate(turning(1), **given)


def test_a_simulation_has_true_and_commanded_headings_or_none() -> None:
    plain = rho.simulate(turning(1))
    shape = plain.positions.shape[:2]
    with pytest.raises(ValueError, match="headings: got true or commanded ones alone"):
        dataclasses.replace(plain, headings=np.zeros(shape))
    with pytest.raises(ValueError, match=r"headings: got shape \(3,\), expected finite ones"):
        dataclasses.replace(plain, headings=np.zeros(3), commanded_headings=np.zeros(3))


def noses(shown: rho.Plan | rho.Simulation, time: float, **options: Any) -> dict[str, Any]:
    """Return the directions of the noses in the page at a time, by vehicle."""
    script = """time => {
        viewer.animator.pause(); viewer.animator.seek(time);
        const vehicles = viewer.scene_tree.find(["flight", "vehicles"]).children;
        return Object.fromEntries(Object.entries(vehicles).map(([name, each]) => {
            each.object.updateMatrix(); return [name, each.object.matrix.elements.slice(0, 3)];
        }));
    }"""
    meshcat = rho.animate(shown, rate=1.0, **options)
    with open_page() as (page, errors):
        page.set_default_timeout(120_000)
        page.goto(meshcat.web_url())
        page.wait_for_function(
            "typeof viewer !== 'undefined' && viewer.animator.duration > 0", timeout=120_000
        )
        found: dict[str, list[float]] = page.evaluate(script, time)
        assert errors == []
    return {name: np.array(each) / np.linalg.norm(each) for name, each in found.items()}


def circling(airframe: Any) -> rho.Plan:
    """Return three vehicles of an airframe that turn left around each other."""
    vehicles = [
        rho.Vehicle(
            name, rho.State([4.0 * n, 0, 2], [2, 0, 0]), rho.State([9, 9, 9]), airframe=airframe
        )
        for n, name in enumerate("abc")
    ]
    scenario = rho.Scenario("circling", rho.Grid(0.5, 5), vehicles)
    return rho.Plan.from_accelerations(scenario, np.tile([0.0, 1.0, 0.0], (3, 4, 1)))


@pytest.mark.parametrize("airframe", ["quadrotor", "aircraft"])
def test_scenes_turn_vehicles_to_their_headings(airframe: Any) -> None:
    plan, point = circling(airframe), np.array([1.0, 30.0, 0.0])
    found = noses(plan, 1.0, heading={"a": "velocity", "b": point, "c": -2.0})
    states = plan.at(1.0)
    angle = np.array([np.cos(-2.0), np.sin(-2.0)])
    ahead = [states.velocities[0, 0], point - states.positions[1, 0], angle]
    for nose, wanted in zip(found.values(), ahead, strict=True):
        one, other = (np.arctan2(each[1], each[0]) for each in (nose, wanted))
        assert same(one, other, DRAWN)


def test_a_simulation_is_shown_as_it_was_turned() -> None:
    found = quadrotor(turning(1), 2.5)
    (nose,) = noses(found, 0.3).values()
    assert same(np.arctan2(nose[1], nose[0]), 2.5, DRAWN)
    (other,) = noses(found, 0.3, heading=-1.0).values()
    assert same(np.arctan2(other[1], other[0]), -1.0, DRAWN)


def test_a_page_tells_of_the_cone_only_where_headings_are_shown() -> None:
    for airframe, heading, told in (
        ("quadrotor", None, False),
        ("quadrotor", 0.0, True),
        ("aircraft", 0.0, False),
    ):
        page = rho.viewer_page(circling(airframe), heading=heading)
        assert ("cone: heading of a quadrotor" in page) == told
    with pytest.raises(ValueError, match="heading: got 'd', expected names of vehicles: a, b, c"):
        rho.viewer_page(circling("quadrotor"), heading={"d": 0.0})


def test_commands_take_headings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, files = turning(1), [tmp_path / name for name in ("plan.npz", "sim.npz", "page.html")]
    rho.save(plan, files[0])
    source, output, page = map(str, files)
    words = ["simulate", source, "--heading=1.5", "-o", output]
    status, _, err = run(capsys, monkeypatch, *words)
    assert status == 2
    assert "--heading: got one with points, expected --plant quadrotor" in err
    run(capsys, monkeypatch, *words, "--plant", "quadrotor")
    kept = rho.load(output)
    assert isinstance(kept, rho.Simulation)
    np.testing.assert_array_equal(kept.commanded_headings, 1.5)
    status, _, err = run(capsys, monkeypatch, "show", source, "--heading=velocity", "--html", page)
    assert (status, err) == (0, "")
    wanted, nose_first = rho.viewer_page(plan, heading="velocity"), rho.viewer_page(plan)
    assert len(files[2].read_text()) == len(wanted) != len(nose_first)
    status, _, err = run(capsys, monkeypatch, "show", source, "--heading=up", "--html", page)
    assert status == 2
    assert "heading: got 'up', expected 'velocity'" in err
