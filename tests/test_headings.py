"""Headings of exports, read from the setpoints of PX4 and turned back to the scenario's axes."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import fleet
from tests.test_cli import run
from tests.test_export import rough

FASTEST = np.pi / 2.0
"""Largest rate of turning, as documented [rad/s]."""


def flown(accelerations: Any, *, speed: Any = (0.0, 0.0, 0.0)) -> rho.Plan:
    """Return a vehicle from the origin that accelerates so in steps of half a second."""
    a = np.asarray(accelerations, dtype=float)[None]
    scenario = fleet(np.zeros((1, 3)), np.full((1, 3), 50.0), grid=rho.Grid(0.5, a.shape[1] + 1))
    (vehicle,) = scenario.vehicles
    moving = rho.Vehicle(vehicle.name, rho.State([0, 0, 0], speed), vehicle.goal, radius=0.1)
    scenario = rho.Scenario(
        grid=scenario.grid, vehicles=[moving], limits=scenario.limits, name="turns"
    )
    return rho.Plan.from_accelerations(scenario, a)


def exported(plan: rho.Plan, heading: Any, path: Path) -> dict[str, np.ndarray]:
    """Return times [s] and headings from east, anticlockwise [rad], of each vehicle, (M, 2)."""
    rho.export(plan, path / "x.csv", format="px4", rate=100.0, heading=heading)
    found: dict[str, list[tuple[float, float]]] = {}
    with open(path / "x.csv", encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            angle = np.pi / 2.0 - float(row["yaw"])  # from north, clockwise
            assert -np.pi <= float(row["yaw"]) <= np.pi
            found.setdefault(row["vehicle"], []).append((int(row["time_boot_ms"]) / 1000.0, angle))
    tables = {name: np.array(rows) for name, rows in found.items()}
    for table in tables.values():
        table[:, 1] = np.unwrap(table[:, 1])
    return tables


def same(one: Any, other: Any, tolerance: float = 1e-9) -> bool:
    """Return whether angles are equal but for whole turns."""
    return bool(
        np.all(np.abs(np.exp(1j * np.asarray(one)) - np.exp(1j * np.asarray(other))) < tolerance)
    )


def test_a_heading_along_the_velocity_is_that_of_a_turn_slower_than_the_limit(
    tmp_path: Path,
) -> None:
    plan = flown([[0.0, 1.0, 0.0]] * 8, speed=(2.0, 0.0, 0.0))
    (table,) = exported(plan, "velocity", tmp_path).values()
    velocities = plan.at(table[:, 0]).velocities[0]
    assert same(table[:, 1], np.arctan2(velocities[:, 1], velocities[:, 0]), 1e-3)


def test_a_vehicle_that_reverses_turns_at_the_limit_and_arrives(tmp_path: Path) -> None:
    plan = flown([[-4.0, 0.01, 0.0]] * 10, speed=(4.0, 0.0, 0.0))
    (table,) = exported(plan, "velocity", tmp_path).values()
    rates = np.abs(np.diff(table[:, 1]) / np.diff(table[:, 0]))
    assert FASTEST * 0.999 < rates.max() <= FASTEST * 1.001
    velocity = plan.at(5.0).velocities[0, 0]
    assert same(table[-1, 1], np.arctan2(velocity[1], velocity[0]), 1e-2)
    assert abs(table[-1, 1] - table[0, 1]) < 1.5 * np.pi  # the shorter way


def test_it_is_held_where_the_vehicle_is_slow_and_begins_as_it_will_depart(tmp_path: Path) -> None:
    stop = [[0, 0, 0]] * 2 + [[0, 2, 0]] * 2 + [[0, -2, 0]] * 2 + [[0, 0, 0]] * 4
    (table,) = exported(flown(stop), "velocity", tmp_path).values()
    assert same(table[:, 1], np.pi / 2.0)


def test_a_vehicle_that_only_climbs_looks_along_x(tmp_path: Path) -> None:
    (table,) = exported(flown([[0, 0, 1.0]] * 4), "velocity", tmp_path).values()
    assert same(table[:, 1], 0.0)


def test_a_point_is_looked_at_and_each_vehicle_has_its_own(tmp_path: Path) -> None:
    plan, point = rough(vehicles=4), [200.0, -300.0, 1.0]
    headings = {"v0": point, "v1": "velocity", "v2": -2.0}
    tables = exported(plan, headings, tmp_path)
    p = plan.at(tables["v0"][:, 0]).positions[0]
    angles = np.arctan2(point[1] - p[:, 1], point[0] - p[:, 0])
    assert same(tables["v0"][:, 1], angles, 1e-3)
    assert same(tables["v2"][:, 1], -2.0)
    assert same(tables["v3"][:, 1], 0.0)
    alone = exported(plan, "velocity", tmp_path)
    np.testing.assert_array_equal(tables["v1"], alone["v1"])


def test_headings_turn_with_the_scene(tmp_path: Path) -> None:
    a = np.random.default_rng(3).normal(size=(8, 3))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    speed = np.array([3.0, 1.0, 0.0])
    (one,) = exported(flown(a, speed=speed), "velocity", tmp_path).values()
    (other,) = exported(flown(a @ turn.T, speed=turn @ speed), "velocity", tmp_path).values()
    assert same(other[:, 1], one[:, 1] + np.pi / 2.0, 1e-9)


def test_polynomials_hold_angles(tmp_path: Path) -> None:
    written = rho.export(rough(), tmp_path / "x", format="crazyswarm", heading={"v1": 1.25})
    for file, angle in zip(written.files, (0.0, 1.25, 0.0), strict=True):
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        np.testing.assert_array_equal(table[:, 25], angle)
        np.testing.assert_array_equal(table[:, 26:], 0.0)


REFUSED: list[tuple[str, str, Any, str]] = [
    ("csv", "x.csv", 0.0, "heading: got one, expected none with csv, which holds none"),
    ("json", "x.json", "velocity", "expected none with json"),
    ("skybrush", "x.zip", 1.0, "expected none with skybrush"),
    ("crazyswarm", "x", "velocity", "got 'velocity', expected angles in rad with crazyswarm"),
    ("crazyswarm", "x", [1.0, 2.0, 3.0], "expected angles in rad with crazyswarm"),
    ("crazyswarm", "x", {"v0": "velocity"}, "expected angles in rad with crazyswarm"),
    ("px4", "x.csv", "north", "heading: got 'north', expected .*velocity"),
    ("px4", "x.csv", float("nan"), "heading: got nan, expected 'velocity', an angle in rad"),
    ("px4", "x.csv", True, "heading: got True, expected 'velocity', an angle in rad"),
    ("px4", "x.csv", {"v0": True}, "heading: got True, expected 'velocity', an angle in rad"),
    ("px4", "x.csv", [1.0, 2.0], r"heading: got \[1.0, 2.0\], expected 'velocity', an angle"),
    ("mcap", "x.mcap", {"v0": "up"}, "heading: got 'up', expected 'velocity'"),
    ("px4", "x.csv", {"v9": 1.0}, "heading: got 'v9', expected names of vehicles: v0, v1, v2"),
]


@pytest.mark.parametrize(("format", "name", "heading", "words"), REFUSED)
def test_invalid_headings_are_refused(
    format: str, name: str, heading: Any, words: str, tmp_path: Path
) -> None:
    unused = rough() if isinstance(heading, Mapping) else object.__new__(rho.Plan)
    with pytest.raises(ValueError, match=words):
        rho.export(unused, tmp_path / name, format=format, heading=heading)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "heading"),
    [
        (["velocity"], "velocity"),
        (["-1.5"], -1.5),
        (["3,-4,0"], [3.0, -4.0, 0.0]),
        (["v1=velocity", "v0=0.5"], {"v1": "velocity", "v0": 0.5}),
    ],
)
def test_the_command_takes_the_same_headings(
    words: list[str],
    heading: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan = rough()
    rho.save(plan, tmp_path / "plan.npz")
    options = [f"--heading={each}" for each in words]
    path = str(tmp_path / "one.skyc")
    status, _, err = run(
        capsys, monkeypatch, "export", str(tmp_path / "plan.npz"), "-o", path, *options
    )
    assert (status, err) == (0, "")
    rho.export(plan, tmp_path / "other.skyc", heading=heading)
    assert (tmp_path / "one.skyc").read_bytes() == (tmp_path / "other.skyc").read_bytes()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["velocity", "1"], "--heading: got velocity and 1, expected one, or one NAME=HEADING"),
        (["v0=1", "v0=2"], "--heading: got v0=1 and v0=2"),
        (["fast"], "heading: got 'fast', expected 'velocity'"),
    ],
)
def test_the_command_refuses_other_headings(
    words: list[str],
    expected: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options = [f"--heading={each}" for each in words]
    path = str(tmp_path / "x.skyc")
    status, _, err = run(capsys, monkeypatch, "export", "none.npz", "-o", path, *options)
    assert status == 2
    assert expected in err
