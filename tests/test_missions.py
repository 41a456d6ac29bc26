"""Missions of the LSC planner are read as its own reader does, or refused with the file's keys."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.formats.lsc_missions import is_lsc_mission

GRID = rho.Grid(0.2, 51)

MISSION: dict[str, Any] = {
    "quadrotors": {
        "small": {
            "max_vel": [1.0, 1.5, 0.5],
            "max_acc": [2, 3, 1],
            "radius": 0.15,
            "nominal_velocity": 1.0,
            "downwash": 2.0,
        },
        "large": {
            "max_vel": [2.0, 2.0, 2.0],
            "max_acc": [4.0, 4.0, 4.0],
            "radius": 0.25,
            "nominal_velocity": 1.0,
            "downwash": 1.5,
        },
    },
    "world": [{"dimension": [-2, -3, 0.5, 2, 3, 2.5]}],
    "agents": [
        {"type": "small", "cid": 7, "start": [-2, 0, 1], "goal": [2, 0.25, 1]},
        {"type": "small", "cid": 3, "start": [1, -1, 1], "goal": [-1, 1, 2.5]},
    ],
    "obstacles": [],
}

BOX: dict[str, Any] = {"type": "static", "pose": [0, -2.5, 1], "dimensions": [0.5, 0.25, 1]}


def written(folder: Path, content: object) -> Path:
    """Write `content`, as JSON unless it is text, and return the file's path."""
    path = folder / "mission.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def changed(*changes: tuple[tuple[Any, ...], object]) -> dict[str, Any]:
    """Return the mission with other values at some places, each given by its keys."""
    mission = copy.deepcopy(MISSION)
    for (*way, last), value in changes:
        place: Any = mission
        for key in way:
            place = place[key]
        if value is None:
            del place[last]
        else:
            place[last] = value
    return mission


def test_a_mission_becomes_the_scenario_it_describes(tmp_path: Path) -> None:
    scenario = rho.load_lsc_mission(written(tmp_path, MISSION), grid=GRID)
    assert scenario == rho.Scenario(
        name="mission",
        grid=GRID,
        vehicles=(
            rho.Vehicle("small-7", rho.State([-2, 0, 1]), rho.State([2, 0.25, 1]), radius=0.15),
            rho.Vehicle("small-3", rho.State([1, -1, 1]), rho.State([-1, 1, 2.5]), radius=0.15),
        ),
        limits=rho.Limits(
            position=rho.Box([-2, -3, 0.5], [2, 3, 2.5]),
            velocity=rho.Box([-1, -1.5, -0.5], [1, 1.5, 0.5]),
            acceleration=rho.Box([-2, -3, -1], [2, 3, 1]),
        ),
        separation=rho.Separation(0.3, downwash=2.0),
    )
    assert scenario.between_knots


def test_the_order_of_fields_and_unused_types_change_nothing(tmp_path: Path) -> None:
    plain = rho.load_lsc_mission(written(tmp_path, MISSION), grid=GRID)
    other = changed((("quadrotors", "large"), None), (("agents", 0, "nominal_velocity"), 5.0))
    other = dict(reversed(other.items()))
    assert rho.load_lsc_mission(written(tmp_path, other), grid=GRID) == plain


def test_different_types_have_their_own_limits_and_the_safe_separation(tmp_path: Path) -> None:
    mission = changed((("agents", 1, "type"), "large"))
    scenario = rho.load_lsc_mission(written(tmp_path, mission), grid=GRID)
    small, large = (scenario.limits_of(vehicle) for vehicle in scenario.vehicles)
    assert small.velocity == rho.Box([-1, -1.5, -0.5], [1, 1.5, 0.5])
    assert large.acceleration == rho.Box([-4] * 3, [4] * 3)
    assert small.position == large.position == rho.Box([-2, -3, 0.5], [2, 3, 2.5])
    assert scenario.separation is not None
    # no pair may be closer than in the LSC planner: radii r, extents above d r, each summed
    for r, other in ((0.15, 0.25), (0.25, 0.25), (0.15, 0.15)):
        above = sum({0.15: 2.0, 0.25: 1.5}[radius] * radius for radius in (r, other))
        assert scenario.separation.distance >= r + other - 1e-12
        assert scenario.separation.distance * scenario.separation.downwash >= above - 1e-12


