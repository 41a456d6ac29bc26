"""Exports of states, read back by independent readers."""

from __future__ import annotations

import csv
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import disturbed, winds_for
from tests.scenarios import fleet, random_scenario, single, slow, straight
from tests.tolerances import ROUNDING

AXES = ("x", "y", "z")


def rough(
    *, vehicles: int = 3, steps: int = 12, step: float = 0.3, start: float = 0.0, seed: int = 0
) -> rho.Plan:
    """Return vehicles with random accelerations, which reveal any rounding or shift of time."""
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-5.0, 5.0, (vehicles, 3))
    scenario = fleet(
        starts,
        starts + 20.0,
        grid=rho.Grid(step, steps + 1, start),
        separation=rho.Separation(1e-9),
    )
    accelerations = rng.normal(size=(vehicles, steps, 3))
    return rho.Plan.from_accelerations(scenario, accelerations, rho.Statistics(programs=3))


def _true(plan: rho.Plan, name: str, times: np.ndarray) -> list[np.ndarray]:
    """Return positions, velocities and accelerations by Drake's own type, each of shape (M, 3)."""
    path = plan.trajectory(name)
    ways = (path, path.derivative(1), path.derivative(2))
    return [np.hstack([way.value(time) for time in times]).T for way in ways]


def _same(one: rho.Plan, other: rho.Plan) -> bool:
    """Return whether two plans are equal to the last digit."""
    return (
        one.scenario == other.scenario
        and one.accelerations.tobytes() == other.accelerations.tobytes()
        and one.positions.tobytes() == other.positions.tobytes()
        and one.velocities.tobytes() == other.velocities.tobytes()
    )


def _rows(path: Path) -> dict[str, np.ndarray]:
    """Return each vehicle's table in a CSV of states: time, position, velocity, acceleration."""
    with open(path, encoding="utf-8", newline="") as file:
        reader = csv.reader(file)
        header = next(reader)
        assert header[:5] == ["vehicle", "time [s]", "x [m]", "y [m]", "z [m]"]
        assert header[5:8] == [f"v{axis} [m/s]" for axis in AXES]
        assert header[8:] == [f"a{axis} [m/s^2]" for axis in AXES]
        found: dict[str, list[list[float]]] = {}
        for name, *numbers in reader:
            found.setdefault(name, []).append([float(number) for number in numbers])
    return {name: np.array(rows) for name, rows in found.items()}


@pytest.mark.parametrize("rate", [None, 7.0, 10.0, 0.1, *slow(1000.0)])
@pytest.mark.parametrize("start", [0.0, -3.7])
def test_a_table_has_the_states_at_the_rate_and_at_every_knot(
    rate: float | None, start: float, tmp_path: Path
) -> None:
    plan = rough(start=start)
    path = tmp_path / "plan.csv"
    written = rho.export(plan, path, format="csv", rate=rate)
    assert (written.files, written.deviation, written.spare) == ((path,), 0.0, None)
    tables = _rows(path)
    assert list(tables) == ["v0", "v1", "v2"]
    grid = plan.scenario.grid
    for name, table in tables.items():
        times = table[:, 0]
        assert np.all(np.diff(times) > 1e-9 * grid.step)
        assert set(grid.times) <= set(times)
        required = start + np.arange(0.0, grid.duration, 1.0 / (rate or 20.0))
        assert np.abs(times[:, None] - required).min(axis=0).max() < 1e-9
        assert len(times) <= len(required) + grid.knots
        p, v, a = _true(plan, name, times)
        np.testing.assert_allclose(table[:, 1:4], p, rtol=0, atol=ROUNDING * 100)
        np.testing.assert_allclose(table[:, 4:7], v, rtol=0, atol=ROUNDING * 100)
        # Drake computes its own knots
        inner = np.abs(times[:, None] - grid.times).min(axis=1) > 1e-6
        np.testing.assert_array_equal(table[inner, 7:], a[inner])
        k = np.searchsorted(times, grid.times)
        np.testing.assert_array_equal(table[k[:-1], 7:], plan.accelerations[int(name[1:])])
        np.testing.assert_array_equal(table[-1, 7:], np.zeros(3))


