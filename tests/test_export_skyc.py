"""Compiled shows of Skybrush, replayed by an evaluator of the tests' own."""

from __future__ import annotations

import base64
import dataclasses
import json
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import straight
from tests.test_export import rough
from tests.tolerances import ROUNDING


def smooth(width: float, times: int) -> rho.Plan:
    """Return random plans that end at rest, averaged."""
    scenario = dataclasses.replace(
        rough(steps=20).scenario,
        limits=rho.Limits(max_acceleration=20.0),
        smoothing=rho.Smoothing(width, times=times),
    )
    forth = 3.0 * np.random.default_rng(times).normal(size=(3, 10, 3))
    return rho.Plan.from_accelerations(scenario, np.concatenate([forth, -forth], axis=1))


def _drones(path: Path) -> list[dict[str, Any]]:
    """Return the settings of a show's drones, with the documents that they refer to."""
    with zipfile.ZipFile(path) as archive:
        show = json.loads(archive.read("show.json"), parse_constant=pytest.fail)
        assert show["version"] == 1
        drones: list[dict[str, Any]] = [each["settings"] for each in show["swarm"]["drones"]]
        for settings in drones:
            for key in ("trajectory", "lights"):
                link = settings[key]["$ref"]
                assert link.startswith("./")
                assert link.endswith(".json#")
                settings[key] = json.loads(archive.read(link[2:-1]), parse_constant=pytest.fail)
    return drones


def _replayed(trajectory: dict[str, Any], ticks: np.ndarray) -> np.ndarray:
    """Return positions at times [ms] by de Casteljau's algorithm, shape (M, 3)."""
    assert trajectory["version"] == 1
    points = trajectory["points"]
    ends = np.array([round(1000.0 * time) for time, _, _ in points])
    np.testing.assert_allclose(ends / 1000.0, [time for time, _, _ in points], rtol=1e-15)
    assert np.all(np.diff(ends) > 0)
    assert points[0][2] == []
    found = []
    for tick in ticks:
        k = min(int(np.searchsorted(ends, tick, side="right")), len(ends) - 1)
        u = (tick - ends[k - 1]) / (ends[k] - ends[k - 1])
        corners = np.array([points[k - 1][1], *points[k][2], points[k][1]])
        assert 3 <= len(corners) <= 4  # quadratic or cubic
        while len(corners) > 1:
            corners = (1.0 - u) * corners[:-1] + u * corners[1:]
        found.append(corners[0])
    return np.array(found)


def _largest_deviation(plan: rho.Plan, path: Path) -> np.ndarray:
    """Return each vehicle's largest deviation from the plan at all milliseconds [m]."""
    scenario = plan.scenario
    begin = scenario.grid.start - scenario.lead
    last = scenario.grid.duration + 2.0 * scenario.lead
    ticks = np.arange(0, int(1000.0 * last + 1e-6) + 1)
    expected = plan.at(np.minimum(begin + ticks / 1000.0, begin + last)).positions
    drones = _drones(path)
    assert [each["name"] for each in drones] == list(scenario.names)
    replayed = np.array([_replayed(each["trajectory"], ticks) for each in drones])
    return np.asarray(np.linalg.norm(replayed - expected, axis=2).max(axis=1))


@pytest.mark.parametrize("step", [0.25, 0.3, 0.001])
def test_steps_of_whole_milliseconds_are_written_without_loss(step: float, tmp_path: Path) -> None:
    plan = rough(step=step, start=1.5)
    written = rho.export(plan, tmp_path / "show.skyc")
    assert (written.deviation, written.spare) == (0.0, None)
    assert _largest_deviation(plan, tmp_path / "show.skyc").max() <= ROUNDING
    degrees = {len(p[2]) for each in _drones(tmp_path / "show.skyc") for p in _points(each)[1:]}
    assert degrees == {1}  # one control point between the ends: quadratic


def _points(settings: dict[str, Any]) -> list[Any]:
    points: list[Any] = settings["trajectory"]["points"]
    return points


@pytest.mark.parametrize("width", [0.2, 0.3])
def test_one_average_is_written_without_loss(width: float, tmp_path: Path) -> None:
    plan = smooth(width, 1)
    written = rho.export(plan, tmp_path / "show.skyc")
    assert (written.deviation, written.spare) == (0.0, None)
    assert _largest_deviation(plan, tmp_path / "show.skyc").max() <= ROUNDING


@pytest.mark.parametrize(
    "plan",
    [
        rough(step=0.1001, steps=40),
        rough(step=1.0 / 3.0),
        rough(step=0.0007),
        smooth(0.2501, 1),
        smooth(0.2, 2),
        smooth(0.3, 3),
    ],
    ids=["0.1001 s", "1/3 s", "0.7 ms", "one average", "two", "three"],
)
def test_other_motions_deviate_by_less_than_a_millimetre_and_say_so(
    plan: rho.Plan, tmp_path: Path
) -> None:
    written = rho.export(plan, tmp_path / "show.skyc")
    true = _largest_deviation(plan, tmp_path / "show.skyc")
    assert 0.0 < written.deviation < 1e-3
    assert np.all(true <= written.deviations + ROUNDING)
    assert written.spare is not None


def test_a_show_has_white_lights_pads_and_no_headings_of_its_own(tmp_path: Path) -> None:
    plan = rough(step=0.3)
    rho.export(plan, tmp_path / "show.skyc")
    for i, settings in enumerate(_drones(tmp_path / "show.skyc")):
        lights = base64.b64decode(settings["lights"]["data"])
        assert lights == bytes(
            [4, *[255] * 3, 0x80 | 180 & 127, 180 >> 7, 0]
        )  # white for 180 times 20 ms
        np.testing.assert_array_equal(settings["home"], plan.positions[i, 0])
        np.testing.assert_allclose(settings["landAt"], plan.positions[i, -1], atol=ROUNDING)
        assert "yawControl" not in settings