def test_an_agent_may_have_its_own_downwash_and_no_number(tmp_path: Path) -> None:
    mission = changed((("agents", 0, "cid"), None), (("agents", 1, "downwash"), 3.0))
    scenario = rho.load_lsc_mission(written(tmp_path, mission), grid=GRID)
    assert [vehicle.name for vehicle in scenario.vehicles] == ["small-0", "small-3"]
    assert scenario.separation is not None
    assert scenario.separation.distance == pytest.approx(0.3)
    assert scenario.separation.downwash == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("way", "value", "field", "words"),
    [
        (("quadrotors",), None, "quadrotors", "nothing"),
        (("obstacles",), None, "obstacles", "nothing"),
        (("wind",), [1, 0, 0], "wind", "no field of this name"),
        (("agents", 1, "colour"), "red", "agents[1].colour", "no field of this name"),
        (("agents", 1, "radius"), 0.3, "agents[1].radius", "no field of this name"),
        (("agents", 1, "size"), 0.3, "agents[1].size", "no field of this name"),
        (("quadrotors", "small", "mass"), 1, "quadrotors.small.mass", "no field of this name"),
        (("quadrotors", "small", "radius"), "0.15", "quadrotors.small.radius", "a number"),
        (("quadrotors", "small", "radius"), True, "quadrotors.small.radius", "a number"),
        (("quadrotors", "small", "radius"), 0, "quadrotors.small.radius", "greater than"),
        (("quadrotors", "small", "downwash"), -2, "quadrotors.small.downwash", "greater than"),
        (("quadrotors", "small", "downwash"), 1e6, "separation.downwash", "less than"),
        (("quadrotors", "small", "max_vel"), [1, 1], "quadrotors.small.max_vel[2]", "nothing"),
        (("quadrotors", "small", "max_acc"), [1, 0, 1], "quadrotors.small.max_acc[1]", "greater"),
        (("quadrotors", "small"), 5, "quadrotors.small", "an object"),
        (("world",), [], "world", "at least 1"),
        (("world",), [{"dimension": [0, 0, 0, 1, 1, 1]}] * 2, "world", "at most 1"),
        (("world", 0, "dimension"), [0, 0, 0, 1, -1, 1], "world[0].dimension", "none of them"),
        (("world", 0, "dimension"), [0, 0, 0, 1, 1, 1, 1], "world[0].dimension", "at most 6"),
        (("agents",), [], "agents", "at least 1"),
        (("agents",), {"small": 1}, "agents", "array"),
        (("agents", 0, "type"), "huge", "agents[0].type", "one of the quadrotors: small, large"),
        (("agents", 1, "cid"), 7, "agents[1].cid", "no other agent has"),
        (("agents", 1, "cid"), 7.5, "agents[1].cid", "integer"),
        (("agents", 1, "start"), [0, 0, "1"], "agents[1].start[2]", "a number"),
        (("agents", 1, "start"), [0, 0, 1e13], "agents[1].start[2]", "less than"),
        (("agents", 1, "start"), [0, 0, float("nan")], "agents[1].start[2]", "finite"),
        (("agents", 1, "start"), [0, 0, 0.4], "agents[1].start", "a position within"),
        (("agents", 1, "goal"), [2, 0, 1], "agents[1].goal", "small-3 at least 0.3 m"),
        (("obstacles",), [{"type": "static"}], "obstacles[0].pose", "nothing"),
        (("obstacles",), [BOX | {"pose": [0, 0]}], "obstacles[0].pose[2]", "nothing"),
        (("obstacles",), [BOX, BOX | {"size": 1}], "obstacles[1].size", "no field of this name"),
        (("obstacles",), [BOX | {"dimensions": [1, 0, 1]}], "obstacles[0].dimensions[1]", "great"),
        (("obstacles",), [BOX | {"dimensions": [1, 1e-9, 1]}], "obstacles[0].dimensions", "flat"),
        (("obstacles",), [{"pose": [0, 0, 1]}], "obstacles[0].type", "nothing"),
        (("obstacles",), [{"type": "spin", "speed": 1}], "obstacles[0].type", "moving types"),
        (("obstacles",), [{"type": ["static"]}], "obstacles[0].type", "static, a box at rest"),
        (("obstacles",), [5], "obstacles[0]", "an object"),
        (("obstacles",), [BOX | {"pose": [1, -0.7, 1]}], "agents[1].start", "at least 0.15 m from"),
    ],
)
def test_unknown_or_malformed_fields_are_refused_by_name(
    way: tuple[Any, ...], value: object, field: str, words: str, tmp_path: Path
) -> None:
    path = written(tmp_path, changed((way, value)))
    with pytest.raises(rho.ScenarioError) as caught:
        rho.load_lsc_mission(path, grid=GRID)
    assert caught.value.field == f"{path}: {field}"
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: text[:-1], "malformed JSON"),
        (lambda text: text.replace("]}]", "], }]", 1), "line 1 column"),
        (lambda text: text.replace('"cid": 7', '"cid": 7, "cid": 8', 1), "this name only once"),
        (lambda _: "", "malformed JSON"),
        (lambda _: "5", "an object"),
        (lambda _: "[" * 100_000, "malformed JSON"),
        (lambda _: "{" + " " * 10 + "# a comment\n}", "malformed JSON"),
    ],
)
def test_files_that_are_no_json_are_refused(
    damage: Callable[[str], str], words: str, tmp_path: Path
) -> None:
    path = written(tmp_path, damage(json.dumps(MISSION)))
    with pytest.raises(rho.ScenarioError, match=words) as caught:
        rho.load_lsc_mission(path, grid=GRID)
    assert str(path) in str(caught.value)


