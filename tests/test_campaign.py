"""Campaigns: every run exactly once, whatever fails, and the store that records it."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections import defaultdict
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver

import drake_rho as rho
from drake_rho.campaigns import runs as runs_of_campaigns
from drake_rho.campaigns.campaign import CampaignError, SoFar
from drake_rho.campaigns.distributions import Choice
from drake_rho.campaigns.runs import Run, do, generators
from drake_rho.campaigns.sources import FromFile
from drake_rho.campaigns.store import Store, StoreError
from drake_rho.campaigns.workers import Workers
from tests.scenarios import fleet, single, slow
from tests.studies import own, own_trajectories, small, table, text_of


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Any, ...]]:
    """Return the rows of an undisturbed campaign."""
    path = tmp_path_factory.mktemp("undisturbed") / "runs.sqlite"
    rho.campaign(small(), path)
    return table(path)


def test_every_run_has_a_row_and_is_verified(
    expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    results = rho.campaign(small(), tmp_path / "runs.sqlite")
    assert table(tmp_path / "runs.sqlite") == expected
    assert len(results) == len(small()) == len(expected)
    by_key = {run.key: run for run in small().runs()}
    statuses = set()
    for row in table(tmp_path / "runs.sqlite", ("key", "status", "verified", "cost")):
        key, status, verified, cost = row
        statuses.add(status)
        run = by_key.pop(key)
        chance, _ = generators(run.seed)
        source = small().scenarios[run.seed[1]]
        assert not isinstance(source, FromFile)
        scenario = source.drawn(chance)
        try:
            planner = rho.plan if run.method == "best" else rho.plan_convex
            plan = planner(scenario, solver=ClarabelSolver())  # default of methods
        except rho.InfeasibleError:
            assert (status, verified, cost) == ("infeasible", 0, None)
        else:
            assert (status, cost, bool(verified)) == ("solved", plan.cost, rho.verify(plan).ok)
    assert statuses == {"solved", "infeasible"}
    assert not by_key


def test_finished_runs_are_not_repeated(
    expected: list[tuple[Any, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "runs.sqlite"
    rho.campaign(small(2), path)
    done = list[str]()

    def counted(run: Run) -> runs_of_campaigns.Done:
        done.append(run.key)
        return do(run)

    monkeypatch.setattr(runs_of_campaigns, "do", counted)
    before = {key for (key,) in table(path, ("key",))}
    rho.campaign(small(4), path)
    assert table(path) == expected
    assert set(done) == {row[0] for row in expected} - before
    assert len(done) == len(set(done)) == len(small(4)) - len(small(2))


@pytest.mark.parametrize("after", [0, 1, 5])
def test_an_interrupted_campaign_resumes(
    after: int, expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    path = tmp_path / "runs.sqlite"

    def interrupt(now: SoFar) -> None:
        if now.done >= after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rho.campaign(small(), path, progress=interrupt)
    rows = table(path)
    assert after <= len(rows) < len(expected)
    assert set(rows) <= set(expected)
    seen = list[SoFar]()
    rho.campaign(small(), path, progress=seen.append)
    assert table(path) == expected
    assert seen[0].done == len(rows)
    failed = sum(row[0] for row in table(path, ("NOT verified",)))
    assert seen[-1] == SoFar(len(expected), failed, len(expected))


def test_any_executor_gives_the_same_rows(expected: list[tuple[Any, ...]], tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as threads:
        rho.campaign(small(), tmp_path / "threads.sqlite", executor=threads)
    assert table(tmp_path / "threads.sqlite") == expected


@pytest.mark.slow
def test_a_killed_worker_is_replaced(expected: list[tuple[Any, ...]], tmp_path: Path) -> None:
    killed = list[int]()

    def kill(now: SoFar) -> None:
        if now.done and not killed:
            killed.append(int(multiprocessing.active_children()[0].pid or 0))
            os.kill(killed[0], signal.SIGKILL)

    with Workers(2) as workers:
        rho.campaign(small(8), tmp_path / "runs.sqlite", executor=workers, progress=kill)
    assert killed
    rows = table(tmp_path / "runs.sqlite")
    assert set(expected) <= set(rows)
    assert len(rows) == len(small(8))
    assert {row[5] for row in rows} == {"solved", "infeasible"}


class Deadly(Executor):
    """Executor whose processes die of some runs: of some always, of others a number of times."""

    at_once = 4

    def __init__(self, times: dict[str, float]) -> None:
        self.times, self.attempts = times, defaultdict[str, int](int)

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return the result at once, or the error of a dead process."""
        future: Future[Any] = Future()
        chunk, attempt = args
        for run in chunk:
            assert self.attempts[run.key] == attempt
            assert len(chunk) == 1 or attempt == 0
            self.attempts[run.key] += 1
        if any(attempt < self.times.get(run.key, 0) for run in chunk):
            future.set_exception(BrokenProcessPool("died"))
        else:
            future.set_result(fn(*args))
        return future