@pytest.mark.parametrize("rate", [None, 13.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_table_is_read_back_to_the_last_digit(
    seed: int, rate: float | None, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    step, start = float(10 ** rng.uniform(-2, 2)), float(rng.normal() * 10 ** rng.uniform(-2, 4))
    plan = rough(steps=int(rng.integers(1, 40)), step=step, start=start, seed=seed)
    rho.export(plan, tmp_path / "plan.csv", format="csv", rate=rate)
    loaded = rho.load(tmp_path / "plan.csv", scenario=plan.scenario)
    assert isinstance(loaded, rho.Plan)
    assert _same(loaded, plan)


def test_rows_may_have_any_order_but_every_knot_is_needed(tmp_path: Path) -> None:
    plan, path = rough(), tmp_path / "plan.csv"
    rho.export(plan, path, format="csv")
    header, *lines = path.read_text().splitlines(keepends=True)
    shuffled = np.random.default_rng(0).permutation(len(lines))
    path.write_text("\ufeff" + "".join([header, *(lines[i] for i in shuffled)]))
    loaded = rho.load(path, scenario=plan.scenario)
    assert isinstance(loaded, rho.Plan)
    assert _same(loaded, plan)
    time = repr(float(plan.times[4]))
    path.write_text(header + "".join(line for line in lines if not line.startswith(f"v1,{time},")))
    words = r"plan\.csv: .*v1 has no sample at knot 5, 1\.2 s, expected every knot"
    with pytest.raises(rho.PlanFileError, match=words):
        rho.load(path, scenario=plan.scenario)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("v1,", "v9,", "row 74 below the header: expected a vehicle of fleet and 10 numbers"),
        ("v2,", "v1,", "v2 has no time, expected every knot"),
        ("vx [m/s]", "vx [km/h]", "expected the columns vehicle, time"),
        ("v0,0.3,", "v0,nan,", "v0 has values that are not numbers"),
        ("v0,0.3,", "v0,1e13,", "v0 has values that are not numbers"),
        ("v0,0.3,", "v0,", "row 7 below the header"),
        ("v0,0.3,", "v0,soon,", "soon"),
    ],
)
def test_an_invalid_table_is_refused(old: str, new: str, words: str, tmp_path: Path) -> None:
    plan, path = rough(), tmp_path / "plan.csv"
    rho.export(plan, path, format="csv", rate=20.0)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(rho.PlanFileError, match=words):
        rho.load(path, scenario=plan.scenario)


def test_a_table_needs_a_scenario_and_other_files_contain_theirs(tmp_path: Path) -> None:
    plan = rough()
    for name, kind in (("plan.csv", "csv"), ("plan.json", "json")):
        rho.export(plan, tmp_path / name, format=kind)
    rho.save(plan, tmp_path / "plan.npz")
    with pytest.raises(rho.PlanFileError, match=r"plan\.csv: a table of states without a scenario"):
        rho.load(tmp_path / "plan.csv")
    for name in ("plan.json", "plan.npz"):
        with pytest.raises(ValueError, match=f"scenario: got 'fleet', expected none: .*{name}"):
            rho.load(tmp_path / name, scenario=plan.scenario)


@pytest.mark.parametrize("rate", [None, 3.0])
def test_a_document_has_units_names_and_states(rate: float | None, tmp_path: Path) -> None:
    plan = rough(start=2.5)
    rho.export(plan, tmp_path / "plan.json", format="json", rate=rate)
    content = json.loads((tmp_path / "plan.json").read_text(), parse_constant=pytest.fail)
    assert content["units"] == {
        "times": "s",
        "positions": "m",
        "velocities": "m/s",
        "accelerations": "m/s^2",
    }
    times = np.array(content["times"])
    np.testing.assert_array_equal(times[content["knots"]], plan.times)
    assert len(times) > len(plan.times) or rate is None
    assert [each["name"] for each in content["vehicles"]] == ["v0", "v1", "v2"]
    for each in content["vehicles"]:
        p, v, _ = _true(plan, each["name"], times)
        np.testing.assert_allclose(each["positions"], p, rtol=0, atol=ROUNDING * 100)
        np.testing.assert_allclose(each["velocities"], v, rtol=0, atol=ROUNDING * 100)


def _hard_to_write() -> list[rho.Scenario]:
    """Return scenarios with every shape, disturbance, waypoints, own limits, unusual names."""
    moving = rho.Obstacle(rho.Box([4, 4, 4], [5, 5, 5]), velocity=[0.1, 0, 0], known_from=1.0)
    shapes: list[Any] = [
        rho.Cylinder([9, -9, 0], 0.3, 2.0),
        rho.Ellipsoid([0, 9, 9], [1, 2, 3]),
        moving,
    ]
    odd = straight(3, ["<b>é</b>", 'a "quoted", name', "飛行機"]).scenario
    return [*map(random_scenario, range(6)), disturbed(3), single(obstacles=shapes), odd]


@pytest.mark.parametrize("number", range(9))
@pytest.mark.parametrize("rate", [None, 0.7])
def test_a_document_is_read_back_to_the_last_digit(
    number: int, rate: float | None, tmp_path: Path
) -> None:
    scenario = _hard_to_write()[number]
    rng = np.random.default_rng(number)
    accelerations = rng.normal(size=(len(scenario.vehicles), scenario.grid.knots - 1, 3))
    reported = rho.Statistics(programs=7, steps_tried=(0.1, 0.2), seconds=1.0 / 3.0)
    plan = rho.Plan.from_accelerations(scenario, accelerations, reported)
    for flown in (plan, rho.Flight(plan, (rho.Window(0, plan, plan),))):
        rho.export(flown, tmp_path / "plan.json", format="json", rate=rate)
        loaded = rho.load(tmp_path / "plan.json")
        assert isinstance(loaded, rho.Plan)
        assert _same(loaded, plan)
        assert loaded.statistics == reported


@pytest.mark.parametrize(
    "change",
    [
        {"format": "drake_rho plan 2"},
        {"format": "drake_rho true motion 1"},
        {"units": {}},
        {"scenario": {}},
        {"times": [0.0]},
        {"times": "now"},
        {"knots": [0, 1]},
        {"knots": [99] * 13},
        {"vehicles": []},
        {"vehicles": [{"name": "v0"}]},
        {"surplus": 1},
    ],
)
def test_an_invalid_document_is_refused(change: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    rho.export(rough(), path, format="json")
    assert isinstance(rho.load(path), rho.Plan)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(rho.PlanFileError, match=r"^[^\n]*plan\.json: [^\n]+$"):
        rho.load(path)


@pytest.mark.parametrize("text", ["{", '{"agents": []}', "{}", "[]", "\x00\xff", "[" * 100_000])
def test_other_text_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "text.json").write_text(text, encoding="latin-1")
    with pytest.raises(rho.PlanFileError, match=r"text\.json: not a plan or flight"):
        rho.load(tmp_path / "text.json")


def _shows(path: Path) -> dict[str, np.ndarray]:
    """Return Skybrush's files by name, by its documentation: rows of seven numbers."""
    if path.is_dir():
        texts = {each.stem: each.read_text("ascii") for each in path.iterdir()}
    else:
        with zipfile.ZipFile(path) as archive:
            assert archive.testzip() is None
            names = archive.namelist()
            texts = {Path(name).stem: archive.read(name).decode("ascii") for name in names}
    found = {}
    for name, text in texts.items():
        header, *rows = csv.reader(io.StringIO(text))
        assert header == ["Time [msec]", "x [m]", "y [m]", "z [m]", "Red", "Green", "Blue"]
        assert all(0 <= int(cell) <= 255 for row in rows for cell in row[4:])
        assert all(row[0].isdigit() and len(row) == 7 for row in rows)
        found[name] = np.array([[float(cell) for cell in row] for row in rows])
    return found


@pytest.mark.parametrize("rate", [None, 4.0, 24.0])
@pytest.mark.parametrize("name", ["show", "show.v2", "show.zip"])
def test_a_show_is_the_motion_in_milliseconds(
    name: str, rate: float | None, tmp_path: Path
) -> None:
    plan = rough(step=0.25, start=1.5)
    written = rho.export(plan, tmp_path / name, format="skybrush", rate=rate)
    shows = _shows(tmp_path / name)
    assert sorted(shows) == ["v0", "v1", "v2"]
    assert all(file.exists() for file in written.files)
    for number, vehicle in enumerate(("v0", "v1", "v2")):
        ticks, positions = shows[vehicle][:, 0], shows[vehicle][:, 1:4]
        assert ticks[0] == 0.0
        assert ticks[-1] == 3000.0
        assert np.abs(np.diff(ticks)[:-1] - 1000.0 / (rate or 20.0)).max() <= 1.0
        p, *_ = _true(plan, vehicle, 1.5 + ticks / 1000.0)
        np.testing.assert_allclose(positions, p, rtol=0, atol=ROUNDING * 100)
        dense = np.linspace(0.0, 3.0, 4001)
        lines = np.stack([np.interp(1000.0 * dense, ticks, each) for each in positions.T], axis=1)
        off = np.linalg.norm(lines - _true(plan, vehicle, 1.5 + dense)[0], axis=1).max()
        assert 0.5 * written.deviations[number] < off <= written.deviations[number] + ROUNDING


def test_the_same_show_is_the_same_archive(tmp_path: Path) -> None:
    for name in ("one.zip", "other.zip"):
        rho.export(rough(), tmp_path / name, format="skybrush")
    assert (tmp_path / "one.zip").read_bytes() == (tmp_path / "other.zip").read_bytes()


def test_setpoints_are_the_motion_in_north_east_and_down(tmp_path: Path) -> None:
    plan = rough(step=0.25, start=-2.0)
    rho.export(plan, tmp_path / "setpoints.csv", format="px4", rate=30.0)
    with open(tmp_path / "setpoints.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    ticks = [int(row["time_boot_ms"]) for row in rows]
    assert ticks == sorted(ticks)
    assert max(np.diff(sorted(set(ticks)))) <= 34
    assert (ticks[0], ticks[-1]) == (0, 3000)
    for row in rows:
        assert int(row["coordinate_frame"]) == 1  # MAV_FRAME_LOCAL_NED
        assert int(row["target_system"]) == 1 + int(row["vehicle"][1:])
        assert int(row["type_mask"]) & 0b0111_1111_1111 == 0  # position to yaw: nothing ignored
        north, east = np.cos(float(row["yaw"])), np.sin(float(row["yaw"]))
        np.testing.assert_allclose([east, north], [1.0, 0.0], atol=1e-12)  # along x
        time = np.array([-2.0 + int(row["time_boot_ms"]) / 1000.0])
        p, v, a = _true(plan, row["vehicle"], time)
        for values, names in ((p, AXES), (v, ("vx", "vy", "vz")), (a, ("afx", "afy", "afz"))):
            north, east, down = (float(row[name]) for name in names)
            expected = values[0]
            if names[0] == "afx" and int(row["time_boot_ms"]) % 250 == 0:
                k = int(row["time_boot_ms"]) // 250  # a step begins, or the flight has ended
                own = plan.accelerations[int(row["vehicle"][1:])]
                expected = own[k] if k < len(own) else np.zeros(3)
            np.testing.assert_allclose([east, north, -down], expected, rtol=0, atol=1e-9)


def test_a_show_covers_a_flight_that_ends_between_milliseconds(tmp_path: Path) -> None:
    plan = rough(vehicles=1, step=0.1001, steps=3)  # 300.3 ms
    rho.export(plan, tmp_path / "setpoints.csv", format="px4", rate=50.0)
    with open(tmp_path / "setpoints.csv", encoding="utf-8", newline="") as file:
        *_, before, last = csv.DictReader(file)
    assert (before["time_boot_ms"], last["time_boot_ms"]) == ("300", "301")
    assert [float(last[name]) for name in ("afx", "afy", "afz")] == [0.0, 0.0, 0.0]
    place = [float(last["y"]), float(last["x"]), -float(last["z"])]
    np.testing.assert_allclose(place, plan.positions[0, -1], rtol=0, atol=1e-12)


def test_the_last_setpoint_is_at_rest_at_the_goal(tmp_path: Path) -> None:
    scenario = rho.Scenario(
        "short",
        rho.Grid(1.0 / 3.0, 8),
        [rho.Vehicle("v0", rho.State([0, 0, 1]), rho.State([2, 1, 3]))],
    )
    rho.export(rho.plan(scenario), tmp_path / "setpoints.csv", format="px4", rate=50.0)
    with open(tmp_path / "setpoints.csv", encoding="utf-8", newline="") as file:
        *_, last = csv.DictReader(file)
    assert last["time_boot_ms"] == "2334"  # after the end, at 2333.3 ms
    place = [float(last["y"]), float(last["x"]), -float(last["z"])]
    np.testing.assert_allclose(place, [2.0, 1.0, 3.0], rtol=0, atol=1e-12)
    rest = [float(last[name]) for name in ("vx", "vy", "vz", "afx", "afy", "afz")]
    np.testing.assert_allclose(rest, np.zeros(6), rtol=0, atol=1e-12)


def test_mavlink_allows_at_most_255_systems(tmp_path: Path) -> None:
    rho.export(rough(vehicles=255, steps=2), tmp_path / "plan.csv", format="px4")
    with pytest.raises(ValueError, match="vehicles: got 256, expected at most 255 with px4"):
        rho.export(rough(vehicles=256, steps=2), tmp_path / "more.csv", format="px4")
    assert [each.name for each in tmp_path.iterdir()] == ["plan.csv"]


@pytest.fixture(scope="module")
def simulation() -> rho.Simulation:
    """Return a flight in a wind that moves vehicles off their plans."""
    scenario = disturbed(2)
    wind = winds_for(scenario, 2)["constant"]
    return rho.simulate(scenario, wind=wind, rng=np.random.default_rng(2), replan_every=3)


def test_the_export_of_a_simulation_is_its_true_motion(
    simulation: rho.Simulation, tmp_path: Path
) -> None:
    assert simulation.errors().max() > 1e-3
    rho.export(simulation, tmp_path / "true.csv", format="csv", rate=37.0)
    tables = _rows(tmp_path / "true.csv")
    record, start = simulation, simulation.scenario.grid.start
    for number, table in enumerate(tables.values()):
        for row in table:
            m = min(int(np.searchsorted(record.times, row[0], side="right")), len(record.times) - 1)
            s = row[0] - record.times[m - 1]
            acting = record.commands[m - 1, number] + record.wind[m - 1, number]
            v = record.velocities[m - 1, number] + s * acting
            p = record.positions[m - 1, number] + s * (v - s / 2 * acting)
            np.testing.assert_allclose(row[1:4], p, rtol=0, atol=1e-8)
            np.testing.assert_allclose(row[4:7], v, rtol=0, atol=1e-8)
    written = rho.export(simulation, tmp_path / "show", format="skybrush")
    assert written.spare is not None
    for number, show in enumerate(_shows(tmp_path / "show").values()):
        at = np.abs(show[:, None, 0] / 1000.0 + start - record.times).argmin(axis=1)
        near = np.abs(show[:, 0] / 1000.0 + start - record.times[at]) < 1e-9
        assert near.sum() > 5
        expected = record.positions[at[near], number]
        np.testing.assert_allclose(show[near, 1:4], expected, rtol=0, atol=1e-8)


def test_a_true_motion_cannot_be_read_as_a_plan(simulation: rho.Simulation, tmp_path: Path) -> None:
    rho.export(simulation, tmp_path / "true.json", format="json")
    with pytest.raises(rho.PlanFileError, match=r"true\.json: .*expected a plan"):
        rho.load(tmp_path / "true.json")
    for format, name in (("crazyswarm", "folder"), ("px4", "table.csv"), ("skyc", "x.skyc")):
        with pytest.raises(ValueError, match=f"got a simulation, expected a plan .* {format}"):
            rho.export(simulation, tmp_path / name, format=format)
    assert [each.name for each in tmp_path.iterdir()] == ["true.json"]


def test_data_that_could_not_be_read_back_are_not_written(tmp_path: Path) -> None:
    plan = rho.Plan.from_accelerations(single(), np.full((1, 16, 3), 1.1e12))
    for name in ("csv", "json"):
        with pytest.raises(ValueError, match="single: got states beyond 1e"):
            rho.export(plan, tmp_path / f"far.{name}", format=name)
    assert not list(tmp_path.iterdir())
