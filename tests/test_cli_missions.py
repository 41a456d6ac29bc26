"""Missions and robots of other programs, imported as scenario files."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

import drake_rho as rho
from tests.test_cli import run

Captured = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch

MISSION = """
{"quadrotors": {"small": {"max_vel": [1, 1, 1], "max_acc": [2, 2, 1], "radius": 0.15,
                          "nominal_velocity": 1, "downwash": 2}},
 "world": [{"dimension": [-2, -2, 0, 2, 2, 2]}],
 "agents": [{"type": "small", "cid": 1, "start": [-1, -1, 1], "goal": [1, -1, 1]},
            {"type": "small", "cid": 2, "start": [-1, 1, 1], "goal": [1, 1, 0.5]}],
 "obstacles": []}
"""

# as crazyflie/config/crazyflies.yaml of Crazyswarm2, in the words of its documentation
ROBOTS = """\
robots:
  cf1:
    enabled: true
    uri: radio://0/80/2M/E7E7E7E701
    initial_position: [0.0, 0.5, 0.0]
    type: cf21  # see robot_types
  cf2:
    enabled: false
    uri: radio://0/80/2M/E7E7E7E702
    initial_position: [0.0, -0.5, 0.0]
    type: cf21
  cf3:
    enabled: true
    uri: radio://0/80/2M/E7E7E7E703
    initial_position: [1, 0, 0]
    type: cf21
robot_types:
  cf21:
    motion_capture: {enabled: true, marker: default_single_marker}
    big_quad: false
all:
  firmware_params: {stabilizer: {estimator: 2, controller: 2}}
