"""Missions of another planner on the command line, with the grid that they lack."""

from __future__ import annotations

from pathlib import Path

import pytest

import drake_rho as rho
from tests.scenarios import single
from tests.test_cli import run

MISSION = """
{"quadrotors": {"small": {"max_vel": [1, 1, 1], "max_acc": [2, 2, 1], "radius": 0.15,
                          "nominal_velocity": 1, "downwash": 2}},
 "world": [{"dimension": [-2, -2, 0, 2, 2, 2]}],
 "agents": [{"type": "small", "cid": 1, "start": [-1, -1, 1], "goal": [1, -1, 1]},
            {"type": "small", "cid": 2, "start": [-1, 1, 1], "goal": [1, 1, 0.5]}],
 "obstacles": []}
"""


@pytest.fixture
def mission_file(tmp_path: Path) -> Path:
    """Write a mission of the LSC planner."""
    path = tmp_path / "mission.json"
    path.write_text(MISSION)
    return path


@pytest.mark.parametrize("command", ["plan", "fly"])
def test_a_mission_is_planned_on_the_requested_grid(
    command: str,
    mission_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = tmp_path / "kept.npz"
    words = [command, str(mission_file), "--duration", "10", "--step", "0.2", "-o", str(kept)]
    status, out, _ = run(capsys, monkeypatch, *words)
    assert status == 0, out
    assert "small-2" in out
    loaded = rho.load(kept)
    plan = loaded.plan if isinstance(loaded, rho.Flight) else loaded
    assert plan.scenario == rho.load_lsc_mission(mission_file, grid=rho.Grid(0.2, 51))


def test_a_mission_without_a_plan_at_one_step_is_tried_with_the_next(
    mission_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["plan", str(mission_file), "--duration", "4", "--step", "4", "--step", "0.1"]
    status, out, _ = run(capsys, monkeypatch, *words)
    assert status == 0
    assert "step 0.1 s" in out


@pytest.mark.parametrize("command", ["plan", "fly", "show"])
@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ([], "no --duration, expected --duration and --step"),
        (["--step", "0.2"], "no --duration, expected --duration and --step"),
        (["--duration", "10"], "no --step, expected --duration and --step"),
        (["--duration", "10", "--step", "0.3"], "a step that divides the duration, 10 s"),
        (["--duration", "-1", "--step", "0.3"], "duration: got -1"),
    ],
)
def test_a_mission_needs_its_grid_on_the_command_line(
    command: str,
    options: list[str],
    complaint: str,
    mission_file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    status, out, err = run(capsys, monkeypatch, command, str(mission_file), *options)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert complaint in err


@pytest.mark.parametrize("command", ["plan", "fly", "show"])
@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "got no text, expected a readable CSV file; No such file or directory"),
        ("", "got no row, expected at least one box"),
        ("0,0,1,1,1\n", "world.csv: line 1: got '0,0,1,1,1', expected six numbers"),
        ("0,0,1,0.5,0.5,2\nx\n", "world.csv: line 2: got 'x', expected six numbers"),
        ("-1,1,1,0.5,0.5,2\n", "mission.json: agents[1].start: got"),
    ],
)
def test_a_malformed_world_is_refused_in_one_line(
    command: str,
    text: str | None,
    complaint: str,
    mission_file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = mission_file.parent / "world.csv"
    if text is not None:
        world.write_text(text)
    words = [command, str(mission_file), "--duration", "10", "--step", "0.2", "--world", str(world)]
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert complaint in err


@pytest.mark.parametrize("command", ["plan", "fly", "show"])
def test_a_world_is_refused_for_files_that_are_no_mission(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    status, out, err = run(capsys, monkeypatch, command, "paper", "--world", "w.csv")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "--world: got 'w.csv', expected a mission (.json) with it: paper has obstacles" in err


def test_a_malformed_mission_is_refused_by_the_names_in_it(
    mission_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mission_file.write_text(MISSION.replace('"downwash"', '"backwash"'))
    words = ["plan", str(mission_file), "--duration", "10", "--step", "0.2"]
    status, _, err = run(capsys, monkeypatch, *words)
    assert status == 2
    assert "mission.json: quadrotors.small.backwash: got 2, expected no field of this name" in err


def test_a_grid_is_refused_for_a_saved_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rho.save(rho.plan_convex(single()), tmp_path / "plan.npz")
    status, _, err = run(capsys, monkeypatch, "show", str(tmp_path / "plan.npz"), "--step", "0.2")
    assert status == 2
    assert "--step: got 0.2" in err
