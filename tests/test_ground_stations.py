"""Missions of QGroundControl and MAVLink: read, planned, written, and read by others."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from pymavlink import mavwp

import drake_rho as rho
from tests.scenarios import slow
from tests.test_cli import run
from tests.test_cli_missions import MISSION as LSC
from tests.test_cli_missions import ROBOTS

Patch = pytest.MonkeyPatch
HOME = rho.Frame(47.3977, 8.5456, 488.0)
MILLIMETRE = 1e-3


def geodetic(*position: float) -> list[float]:
    """Return latitude, longitude and altitude of a place in metres from home."""
    place = pymap3d.enu2geodetic(*position, HOME.latitude, HOME.longitude, HOME.altitude)
    return [float(each) for each in place]


def item(command: int, *position: float, hold: float = 0.0, frame: int = 3) -> dict[str, Any]:
    """Return an item of a plan file at a place in metres from home."""
    latitude, longitude, altitude = geodetic(*position)
    altitude -= HOME.altitude if frame == 3 else 0.0
    params = [hold, 0, 0, None, latitude, longitude, altitude]
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": params}


def other(command: int, *params: float) -> dict[str, Any]:
    """Return an item without a place."""
    return {"type": "SimpleItem", "command": command, "frame": 2, "params": [*params, 0, 0, 0]}


PLACES = np.array([[0, 0, 15], [40, 0, 15], [40, 30, 20], [0, 0, 20], [0, 0, 0]], dtype=float)
ITEMS = [
    item(22, *PLACES[0]),
    item(16, *PLACES[1], hold=2.0),
    other(178, 1, 3.0, -1, 0),
    item(16, *PLACES[2], frame=0),
    other(20, 0, 0, 0, 0),
]


def plan_file(folder: Path, items: list[dict[str, Any]], **fence: Any) -> Path:
    """Write a plan file with a fence."""
    content = {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2, **fence},
        "groundStation": "QGroundControl",
        "mission": {
            "cruiseSpeed": 15,
            "hoverSpeed": 5,
            "items": items,
            "plannedHomePosition": [HOME.latitude, HOME.longitude, HOME.altitude],
            "vehicleType": 2,
            "version": 2,
        },
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }
    path = folder / "survey.plan"
    path.write_text(json.dumps(content))
    return path


def on_map(*corners: tuple[float, float]) -> list[list[float]]:
    """Return latitudes and longitudes of corners in metres from home."""
    return [geodetic(x, y, 0.0)[:2] for x, y in corners]


def polygon(inclusion: bool, *corners: tuple[float, float]) -> dict[str, Any]:
    """Return a polygon of a fence."""
    return {"inclusion": inclusion, "polygon": on_map(*corners), "version": 1}


def places_of(scenario: rho.Scenario) -> np.ndarray:
    """Return waypoints and goal of the only vehicle [m]."""
    (vehicle,) = scenario.vehicles
    return np.array([*(each.position for each in vehicle.waypoints), vehicle.goal.position])


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> rho.Scenario:
    """Return the mission with a stop, a change of speed and a return."""
    return rho.load_mission(plan_file(tmp_path_factory.mktemp("mission"), ITEMS))


@pytest.fixture(scope="module")
def plan(scenario: rho.Scenario) -> rho.Plan:
    """Return its plan."""
    return rho.plan(scenario)


def test_places_dwells_speeds_and_ends_are_those_of_the_file(scenario: rho.Scenario) -> None:
    (vehicle,) = scenario.vehicles
    np.testing.assert_allclose(places_of(scenario), PLACES, rtol=0, atol=MILLIMETRE)
    np.testing.assert_allclose(vehicle.start.position, 0.0, atol=1e-9)
    assert [each.dwell for each in vehicle.waypoints] == [0.0, 2.0, 0.0, 0.0]
    assert [each.name for each in vehicle.waypoints] == ["item 1", "item 2", "item 4", "item 5"]
    assert scenario.frame == HOME
    assert scenario.limits == rho.Limits(max_speed=5.0, max_acceleration=2.5)
    (cap,) = (each for each in scenario.requirements if each.of == "velocity")
    assert cap.between == ("item 2", "goal")
    assert cap.name == "3 m/s"


def test_the_speed_is_limited_from_its_change_on(plan: rho.Plan) -> None:
    speeds = np.linalg.norm(plan.velocities[0], axis=-1)
    changed = plan.scenario.vehicles[0].waypoints[1].time
    assert changed is not None
    assert rho.verify(plan).ok
    assert speeds[plan.times >= changed].max() <= 3.0 + 1e-6
    assert speeds[plan.times < changed].max() > 3.0


def own_places(path: Path) -> np.ndarray:
    """Return latitude, longitude and altitude of the items with a place of a plan file."""
    mission = json.loads(path.read_text())["mission"]
    level = mission["plannedHomePosition"][2]
    placed = [each["params"][4:] for each in mission["items"] if each["command"] != 178]
    return np.array([[*place, level + height] for *place, height in placed])


def places_by_pymavlink(path: Path) -> np.ndarray:
    """Return the same of a mission file, read by pymavlink."""
    loader = mavwp.MAVWPLoader()
    loader.load(str(path))
    home, *items = [loader.wp(k) for k in range(loader.count())]
    items = [each for each in items if each.command != 178]
    return np.array([[each.x, each.y, home.z + each.z] for each in items])


@pytest.mark.parametrize(
    ("name", "parse"), [("m.plan", own_places), ("m.waypoints", places_by_pymavlink)]
)
def test_a_plan_is_written_for_others_and_read_again(
    name: str, parse: Callable[[Path], np.ndarray], plan: rho.Plan, tmp_path: Path
) -> None:
    written = rho.export(plan, tmp_path / name)
    local = pymap3d.geodetic2enu(
        *parse(tmp_path / name).T, HOME.latitude, HOME.longitude, HOME.altitude
    )
    for found in (np.stack(local, axis=-1), places_of(rho.load_mission(tmp_path / name))):
        apart = np.linalg.norm(found[:, None] - PLACES, axis=-1).min(axis=0)
        assert apart.max() < MILLIMETRE
    again = rho.load_mission(tmp_path / name)
    assert max(each.dwell for each in again.vehicles[0].waypoints) == 2.0
    assert 0.1 < written.deviation <= 1.0  # it does not start straight up
    x = plan.at(np.linspace(plan.times[0], plan.times[-1], 5000)).positions[0]
    ends = np.concatenate([[plan.positions[0, 0]], np.stack(local, axis=-1)])
    assert distances(x, ends).max() <= written.deviation
    assert "no times" in str(written)


def distances(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the distances of points from a polyline [m]."""
    a, leg = ends[:-1], np.diff(ends, axis=0)
    squares = np.maximum(np.sum(leg**2, axis=1), 1e-12)
    part = np.clip(np.sum((x[:, None] - a) * leg, axis=-1) / squares, 0.0, 1.0)
    return np.asarray(np.linalg.norm(x[:, None] - a - part[..., None] * leg, axis=-1).min(axis=1))