"""

GRID = ["--duration", "10", "--step", "0.2"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    """Work in a folder with a mission of the LSC planner and robots of Crazyswarm2."""
    (tmp_path / "mission.json").write_text(MISSION)
    (tmp_path / "crazyflies.yaml").write_text(ROBOTS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_mission_is_imported_on_the_requested_grid_and_planned(
    capsys: Captured, monkeypatch: Patch
) -> None:
    Path("world.csv").write_text("0,0,1,0.5,0.5,2\n")
    words = ["import", "mission.json", *GRID, "--world", "world.csv", "-o", "scenario.yaml"]
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, err) == (0, "")
    assert "2 vehicles, 1 obstacle" in out
    assert "saved to scenario.yaml" in out
    loaded = rho.load_lsc_mission("mission.json", grid=rho.Grid(0.2, 51), world="world.csv")
    assert rho.load_scenario("scenario.yaml") == loaded
    status, out, _ = run(capsys, monkeypatch, "plan", "scenario.yaml")
    assert status == 0, out


def test_the_convex_method_tries_further_steps(capsys: Captured, monkeypatch: Patch) -> None:
    words = ["import", "mission.json", "--duration", "4", "--step", "4", "-o", "scenario.yaml"]
    assert run(capsys, monkeypatch, *words)[0] == 0
    status, out, _ = run(capsys, monkeypatch, "plan", "scenario.yaml", "--step", "0.1")
    assert status == 0
    assert "step 0.1 s" in out


@pytest.mark.parametrize("command", ["plan", "fly", "show", "simulate", "diagnose", "assign"])
@pytest.mark.parametrize(
    ("file", "arguments"),
    [
        (
            "mission.json",
            "mission.json --duration S --step S [--world FILE] -o scenario.yaml",
        ),
        ("crazyflies.yaml", "crazyflies.yaml --duration S --step S -o scenario.yaml"),
        ("timed.csv", "timed.csv --step S -o scenario.yaml"),
        ("places.csv", "places.csv --duration S --step S -o scenario.yaml"),
    ],
)
def test_files_without_a_grid_are_refused_with_the_command_that_imports_them(
    command: str, file: str, arguments: str, capsys: Captured, monkeypatch: Patch
) -> None:
    Path("timed.csv").write_text("1,0,0,1\n6,4,0,1\n")
    Path("places.csv").write_text("0,0,1\n4,0,1\n")
    status, out, err = run(capsys, monkeypatch, command, file)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert err.endswith(f"expected a scenario: drake-rho import {arguments}\n")


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["mission.json"], "mission.json: got no --duration, expected --duration and --step"),
        (["mission.json", "--step", "0.2"], "got no --duration, expected --duration and --step"),
        (["mission.json", "--duration", "10"], "got no --step, expected --duration and --step"),
        (["mission.json", "--duration", "10", "--step", "0.3"], "a step that divides the duration"),
        (["mission.json", "--duration", "-1", "--step", "0.3"], "drake-rho: --duration: got -1"),
        (["mission.json", *GRID, "--max-speed", "1"], "--max-speed: got 1.0, expected none with"),
        (
            ["mission.json", *GRID, "--world", "w.csv"],
            "w.csv: got no text, expected a",
        ),
        (["mission.json", *GRID, "--world", "none.csv"], "none.csv: got no row"),
        (["mission.json", *GRID, "--world", "short.csv"], "short.csv: line 1: got '0,0,1,1,1'"),
        (["mission.json", *GRID, "--world", "words.csv"], "words.csv: line 2: got 'x'"),
        (["mission.json", *GRID, "--world", "on.csv"], "mission.json: agents[1].start: got"),
        (["backwash.json", *GRID], "backwash.json: quadrotors.small.backwash: got 2, expected no"),
        (
            ["mission.json", "mission.json", *GRID],
            "got 2 files, expected one with a",
        ),
        (["mission.json", "crazyflies.yaml", *GRID], "crazyflies.yaml: got crazyflies.yaml of"),
        (["crazyflies.yaml"], "crazyflies.yaml: got no --duration"),
        (
            ["crazyflies.yaml", *GRID, "--world", "on.csv"],
            "--world: got on.csv, expected none",
        ),
        (["crazyflies.yaml", *GRID, "--max-speed", "-1"], "drake-rho: --max-speed: got -1"),
        (
            ["table.csv", *GRID],
            "--duration: got 10, expected none: the times of table.csv",
        ),
        (["table.csv"], "table.csv: got no --step, expected --step: a table with times has"),
        (["on.csv", *GRID], "on.csv: line 1: got 6 columns"),
        (
            ["one.csv", *GRID],
            "one.csv: got one row, expected a start, waypoints if",
        ),
    ],
)
def test_imports_are_refused_in_one_line(
    words: list[str], complaint: str, capsys: Captured, monkeypatch: Patch
) -> None:
    Path("none.csv").write_text("")
    Path("short.csv").write_text("0,0,1,1,1\n")
    Path("words.csv").write_text("0,0,1,0.5,0.5,2\nx\n")
    Path("on.csv").write_text("-1,1,1,0.5,0.5,2\n")
    Path("one.csv").write_text("0,0,1\n")
    Path("table.csv").write_text("1,0,0,1\n6,4,0,1\n")
    Path("backwash.json").write_text(MISSION.replace('"downwash"', '"backwash"'))
    Path("scenario.yaml").write_text("before")
    status, out, err = run(capsys, monkeypatch, "import", *words, "-o", "scenario.yaml")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert complaint in err
    assert Path("scenario.yaml").read_text() == "before"


def test_enabled_robots_start_and_stay_at_their_initial_positions() -> None:
    vehicles = rho.load_crazyflies("crazyflies.yaml")
    assert vehicles == tuple(
        rho.Vehicle(name, rho.State(place), rho.State(place))
        for name, place in (("cf1", [0, 0.5, 0]), ("cf3", [1, 0, 0]))
    )


def test_robots_become_a_scenario_that_says_what_it_lacks(
    capsys: Captured, monkeypatch: Patch
) -> None:
    words = ["import", "crazyflies.yaml", *GRID, "--max-speed", "1.5", "-o", "swarm.yaml"]
    status, out, _ = run(capsys, monkeypatch, *words, "--json")
    told, scenario = json.loads(out), rho.load_scenario("swarm.yaml")
    assert (status, told["vehicles"], told["file"]) == (0, 2, "swarm.yaml")
    assert [each.partition(":")[0] for each in told["notes"]] == [
        "the goals are the starts, so that vehicles stay",
        "vehicles do not avoid each other",
    ]
    assert scenario.vehicles == rho.load_crazyflies("crazyflies.yaml")
    assert scenario.limits == rho.Limits(max_speed=1.5)
    up = dataclasses.replace(scenario.vehicles[0], goal=rho.State([0, 0.5, 1]))
    assert rho.verify(rho.plan(dataclasses.replace(scenario, vehicles=(up,)))).ok


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robots: 5", "robots: got 5, expected a mapping"),
        ("- robots", r"got \['robots'\], expected a mapping"),
        ("robots: {cf1: [0, 0, 0]}", r"robots\.cf1: got \[0, 0, 0\], expected a mapping"),
        ("robots: {cf1: {enabled: true}}", r"robots\.cf1\.initial_position: got nothing"),
        (ROBOTS.replace("true", "1"), r"robots\.cf1\.enabled: got 1, expected true or false"),
        (ROBOTS.replace("[1, 0, 0]", "[1, 0]"), r"robots\.cf3\.initial_position\[2\]: got nothing"),
        (ROBOTS.replace("[1, 0, 0]", "[1, 0, .nan]"), r"initial_position\[2\]: got nan"),
        (ROBOTS.replace("cf3:", "cf1:"), "malformed YAML, expected YAML; the key 'cf1' once"),
        (ROBOTS.replace("true", "false"), "robots: got none, expected at least one with enabled"),
        ("robots: !!python/object/apply:os.system [exit]", "malformed YAML"),
        ("robots: &a {cf1: *a}", "inside of itself"),
        ("", "got None, expected a mapping"),
    ],
)
def test_malformed_robots_are_refused_by_name(text: str, words: str) -> None:
    Path("crazyflies.yaml").write_text(text)
    with pytest.raises(rho.ScenarioError, match=rf"crazyflies\.yaml: .*{words}"):
        rho.load_crazyflies("crazyflies.yaml")


@pytest.mark.parametrize(
    ("text", "options", "begin"),
    [
        ("0,0,1\n4,0,1\n4,3,2\n", ["--duration", "5"], 0.0),
        ("1,0,0,1\n3.3,4,0,1\n6,4,3,2\n", [], 1.0),
    ],
)
def test_a_table_becomes_a_vehicle_from_its_first_row_to_its_last(
    text: str, options: list[str], begin: float, capsys: Captured, monkeypatch: Patch
) -> None:
    Path("table.csv").write_text(text)
    words = ["import", "table.csv", *options, "--step", "0.5", "-o", "scenario.yaml"]
    status, out, _ = run(capsys, monkeypatch, *words, "--max-acceleration", "9")
    scenario = rho.load_scenario("scenario.yaml")
    assert status == 0, out
    assert scenario.grid == rho.Grid(0.5, 11, begin)
    (vehicle,) = scenario.vehicles
    assert vehicle.waypoints == rho.load_waypoints("table.csv")[1:-1]
    assert vehicle.start == rho.State([0, 0, 1])
    assert vehicle.goal == rho.State([4, 3, 2])
