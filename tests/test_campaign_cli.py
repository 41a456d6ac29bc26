"""`drake-rho campaign` and `drake-rho results`: what they print, and how they refuse."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

import drake_rho as rho
from tests.scenarios import slow
from tests.studies import small, table, text_of
from tests.test_cli import run

Patch = pytest.MonkeyPatch
Captured = pytest.CaptureFixture[str]


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Write the file of a small study (JSON is YAML)."""
    path = tmp_path / "study.yaml"
    path.write_text(text_of(small()))
    return path


def test_an_example_of_a_hundred_runs_and_the_schema_are_printed(
    tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    status, printed, _ = run(capsys, monkeypatch, "campaign", "--example")
    (tmp_path / "example.yaml").write_text(printed)
    assert (status, len(rho.load_study(tmp_path / "example.yaml")) >= 100) == (0, True)
    status, printed, _ = run(capsys, monkeypatch, "campaign", "--schema")
    assert (status, json.loads(printed)["title"]) == (0, "Study")


def test_a_campaign_and_its_results(
    study: Path, tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    store = str(tmp_path / "runs.sqlite")
    words = ["campaign", str(study), "--store", store]
    for expected in (len(small()), len(small())):  # the second time nothing is left to do
        status, printed, _ = run(capsys, monkeypatch, *words)
        assert status == 0
        assert printed.startswith(f"{expected} runs in {store}, ")
    status, printed, _ = run(capsys, monkeypatch, "results", store)
    assert (status, printed.strip()) == (0, str(rho.Results(store)))
    status, printed, _ = run(capsys, monkeypatch, "results", store, "--json")
    reported = {"status": 0, "export": None, "figures": []} | rho.Results(store).to_json()
    assert (status, json.loads(printed)) == (0, reported)
    made = [str(tmp_path / "figures"), str(tmp_path / "runs.csv")]
    words = ["results", store, "--figures", made[0], "--export", made[1]]
    status, printed, _ = run(capsys, monkeypatch, *words)
    assert status == 0
    assert f"{len(small())} rows in {made[1]}" in printed
    assert len(list(Path(made[0]).glob("*.png"))) == 4


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            "UPDATE runs SET scenario = 'elsewhere' WHERE rowid = 2",
            "got a run of 'convex' on 'elsewhere', expected runs of best, convex on pair, past",
        ),
        (
            "UPDATE runs SET method = 'other' WHERE rowid = 1",
            "got a run of 'other' on 'pair', expected runs of best, convex on pair, past",
        ),
        ("DELETE FROM study", "got no study, expected the study of the runs"),
    ],
)
def test_a_store_with_foreign_runs_is_one_line_and_status_2(
    change: str, complaint: str, tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    store = tmp_path / "runs.sqlite"
    rho.campaign(small(1), store)
    with sqlite3.connect(store) as connection:
        connection.execute(change)
    connection.close()
    status, printed, complained = run(capsys, monkeypatch, "results", str(store))
    assert (status, printed) == (2, "")
    assert complained == f"drake-rho: {store}: {complaint}\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("campaign",), "campaign: got no STUDY, expected STUDY and --store FILE"),
        (("campaign", "{study}"), "campaign: got no --store"),
        (
            ("campaign", "{none}", "--store", "{store}"),
            "expected a readable YAML file",
        ),
        (("campaign", "{broken}", "--store", "{store}"), "repetitons: got 3, expected no field of"),
        (("campaign", "{study}", "--store", "{study}"), "file is not a database"),
        (("campaign", "{study}", "--store", "{none}/runs"), "unable to open database file"),
        (
            ("campaign", "{study}", "--store", "{store}", "--workers", "0"),
            "Input should be greater than or equal to 1",
        ),
        (
            ("campaign", "{study}", "--store", "{store}", "--workers", "2", "--scheduler", "x"),
            "--scheduler: got it beside --workers",
        ),
        (("results", "{none}"), "{none}: got no such file"),
        (("results", "{study}"), "file is not a database"),
        (("results", "{study}", "--export", "{none}.xlsx"), "--export: got"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    words: tuple[str, ...],
    complaint: str,
    study: Path,
    tmp_path: Path,
    capsys: Captured,
    monkeypatch: Patch,
) -> None:
    broken = tmp_path / "broken.yaml"
    broken.write_text(text_of(small()).replace('"repetitions":4', '"repetitons":3'))
    names = {
        "study": str(study),
        "none": str(tmp_path / "none"),
        "broken": str(broken),
        "store": str(tmp_path / "runs.sqlite"),
    }
    before = study.read_bytes()
    status, printed, complained = run(
        capsys, monkeypatch, *(word.format(**names) for word in words)
    )
    assert (status, printed) == (2, "")
    assert complained.startswith("drake-rho: ")
    assert complained.count("\n") == 1
    assert complaint.format(**names) in complained
    assert study.read_bytes() == before


def test_another_study_is_refused(
    study: Path, tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    store = tmp_path / "runs.sqlite"
    rho.campaign(small(1, seed=1), store)
    before = table(store)
    status, _, complained = run(capsys, monkeypatch, "campaign", str(study), "--store", str(store))
    assert (status, complained.count("\n")) == (2, 1)
    assert "got the store of another study" in complained
    assert table(store) == before


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, *slow(signal.SIGKILL)])
def test_a_terminated_campaign_on_workers_resumes(
    how: signal.Signals, tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    go = tmp_path / "go"
    held = {
        "planner": "function",
        "function": "tests.studies:held",
        "arguments": {"until": str(go)},
    }
    study = small(2, methods=[*small().methods, {"name": "held", **held}])
    (tmp_path / "study.yaml").write_text(text_of(study))
    store = tmp_path / "runs.sqlite"
    words = ["campaign", str(tmp_path / "study.yaml"), "--store", str(store)]
    process = subprocess.Popen(
        [sys.executable, "-m", "drake_rho", *words, "--workers", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_handles_interrupts,
        cwd=Path(__file__).parent.parent,  # where workers find the planner
    )
    while process.poll() is None and _count(store) < 4:  # then both workers are busy waiting
        time.sleep(0.01)
    if how == signal.SIGINT:  # like a terminal: send it to all of them
        os.killpg(process.pid, how)
    else:
        process.send_signal(how)
    _, complained = process.communicate()
    assert process.returncode == (130 if how == signal.SIGINT else -how)
    if how == signal.SIGINT:
        assert "interrupted" in complained
        assert "Traceback" not in complained
    rows = table(store)
    assert 4 <= len(rows) < len(study)
    go.touch()
    assert run(capsys, monkeypatch, *words)[0] == 0
    again = table(store)
    assert set(rows) <= set(again)
    assert len(again) == len({row[0] for row in again}) == len(study)
    rho.campaign(study, tmp_path / "alone.sqlite")
    assert again == table(tmp_path / "alone.sqlite")


def _handles_interrupts() -> None:
    """Handle interrupts, which shells let background processes ignore."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _count(store: Path) -> int:
    try:
        return len(rho.Results(store))
    except rho.DrakeRhoError:  # not created yet
        return 0
