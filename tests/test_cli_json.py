"""`--json` and `--quiet` of every command: one document with the defined keys, or less."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver

import drake_rho as rho
from tests.scenarios import box, single, slow
from tests.studies import small, text_of
from tests.test_cli import run

Patch = pytest.MonkeyPatch
Captured = pytest.CaptureFixture[str]

ASKED: dict[str, list[str]] = {
    "plan": ["plan", "paper", "-o", "kept.npz"],
    "fly": ["fly", "paper"],
    "fastest": ["fastest", "weak.yaml"],
    "simulate": ["simulate", "windy.yaml", "--wind", "noise"],
    "assign": ["assign", "paper_assembly", "-o", "kept.yaml"],
    "storyboard": ["storyboard", "show.yaml", "-o", "kept.npz"],
    "verify": ["verify", "plan.npz"],
    "certify": ["certify", "plan.npz"],
    "diagnose": ["diagnose", "weak.yaml"],
    "show": ["show", "plan.npz", "--html", "page.html"],
    "import": ["import", "swarm.yaml", "--duration", "9", "--step", "1", "-o", "kept.yaml"],
    "map": ["map", "pyramid.obj"],
    "export": ["export", "plan.npz", "--format", "csv", "-o", "plan.csv"],
    "campaign": ["campaign", "study.yaml", "--store", "new.sqlite"],
    "results": ["results", "runs.sqlite"],
    "reproduce": ["reproduce", "--figures", "drawn"],
    "schema": ["schema"],
    "formats": ["formats"],
}
"""Arguments of each command."""
FAILED = "any command that fails"
PYRAMID = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SHOW = """
name: pair
pads: {kind: grid, columns: 2, rows: 1, spacing: 2}
limits: {max_speed: 4, max_acceleration: 3}
separation: {distance: 1}
scenes: [{name: ring, formation: {kind: ring, count: 2, radius: 2, center: [0, 0, 4]}}]
"""
SWARM = "robots: {cf1: {enabled: true, initial_position: [0, 0, 0]}}\n"
WEAK = rho.Limits(acceleration=box(0.3))


WINDY = dataclasses.replace(
    single(grid=rho.Grid(1.0, 9), obstacles=[rho.Sphere([5.0, 6.0, 0.0], 1.0)]),
    disturbance=rho.Disturbance(0.02, 0.001, 0.002, share=0.5),
)


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with one file of every kind."""
    folder = tmp_path_factory.mktemp("files")
    rho.save(rho.plan_convex(single()), folder / "plan.npz")
    rho.save_scenario(single(limits=WEAK), folder / "weak.yaml")
    rho.save_scenario(WINDY, folder / "windy.yaml")
    (folder / "study.yaml").write_text(text_of(small(1)))
    rho.campaign(small(1), folder / "runs.sqlite")
    (folder / "pyramid.obj").write_text(PYRAMID)
    (folder / "swarm.yaml").write_text(SWARM)
    (folder / "show.yaml").write_text(SHOW)
    return folder


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: Patch, study: object, files: Path) -> Path:
    """Work in a copy of the folder."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("drake_rho.cli.commands.run_study", lambda advance: study)
    monkeypatch.setattr("drake_rho.paper.figures.write_paper_figures", _no_figures)
    return tmp_path


def _no_figures(study: object, folder: str, *_: object, **__: object) -> list[Path]:
    """Stand in for the drawing of sixteen figures, which other tests cover."""
    return [Path(folder) / "fig03.png"]


def _tables() -> dict[tuple[str, str], list[str]]:
    """Return the keys of documents (row "") and of their rows in docs/command_line.md."""
    text = (Path(__file__).parent.parent / "docs" / "command_line.md").read_text()
    tables, of = dict[tuple[str, str], list[str]](), [""]
    table = r"^\| (.+) \| \|\n\|---\|---\|\n((?:\|.*\n)+)"
    for head, body in re.findall(table, text, re.MULTILINE):
        keys = re.findall(r"^\| `(\w+)` \| .+ \|$", body, re.MULTILINE)
        rows = re.findall(r"`(\w+)`", head) if head.startswith("each of") else [""]
        of = of if head.startswith("each of") else re.findall(r"`([^`]+)`", head) or [head]
        tables |= {(document, row): keys for document in of for row in rows}
    return tables


TABLES = _tables()
"""Keys of documents and of their rows, as they are described."""


def read(text: str, of: str) -> dict[str, Any]:
    """Return the one document in a text, which has exactly the keys described for it, in order."""
    found: dict[str, Any] = json.loads(text)
    assert list(found) == TABLES["Every document has", ""] + TABLES[of, ""]
    _has_rows(found, of)
    return found


def _has_rows(found: dict[str, Any], of: str) -> None:
    """Check the keys of all rows in a document or a part of one."""
    for key, value in found.items():
        if isinstance(value, dict) and (key, "") in TABLES:
            assert list(value) == TABLES[key, ""]
            _has_rows(value, key)
        for row in value if isinstance(value, list) and of != "results" else []:
            if isinstance(row, dict):
                assert list(row) == (TABLES.get((of, key)) or TABLES["plan", key]), key
                _has_rows(row, of)


@pytest.mark.parametrize("name", sorted(set(ASKED) - {"schema"}))
def test_each_command_prints_one_document_and_nothing_else(
    name: str, capsys: Captured, monkeypatch: Patch
) -> None:
    words = ASKED[name]
    status, out, err = run(capsys, monkeypatch, *words, "--json")
    assert err == ""
    assert read(out, {"diagnose": "diagnose SCENARIO"}.get(name, name))["status"] == status == 0


@pytest.mark.parametrize("name", ["verify", "certify"])
def test_the_option_may_come_before_the_command(
    name: str, capsys: Captured, monkeypatch: Patch
) -> None:
    words = ASKED[name]
    after = run(capsys, monkeypatch, *words, "--json")
    assert run(capsys, monkeypatch, "--json", *words) == after
    assert run(capsys, monkeypatch, "--quiet", "--json", *words) == after


@pytest.mark.parametrize("words", [["schema"], *slow(["campaign", "--schema"])])
def test_a_schema_is_its_own_document(
    words: list[str], capsys: Captured, monkeypatch: Patch
) -> None:
    _, plain, _ = run(capsys, monkeypatch, *words)
    for manner in ("--json", "--quiet"):
        assert run(capsys, monkeypatch, *words, manner) == (0, plain, "")
    assert "$defs" in json.loads(plain)


@pytest.mark.parametrize("words", [[], ["--version"]])
def test_the_lists_of_names_are_documents_too(
    words: list[str], capsys: Captured, monkeypatch: Patch
) -> None:
    status, out, _ = run(capsys, monkeypatch, *words, "--json")
    found = read(out, "--version")
    assert (status, found["version"]) == (0, rho.__version__)
    assert set(found["commands"]) == set(ASKED)


def test_an_example_comes_inside_a_document(capsys: Captured, monkeypatch: Patch) -> None:
    _, out, _ = run(capsys, monkeypatch, "campaign", "--example", "--json")
    _, text, _ = run(capsys, monkeypatch, "campaign", "--example")
    assert read(out, "campaign --example")["content"] == text


@pytest.mark.parametrize(
    "words",
    [
        *([name, "--bogus"] for name in ASKED),
        *([name, "nowhere"] for name in ("plan", "fly", "simulate", "assign", "diagnose", "show")),
        *([name, "weak.yaml"] for name in ("verify", "certify", "results", "campaign")),
        *(["dance"], ["plan"], ["--bogus"], ["plan", "paper", "-o", "kept.csv"]),
        ["reproduce", "--figures", "plan.npz"],
    ],
    ids=" ".join,
)
def test_bad_input_is_a_document_of_status_2(
    words: list[str], capsys: Captured, monkeypatch: Patch
) -> None:
    _, _, complained = run(capsys, monkeypatch, *words)
    status, out, err = run(capsys, monkeypatch, *words, "--json")
    found = read(out, FAILED)
    assert (status, found["status"], err) == (2, 2, "")
    assert complained == f"drake-rho: {found['error']}\n"


@pytest.mark.parametrize("name", ["plan", *slow("fly", "simulate", "show")])
def test_no_plan_is_a_document_with_the_reason_and_the_remedies(
    name: str, capsys: Captured, monkeypatch: Patch
) -> None:
    status, out, err = run(capsys, monkeypatch, name, "weak.yaml", "--json")
    found = read(out, FAILED)
    assert (status, found["status"], err) == (3, 3, "")
    assert "acceleration box x" in found["error"]
    _agrees(found["diagnosis"], rho.diagnose(rho.load_scenario("weak.yaml")))


def _agrees(reported: dict[str, Any], expected: rho.Diagnosis) -> None:
    assert reported["feasible"] == expected.feasible
    assert reported["conflicts"] == {name: list(why) for name, why in expected.conflicts.items()}
    assert reported["shortest_duration_s"] == expected.shortest_duration
    assert reported["acceleration_factor"] == expected.acceleration_factor
    assert [each["excess"] for each in reported["violations"]] == [
        each.excess for each in expected.violations
    ]


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [(rho.SolverError("stuck"), 4, "stuck"), (KeyboardInterrupt(), 130, "interrupted")],
)
def test_failing_solvers_and_ctrl_c_have_documents_and_lines(
    error: BaseException, status: int, said: str, capsys: Captured, monkeypatch: Patch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("drake_rho.cli.planning.best_plan", fail)
    assert run(capsys, monkeypatch, "plan", "paper") == (status, "", f"drake-rho: {said}\n")
    left, out, _ = run(capsys, monkeypatch, "plan", "paper", "--json")
    assert (left, read(out, FAILED)) == (
        status,
        {"status": status, "error": said, "diagnosis": None},
    )


def test_ctrl_c_during_the_search_for_a_remedy_keeps_the_reason(
    capsys: Captured, monkeypatch: Patch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("drake_rho.cli.failures.diagnose", interrupted)
    status, out, err = run(capsys, monkeypatch, "plan", "weak.yaml")
    reason, last = err.splitlines()
    assert (status, out, last) == (130, "", "drake-rho: interrupted")
    assert "acceleration box x" in reason


@pytest.mark.slow
def test_a_plans_document_lists_its_figures(
    folder: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    _, out, _ = run(capsys, monkeypatch, *ASKED["plan"], "--figures", "drawn", "--json")
    drawn = {str(path.relative_to(folder)) for path in (folder / "drawn").iterdir()}
    assert drawn == set(read(out, "plan")["figures"])


def test_a_plans_document_describes_the_plan(capsys: Captured, monkeypatch: Patch) -> None:
    _, out, _ = run(capsys, monkeypatch, *ASKED["plan"], "--json")
    found, plan = read(out, "plan"), rho.load("kept.npz")
    assert isinstance(plan, rho.Plan)
    sphere = plan.scenario.bodies[0].shape
    assert isinstance(sphere, rho.Sphere)
    nearest = np.linalg.norm(plan.positions - sphere.center, axis=2).min() - sphere.radius
    assert found["cost"] == pytest.approx(np.sum(plan.accelerations**2))
    assert found["clearance_m"] == pytest.approx(nearest, abs=1e-6)  # the paper limits the knots
    assert found["step_s"] == plan.scenario.grid.step
    assert found["programs"] == plan.statistics.programs
    assert (found["kind"], found["windows"], found["file"]) == ("plan", None, "kept.npz")
    tightest = {each["constraint"] for each in found["tightest"]}
    assert {"goal position", "obstacle 1 at knots", "velocity box x upper"} <= tightest


def test_the_document_of_a_violating_plan_lists_all_violations(
    capsys: Captured, monkeypatch: Patch
) -> None:
    spheres = [rho.Sphere([5.0, 2.0, -1.0], 0.01 * size) for size in range(50, 150)]
    plan = rho.plan_convex(single())
    scenario = single(obstacles=spheres, between_knots=True)
    rho.save(rho.Plan.from_accelerations(scenario, plan.accelerations), "broken.npz")
    status, out, _ = run(capsys, monkeypatch, "verify", "broken.npz", "--json")
    found = read(out, "plan")
    assert (status, found["status"], found["ok"]) == (1, 1, False)
    assert len(found["violations"]) == 200
    assert not any(each["holds"] for each in found["violations"])
    assert max(each["excess"] for each in found["violations"]) == pytest.approx(1.49, abs=1e-3)
    assert found["clearance_m"] == pytest.approx(-1.49, abs=1e-3)


def test_a_flights_document_counts_its_windows(capsys: Captured, monkeypatch: Patch) -> None:
    _, out, _ = run(capsys, monkeypatch, "fly", "paper", "--replan-every", "10", "--json")
    found = read(out, "plan")
    flight = rho.plan_rho(rho.load_scenario("paper"), replan_every=10)
    assert (found["kind"], found["windows"]) == ("flight", len(flight.windows))
    assert found["cost"] == pytest.approx(flight.cost)


def test_a_simulations_document_reports_errors(capsys: Captured, monkeypatch: Patch) -> None:
    words = [*ASKED["simulate"], "-o", "flown.npz", "--json"]
    _, out, _ = run(capsys, monkeypatch, *words)
    found, flown = read(out, "plan"), rho.load("flown.npz")
    assert isinstance(flown, rho.Simulation)
    (row,) = found["errors"]
    assert row["error_m"] == pytest.approx(flown.errors().max())
    assert row["to_others_m"] is None
    distances = [
        each.distances(flown.positions[:, 0], flown.times).min() for each in flown.scenario.bodies
    ]
    assert row["to_obstacles_m"] == pytest.approx(
        min(distances) - flown.scenario.fleet.radii[0], abs=1e-6
    )
    assert found["wind"] == "noise; seed 1"


def test_a_certificate_is_that_of_the_python_function(capsys: Captured, monkeypatch: Patch) -> None:
    plan = rho.plan_convex(rho.load_scenario("paper"))
    rho.save(plan, "convex.npz")
    status, out, _ = run(capsys, monkeypatch, "certify", "convex.npz", "--json")
    found = read(out, "certify")
    expected = rho.certify(plan, solver=ClarabelSolver())  # default of commands
    assert status == 0
    assert found["gap"] > 0.19
    for name in ("cost", "lower_bound", "gap", "holds", "is_globally_optimal"):
        assert found[name] == pytest.approx(getattr(expected, name)), name
    assert [each["lower_bound"] for each in found["vehicles"]] == pytest.approx(
        [each.lower_bound for each in expected.vehicles]
    )
    _, words, _ = run(capsys, monkeypatch, "certify", "convex.npz")
    assert words == f"{expected}\n"


def test_an_exports_document_lists_its_files_and_deviations(
    folder: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    words = ["export", "plan.npz", "--format", "crazyswarm", "-o", "swarm"]
    _, out, _ = run(capsys, monkeypatch, *words, "--json")
    found = read(out, "export")
    written = {str(path.relative_to(folder)) for path in (folder / "swarm").iterdir()}
    assert set(found["files"]) == written
    assert set(found["deviations_m"]) == {"solo"}


def test_a_simulation_has_no_certificate(capsys: Captured, monkeypatch: Patch) -> None:
    run(capsys, monkeypatch, "simulate", "windy.yaml", "-o", "flown.npz")
    status, _, err = run(capsys, monkeypatch, "certify", "flown.npz")
    assert (status, err) == (
        2,
        "drake-rho: flown.npz: got a simulation, expected a plan or a flight\n",
    )


@pytest.mark.parametrize("limits", [WEAK, rho.Limits(acceleration=box(3.0))], ids=["weak", "able"])
def test_a_diagnosis_is_that_of_the_python_function(
    limits: rho.Limits, capsys: Captured, monkeypatch: Patch
) -> None:
    scenario = single(limits=limits)
    rho.save_scenario(scenario, "asked.yaml")
    expected = rho.diagnose(scenario)
    assert expected.feasible == (limits is not WEAK)
    status, out, _ = run(capsys, monkeypatch, "diagnose", "asked.yaml", "--json")
    assert status == 0
    _agrees(read(out, "diagnose SCENARIO")["diagnosis"], expected)
    assert run(capsys, monkeypatch, "diagnose", "asked.yaml") == (0, f"{expected}\n", "")


def test_assigned_goals_are_those_of_the_python_function(
    capsys: Captured, monkeypatch: Patch
) -> None:
    asked = rho.load_scenario("paper_assembly")
    _, out, _ = run(capsys, monkeypatch, *ASKED["assign"], "--json")
    found, better = read(out, "assign"), rho.assign_goals(asked)
    assert rho.load_scenario("kept.yaml") == better
    for scenario, reported in ((asked, found["effort_before"]), (better, found["effort"])):
        free = dataclasses.replace(
            scenario, limits=rho.Limits(), obstacles=(), separation=None, between_knots=False
        )
        assert reported == pytest.approx(rho.plan_convex(free).cost)
    for row, vehicle in zip(found["vehicles"], better.vehicles, strict=True):
        assert row["vehicle"] == vehicle.name
        assert row["goal_m"] == vehicle.goal.position.tolist()
        before = asked.vehicles[asked.index_of(row["goal_of"])]
        assert np.array_equal(before.goal.position, vehicle.goal.position)


def test_optimal_goals_are_kept(capsys: Captured, monkeypatch: Patch) -> None:
    run(capsys, monkeypatch, *ASKED["assign"])
    status, out, _ = run(capsys, monkeypatch, "assign", "kept.yaml")
    assert status == 0
    assert "every vehicle keeps its goal" in out


@pytest.mark.parametrize(
    "name",
    ["plan", "fly", "simulate", "assign", "verify", "show", "export", "campaign", "reproduce"],
)
def test_with_quiet_a_command_that_acts_prints_nothing(
    name: str, capsys: Captured, monkeypatch: Patch
) -> None:
    assert run(capsys, monkeypatch, *ASKED[name], "--quiet") == (0, "", "")


@pytest.mark.parametrize("name", ["certify", "diagnose", "results"])
def test_with_quiet_a_query_is_still_answered(
    name: str, capsys: Captured, monkeypatch: Patch
) -> None:
    words = ASKED[name]
    _, plain, _ = run(capsys, monkeypatch, *words)
    assert run(capsys, monkeypatch, *words, "--quiet") == (0, plain, "")
    assert plain


def test_with_quiet_an_error_is_still_one_line(capsys: Captured, monkeypatch: Patch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("searched for a remedy that was not requested")

    monkeypatch.setattr("drake_rho.cli.failures.diagnose", never)
    for words, expected in ((("plan", "nowhere"), 2), (("plan", "weak.yaml"), 3)):
        status, out, err = run(capsys, monkeypatch, *words, "--quiet")
        assert (status, out, err.count("\n")) == (expected, "", 1)


def test_arguments_after_two_dashes_are_no_options(capsys: Captured, monkeypatch: Patch) -> None:
    status, out, err = run(capsys, monkeypatch, "plan", "--", "--json")
    assert (status, out) == (2, "")
    assert "'--json'" in err