def world(folder: Path, text: str | bytes) -> Path:
    """Write a file with a world, and return its path."""
    path = folder / "world.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_the_rows_of_a_world_are_boxes_by_centre_and_full_sides(tmp_path: Path) -> None:
    rows = world(tmp_path, "0,0,1.25,0.5,0.5,2.5\r\n1.5, 2.0, 1, 1, 0.5, 2\n\n")
    mission = written(tmp_path, changed((("obstacles",), [BOX])))
    scenario = rho.load_lsc_mission(mission, grid=GRID, world=rows)
    assert scenario.name == "mission in world"
    assert scenario.obstacles == (
        rho.Box([-0.25, -0.25, 0.0], [0.25, 0.25, 2.5]),
        rho.Box([1.0, 1.75, 0.0], [2.0, 2.25, 2.0]),
        # of the mission, which gives half of its sides
        rho.Box([-0.5, -2.75, 0.0], [0.5, -2.25, 2.0]),
    )
    assert [vehicle.radius for vehicle in scenario.vehicles] == [0.15, 0.15]
    plain = rho.load_lsc_mission(mission, grid=GRID)
    assert plain.obstacles == scenario.obstacles[2:]


def test_vehicles_keep_the_radius_of_their_type_from_a_world(tmp_path: Path) -> None:
    mission = written(tmp_path, changed((("agents", 1, "type"), "large")))
    scenario = rho.load_lsc_mission(mission, grid=GRID)
    assert [vehicle.radius for vehicle in scenario.vehicles] == [0.15, 0.25]
    # 0.2 m beside both starts: too close for the large vehicle only
    rows = world(tmp_path, "-1.3,0,1,1,1,1\n0.3,-1,1,1,1,1")
    with pytest.raises(rho.ScenarioError, match=r"at least 0\.25 m from obstacle 2") as caught:
        rho.load_lsc_mission(mission, grid=GRID, world=rows)
    assert caught.value.field == f"{mission}: agents[1].start"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", "", "no row, expected at least one box: six numbers"),
        ("\n \n", "", "no row"),
        ("x,y,z,sx,sy,sz\n0,0,1,1,1,1", ": line 1", "six numbers and no header"),
        ("0,0,1,1,1,1\n\n0,0,1,1,1", ": line 3", "six numbers"),
        ("0,0,1,1,1,1,1", ": line 1", "six numbers"),
        ("0,0,1,1,1,1,", ": line 1", "six numbers"),
        ("0;0;1;1;1;1", ": line 1", "six numbers"),
        ("0,0,nan,1,1,1", ": line 1", "all finite"),
        ("0,0,1,1,1,inf", ": line 1", "all finite"),
        ("0,0,1e13,1,1,1", ": line 1", "of at most 1e+12"),
        ("0,0,1,1,1,1\n0,0,1,1,0,1", ": line 2", "three sides above 0"),
        ("0,0,1,1,-1,1", ": line 1", "three sides above 0"),
        ("0,0,1,1,1,1e-9", ": line 1", "a flat shape has no interior"),
    ],
)
def test_a_malformed_world_is_refused_by_line(
    text: str, line: str, words: str, tmp_path: Path
) -> None:
    rows = world(tmp_path, text)
    with pytest.raises(rho.ScenarioError) as caught:
        rho.load_lsc_mission(written(tmp_path, MISSION), grid=GRID, world=rows)
    assert caught.value.field == f"{rows}{line}"
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_world_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    latin = world(tmp_path, b"0,0,1,1,1,1 \xe9")
    for path in (tmp_path / "nowhere.csv", tmp_path, latin):
        with pytest.raises(rho.ScenarioError, match="a readable CSV file") as caught:
            rho.load_lsc_mission(written(tmp_path, MISSION), grid=GRID, world=path)
        assert caught.value.field == str(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "latin.json").write_bytes(b'{"name": "\xe9"}')
    for path in (tmp_path / "nowhere.json", tmp_path, tmp_path / "latin.json"):
        with pytest.raises(rho.ScenarioError, match="a readable JSON file") as caught:
            rho.load_lsc_mission(path, grid=GRID)
        assert caught.value.field == str(path)


def test_a_mission_is_recognised_by_its_content(tmp_path: Path, paper: rho.Scenario) -> None:
    path = written(tmp_path, MISSION)
    assert is_lsc_mission(path)
    # recognised as a mission, and later refused by name
    assert is_lsc_mission(written(tmp_path, json.dumps(MISSION)[:-1]))
    other = tmp_path / "mission.txt"
    other.write_text(path.read_text())
    assert is_lsc_mission(other)
    rho.save_scenario(paper, tmp_path / "paper.json")
    assert not is_lsc_mission(tmp_path / "paper.json")
    assert not is_lsc_mission(tmp_path / "nowhere.json")
    assert not is_lsc_mission("paper")


def test_a_mission_is_planned_within_its_limits(tmp_path: Path) -> None:
    scenario = rho.load_lsc_mission(written(tmp_path, MISSION), grid=GRID)
    plan = rho.plan_convex(scenario)
    assert np.all(np.abs(plan.accelerations) <= np.array([2.0, 3.0, 1.0]) + 1e-6)
    np.testing.assert_allclose(plan.positions[:, -1], [[2, 0.25, 1], [-1, 1, 2.5]], atol=1e-9)