def test_headings_are_clockwise_degrees(tmp_path: Path) -> None:
    plan = rough(step=0.3)
    rho.export(plan, tmp_path / "show.skyc", heading={"v1": np.pi / 2.0})
    setpoints = [each["yawControl"]["setpoints"] for each in _drones(tmp_path / "show.skyc")]
    assert [each[0] for each in setpoints] == [[0.0, 0.0], [0.0, -90.0], [0.0, 0.0]]
    assert [each[-1][0] for each in setpoints] == [3.6, 3.6, 3.6]


def test_equal_shows_are_equal_archives_and_names_stay(tmp_path: Path) -> None:
    plan = straight(3, ["a/b", "飛行機", 'q" #%'])
    for name in ("one.skyc", "other.skyc"):
        rho.export(plan, tmp_path / name, heading="velocity")
    assert (tmp_path / "one.skyc").read_bytes() == (tmp_path / "other.skyc").read_bytes()
    assert [each["name"] for each in _drones(tmp_path / "one.skyc")] == list(plan.scenario.names)


def _show(trajectories: dict[str, Any], drones: int = 1, link: str = "./t.json#") -> dict[str, str]:
    """Return the files of a show whose drones refer to a trajectory."""
    settings = [{"name": f"d{n}", "trajectory": {"$ref": link}} for n in range(drones)]
    show = {"version": 1, "swarm": {"drones": [{"settings": each} for each in settings]}}
    files = {"show.json": show} | trajectories
    return {name: json.dumps(each) for name, each in files.items()}


def _written(path: Path, files: dict[str, str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


def _of_points(points: Any, **more: Any) -> dict[str, Any]:
    return {"t.json": {"version": 1, "points": points, **more}}


FINE = [[0, [0, 0, 0], []], [1, [1, 0, 0], []]]


@pytest.mark.parametrize(
    ("trajectories", "reason"),
    [
        (_of_points("abc"), "points: got 'abc', expected a list of two or more"),
        (_of_points(FINE[:1]), "points: got .*, expected a list of two or more"),
        (_of_points([*FINE, [1, [1, 0, 0], []]]), "point 3: got 1, expected a time after 1 s"),
        (_of_points([*FINE, [2, [1, 0], []]]), r"point 3: got \[1, 0\], expected x, y and z"),
        (_of_points([*FINE, [2, [], []]]), r"point 3: got \[\], expected x, y and z"),
        (_of_points([*FINE, [2, [1, 0, True], []]]), "point 3: got .*, expected x, y and z"),
        (_of_points([*FINE, [2, [1, 0, 0], [[0] * 3] * 7]]), "got 7 control points, .* most 6"),
        (_of_points([[0, [0, 0, 0], [[0] * 3]], *FINE[1:]]), "point 1: got 1 control points"),
        (_of_points([*FINE, 5]), "point 3: got 5, expected a time, a position and a list"),
        (_of_points(FINE, takeoffTime="now"), "takeoffTime: got 'now', expected a time in s"),
        ({"t.json": {"$ref": "./t.json#"}}, "got a reference in the file of a reference"),
        ({"t.json": {"$ref": "u.json"}, "u.json": {}}, "got a reference in the file of a"),
        ({"t.json": 0}, "got 0, expected version and points"),
        ({"t.json": {"version": 2}}, "got version 2"),
        ({}, "got a reference to 't.json', expected a file in the archive"),
    ],
)
def test_a_trajectory_that_is_none_is_refused_by_its_point(
    trajectories: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    path = _written(tmp_path / "x.skyc", _show(trajectories))
    with pytest.raises(rho.PlanFileError, match=rf"x\.skyc: drone 1: .*{reason}"):
        rho.load_trajectories(path)


def test_a_file_that_drones_share_is_read_once_and_segments_are_bounded(tmp_path: Path) -> None:
    points = [[k, [0, 0, k % 2], [[0, 0, 1]] * (k > 0)] for k in range(20_000)]
    path = _written(tmp_path / "x.skyc", _show(_of_points(points), drones=100))
    found = rho.load_trajectories(path)
    assert len({id(each) for each in found.motions.values()}) == 1
    np.testing.assert_allclose(found.at([0.5, 1.5], "d7").positions[:, 2], [0.75, 0.75])
    path = _written(tmp_path / "x.skyc", _show(_of_points(points), drones=1000))
    with pytest.raises(rho.PlanFileError, match="got more than 5000000 segments of all drones"):
        rho.load_trajectories(path)


def test_no_more_of_a_file_is_inflated_than_its_header_claims(tmp_path: Path) -> None:
    path = _written(tmp_path / "x.skyc", {"show.json": " " * (64 << 20)})
    content, size = path.read_bytes(), struct.pack("<I", 64 << 20)
    assert content.count(size) == 2  # before the file, and in the directory at the end
    path.write_bytes(content.replace(size, struct.pack("<I", 100)))
    tracemalloc.start()
    with pytest.raises(rho.PlanFileError, match=r"not a Skybrush show, or damaged .*CRC"):
        rho.load_trajectories(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 8 << 20


def test_files_that_do_not_inflate_piece_by_piece_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "x.skyc", "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("show.json", "{}")
    with pytest.raises(rho.PlanFileError, match=r"show.json.: got compression 12, expected 8"):
        rho.load_trajectories(tmp_path / "x.skyc")
