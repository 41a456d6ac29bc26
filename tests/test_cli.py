"""The command line: exit statuses, one line for bad input, no half-written files."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import drake_rho as rho
from drake_rho import cli
from tests.scenarios import box, single, slow

Run = tuple[int, str, str]
Patch = pytest.MonkeyPatch

FROM_SCRATCH = """
name: two columns
grid: {step: 0.25, knots: 41}
vehicles:
  - name: scout
    start: {position: [0, 0, 1], acceleration: [0, 0, 0]}
    goal: {position: [20, 2, 3]}
    limits:
      velocity: {lower: [-6, -6, -2], upper: [6, 6, 2]}
  - name: cargo
    start: {position: [0, 4, 1], velocity: [1, 0, 0]}
    goal: {position: [20, -1, 2], velocity: [1, 0, 0]}
limits:
  position: {lower: [-1, -6, 0], upper: [21, 8, 6]}
  velocity: {lower: [-4, -4, -2], upper: [4, 4, 2]}
  acceleration: {lower: [-3, -3, -3], upper: [3, 3, 3]}
  jerk: {lower: [-6, -6, -6], upper: [6, 6, 6]}
obstacles:
  - {center: [7, 1, 1.5], radius: 1.5}
  - {center: [13, 1, 2], radius: 2}