def test_only_the_run_that_kills_its_process_is_recorded_as_the_cause(
    expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    first, second, third, deadly, *_ = (run.key for run in small().runs())
    executor = Deadly({first: 1, second: 2, third: 3, deadly: np.inf})
    rho.campaign(small(), tmp_path / "runs.sqlite", executor=executor)
    assert [path.name for path in tmp_path.iterdir()] == ["runs.sqlite"]
    rows = table(tmp_path / "runs.sqlite")
    assert len(rows) == len(expected)
    (other,) = set(rows) - set(expected)
    assert other[0] == deadly
    assert other[5:8] == ("error", "its worker process died 4 times", 0)
    assert executor.attempts[deadly] == 4


def test_a_failing_executor_ends_the_campaign_without_loss(
    expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    path, pool = tmp_path / "runs.sqlite", ThreadPoolExecutor(1)

    def stop(now: SoFar) -> None:
        if now.done:
            pool.shutdown(cancel_futures=True)

    with pytest.raises(CampaignError, match=r"executor: .*arlier results are kept"):
        rho.campaign(small(), path, executor=pool, progress=stop)
    assert 0 < len(table(path)) < len(expected)
    rho.campaign(small(), path)
    assert table(path) == expected


def test_a_run_that_raises_anything_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("on\nuse")

    monkeypatch.setattr("drake_rho.campaigns.methods.evaluate", broken)
    rho.campaign(small(1), tmp_path / "runs.sqlite")
    found = table(tmp_path / "runs.sqlite", ("status", "reason"))
    wrong = [words for words in found if words[0] != "infeasible"]
    assert wrong == [("error", "ZeroDivisionError: on use")] * len(wrong)
    assert len(wrong) >= 2


@pytest.mark.parametrize("processes", [False, *slow(True)])
def test_functions_are_methods(
    processes: bool, expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    """Given by name or as an object, here or on processes, a function equals its method."""
    names = ("method", "scenario", "repetition", "status", "reason", "verified", "cost", "programs")
    methods: list[dict[str, Any]] = [
        {"name": "best", "planner": "function", "function": "drake_rho:plan"},
        {"name": "convex", "planner": "function", "function": rho.plan_convex},
    ]
    rho.campaign(small(), tmp_path / "methods.sqlite")
    with Workers(1) if processes else nullcontext() as workers:
        functions = small(methods=methods)
        results = rho.campaign(functions, tmp_path / "runs.sqlite", executor=workers)
    found = table(tmp_path / "runs.sqlite", names)
    assert sorted(found) == sorted(table(tmp_path / "methods.sqlite", names))
    assert {row.key for row in results.rows()}.isdisjoint(row[0] for row in expected)


def test_misbehaviour_of_a_function_is_recorded_in_its_row(tmp_path: Path) -> None:
    by_own = {"planner": "function", "function": own}
    wrongs = "", "late", "nothing", "another", "separation"
    methods = [
        {"name": wrong or "right", **by_own, "arguments": {"wrong": wrong}} for wrong in wrongs
    ]
    other = {"planner": "function", "function": own_trajectories}
    methods += [
        {"name": name, **other, "arguments": {"sampled": name == "samples"}}
        for name in ("trajectories", "samples")
    ]
    crossing = fleet([[-5, 0, 0], [0, -5, 0]], [[5, 0, 0], [0, 5, 0]])
    given = [{"name": "crossing", "scenario": crossing}]
    results = rho.campaign(small(1, scenarios=given, methods=methods), tmp_path / "runs.sqlite")
    rows = {row.method: row for row in results.rows()}
    assert (rows["late"].status, rows["late"].reason) == ("error", "TimeoutError: not done in 0 s")
    assert rows["nothing"].status == "error"
    assert (
        "got NoneType, expected a plan, flight, simulation or trajectories"
        in rows["nothing"].reason
    )
    assert rows["another"].status == "error"
    assert "got a plan of another scenario" in rows["another"].reason
    assert rows["separation"].status == "solved"
    assert rows["separation"].reason.startswith("separation of v")
    assert rows["samples"].reason.endswith(", undecided")
    assert rows["trajectories"].cost == pytest.approx(rows["right"].cost)
    holding = [row.method for row in rows.values() if row.verified]
    assert holding == ["right", "trajectories"]


@pytest.mark.slow
def test_times_and_memory_are_those_of_the_run(tmp_path: Path) -> None:
    by_own = {"planner": "function", "function": own}
    methods = [
        {"name": f"{taken}", **by_own, "arguments": {"megabytes": taken}} for taken in (0, 300)
    ]
    with Workers(1) as workers:
        study = small(methods=methods)
        results = rho.campaign(study, tmp_path / "runs.sqlite", executor=workers)
    rows = list(results.rows())
    assert {row.status for row in rows} == {"solved", "infeasible"}
    for row in rows:
        assert row.plan_seconds is not None
        assert row.run_seconds is not None
        assert (row.verify_seconds is None) == (row.status == "infeasible")
        assert 0.0 < row.plan_seconds + (row.verify_seconds or 0.0) < row.run_seconds
    before, after = (next(row for row in rows if row.method == name) for name in ("0", "300"))
    assert before.megabytes is not None
    assert after.megabytes is not None
    assert 290.0 < after.megabytes - before.megabytes < 400.0


_INSIDE = "vehicles[0].start.position"


def test_a_draw_that_is_no_valid_scenario_is_a_row(tmp_path: Path) -> None:
    vary = {_INSIDE: Choice(([4.0, 0.5, 0.0], [0.0, 0.0, 0.0]))}
    source = dataclasses.replace(small().scenarios[1], vary=vary)
    rho.campaign(small(8, scenarios=[source]), tmp_path / "runs.sqlite")
    rows = table(tmp_path / "runs.sqlite", ("status", "reason"))
    assert {status for status, _ in rows} >= {"invalid", "solved"}
    for status, reason in rows:
        assert (_INSIDE in reason) == (status == "invalid")


def test_a_source_without_any_draw_ends_the_campaign_before_it_begins(
    tmp_path: Path,
) -> None:
    good, past = small().scenarios
    source = dataclasses.replace(past, vary={_INSIDE: Choice(([4.0, 0.5, 0.0],))})
    words = (
        r"scenarios\[1\]: got no scenario in 3 draws of 'past', expected at least one valid "
        r"scenario; the last draw: vehicles\[0\]\.start\.position: got \[4\.0, 0\.5, 0\.0\],"
    )
    with pytest.raises(rho.ScenarioError, match=words):
        rho.campaign(small(3, scenarios=[good, source]), tmp_path / "runs.sqlite")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("repetitions", [1, *slow(3)])
def test_flights_in_wind_are_verified_by_their_true_motion(
    repetitions: int, tmp_path: Path
) -> None:
    source = {
        "name": "pair",
        "generator": "random_transitions",
        "parameters": {"n": 2, "duration": 5.0},
        "vary": {"disturbance": {"choice": [{"acceleration": 0.1, "feedback_every": 0.1}]}},
    }
    winds = [
        {"wind": "gust", "duration": 2.0},
        {"wind": "constant"},
        {"wind": "coloured_noise"},
        {"wind": "constant", "direction": [1, 0, 0]},
    ]
    methods = [
        {"name": str(number), "planner": "simulate", "wind": wind}
        for number, wind in enumerate(winds)
    ]
    study = small(repetitions, scenarios=[source], methods=methods, plans=True)
    results = rho.campaign(study, tmp_path / "runs.sqlite")
    names = ("key", "verified", "tube_share", "separation_clearance")
    rows = table(tmp_path / "runs.sqlite", names)
    assert len(rows) == 4 * repetitions
    for key, verified, share, apart in rows:
        flown = results.plan(key)
        assert isinstance(flown, rho.Simulation)
        separation = flown.scenario.separation
        assert separation is not None
        away = separation.scaled(flown.positions[:, 0] - flown.positions[:, 1])
        at_samples = np.linalg.norm(away, axis=1).min() - separation.distance
        assert at_samples - 1e-3 < apart <= at_samples + 1e-9
        errors, radii = flown.errors().max(axis=1), flown.radii()
        wide = radii > 0.0
        assert share == pytest.approx(np.max(errors[wide] / radii[wide]))
        assert np.all(errors <= radii + 1e-6 * np.abs(flown.positions).max())
        assert verified
        assert 0.0 < share <= 1.0 + 1e-9


def test_methods_fly_with_contingencies_late_plans_and_bounded_costs(tmp_path: Path) -> None:
    """A wall seen in flight is known to windows whose planning begins later."""
    wall = {
        "shape": {"lower": [8, -40, -40], "upper": [8.5, 40, 40]},
        "known_from": 1.5,
        "active": [0.0, 4.1],
    }
    scenario = {
        "name": "corridor",
        "grid": {"step": 0.2, "knots": 31},
        "vehicles": [
            {"name": "v", "start": {"position": [0, 0, 1]}, "goal": {"position": [12, 0, 1]}}
        ],
        "limits": {"max_acceleration": 3.0},
        "obstacles": [wall],
        "disturbance": {"acceleration": 0.05, "feedback_every": 0.1},
    }
    simulated = {"planner": "simulate", "replan_every": 4, "windows": "convex"}
    options = {"contingencies": True, "bounded_cost": True}
    methods = [
        {"name": "without", **simulated},
        {"name": "with", **simulated, **options},
        {"name": "late", **simulated, **options, "latency": 0.6},
        {"name": "calm", "planner": "plan_rho", "windows": "convex", **options},
    ]
    study = small(1, scenarios=[{"name": "s", "scenario": scenario}], methods=methods, plans=True)
    results = rho.campaign(study, tmp_path / "runs.sqlite")

    def windows_of(key: str) -> tuple[rho.Window, ...]:
        flight = results.plan(key).flight
        assert flight is not None
        return flight.windows

    names = ("method", "key", "status", "without_contingency", "reason")
    rows = {name: rest for name, *rest in table(tmp_path / "runs.sqlite", names)}
    assert rows["without"][2] is None
    for name in ("with", "late", "calm"):
        key, status, missing, reason = rows[name]
        assert status == "solved", reason
        windows = windows_of(key)
        assert missing == sum(window.contingency is None for window in windows) == 0
        assert all(window.cost_bound is not None for window in windows)
    learned = {
        name: next(each.first_knot for each in windows_of(rows[name][0]) if each.learned)
        for name in ("with", "late")
    }
    assert learned == {"with": 8, "late": 12}


@pytest.mark.slow
def test_a_study_compares_final_times(tmp_path: Path) -> None:
    """Rows, groups and comparisons hold the least times that direct calls find."""
    gates = [{"position": [3, 2, 0]}, {"position": [6, -1, 1]}]
    race: dict[str, Any] = {
        "name": "race",
        "grid": {"step": 0.2, "knots": 13},
        "vehicles": [
            {
                "name": "racer",
                "start": {"position": [0, 0, 0]},
                "goal": {"position": [8, 0, 0]},
                "waypoints": gates,
            }
        ],
        "limits": {"max_thrust": 20.0},
    }
    vary = {"vehicles[0].waypoints[0].position[1]": {"uniform": [-2.0, 2.0]}}
    source = {"name": "race", "scenario": race, "vary": vary}
    methods = [
        {"name": "few", "planner": "plan_minimum_time"},
        {"name": "many", "planner": "plan_minimum_time", "knots": 37},
        {"name": "given", "planner": "plan", "options": {"max_iterations": 3}},
    ]
    study = small(3, scenarios=[source], methods=methods, plans=True)
    results = rho.campaign(study, tmp_path / "runs.sqlite")
    rows = {(row.method, row.repetition): row for row in results.rows()}
    assert all(row.verified for row in rows.values())
    for run in study.runs():
        row = rows[run.method, run.seed[2]]
        if run.method == "given":
            assert row.duration == pytest.approx(0.2 * 12)
            continue
        drawn = study.scenarios[0].drawn(generators(run.seed)[0])  # type: ignore[union-attr]
        knots = 37 if run.method == "many" else None
        plan = rho.plan_minimum_time(drawn, knots=knots, solver="clarabel")
        assert row.duration == plan.scenario.grid.duration
        assert results.plan(row.key).scenario == plan.scenario
    found = results.compare("many", "few")
    assert found is not None
    assert (found.shorter, found.longer, found.p_duration) == (3, 0, 0.25)
    ratios = [float(rows["many", i].duration / rows["few", i].duration) for i in range(3)]  # type: ignore[operator]
    assert found.duration_ratio.median == pytest.approx(np.median(ratios))
    few = next(group for group in results.groups if group.method == "few")
    assert few.duration.least == min(rows["few", i].duration or 0.0 for i in range(3))
    assert "final time [s]" in str(results)
    assert "shorter:longer" in str(results)
    assert results.to_json()["comparisons"][0]["p_duration"] == 0.25


def test_final_times_that_scenarios_give_are_not_printed(tmp_path: Path) -> None:
    source = {"name": "pair", "generator": "random_transitions", "parameters": {"n": 2}}
    results = rho.campaign(small(2, scenarios=[source]), tmp_path / "runs.sqlite")
    assert {row.duration for row in results.rows()} == {10.0}
    assert "final time" not in str(results)


def test_a_study_varies_the_smoothing(tmp_path: Path) -> None:
    """By its parts where a scenario has one, or as a whole where it has none."""
    pushed = rho.Limits(acceleration=rho.Box([-3, -3, -3], [3, 3, 3]))
    ball = rho.Sphere([4.0, 0.5, 0.0], 1.0)
    past = single(limits=pushed, obstacles=[ball], between_knots=True)
    smooth = dataclasses.replace(past, smoothing=rho.Smoothing(0.25))
    parts = {
        "smoothing.width": {"uniform": [0.1, 0.25]},
        "smoothing.times": {"integers": [1, 3]},
    }
    whole = {"smoothing": {"choice": [None, {"width": 0.2, "times": 2}]}}
    sources = [
        {"name": "parts", "scenario": smooth, "vary": parts},
        {"name": "whole", "scenario": past, "vary": whole},
    ]
    study = small(6, scenarios=sources, methods=small().methods[:1], plans=True)
    results = rho.campaign(study, tmp_path / "runs.sqlite")
    drawn = defaultdict[str, list[rho.Smoothing | None]](list)
    for row in results.rows():
        assert row.verified, row.reason
        drawn[row.scenario].append(results.plan(row.key).scenario.smoothing)
    assert {each and each.times for each in drawn["parts"]} == {1, 2, 3}
    assert len({each and each.width for each in drawn["parts"]}) == 6
    assert None in drawn["whole"]
    assert rho.Smoothing(0.2, 2) in drawn["whole"]
    wide = {"smoothing.width": {"choice": [0.2, 9.0]}}
    source = {"name": "wide", "scenario": smooth, "vary": wide}
    study = small(6, scenarios=[source], methods=small().methods[:1])
    results = rho.campaign(study, tmp_path / "wide.sqlite")
    statuses = {row.status: row.reason for row in results.rows()}
    assert set(statuses) == {"solved", "invalid"}
    assert "smoothing.width: got 9.0" in statuses["invalid"]


def test_stores_of_other_studies_are_refused_and_left_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "runs.sqlite"
    rho.campaign(small(1), path)
    before = table(path)
    with pytest.raises(StoreError, match="another study"):
        rho.campaign(small(1, seed=8), path)
    _set(path, "UPDATE study SET version = '0.0.1'")
    with pytest.raises(StoreError, match=r"a store of drake_rho 0\.0\.1"):
        rho.campaign(small(1), path)
    _set(path, "PRAGMA user_version = 99")
    with pytest.raises(StoreError, match="format 99"):
        rho.campaign(small(1), path)
    with pytest.raises(StoreError, match="format 99"):
        rho.Results(path)
    assert table(path) == before


def _set(path: Path, statement: str) -> None:
    connection = sqlite3.connect(path)
    connection.execute(statement)
    connection.commit()
    connection.close()


def test_files_that_are_no_store_are_refused_and_left_unchanged(tmp_path: Path) -> None:
    text, other = tmp_path / "text", tmp_path / "other.sqlite"
    text.write_text("no database" * 100)
    _set(other, "CREATE TABLE runs (a)")
    contents = [path.read_bytes() for path in (text, other)]
    for path, words in ((text, "not a database"), (other, "another SQLite file")):
        with pytest.raises(StoreError, match=words):
            rho.campaign(small(1), path)
        with pytest.raises(StoreError, match=words):
            rho.Results(path)
    assert [path.read_bytes() for path in (text, other)] == contents
    with pytest.raises(StoreError, match="no such file"):
        rho.Results(tmp_path / "none.sqlite")
    with pytest.raises(StoreError, match="unable to open"):
        rho.campaign(small(1), tmp_path / "no folder" / "runs.sqlite")


def test_a_full_disk_loses_nothing(
    expected: list[tuple[Any, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "runs.sqlite"
    begin = Store.__init__

    def cramped(self: Store, path: Path, study: rho.Study) -> None:
        begin(self, path, study)
        (pages,) = self._connection.execute("PRAGMA page_count").fetchone()
        self._connection.execute(f"PRAGMA max_page_count = {pages}")

    with monkeypatch.context() as cramping:
        cramping.setattr(Store, "__init__", cramped)
        with pytest.raises(StoreError, match="is full"):
            rho.campaign(small(16), path)
    rows = set(table(path))
    assert 0 < len(rows) < len(small(16))
    rho.campaign(small(16), path)
    assert set(table(path)) >= rows | set(expected)
    assert len(table(path)) == len(small(16))


def test_a_store_is_read_while_it_is_written(tmp_path: Path) -> None:
    path, seen = tmp_path / "runs.sqlite", list[int]()

    def look(now: SoFar) -> None:
        seen.append(len(rho.Results(path)))
        assert seen[-1] == now.done

    rho.campaign(small(1), path, progress=look)
    assert seen == [0, 1, 2, 3, 4]


@pytest.mark.slow
def test_a_campaign_killed_anywhere_resumes(
    expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    path, program = tmp_path / "runs.sqlite", tmp_path / "program.py"
    (tmp_path / "study.json").write_text(text_of(small()))
    program.write_text(_PROGRAM)
    command = [sys.executable, str(program), str(tmp_path)]
    for rows in (1, 6):  # once there are this many rows, amid the next runs
        process = subprocess.Popen(command)
        while process.poll() is None and _count(path) < rows:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert set(table(path)) <= set(expected)
        assert len(table(path)) >= rows
    subprocess.run(command, check=True)
    assert table(path) == expected


_PROGRAM = """
import sys
from pathlib import Path
import drake_rho as rho
from drake_rho.campaigns.study import study_from_yaml
from drake_rho.campaigns.workers import Workers

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    study = study_from_yaml((folder / "study.json").read_text())
    with Workers(1) as workers:
        rho.campaign(study, folder / "runs.sqlite", executor=workers)
"""


def _count(path: Path) -> int:
    try:
        return len(rho.Results(path))
    except StoreError:  # not created yet
        return 0