def test_several_vehicles_are_a_folder_and_lose_their_separation(tmp_path: Path) -> None:
    vehicles = [
        rho.Vehicle(f"v{y}", rho.State([0, y, 1]), rho.State([20, y, 1])) for y in (0.0, 5.0)
    ]
    pair = rho.Scenario(
        "pair",
        rho.Grid.lasting(10.0, step=0.5),
        vehicles,
        separation=rho.Separation(1.0),
        frame=HOME,
    )
    plan = rho.plan(pair)
    with pytest.raises(ValueError, match=r"m\.plan' for 2 vehicles, expected a folder"):
        rho.export(plan, tmp_path / "m.plan")
    written = rho.export(plan, tmp_path / "all", format="mavlink")
    assert [each.name for each in written.files] == ["v0.0.waypoints", "v5.0.waypoints"]
    assert "separation is lost" in str(written)
    assert written.spare is not None
    assert not written.spare.keeps_clear
    loaded = rho.load_mission(written.files, limits=rho.Limits(max_acceleration=2.0))
    assert loaded.names == ("v0.0", "v5.0")
    np.testing.assert_allclose(loaded.vehicles[1].start.position, [0, 5, 0], atol=MILLIMETRE)


def test_flights_of_many_short_legs_last_little_longer_than_they_need(tmp_path: Path) -> None:
    lanes = [(200.0 * ((k + 1) // 2 % 2), 20.0 * (k // 2), 30.0) for k in range(100)]
    scenario = rho.load_mission(plan_file(tmp_path, [item(16, *each) for each in lanes]))
    lengths = np.linalg.norm(np.diff([(0.0, 0.0, 0.0), *lanes], axis=0), axis=1)
    needed = sum(length / 5.0 + 2.0 for length in lengths)  # from rest to rest, beyond 10 m
    assert needed <= scenario.grid.duration <= 1.35 * needed
    assert scenario.grid.knots < 2500


def test_long_names_of_files_are_cut(tmp_path: Path) -> None:
    one = plan_file(tmp_path, ITEMS)
    files = [tmp_path / f"{'n' * 120}{k}.plan" for k in range(2)]
    for each in files:
        each.write_bytes(one.read_bytes())
    loaded = rho.load_mission(files)
    assert loaded.names == ("n" * 72, f"{'n' * 72}-2")


def test_a_mission_needs_a_place_on_the_earth(tmp_path: Path) -> None:
    plan = rho.plan(rho.load_scenario("courier"))
    with pytest.raises(ValueError, match=r"frame: got none, expected Scenario\(frame="):
        rho.export(plan, tmp_path / "m.plan")


def test_fences_keep_in_and_out(tmp_path: Path) -> None:
    concave = [(-20.0, -20.0), (60.0, -20.0), (60.0, 60.0), (20.0, 8.0), (-20.0, 60.0)]
    circle = {"circle": {"center": on_map((20.0, 0.0))[0], "radius": 4.0}, "inclusion": False}
    path = plan_file(tmp_path, ITEMS, polygons=[polygon(True, *concave)], circles=[circle])
    scenario = rho.load_mission(path)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    x = plan.at(np.linspace(plan.times[0], plan.times[-1], 3000)).positions[0]
    assert np.hypot(x[:, 0] - 20.0, x[:, 1]).min() > 4.0 - 1e-3
    edge = np.interp(x[:, 0], [-20.0, 20.0, 60.0], [60.0, 8.0, 60.0])
    assert (x[:, 1] < edge + 0.02).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_concave_no_fly_zone_has_no_gap(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * (np.arange(9) + rng.uniform(0.0, 0.8, 9)) / 9.0
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=1) * rng.uniform(20.0, 200.0, (9, 1))
    zone = polygon(False, *((float(x) + 500.0, float(y)) for x, y in corners))
    path = plan_file(tmp_path, [item(22, 0, 0, 10), item(16, 0, 50, 10)], polygons=[zone])
    k, part = rng.integers(0, 9, 2000), rng.uniform(0.0, 1.0, (2, 2000, 1))
    on_sides = corners[k] + part[0] * (np.roll(corners, -1, axis=0) - corners)[k]
    inside = part[1] * on_sides + [500.0, 0.0]  # of a polygon like a star
    x = np.column_stack([inside, np.full(2000, 10.0)])
    bodies = rho.load_mission(path).bodies
    depths = np.min([each.shape.signed_distance(x) for each in bodies], axis=0)
    assert depths.max() < 1e-3  # the Earth's bend
    assert len(bodies) > 1


@pytest.mark.parametrize(
    ("items", "words"),
    [
        ([item(16, 5, 5, 5), {**item(16, 1, 1, 1), "frame": 10}], "item 2 .NAV_WAYPOINT., frame"),
        ([item(16, 2e5, 0, 5)], "within 100 km of home"),
        ([other(201, 0, 0, 0, 0)], r"no place to fly to \(left out: item 1 \(DO_SET_ROI\)\)"),
        ([{**item(16, 1, 1, 1), "params": ["x"]}], r"mission\.items\[0\]\.params\[0\]"),
        (
            [{"type": "ComplexItem", "complexItemType": "StructureScan"}],
            r"item 1 \(StructureScan\)",
        ),
        ([], "items: got no place to fly to, expected a waypoint"),
    ],
)
def test_what_cannot_be_flown_is_refused_by_its_item(
    items: list[dict[str, Any]], words: str, tmp_path: Path
) -> None:
    with pytest.raises(rho.ScenarioError, match=rf"survey\.plan: .*{words}"):
        rho.load_mission(plan_file(tmp_path, items))


def test_skipped_items_are_named(tmp_path: Path) -> None:
    items = [*ITEMS[:2], other(201, 0, 0, 0, 0), other(177, 1, 5, 0, 0), ITEMS[-1]]
    words = r"not in the scenario: item 3 \(DO_SET_ROI\), item 4 \(DO_JUMP\)"
    with pytest.warns(rho.MissionWarning, match=words):
        rho.load_mission(plan_file(tmp_path, items))


def test_far_from_home_a_level_is_no_altitude(tmp_path: Path) -> None:
    far = 3000.0
    with pytest.warns(rho.MissionWarning, match=r"3000 m from the origin.*0\.71 m above"):
        rho.load_mission(plan_file(tmp_path, [item(16, far, 0, 50)]))


LINES = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.3977\t8.5456\t488\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t20\t1
2\t0\t3\t16\t3\t0\t0\t0\t47.3980\t8.5456\t20\t1
3\t0\t3\t21\t0\t0\t0\t0\t0\t0\t0\t1
"""


def test_missing_places_are_the_present_one(tmp_path: Path) -> None:
    (tmp_path / "m.txt").write_text(LINES)
    scenario = rho.load_mission(tmp_path / "m.txt")
    north = HOME.local(47.3980, 8.5456, 488.0)[1]
    expected = [[0, 0, 20], [0, north, 20], [0, north, 0]]
    np.testing.assert_allclose(places_of(scenario), expected, atol=2e-3)  # of the Earth's bend
    elsewhere = rho.load_mission(tmp_path / "m.txt", home=rho.Frame(47.3977, 8.5456, 100.0))
    assert elsewhere.frame is not None
    assert elsewhere.frame.altitude == 100.0


def test_fences_are_items_of_mission_files(tmp_path: Path) -> None:
    corners = on_map((-50, -50), (80, -50), (80, 80), (-50, 80))
    rows = [f"{k}\t0\t3\t5001\t4\t0\t0\t0\t{x}\t{y}\t0\t1\n" for k, (x, y) in enumerate(corners, 4)]
    latitude, longitude = on_map((20, 20))[0]
    circle = f"8\t0\t3\t5004\t3\t0\t0\t0\t{latitude}\t{longitude}\t0\t1\n"
    (tmp_path / "m.waypoints").write_text(LINES + "".join(rows) + circle)
    scenario = rho.load_mission(tmp_path / "m.waypoints")
    (zone,) = scenario.bodies
    assert isinstance(zone.shape, rho.Cylinder)
    assert zone.shape.radius == 3.0
    np.testing.assert_allclose(zone.shape.center[:2], 20.0, atol=MILLIMETRE)
    assert [each.name for each in scenario.requirements] == ["inclusion polygon 1", "floor"]


def test_a_landing_pattern_is_an_approach_and_a_landing(tmp_path: Path) -> None:
    pattern = {
        "type": "ComplexItem",
        "complexItemType": "fwLandingPattern",
        "altitudesAreRelative": True,
        "landingApproachCoordinate": [*geodetic(60, 0, 0)[:2], 30],
        "landCoordinate": [*geodetic(100, 0, 0)[:2], 0],
    }
    scenario = rho.load_mission(plan_file(tmp_path, [item(22, *PLACES[0]), pattern]))
    expected = [[0, 0, 15], [60, 0, 30], [100, 0, 30], [100, 0, 0]]
    np.testing.assert_allclose(places_of(scenario), expected, atol=2e-3)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("\t3\t22", "\t10\t22", r"item 1 .NAV_TAKEOFF., frame: got 10"),
        ("47.3980", "north", r"line 4, column 9 \(latitude\): got 'north'"),
        ("\t1\n2", "\n2", "line 3: got 11 columns"),
        ("110", "100", "line 1: got version 100"),
    ],
)
def test_a_malformed_line_is_named(old: str, new: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "m.waypoints").write_text(LINES.replace(old, new, 1))
    with pytest.raises(rho.ScenarioError, match=rf"m\.waypoints: {words}"):
        rho.load_mission(tmp_path / "m.waypoints")


def mutated(text: str, rng: np.random.Generator) -> bytes:
    """Return text with some bytes changed, left out or doubled, or cut off."""
    content = bytearray(text.encode())
    for _ in range(rng.integers(1, 6)):
        at, kind = int(rng.integers(0, len(content))), rng.integers(0, 4)
        if kind == 0:
            content[at] = rng.integers(32, 127)
        elif kind == 1:
            del content[at : at + int(rng.integers(1, 20))]
        elif kind == 2:
            content[at:at] = content[at : at + int(rng.integers(1, 60))]
        else:
            content[at:at] = rng.choice([b"-", b"9", b"e99", b"null", b"NaN", b"[", b'"'])
        if not content:
            break
    return bytes(content)


@pytest.mark.parametrize("kind", ["plan", "waypoints", "csv", "json", "yaml"])
@pytest.mark.parametrize("count", [100, *slow(2000)])
def test_mutated_files_are_read_or_refused_by_name(kind: str, count: int, tmp_path: Path) -> None:
    assert mutations(kind, count, tmp_path) == count


def mutations(kind: str, count: int, folder: Path) -> int:
    """Return how many mutated files of a kind are read, or refused with their name."""
    rng, path = np.random.default_rng(count), folder / f"m.{kind}"
    zone = polygon(False, (100, 100), (120, 100), (105, 105), (100, 120))
    texts = {
        "plan": plan_file(folder, ITEMS, polygons=[zone]).read_text(),
        "waypoints": LINES,
        "csv": "time [s],x [m],y [m],z [m]\n1,0,0,1\n2.5,4,0,1\n",
        "json": LSC,
        "yaml": ROBOTS,
    }
    readers: dict[str, Callable[[Path], object]] = {
        "csv": rho.load_waypoints,
        "json": lambda path: rho.load_lsc_mission(path, grid=rho.Grid(0.2, 51)),
        "yaml": rho.load_crazyflies,
    }
    right, read = 0, readers.get(kind, rho.load_mission)
    for _ in range(count):
        path.write_bytes(mutated(texts[kind], rng))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rho.MissionWarning)
            try:
                read(path)
                right += 1
            except rho.ScenarioError as error:
                right += str(error).startswith(str(path)) and len(str(error)) < 1500
    return right


def test_nested_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.plan").write_text('{"fileType": "Plan", "mission": ' + "[" * 100_000)
    with pytest.raises(rho.ScenarioError, match=r"m\.plan: got malformed JSON"):
        rho.load_mission(tmp_path / "m.plan")
    deep = '{"fileType": "Plan", "mission": ' + "[" * 900 + "]" * 900 + "}"
    (tmp_path / "m.plan").write_text(deep)
    with pytest.raises(rho.ScenarioError, match=r"m.plan: got malformed JSON, nested too deeply"):
        rho.load_mission(tmp_path / "m.plan")


def test_a_frame_is_saved_and_printed(scenario: rho.Scenario, tmp_path: Path) -> None:
    rho.save_scenario(scenario, tmp_path / "s.yaml")
    assert rho.load_scenario(tmp_path / "s.yaml") == scenario
    assert "latitude 47.3977°, longitude 8.5456°, altitude 488 m" in str(scenario)
    assert "frame" not in str(rho.load_scenario("courier"))


def test_a_plan_keeps_its_frame(plan: rho.Plan, tmp_path: Path) -> None:
    rho.save(plan, tmp_path / "p.npz")
    loaded = rho.load(tmp_path / "p.npz")
    assert isinstance(loaded, rho.Plan)
    assert loaded.scenario.frame == HOME


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymap3d", None)
    with pytest.raises(rho.ScenarioError, match=r"the extra missions: pip install"):
        HOME.local(47.0, 8.0, 0.0)


def test_a_mission_is_planned_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, kept = plan_file(tmp_path, ITEMS), str(tmp_path / "kept.npz")
    status, out, _ = run(capsys, monkeypatch, "plan", str(path), "-o", kept)
    assert status == 0, out
    status, out, _ = run(capsys, monkeypatch, "export", kept, "-o", str(tmp_path / "m.waypoints"))
    assert status == 0, out
    assert "no times" in out


@pytest.mark.parametrize("options", [[], ["--duration", "80", "--step", "0.5"]])
def test_an_imported_mission_is_the_one_that_is_loaded(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Patch
) -> None:
    zone = polygon(False, (100, 100), (120, 100), (105, 105), (100, 120))
    ring = {"circle": {"center": geodetic(0, 0, 0)[:2], "radius": 300}, "inclusion": True}
    files = [plan_file(tmp_path, [*ITEMS, other(203, 1)], polygons=[zone], circles=[ring])]
    files.append(tmp_path / "m.waypoints")
    files[1].write_text(LINES)
    kept = str(tmp_path / "scenario.yaml")
    words = ["import", *map(str, files), *options, "--max-speed", "2", "-o", kept]
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, err) == (0, "")
    assert "DO_DIGICAM_CONTROL" in out
    assert "vehicles do not avoid each other" in out
    limits = rho.Limits(max_speed=2.0, max_acceleration=2.5)
    grid = rho.Grid(0.5, 161) if options else None
    with pytest.warns(rho.MissionWarning):
        loaded = rho.load_mission(files, limits=limits, grid=grid)
    assert loaded.frame is not None
    assert len(loaded.obstacles) == 2
    assert rho.load_scenario(kept) == loaded
    status, _, err = run(capsys, monkeypatch, "import", str(files[0]), "--step", "1", "-o", kept)
    assert (status, err.count("\n")) == (2, 1)
    assert "got no --duration, expected --duration and --step" in err


@pytest.mark.parametrize(
    "text",
    [
        "0,0,1\n4,0,1\n4,3,2\n",
        "x,y,z\n0,0,1\n4,0,1\n4,3,2\n",
        "# survey\nz [m]; x [m]; y [m]\n1;0;0\n\n1;4;0\n2;4;3\n",
    ],
)
def test_tables_without_times_are_places(text: str, tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text(text)
    waypoints = rho.load_waypoints(tmp_path / "w.csv")
    assert waypoints == tuple(rho.Waypoint(None, p) for p in ([0, 0, 1], [4, 0, 1], [4, 3, 2]))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0,0,1\n4,zero,1\n", "line 2, column 2: got 'zero'"),
        ("t,x,y,z\n1,0,0,1\n2,0,0\n", "line 3: got 3 columns, expected 4"),
        ("x,y,up\n0,0,1\n", "line 1, column 3: got 'up'"),
        ("x [km],y,z\n0,0,1\n", r"line 1, column 1: got 'x \[km\]', expected x \[m\]"),
        ("1,2\n", "line 1: got 2 columns"),
        ("0,0,1e13\n", "line 1, column 3: got '1e13'"),
        ("", "got no row"),
        ("t,x,y,z\n", "got no rows, expected at least one waypoint below the header"),
    ],
)
def test_a_table_is_refused_by_row_and_column(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text(text)
    with pytest.raises(rho.ScenarioError, match=rf"w\.csv: {words}"):
        rho.load_waypoints(tmp_path / "w.csv")


def test_a_written_table_is_near_the_plan_at_all_times(tmp_path: Path) -> None:
    plan = rho.plan(rho.load_scenario("courier"))
    written = rho.export(plan, tmp_path / "w.csv", format="waypoints")
    rows = rho.load_waypoints(tmp_path / "w.csv")
    times, places = (
        np.array([row.time for row in rows], float),
        np.array([row.position for row in rows]),
    )
    t = np.linspace(plan.times[0], plan.times[-1], 2000)
    on_lines = np.stack([np.interp(t, times, axis) for axis in places.T], axis=-1)
    apart = np.linalg.norm(plan.at(t).positions[0] - on_lines, axis=-1)
    assert apart.max() <= written.deviation <= 0.1


def test_an_item_without_its_place_is_refused(tmp_path: Path) -> None:
    items = [dict(each) for each in ITEMS]
    del items[1]["params"]
    with pytest.raises(rho.ScenarioError, match=r"plan: item 2, params: got 0 parameters"):
        rho.load_mission(plan_file(tmp_path, items))


@pytest.mark.parametrize("inclusion", [True, False])
@pytest.mark.parametrize("dent", [-0.3, -1e-3, 0.0, 1e-3, 0.3])
def test_sides_of_fences_may_have_slight_dents(
    inclusion: bool, dent: float, tmp_path: Path
) -> None:
    """Ground stations add corners in the middle of sides; curvature alone moves them."""
    by = 0.0 if inclusion else 300.0
    corners = (-50, -40), (60, -40), (60, 50), (5, 50 + dent), (-50, 50), (-20, 5 - 10 * dent)
    fence = polygon(inclusion, *((x + by, y) for x, y in corners))
    found = rho.load_mission(plan_file(tmp_path, ITEMS, polygons=[fence]))
    middle = np.array([[5 + by, 51, 10], [5 + by, 49, 10]], dtype=float)
    zones = [each.shape for each in found.bodies]
    inside = [bool(any(each.signed_distance(x) <= 0.0 for each in zones)) for x in middle]
    required = [each.set for each in found.requirements if each.of == "position"]
    outside = [each.signed_distance(middle) > 0.0 for each in required]
    forbidden = np.any(outside, axis=0) | np.array(inside)
    assert forbidden.tolist() == [inclusion, not inclusion]


def test_scouts_that_join_a_mission_with_zones_find_their_ways(tmp_path: Path) -> None:
    """Zones have no end in height, but paths are searched only where vehicles fly."""
    corners = (-30, -30), (70, -30), (70, 60), (30, 58), (25, 40), (20, 60), (-30, 60)
    fences = {"polygons": [polygon(True, *corners)]}
    circle = {"circle": {"center": geodetic(20, 0, 0)[:2], "radius": 6}, "inclusion": False}
    mission = rho.load_mission(plan_file(tmp_path, ITEMS, circles=[circle], **fences))
    scouts = [
        rho.Vehicle(f"scout {k}", rho.State([-20, 5 * k, 0]), rho.State([-20, 5 * k + 10, 5]))
        for k in (1, 2)
    ]
    vehicles = (*mission.vehicles, *scouts)
    fleet = dataclasses.replace(mission, vehicles=vehicles, separation=rho.Separation(2.0))
    assert rho.verify(rho.plan(fleet)).ok


def homed(path: Path, *home: float | None) -> Path:
    """Write another home into a plan file."""
    content = json.loads(path.read_text())
    content["mission"]["plannedHomePosition"] = home
    path.write_text(json.dumps(content))
    return path


def test_a_home_without_an_altitude_is_told_or_refused(tmp_path: Path) -> None:
    relative, above_sea = item(22, 0, 0, 15), item(16, 40, 0, 15, frame=0)
    here = HOME.latitude, HOME.longitude
    with pytest.warns(rho.MissionWarning, match=r"HomePosition\[2\] is missing.* altitude 0"):
        rho.load_mission(homed(plan_file(tmp_path, [relative]), *here, None))
    path = homed(plan_file(tmp_path, [relative, above_sea]), *here, None)
    words = r"survey\.plan: mission\.plannedHomePosition\[2\]: got nothing, .*item 2 \(NAV_WAYPOINT"
    with pytest.raises(rho.ScenarioError, match=words):
        rho.load_mission(path)
    found = places_of(rho.load_mission(path, home=HOME))
    np.testing.assert_allclose(found, [[0, 0, 15], [40, 0, 15]], atol=MILLIMETRE)


def test_a_home_that_is_not_set_is_that_of_the_first_item(tmp_path: Path) -> None:
    path = homed(plan_file(tmp_path, ITEMS[:2]), 0, 0, 0)
    with pytest.warns(rho.MissionWarning, match=r"no home, so that of item 1 \(NAV_TAKEOFF\)"):
        scenario = rho.load_mission(path)
    np.testing.assert_allclose(places_of(scenario), PLACES[:2], atol=5e-3)  # at altitude 0


def test_places_below_home_are_told_and_takeoffs_refused(tmp_path: Path) -> None:
    items = [ITEMS[0], item(16, 40, 0, -20), item(21, 40, 30, -0.8)]
    words = r"below home.*: item 2 \(NAV_WAYPOINT\) by 20 m$"
    with pytest.warns(rho.MissionWarning, match=words) as told:
        rho.load_mission(plan_file(tmp_path, items))
    assert len(told) == 1
    assert told[0].filename == __file__
    for frame, deep in ((0, "473"), (3, "20")):
        low = item(22, 0, 0, -float(deep), frame=frame)
        with pytest.raises(rho.ScenarioError, match=rf"item 1 \(NAV_TAKEOFF\).* {deep} m below"):
            rho.load_mission(plan_file(tmp_path, [low, *items[1:]]))


def test_a_takeoff_without_a_climb_is_told(tmp_path: Path) -> None:
    up = item(22, 0, 0, 15)
    up["params"][6] = None
    with pytest.warns(rho.MissionWarning, match=r"the climb of item 1 \(NAV_TAKEOFF\)"):
        rho.load_mission(plan_file(tmp_path, [up, *ITEMS[1:]]))


def scouts(**changes: Any) -> rho.Scenario:
    """Return two vehicles on the ground: one flies aside at once, one there and back to ground."""
    vehicles = [
        rho.Vehicle("one", rho.State([0, 0, 3]), rho.State([0, 60, 23])),
        rho.Vehicle(
            "other",
            rho.State([50, 0, 0]),
            rho.State([50, 60, 0]),
            waypoints=[rho.Waypoint(15.0, [50, 30, 20])],
        ),
    ]
    grid = rho.Grid.lasting(30.0, step=0.5)
    return rho.Scenario("scouts", grid, vehicles, frame=HOME, **changes)


def test_takeoffs_and_landings_are_vertical_and_told_as_flown(tmp_path: Path) -> None:
    """Copters climb where they stand, whatever place a take-off has."""
    plan = rho.plan(scouts())
    written = rho.export(plan, tmp_path / "all", format="qgroundcontrol")
    t = np.linspace(plan.times[0], plan.times[-1], 2000)
    for k, (file, commands) in enumerate(zip(written.files, ([22, 16], [22, 21]), strict=True)):
        items = json.loads(file.read_text())["mission"]["items"]
        assert [items[0]["command"], items[-1]["command"]] == commands
        assert [each["command"] for each in items[1:3]] == [178, items[2]["command"]]
        assert {each["command"] for each in items[2:-1]} <= {16}
        assert 0.0 < items[0]["params"][6] <= 2.5
        home = json.loads(file.read_text())["mission"]["plannedHomePosition"]
        places = np.vstack([home, own_places(file)])
        assert np.ptp(places[:2, :2], axis=0).max() == 0.0
        assert home[2] == round(home[2], 6)
        local = HOME.local(*places.T)
        np.testing.assert_allclose(local[[0, -1]], plan.positions[k, [0, -1]], atol=2e-3)
        x = plan.at(t).positions[k]
        part = np.linspace(0.0, 1.0, 50)[:, None, None]
        on_legs = (local[:-1] + part * np.diff(local, axis=0)).reshape(-1, 3)
        apart = max(distances(x, local).max(), distances(on_legs, x).max())
        assert 0.5 < apart <= written.deviations[k]
        again = places_of(rho.load_mission(file))
        np.testing.assert_allclose(again, local[1:] - local[0], atol=2e-3)


def test_flights_from_the_air_need_no_takeoff(tmp_path: Path) -> None:
    states = rho.State([0, 0, 5], [2, 0, 0]), rho.State([30, 0, 9])
    grid = rho.Grid.lasting(10.0, step=0.5)
    for start in states[0], rho.State([0, 0, 9]):
        vehicle = rho.Vehicle("v", start, states[1])
        written = rho.export(
            rho.plan(rho.Scenario("air", grid, [vehicle], frame=HOME)), tmp_path / "v.plan"
        )
        items = json.loads((tmp_path / "v.plan").read_text())["mission"]["items"]
        assert [each["command"] for each in items[:2]] == [178, 16]
        assert {each["command"] for each in items[1:]} == {16}
        assert written.deviation <= 0.1 + 1e-3


def test_fences_come_back_as_they_were(tmp_path: Path) -> None:
    dent = [(-50.0, -50.0), (150.0, -50.0), (150.0, 150.0), (50.0, 140.0), (-50.0, 150.0)]
    zone = [(60.0, 60.0), (90.0, 60.0), (90.0, 90.0)]
    circles = [
        {"circle": {"center": geodetic(*place, 0.0)[:2], "radius": size}, "inclusion": inside}
        for place, size, inside in (((40.0, 40.0), 250.0, True), ((110.0, 20.0), 12.0, False))
    ]
    fence = {"polygons": [polygon(True, *dent), polygon(False, *zone)], "circles": circles}
    given = rho.load_mission(
        plan_file(tmp_path, [item(22, 0, 0, 20), item(16, 40, 40, 20)], **fence)
    )
    ball = rho.Obstacle(rho.Sphere([20.0, -20.0, 20.0], 3.0))  # no fence
    scenario = dataclasses.replace(given, obstacles=(*given.obstacles, ball))
    written = rho.export(rho.plan(scenario), tmp_path / "again.plan")
    assert "no fences but 5 without an end in height" in str(written)
    again = rho.load_mission(tmp_path / "again.plan")
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.uniform(-100, 200, (4000, 2)), np.full(4000, 20.0)])

    def allowed(scenario: rho.Scenario) -> np.ndarray:
        sets = [each.set for each in scenario.requirements if "circle" in str(each.name)]
        sets += [each.set for each in scenario.requirements if "polygon" in str(each.name)]
        inside = np.all([np.asarray(each.signed_distance(x)) <= 0.0 for each in sets], axis=0)
        shapes = [each.shape for each in scenario.bodies if each is not ball]
        outside = np.all([np.asarray(each.signed_distance(x)) > 0.0 for each in shapes], axis=0)
        return np.asarray(inside & outside)

    assert len(again.requirements) == len(given.requirements)
    differ = allowed(given) != allowed(again)
    assert differ.mean() < 0.001  # at most where rounding decides
    assert 0.2 < allowed(given).mean() < 0.8


def test_a_return_comes_back_as_a_landing_and_speeds_are_missed(
    plan: rho.Plan, tmp_path: Path
) -> None:
    written = rho.export(plan, tmp_path / "m.plan")
    items = json.loads((tmp_path / "m.plan").read_text())["mission"]["items"]
    assert [items[0]["command"], items[-1]["command"]] == [22, 21]
    assert {each["params"][1] for each in items if each["command"] == 16} == {0.5}
    assert "no times, no fences" in str(written)
    assert "no speeds of single legs" in str(written)
    ((again,),) = [rho.load_mission(tmp_path / "m.plan").vehicles]
    np.testing.assert_allclose(again.goal.position, PLACES[-1], atol=MILLIMETRE)
    assert again.waypoints[-1].velocity is not None


def test_the_distance_that_may_be_violated_is_named(tmp_path: Path) -> None:
    wall = rho.KeepIn(rho.HalfSpace([-1, 0, 0], 0.0), name="fence")
    plan = rho.plan(scouts(requirements=[wall], separation=rho.Separation(9.0)))
    written = rho.export(plan, tmp_path / "all", format="mavlink")
    fence = "requirement 1 (fence)"
    words = f"({fence}): separation may now be violated by up to 9 m, {fence} by up to "
    assert str(written).endswith(f"{words}{written.deviation:.3g} m")
    assert written.spare is not None
    assert (written.spare.closest, written.spare.lost) == (fence, "separation")
    assert not written.spare.keeps_clear
    most = {"separation": 9.0, fence: written.deviation}
    assert written.spare.violated == pytest.approx(most, abs=1e-6)


@pytest.mark.parametrize(
    ("content", "found"),
    [("", "empty"), ("hello", "not JSON"), ("[1, 2]", "a JSON list"), ("5", "a JSON value")],
)
def test_other_files_are_described(content: str, found: str, tmp_path: Path) -> None:
    (tmp_path / "m.plan").write_text(content)
    with pytest.raises(
        rho.ScenarioError, match=rf"m\.plan: got another file \({found}\), expected a"
    ):
        rho.load_mission(tmp_path / "m.plan")


def test_errors_of_places_have_few_digits(tmp_path: Path) -> None:
    fence = polygon(True, (-20, -20), (30, -20), (30, 30), (-20, 30))
    with pytest.raises(rho.ScenarioError, match=r"item 2: got \[40\.0, ") as caught:
        rho.load_mission(plan_file(tmp_path, ITEMS, polygons=[fence]))
    assert re.search(r"\d\.\d{5}", str(caught.value)) is None


def read(path: Path) -> tuple[rho.Scenario, list[str]]:
    """Return a mission, and what is told of it."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        scenario = rho.load_mission(path)
    return scenario, [str(each.message) for each in found]


def told(path: Path) -> list[str]:
    """Return what is told of a mission."""
    return read(path)[1]


LANDING = item(21, 60, 0, 0)


@pytest.mark.parametrize("after", [item(22, 60, 0, 15), item(16, 40, 0, 15), other(20, 0, 0, 0, 0)])
def test_nothing_is_flown_after_a_landing(after: dict[str, Any], tmp_path: Path) -> None:
    path = plan_file(tmp_path, [ITEMS[0], LANDING, other(93, 5, 0, 0, 0), after])
    words = r"item 2 \(NAV_LAND\): got a landing, .* item 4 .*: split the mission there$"
    with pytest.raises(rho.ScenarioError, match=words):
        rho.load_mission(path)
    rho.load_mission(plan_file(tmp_path, [ITEMS[0], LANDING, other(93, 5, 0, 0, 0)]))


def test_items_after_a_return_are_left_out(tmp_path: Path) -> None:
    path = plan_file(tmp_path, [*ITEMS, item(16, 40, 30, 20), item(21, 40, 30, 0)])
    with pytest.warns(rho.MissionWarning, match=r"item 6 \(NAV_WAYPOINT\) after item 5 \(NAV_RET"):
        found = rho.load_mission(path)
    np.testing.assert_allclose(places_of(found), PLACES, atol=MILLIMETRE)


PATTERN = {
    "type": "ComplexItem",
    "complexItemType": "fwLandingPattern",
    "landingApproachCoordinate": [*geodetic(60, 0, 0)[:2], 30],
    "landCoordinate": [*geodetic(100, 0, 0)[:2], 0],
}


@pytest.mark.parametrize("key", ["command", "frame"])
def test_keys_of_items_have_no_defaults(key: str, tmp_path: Path) -> None:
    items = [dict(each) for each in ITEMS]
    del items[1][key]
    with pytest.raises(rho.ScenarioError, match=f"plan: item 2, {key}: got nothing"):
        rho.load_mission(plan_file(tmp_path, items))
    with pytest.raises(rho.ScenarioError, match="plan: item 2, altitudesAreRelative: got nothing"):
        rho.load_mission(plan_file(tmp_path, [ITEMS[0], PATTERN]))
    older = {"loiterAltitudeRelative": True, "landAltitudeRelative": True}
    rho.load_mission(plan_file(tmp_path, [ITEMS[0], {**PATTERN, **older}]))


def test_fences_say_on_which_side_vehicles_stay(tmp_path: Path) -> None:
    circle = {"circle": {"center": on_map((200.0, 0.0))[0], "radius": 4.0}}
    zone = polygon(False, (200, 200), (220, 200), (220, 220))
    del zone["inclusion"]
    for name, fence in (("circles", circle), ("polygons", zone)):
        words = rf"geoFence\.{name}\[0\]\.inclusion: got nothing"
        with pytest.raises(rho.ScenarioError, match=words):
            rho.load_mission(plan_file(tmp_path, ITEMS, **{name: [fence]}))


def changed(index: int, parameter: int, value: float | None) -> list[dict[str, Any]]:
    """Return the mission's items with another value of a parameter."""
    items = [{**each, "params": [*each["params"]]} for each in ITEMS]
    items[index]["params"][parameter] = value
    return items


@pytest.mark.parametrize(
    ("items", "words"),
    [
        (changed(1, 4, None), r"item 2 \(NAV_WAYPOINT\), latitude: got nothing, expected both"),
        (changed(1, 5, None), r"item 2 \(NAV_WAYPOINT\), longitude: got nothing, expected both"),
        (
            changed(1, 0, -3),
            r"item 2 \(NAV_WAYPOINT\), hold time: got -3\.0, expected at least 0 s",
        ),
        (
            changed(2, 1, 1e-6),
            r"item 3 \(DO_CHANGE_SPEED\): got 1e-06, expected a speed from 0\.01",
        ),
        (changed(2, 1, 1e6), r"item 3 \(DO_CHANGE_SPEED\): got 1000000\.0, expected a speed"),
        ([{**ITEMS[0], "frame": 99}], "frame: got 99, expected 0 or 5 .* or 3 or 6"),
    ],
)
def test_values_that_mean_nothing_are_refused(
    items: list[dict[str, Any]], words: str, tmp_path: Path
) -> None:
    with pytest.raises(rho.ScenarioError, match=rf"survey\.plan: .*{words}"):
        rho.load_mission(plan_file(tmp_path, items))


@pytest.mark.parametrize(
    ("items", "words"),
    [
        (changed(1, 6, None), r"present one is kept: item 2 \(NAV_WAYPOINT\), altitude"),
        (changed(2, 1, 0.0), r"the speed of item 3 \(DO_CHANGE_SPEED\), 0 m/s"),
        (changed(2, 1, -3.0), r"the speed of item 3 \(DO_CHANGE_SPEED\), -3 m/s"),
        (changed(1, 6, 20000), r"above home, .* another unit: item 2 \(NAV_WAYPOINT\) at 20000 m"),
        (
            [ITEMS[0], {**ITEMS[1], "params": [0, 0, 0, None, 0, 0, 15]}, *ITEMS[2:]],
            r"present one is kept: item 2 \(NAV_WAYPOINT\), latitude and longitude",
        ),
    ],
)
def test_what_is_guessed_is_told(items: list[dict[str, Any]], words: str, tmp_path: Path) -> None:
    (found,) = told(plan_file(tmp_path, items))
    assert re.search(words, found)


def test_a_speed_goes_back_to_that_of_the_plan(tmp_path: Path) -> None:
    items = [*ITEMS[:3], item(16, 40, 20, 20), other(178, 1, -2, -1, 0), *ITEMS[3:]]
    (cap,) = (
        each for each in rho.load_mission(plan_file(tmp_path, items)).requirements if each.between
    )
    assert (cap.between, cap.name) == (("item 2", "item 4"), "3 m/s")


def test_without_a_home_no_altitude_above_the_sea_is_read(tmp_path: Path) -> None:
    path = homed(plan_file(tmp_path, ITEMS), 0, 0, 0)
    with pytest.raises(
        rho.ScenarioError, match=r"plan: home: got nothing, .*item 4 \(NAV_WAYPOINT"
    ):
        rho.load_mission(path)
    assert rho.load_mission(path, home=HOME).frame == HOME


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        ([(0, 0), (10, 10), (20, 20)], "got corners nearly on a line, expected a polygon"),
        ([(0, 0)] * 4, "got only one corner, expected a polygon of 3 to 200"),
    ],
)
@pytest.mark.parametrize("inclusion", [True, False])
def test_fences_without_an_area_are_refused_by_name(
    corners: list[tuple[float, float]], words: str, inclusion: bool, tmp_path: Path
) -> None:
    name = f"{'inclusion' if inclusion else 'exclusion'} polygon 1"
    path = plan_file(tmp_path, ITEMS, polygons=[polygon(inclusion, *corners)])
    with pytest.raises(rho.ScenarioError, match=f"survey.plan: {name}: {words}"):
        rho.load_mission(path)


def calculated(above_sea: float | None, params: float | None = None) -> dict[str, Any]:
    """Return a waypoint 80 m above the terrain, in the altitude mode that calculates altitudes."""
    found = {**item(16, 40, 0, 0), "frame": 0, "Altitude": 80, "AltitudeMode": 3}
    found["params"][6] = params
    return {**found, "AMSLAltAboveTerrain": above_sea}


def test_calculated_altitudes_are_above_the_sea(tmp_path: Path) -> None:
    for each in (calculated(528.0), calculated(None, 528.0), calculated(700.0, 528.0)):
        path = plan_file(tmp_path, [ITEMS[0], each])
        assert told(path) == []
        np.testing.assert_allclose(places_of(rho.load_mission(path))[-1], [40, 0, 40], atol=1e-3)
    away = {**calculated(None), "command": 195}  # looked at
    assert "item 3 (DO_SET_ROI_LOCATION)" in told(plan_file(tmp_path, [*ITEMS[:2], away]))[0]
    with pytest.raises(
        rho.ScenarioError, match=r"item 2 \(NAV_WAYPOINT\), altitude: got nothing, .* terrain"
    ):
        rho.load_mission(plan_file(tmp_path, [ITEMS[0], calculated(None)]))


def rows(*items: str) -> str:
    """Return the text of a mission file with items, whose columns are separated by spaces."""
    return "\n".join(["QGC WPL 110", *(each.replace(" ", "\t") for each in items), ""])


AT_HOME = "0 0 3 16 0 0 0 0 47 8 400 1"
UP = "1 0 3 22 0 0 0 0 0 0 10 1"
NORTH = "2 0 3 16 0 0 0 0 47.0005 8 20 1"


@pytest.mark.parametrize(
    ("first", "altitude", "words"),
    [
        (AT_HOME, 400.0, ["item 0 (NAV_WAYPOINT) as a place to pass: the first row is home"]),
        (AT_HOME.replace("3 16", "10 0"), 400.0, ["item 0 (command 0) as a place to pass"]),
        (AT_HOME.replace("3 16", "0 16"), 400.0, []),
        (AT_HOME.replace("400", "0"), 0.0, ["altitude above mean sea level is missing"]),
    ],
)
def test_the_first_row_is_home_in_any_frame(
    first: str, altitude: float, words: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "m.waypoints"
    path.write_text(rows(first, UP, NORTH))
    scenario, found = read(path)
    assert len(found) == len(words)
    assert all(each in text for each, text in zip(words, found, strict=True))
    assert scenario.frame == rho.Frame(47.0, 8.0, altitude)
    np.testing.assert_allclose(places_of(scenario)[:, 2], [10, 20], atol=1e-3)


def test_an_unknown_altitude_of_home_is_no_level_for_others(tmp_path: Path) -> None:
    path = tmp_path / "m.waypoints"
    path.write_text(rows(AT_HOME.replace("400", "0"), UP, NORTH.replace("0 3 16", "0 0 16")))
    with pytest.raises(rho.ScenarioError, match=r"item 2 \(NAV_WAYPOINT\) is above mean sea level"):
        rho.load_mission(path)


def test_a_single_place_relative_to_home_is_flown_to(tmp_path: Path) -> None:
    (tmp_path / "m.waypoints").write_text(rows(AT_HOME))
    found, (words,) = read(tmp_path / "m.waypoints")
    assert "no home, so that of item 0" in words
    np.testing.assert_allclose(places_of(found), [[0, 0, 400]], atol=1e-3)


@pytest.mark.parametrize("height", [5.0, 0.0, -20.0])
def test_landings_at_any_height_are_written_as_landings(height: float, tmp_path: Path) -> None:
    path = plan_file(tmp_path, [ITEMS[0], item(16, 40, 0, 15, hold=3), item(21, 60, 0, height)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.MissionWarning)
        plan = rho.plan(rho.load_mission(path))
        assert rho.verify(plan).ok
        rho.export(plan, tmp_path / "m.waypoints")
        again = rho.load_mission(tmp_path / "m.waypoints")
    command, *_, z, _ = (tmp_path / "m.waypoints").read_text().split("\n")[-2].split("\t")[3:]
    assert command == "21"
    assert float(z) == pytest.approx(height, abs=1e-3)
    np.testing.assert_allclose(again.vehicles[0].goal.position, [60, 0, height], atol=2e-3)
    floors = [each.name for each in again.requirements if each.between and each.of == "position"]
    assert floors == (["ground"] if height > 0.1 else [])


def test_plans_that_end_in_the_air_are_no_landings(tmp_path: Path) -> None:
    """Not even after a vertical descent from rest, or for a goal away from a mission's ground."""
    above = rho.Waypoint(8.0, [20, 0, 20], velocity=[0, 0, 0], name="above")
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([20, 0, 5]), waypoints=[above])
    hover = rho.Scenario("hover", rho.Grid.lasting(16.0, step=0.5), [vehicle], frame=HOME)
    path = plan_file(tmp_path, [ITEMS[0], item(21, 60, 0, 5)])
    landing = rho.load_mission(path)
    (lander,) = landing.vehicles
    higher = dataclasses.replace(lander, goal=rho.State(lander.goal.position + np.array([0, 0, 5])))
    for scenario in (hover, dataclasses.replace(landing, vehicles=(higher,))):
        rho.export(rho.plan(scenario), tmp_path / "m.waypoints")
        last = (tmp_path / "m.waypoints").read_text().split("\n")[-2].split("\t")
        assert last[3] == "16"


def test_a_landing_at_sea_level_far_below_home_has_no_ground(tmp_path: Path) -> None:
    low = item(21, 60, 0, 0, frame=0)
    low["params"][6] = 0
    words = r"item 2 \(NAV_LAND\): got 0 m above mean sea level, 488 m below home, expected the alt"
    with pytest.raises(rho.ScenarioError, match=words):
        rho.load_mission(plan_file(tmp_path, [ITEMS[0], low]))
    low["params"][6] = HOME.altitude - 20.0  # a valley
    with pytest.warns(rho.MissionWarning, match=r"below home, .*item 2 \(NAV_LAND\) by 20 m"):
        rho.load_mission(plan_file(tmp_path, [ITEMS[0], low]))


def test_a_landing_above_the_present_altitude_is_told(tmp_path: Path) -> None:
    words = r"the descent of item 2 \(NAV_LAND\), whose altitude is above the present one"
    with pytest.warns(rho.MissionWarning, match=words):
        rho.load_mission(plan_file(tmp_path, [ITEMS[0], item(21, 60, 0, 40)]))


def test_places_at_the_level_of_home_are_told(tmp_path: Path) -> None:
    low, lower = item(16, 40, 0, 0), item(16, 60, 0, 0)
    low["params"][6] = lower["params"][6] = 0
    (found,) = told(plan_file(tmp_path, [ITEMS[0], low, lower, ITEMS[-1]]))
    words = (
        "at home's level, where ArduPilot would keep the present altitude: item 2 (NAV_WAYPOINT)"
    )
    assert found.endswith(words)


@pytest.mark.parametrize(
    ("command", "part", "height"),
    [(94, "descent of item 2 (NAV_PAYLOAD_PLACE)", 15), (36, "arc of item 2 (NAV_ARC_WAYP", 9)],
)
def test_places_of_descents_and_arcs_are_passed(
    command: int, part: str, height: float, tmp_path: Path
) -> None:
    """ArduPilot flies to a place of payload at the present altitude, as to a landing."""
    path = plan_file(tmp_path, [ITEMS[0], item(command, 40, 0, 9), ITEMS[-1]])
    scenario, (found,) = read(path)
    assert f"not in the scenario: the {part}" in found
    np.testing.assert_allclose(places_of(scenario)[1], [40, 0, height], atol=1e-3)


def zigzag(count: int) -> str:
    """Return the text of a mission file with a number of items."""
    places = [on_map((10.0 * (k % 2), 0.01 * k))[0] for k in range(count - 2)]
    further = [f"{k} 0 3 16 0 0 0 0 {x} {y} 20 1" for k, (x, y) in enumerate(places, start=2)]
    home = f"0 1 0 16 0 0 0 0 {HOME.latitude} {HOME.longitude} {HOME.altitude} 1"
    return rows(home, UP, *further)


def test_long_missions_are_read(tmp_path: Path) -> None:
    (tmp_path / "m.waypoints").write_text(zigzag(2500))
    assert len(rho.load_mission(tmp_path / "m.waypoints").vehicles[0].waypoints) == 2498
    (tmp_path / "m.waypoints").write_text("QGC WPL 110\n" + f"{UP}\n" * 65_536)
    with pytest.raises(rho.ScenarioError, match="waypoints: got 65536 items, expected at most"):
        rho.load_mission(tmp_path / "m.waypoints")


def test_the_number_of_many_items_is_told(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setattr("drake_rho.formats.written_missions._STORED", 4)
    plan = rho.plan(scouts())
    written = rho.export(plan, tmp_path / "all", format="mavlink")
    count = max(len(each.read_text().splitlines()) - 2 for each in written.files)
    assert f", {count} items, where boards with ArduPilot usually store some 4" in str(written)
    monkeypatch.setattr("drake_rho.formats.written_missions.MOST_ITEMS", count)
    with pytest.raises(ValueError, match=f"mavlink: got {count} items, expected less than {count}"):
        rho.export(plan, tmp_path / "all", format="mavlink")


def test_many_places_and_zones_are_refused_at_once(tmp_path: Path) -> None:
    """Every place is compared with every zone."""
    angles = 2.0 * np.pi * np.arange(180) / 180.0
    radii = np.where(np.arange(180) % 2 == 0, 30.0, 60.0)
    star = polygon(False, *zip(radii * np.cos(angles) + 300, radii * np.sin(angles), strict=True))
    items = [item(16, 10.0 * (k % 2), 0, 20) for k in range(2000)]
    path = plan_file(tmp_path, items, polygons=[star] * 30)
    with pytest.raises(rho.ScenarioError, match=r"plan: got 2000 places and \d+ parts of fences"):
        rho.load_mission(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (rows(), "items: got no place to fly to, expected a waypoint"),
        (rows("0 0 0 5004 9 0 0 0 47 8 0 0"), "items: got no place to fly to, expected a waypoint"),
        (
            rows(*(f"{k} 0 0 5100 0 0 0 0 47 8 0 0" for k in range(3))),
            r"\(left out: item 0 \(NAV_RALLY_POINT\) and 2 more\), expected",
        ),
        (rows("0 0 3 22 0 0 0 0 0 0 10 1"), r"got no home, expected one in the file, or home="),
        (rows(AT_HOME, "1 0 3 16 0 0 0 0 49 8 9 1"), r"item 1: .* another home="),
        (
            rows(*(f"{k} 0 0 5001 5 0 0 0 {47 + k % 2} {8 + k // 2} 0 1" for k in range(4))),
            "item 0: got a polygon of 4 corners, expected 5 corners, as its first parameter says",
        ),
        (rows("0 0 0 5001 nan 0 0 0 47 8 0 1"), "of 1 corners, expected at least 3 corners"),
        ('{"MAV_AUTOPILOT": 3, "items": []}', "got an older mission of QGroundControl, expected"),
        ('{"fileType": "Mission", "items": []}', "got an older mission .* save it as .plan"),
    ],
)
def test_files_without_a_mission_are_refused_by_what_they_lack(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Patch
) -> None:
    path = tmp_path / "m.mission"
    path.write_text(text)
    with pytest.raises(rho.ScenarioError, match=rf"m\.mission: .*{words}"):
        rho.load_mission(path)
    status, _, err = run(capsys, monkeypatch, "plan", str(path))
    assert (status, err.count("\n")) == (2, 1)
    assert re.search(words.replace("home=", ""), err)


def test_a_breach_return_point_is_told(tmp_path: Path) -> None:
    path = plan_file(tmp_path, ITEMS, breachReturn=geodetic(0, 0, 30))
    assert told(path) == [f"{path}: not in the scenario: the fence's breach return point"]


def test_legs_without_a_speed_have_at_most_that_of_no_limits(tmp_path: Path) -> None:
    for speed, caps in ((12, [("start", "item 1"), "5 m/s"]), (3, [])):
        path = tmp_path / "m.waypoints"
        change = f"2 0 2 178 1 {speed} -1 0 0 0 0 1"
        path.write_text(rows(AT_HOME.replace("3 16", "0 16"), UP, change, f"3{NORTH[1:]}"))
        found = rho.load_mission(path)
        assert found.limits.max_speed == speed
        assert [
            w for each in found.requirements if each.between for w in (each.between, each.name)
        ] == (caps)
        limits = rho.Limits(max_speed=20.0, max_acceleration=5.0)
        (cap,) = (
            each for each in rho.load_mission(path, limits=limits).requirements if each.between
        )
        assert cap.between == ("item 1", "goal")


@pytest.mark.parametrize(("name", "zero"), [("m.waypoints", "-0.000000"), ("m.plan", "-0.0")])
def test_written_altitudes_have_no_sign_at_zero(name: str, zero: str, tmp_path: Path) -> None:
    up, down = rho.Waypoint(5.0, [0, 0, 9]), rho.State([0, 0, -1e-8])
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), down, waypoints=[up])
    grid = rho.Grid.lasting(10.0, step=0.5)
    plan = rho.plan(rho.Scenario("there and back", grid, [vehicle], frame=HOME))
    rho.export(plan, tmp_path / name)
    assert re.search(rf"{zero}\b", (tmp_path / name).read_text()) is None


def test_an_obstacle_on_a_waypoint_names_its_item(scenario: rho.Scenario) -> None:
    with pytest.raises(rho.ScenarioError, match=r"of waypoint 3 \(item 4\) outside obstacle 1"):
        dataclasses.replace(scenario, obstacles=(rho.Sphere(PLACES[2], 5.0),))


@pytest.mark.parametrize("name", ["m.plan", "m.waypoints"])
def test_the_largest_speed_is_set_after_the_takeoff(
    name: str, plan: rho.Plan, tmp_path: Path
) -> None:
    rho.export(plan, tmp_path / name)
    top = round(float(np.linalg.norm(plan.velocities, axis=-1).max()), 3)
    again = rho.load_mission(tmp_path / name)
    assert again.limits.max_speed == top
    assert [each.name for each in again.vehicles[0].waypoints[:2]] == ["item 1", "item 3"]
    assert not any(each.between for each in again.requirements)