"""


def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str) -> Run:
    """Run `drake-rho words` in this process."""
    monkeypatch.setattr(sys, "argv", ["drake-rho", *words])
    with pytest.raises(SystemExit) as left:
        cli.main()
    printed = capsys.readouterr()
    status = left.value.code
    assert isinstance(status, int)
    return status, printed.out, printed.err


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    """Write a scenario from scratch."""
    path = tmp_path / "scenario.yaml"
    path.write_text(FROM_SCRATCH)
    return path


@pytest.mark.parametrize("words", [["plan"], *slow(["plan", "--method", "scp"]), ["fly"]])
def test_a_scenario_from_scratch_is_planned_saved_and_verified(
    words: list[str],
    scenario_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = tmp_path / "kept.npz"
    status, out, _ = run(capsys, monkeypatch, *words, str(scenario_file), "-o", str(kept))
    assert status == 0, out
    assert "two columns: all constraints hold" in out
    assert isinstance(rho.load(kept), rho.Flight if words == ["fly"] else rho.Plan)
    status, out, _ = run(capsys, monkeypatch, "verify", str(kept))
    assert status == 0
    assert "obstacle 2" in out


@pytest.mark.parametrize(
    ("words", "name"), [("clarabel", "Clarabel"), ("osqp", "OSQP"), ("daqp", "DAQP")]
)
def test_a_solver_is_chosen_by_its_name(
    words: str,
    name: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = tmp_path / "kept.npz"
    command = ["plan", "paper", "--solver", words, "-o", str(kept)]
    status, out, _ = run(capsys, monkeypatch, *command)
    assert status == 0, out
    plan = rho.load(kept)
    assert isinstance(plan, rho.Plan)
    assert plan.statistics.solver == name


def test_a_plan_that_violates_a_constraint_exits_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = rho.plan_convex(single())
    sphere = rho.Sphere([5.0, 2.0, -1.0], 1.0)
    broken = rho.Plan.from_accelerations(single(obstacles=(sphere,)), plan.accelerations)
    rho.save(broken, tmp_path / "broken.npz")
    status, out, _ = run(capsys, monkeypatch, "verify", str(tmp_path / "broken.npz"))
    assert status == 1
    assert "solo" in out
    assert "obstacle 1" in out


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["plan", "nowhere"], "'nowhere'"),
        (["plan", "paper", "-o", "nowhere/plan.npz"], "nowhere"),
        (["plan", "paper", "--step", "0.3"], "divides"),
        (["plan", "paper", "--method", "scp", "--step", "0.5"], "--step"),
        (["plan", "paper", "--duration", "49"], "--duration"),
        (["fly", "paper", "--step", "0.5"], "--step"),
        (["show", "paper", "--world", "w.csv"], "--world"),
        (["plan", "nowhere.json"], "'nowhere.json'"),
        (["import", "nowhere.plan", "-o", "s.yaml"], "nowhere.plan: got no text, expected a"),
        (
            ["import", __file__, "-o", "s.yaml"],
            "got another file (not JSON), expected a mission of QGr",
        ),
        (["plan", "nowhere.plan"], "expected a readable mission (.plan or .waypoints)"),
        (["export", "x.npz", "-o", "none/x.plan"], "drake-rho: --output: got 'none/x.plan'"),
        (["import", "m.plan"], "no --output, expected --output FILE"),
        (["import", "m.plan", "-o", "s.npz"], "ending in .yaml"),
        (["fly", "paper", "--replan-every", "0"], "replan_every"),
        (["fly", "paper", "--replan-every", "x"], "--replan-every"),
        (["fly", "paper", "--bogus"], "--bogus"),
        (["verify", __file__], "not a plan or flight"),
        (["verify", "missing.npz"], "No such file"),
        (["export", "plan.npz"], "no --output, expected --output PATH"),
        (["export", "plan.npz", "-o", "x.csv"], "expected one of csv, px4"),
        (["export", "plan.npz", "-o", "x.mp3"], "expected one of csv, json, crazyswarm"),
        (["export", "plan.npz", "--format", "csv"], "no --output, expected --output PATH"),
        (["plan"], "SCENARIO"),
        (["dance"], "dance"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    words: list[str],
    complaint: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    status, out, err = run(capsys, monkeypatch, *words)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert complaint in err


@pytest.mark.parametrize("command", ["plan", "fly", "simulate", "diagnose", "show"])
@pytest.mark.parametrize(
    ("mistyped", "nearest"),
    [
        ("papper", "paper"),
        ("paper-assembly", "paper_assembly"),
        ("mision.yaml", "mission.yaml"),
        ("folder/mission.yaml", "folder/missions.yml"),
        ("nowhere", None),
        ("nowhere/mission.yaml", None),
    ],
)
def test_of_an_unknown_scenario_the_nearest_name_is_suggested(
    command: str,
    mistyped: str,
    nearest: str | None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: Patch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    for name in ("mission.yaml", "mission.yaml.txt", "folder/missions.yml"):
        Path(name).touch()
    status, out, err = run(capsys, monkeypatch, command, mistyped)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"got {mistyped!r}, expected a library scenario (courier, paper, " in err
    assert ("did you mean" in err) == (nearest is not None)
    assert nearest is None or err.endswith(f"; did you mean {nearest!r}?\n")


@pytest.mark.parametrize("command", ["plan", "fly", *slow("fastest"), "assign"])
def test_commands_take_the_scenario_of_a_result(
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = dataclasses.replace(rho.load_scenario("courier"), disturbance=None)
    rho.save_scenario(scenario, tmp_path / "courier.yaml")
    plan = rho.plan(scenario)
    rho.save(plan, tmp_path / "plan.npz")
    rho.export(plan, tmp_path / "plan.json", format="json")
    costs = list[object]()
    for name in ("courier.yaml", "plan.npz", "plan.json"):
        status, out, _ = run(capsys, monkeypatch, command, str(tmp_path / name), "--json")
        found = json.loads(out)
        costs.append(found["effort" if command == "assign" else "cost"])
        assert status == found["status"] == 0
    assert costs == [costs[0]] * 3


@pytest.mark.slow
def test_texts_in_a_pipe_have_at_most_a_hundred_columns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = rho.load_scenario("courier")
    (courier,) = scenario.vehicles
    named = dataclasses.replace(courier, name="courier of the morning round, north of the river")
    tree = rho.Obstacle(rho.Sphere([2, 0, 1], 0.3), name="the old lime tree beside the chapel")
    changed = dataclasses.replace(
        scenario, vehicles=(named,), obstacles=(*scenario.obstacles, tree), name="a long name " * 3
    )
    mission, flight = tmp_path / "mission.yaml", tmp_path / "flight.npz"
    rho.save_scenario(changed, mission)
    for words in (
        f"fly {mission} -o {flight}",
        f"verify {flight} --all",
        f"simulate {mission} --wind worst",
        f"diagnose {mission}",
        f"fastest {mission}",
        "diagnose paper",
        "reproduce --figures figures",
    ):
        monkeypatch.chdir(tmp_path)
        _, out, _ = run(capsys, monkeypatch, *words.split())
        assert max(map(len, out.splitlines())) <= 100, words


@pytest.mark.parametrize("content", ["", "# nothing yet\n", "---\n"])
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["plan", "empty.yaml"], "a scenario in YAML; 'drake-rho schema' prints its fields"),
        (["show", "./empty.yaml"], "a scenario in YAML; 'drake-rho schema' prints its fields"),
        (
            ["campaign", "./empty.yaml", "--store", "runs.sqlite"],
            "a study in YAML; 'drake-rho campaign --schema' prints its fields",
        ),
    ],
)
def test_an_empty_file_is_named_as_such(
    words: list[str],
    expected: str,
    content: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: Patch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty.yaml").write_text(content)
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, out) == (2, "")
    assert err.endswith(f"empty.yaml: got an empty file, expected {expected}\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "words", [["verify"], ["certify"], ["export", "--format", "json", "-o", "again.json"]]
)
def test_a_table_of_states_is_refused_with_the_kinds_of_files_that_are_expected(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Patch
) -> None:
    monkeypatch.chdir(tmp_path)
    rho.export(rho.plan_convex(single()), "plan.csv", format="csv")
    status, out, err = run(capsys, monkeypatch, *words, "plan.csv")
    assert (status, out) == (2, "")
    expected = "a file saved by plan, fly or simulate (.npz), or a plan exported as JSON (.json)"
    got = "a table of states (CSV), which has no scenario"
    if words != ["certify"]:  # which take trajectories too
        got, expected = "trajectories without their scenario", "it too: --scenario FILE"
    assert err == f"drake-rho: plan.csv: got {got}, expected {expected}\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["plan", "paper", "-o", "folder.npz"], "--output: got 'folder.npz', expected"),
        (["plan", "paper", "-o", "folder.npz"], "(not a regular file)"),
        (["plan", "paper", "-o", "."], "--output: got '.', expected"),
        (["plan", "paper", "-o", ""], "--output: got '', expected a file to write, ending in .npz"),
        (["plan", "paper", "-o", "room.csv"], "got 'room.csv', expected"),
        (["plan", "paper", "-o", "room"], "got 'room', expected"),
        (["fly", "paper", "-o", "room.tar.gz"], "got 'room.tar.gz', expected"),
        (["plan", "paper", "-o", "a\0b.npz"], "--output: got 'a\\x00b.npz', expected"),
        (["plan", "paper", "-o", "loop.npz"], "(Too many levels of symbolic links)"),
        (["plan", "paper", "-o", "loop.npz/plan.npz"], "(Too many levels of symbolic links)"),
        (["plan", "paper", "-o", "file.yaml/plan.npz"], "(Not a directory)"),
        (["plan", "paper", "-o", "a" * 300 + ".npz"], "(File name too long)"),
        (["plan", "paper", "-o", "/proc/plan.npz"], "--output: got '/proc/plan.npz', expected"),
        (["plan", "paper", "--figures", "file.yaml"], "--figures: got 'file.yaml', expected"),
        (["plan", "paper", "--figures", "file.yaml/x"], "--figures: got 'file.yaml/x', expected"),
        (["fly", "paper", "--figures", ""], "--figures: got '', expected a folder"),
        (["assign", "paper", "-o", "room.npz"], "ending in .yaml or .yml"),
        (["reproduce", "--figures", "loop.npz"], "--figures: got 'loop.npz', expected"),
        (["show", "paper", "--html", "room.png"], "--html: got 'room.png', expected"),
        (["show", "paper", "--html", "room"], "a file to write, ending in .html or .htm"),
        (["show", "paper", "--html", "nowhere/x.html"], "--html: got 'nowhere/x.html', expected"),
        (
            ["show", "paper", "--film", "film.avi"],
            "--film: got 'film.avi', expected a file to write",
        ),
        (["show", "paper", "--film", "nowhere/x.gif"], "--film: got 'nowhere/x.gif', expected"),
        (["show", "paper", "--host", ""], "--host: got '', expected"),
        (["show", "paper", "--host", " "], "--host: got ' ', expected"),
        (["show", "paper", "--port", "80"], "'--port'"),
        (["show", "paper", "--rate", "1e300"], "--rate: got 1e+300, expected 0.01 to 1000"),
        (["show", "paper", "--rate", "0"], "--rate: got 0, expected 0.01 to 1000"),
        (["show", "paper", "--rate", "-1"], "--rate: got -1, expected 0.01 to 1000"),
        (["show", "paper", "--rate", "nan"], "--rate: got nan, expected 0.01 to 1000"),
        (["show", "paper", "--rate", "inf"], "--rate: got inf, expected 0.01 to 1000"),
    ],
)
def test_output_that_cannot_be_written_is_refused_before_planning(
    words: list[str],
    complaint: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("planned before all arguments were checked")

    for module, names in (
        ("commands", ("best_plan", "plan_rho", "run_study")),
        ("planning", ("best_plan", "plan_convex", "plan_rho")),
        ("assign", ("assignment",)),
    ):
        for name in names:
            monkeypatch.setattr(f"drake_rho.cli.{module}.{name}", never)
    monkeypatch.chdir(tmp_path)
    Path("folder.npz").mkdir()
    Path("file.yaml").touch()
    Path("loop.npz").symlink_to("loop.npz")
    before = sorted(tmp_path.iterdir())
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert complaint in err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("words", [[], ["--quiet"]])
def test_without_arguments_the_command_lists_what_it_offers(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    listed = set(re.findall(r"^  (\w+)  +\S", out, flags=re.MULTILINE))
    commands = json.loads(run(capsys, monkeypatch, "--json")[1])["commands"]
    assert listed == set(commands)
    assert "drake-rho plan paper -o plan.npz" in out


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["60", "200"])
def test_tables_fit_a_terminal_and_have_full_lines_in_a_pipe(columns: str) -> None:
    def printed(words: str, **environment: str) -> list[str]:
        ran = subprocess.run(
            [sys.executable, "-m", "drake_rho", *words.split()],
            env=os.environ | {"COLUMNS": columns} | environment,
            capture_output=True,
            text=True,
            check=True,
        )
        lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", ran.stdout).splitlines()
        return [line.rstrip() for line in lines]

    explained = "Explain why there is no plan, or which limits make a plan so long."
    in_full = re.compile(rf"^  diagnose +{re.escape(explained)}$", flags=re.MULTILINE)
    assert in_full.search("\n".join(printed("")))
    on_terminal = printed("", FORCE_COLOR="1")
    assert max(map(len, on_terminal)) <= int(columns)
    assert bool(in_full.search("\n".join(on_terminal))) == (columns == "200")
    assert explained in " ".join(" ".join(on_terminal).split())
    (goal,) = (line for line in printed("assign paper_assembly") if line.startswith("UAV-1 "))
    assert re.fullmatch(r"UAV-1 +UAV-\d +[-\d.]+ +[-\d.]+ +[-\d.]+", goal)


def test_the_version_is_that_of_the_package(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = (0, f"drake-rho {importlib.metadata.version('drake-rho')}\n", "")
    assert run(capsys, monkeypatch, "--version") == expected
    assert expected[1].split()[1] == rho.__version__


def _completed(*words: str) -> list[str]:
    """Return the completions that a shell offers for the last word."""
    environment = {"COMP_WORDS": shlex.join(words), "COMP_CWORD": str(len(words) - 1)}
    code = "import sys; sys.argv[0] = 'drake-rho'; from drake_rho.cli import main; main()"
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | environment | {"_DRAKE_RHO_COMPLETE": "complete_bash"},
        capture_output=True,
        text=True,
        check=True,
    )
    return ran.stdout.split()


@pytest.mark.slow
def test_shells_complete_commands_options_and_scenarios() -> None:
    assert _completed("drake-rho", "pl") == ["plan"]
    assert _completed("drake-rho", "fly", "pa") == ["paper", "paper_assembly"]
    assert _completed("drake-rho", "verify", "x.npz", "--q") == ["--quiet"]


@pytest.mark.slow
@pytest.mark.parametrize("width", [50, 80])
def test_a_report_fits_a_narrow_terminal(width: int) -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "drake_rho", "plan", "paper"],
        env=os.environ | {"FORCE_COLOR": "1", "COLUMNS": str(width)},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", ran.stdout).splitlines()
    assert max(map(len, lines)) <= width
    assert any(re.search(r"UAV-3 +18 +23\.6 m/s", each) for each in lines)


def test_no_plan_is_a_diagnosis_and_status_3(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rho.save_scenario(single(limits=rho.Limits(acceleration=box(0.3))), tmp_path / "s.yaml")
    kept = tmp_path / "kept.npz"
    status, _, err = run(capsys, monkeypatch, "plan", str(tmp_path / "s.yaml"), "-o", str(kept))
    assert status == 3
    assert "acceleration box x" in err.splitlines()[0]
    assert "a duration of 11.5" in err
    assert "acceleration: ±0.625" in err
    assert err.count("\n") <= 12
    assert not kept.exists()


def test_a_method_without_a_plan_names_the_method_that_has_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead = rho.Sphere([5.0, 2.0, -1.0], 2.0)  # its centre is on the straight path
    scenario = single(limits=rho.Limits(velocity=box(2.2)), obstacles=[ahead])
    rho.save_scenario(scenario, tmp_path / "s.yaml")
    words = ("plan", str(tmp_path / "s.yaml"))
    assert run(capsys, monkeypatch, *words)[0] == 0
    status, out, err = run(capsys, monkeypatch, *words, "--method", "convex")
    assert (status, out) == (3, "")
    assert "another reference" in err.splitlines()[0]
    assert "there is a plan" in err.splitlines()[1]
    assert len(err.splitlines()) == 2


def test_a_plan_with_a_dip_between_knots_exits_1_and_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    paper = rho.load_scenario("paper")
    careful = dataclasses.replace(paper, between_knots=True)
    dipping = dataclasses.replace(rho.plan_scp(paper), scenario=careful)
    rho.save(dipping, tmp_path / "dip.npz")
    status, out, _ = run(capsys, monkeypatch, "verify", str(tmp_path / "dip.npz"))
    assert status == 1
    assert re.search(r"obstacle 1 at all times +UAV-3 +31\.49\d+ +-3\.5\d m +VIOLATED", out)
    every = run(capsys, monkeypatch, "verify", str(tmp_path / "dip.npz"), "--all")[1]
    assert "dynamics position" in every
    assert "dynamics position" not in out


def _with_reader(reader: str, *words: str, python: str = "-s") -> tuple[str, str]:
    """Return both exit statuses, and stderr, of `drake-rho words` piped into `reader`."""
    command = shlex.join([sys.executable, python, "-m", "drake_rho", *words])
    script = f"{command} {reader}; echo ${{PIPESTATUS[@]}} >&2"
    ran = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)  # noqa: S607  # any bash
    *complaints, statuses = ran.stderr.splitlines()
    return statuses, "\n".join(complaints)


@pytest.mark.parametrize(
    "words",
    [
        ["plan", "paper"],
        *slow(
            *(
                ["--help"],
                ["schema"],
                ["fly", "paper"],
                ["plan", "--help"],
                ["verify", "{}/plan.npz"],
            ),
            ["show", "{}/plan.npz", "--html", "{}/page.html"],
            ["reproduce", "--figures", "{}/figures", "--width", "3"],
        ),
    ],
    ids=" ".join,
)
def test_a_reader_that_closes_early_is_status_141_without_a_message(
    words: list[str], tmp_path: Path
) -> None:
    rho.save(rho.plan_convex(single()), tmp_path / "plan.npz")
    words = [word.format(tmp_path) for word in words]
    assert _with_reader("| true", *words) == ("141 0", "")


@pytest.mark.slow
def test_a_reader_of_unbuffered_output_may_close_early() -> None:
    assert _with_reader("| true", "schema", python="-u") == ("141 0", "")


@pytest.mark.slow
def test_a_reader_that_closes_amid_the_output_is_status_141(tmp_path: Path) -> None:
    plan = rho.plan_convex(single())
    spheres = [rho.Sphere([5.0, 2.0, -1.0], 0.001 * size) for size in range(100, 400)]
    broken = rho.Plan.from_accelerations(single(obstacles=spheres), plan.accelerations)
    rho.save(broken, tmp_path / "broken.npz")  # whose report is longer than a pipe's buffer
    words = ("verify", str(tmp_path / "broken.npz"), "--json")
    assert _with_reader("| head -c 9", *words) == ("141 0", "")


@pytest.mark.slow
def test_error_messages_that_nobody_reads_are_status_141() -> None:
    assert _with_reader("2>&1 | true", "plan", "nowhere") == ("141 0", "")


@pytest.mark.slow
def test_output_that_cannot_be_written_is_one_line_and_status_2() -> None:
    complaint = "drake-rho: [Errno 28] No space left on device"
    assert _with_reader("> /dev/full", "schema") == ("2", complaint)
    assert _with_reader(">&-", "schema") == ("0", "")


@pytest.mark.slow
def test_a_reader_that_closes_early_loses_no_plan(tmp_path: Path) -> None:
    kept = tmp_path / "kept.npz"
    assert _with_reader("| true", "plan", "paper", "-o", str(kept)) == ("141 0", "")
    assert isinstance(rho.load(kept), rho.Plan)


@pytest.mark.slow
def test_a_terminal_without_greek_or_superscripts_works(tmp_path: Path) -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "drake_rho", "plan", "paper"],
        capture_output=True,
        env={"PYTHONIOENCODING": "ascii"},
        check=False,
    )
    assert ran.returncode == 0
    assert b"m/s?" in ran.stdout


@pytest.mark.slow
def test_a_terminal_of_width_zero_and_names_like_markup_work(tmp_path: Path) -> None:
    scenario = dataclasses.replace(single(), name="[/b] [red] :x:")
    rho.save(rho.plan_convex(scenario), tmp_path / "plan.npz")
    for words in (("verify", str(tmp_path / "plan.npz")), ("plan", "[/b] [red] :x:")):
        ran = subprocess.run(
            [sys.executable, "-m", "drake_rho", *words],
            capture_output=True,
            text=True,
            env={"COLUMNS": "0"},
            check=False,
        )
        assert "[/b] [red] :x:" in ran.stdout + ran.stderr


def test_the_schema_is_json(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    status, out, _ = run(capsys, monkeypatch, "schema")
    assert status == 0
    assert json.loads(out)["title"] == "Scenario"


@pytest.mark.slow  # in another format: tests/test_figures_published.py
@pytest.mark.parametrize("command", ["plan", "fly"])
def test_figures_of_the_result_are_written_to_the_given_folder(
    command: str,
    scenario_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = tmp_path / "drawn"
    words = (command, str(scenario_file), "--figures", str(folder))
    status, out, _ = run(capsys, monkeypatch, *words)
    assert status == 0
    names = ["paths.png", "distances.png", "velocities.png", "accelerations.png"]
    told = " ".join(out.split())  # long paths have lines of their own
    assert f"{', '.join(names)} in {folder}" in told
    assert {path.name for path in folder.iterdir()} == set(names)


def test_reproduce_writes_sixteen_figures_and_the_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drake_rho.paper.figures.draw_figure", lambda *_, **__: Figure())
    folder = tmp_path / "[bold]"
    status, out, _ = run(capsys, monkeypatch, "reproduce", "--figures", str(folder))
    assert 80 < max(map(len, out.splitlines())) <= 100  # in a pipe
    assert status == 0
    assert len(list(folder.iterdir())) == 16
    assert f"16 figures in {folder}" in out
    assert "17027.239" in out
    assert "greatly reduces" in out


@pytest.mark.parametrize("command", ["plan", "fly"])
def test_an_invalid_bound_on_memory_is_refused(
    command: str,
    scenario_file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words = (command, str(scenario_file), "--max-memory")
    status, _, err = run(capsys, monkeypatch, *words, "1e6")
    assert status == 2
    assert "max_memory: got 1000000.0, expected" in err
    assert run(capsys, monkeypatch, *words, "2e7")[0] == 0


@pytest.mark.slow
def test_the_package_runs_as_a_module() -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "drake_rho", "plan", "nowhere"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 2
    assert "Traceback" not in ran.stderr
