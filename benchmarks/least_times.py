"""Plans of least time: how long they take, whether they answer their scenario, and the referee."""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

import drake_rho as rho
from benchmarks.apart import run_apart
from benchmarks.stopwatch import Stopwatch, Taken, median

Planner = Callable[[rho.Scenario], rho.Plan]


@dataclasses.dataclass(frozen=True)
class Found:
    """Plan of least time, or the lack of one."""

    plan: rho.Plan | None
    """plan, if there is one"""
    taken: Taken
    """median time of the call"""
    holds: bool = False
    """true if the plan is one of the scenario's that was given, and `rho.verify` accepts it"""
    words: str = ""
    """error without a plan"""

    @property
    def duration(self) -> float | None:
        """T [s]; None without a plan that holds."""
        return self.plan.scenario.grid.duration if self.plan is not None and self.holds else None


def minimum_time(scenario: rho.Scenario) -> rho.Plan:
    """Return the plan of the package."""
    return rho.plan_minimum_time(scenario)


def within(limit: float) -> Planner:
    """Return the planner of the package with a time limit [s]."""
    return lambda given: rho.plan_minimum_time(given, options=rho.Options(time_limit=limit))


def found(scenario: rho.Scenario, planner: Planner = minimum_time, repetitions: int = 1) -> Found:
    """Return the plan of a scenario, and the median time of a few calls."""
    plan, times, words = None, list[Taken](), ""
    for _ in range(repetitions):
        watch = Stopwatch()
        try:
            plan = planner(scenario)
        except (rho.InfeasibleError, rho.OutOfTimeError, rho.SolverError) as error:
            words = f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"
        times.append(watch.taken())
        if words:
            return Found(None, median(times), words=words)
    good = plan is not None and answers(plan, scenario) and rho.verify(plan).ok
    return Found(plan, median(times), good)


def answers(plan: rho.Plan, scenario: rho.Scenario) -> bool:
    """Return whether a plan's scenario is the one given but for its step and its free times.

    Waypoints are to be passed in the order given.
    """
    timed, vehicles = plan.scenario, list[rho.Vehicle]()
    if len(timed.vehicles) != len(scenario.vehicles):
        return False
    for given, vehicle in zip(scenario.vehicles, timed.vehicles, strict=True):
        times = [each.time for each in vehicle.waypoints if each.time is not None]
        if len(times) != len(given.waypoints) or any(np.diff(times) <= 0.0):
            return False
        waypoints = tuple(
            dataclasses.replace(each, time=at) if each.time is None else each
            for each, at in zip(given.waypoints, times, strict=True)
        )
        vehicles.append(dataclasses.replace(given, waypoints=waypoints))
    grid = dataclasses.replace(scenario.grid, step=timed.grid.step)
    return timed == dataclasses.replace(scenario, grid=grid, vehicles=tuple(vehicles))


@dataclasses.dataclass(frozen=True)
class Refereed:
    """Answer of IPOPT."""

    time: float
    """least time that it finds [s]"""
    seconds: float
    """wall time from the track to the answer, in its process [s]"""
    processor: float
    """processor time of that [s]"""
    programs: int
    """programs that it took"""
    error: float
    """largest violation by its accelerations alone [m, m/s or m/s²]"""


def by_ipopt(
    tracks: Sequence[ArrayLike], steps: int, thrust: float, gravity: float, *, uniform: bool
) -> list[Refereed]:
    """Return the least times of tracks by IPOPT.

    Args:
        tracks: start, waypoints and goal of each [m], shapes (L + 1, 3).
        steps: of each leg.
        thrust: largest norm of a + g e_z [m/s²].
        gravity: g [m/s²].
        uniform: whether the step is the same everywhere; otherwise each leg has its own.

    Raises:
        Skipped: there is no environment with CasADi.
    """
    model = {"steps": steps, "thrust": thrust, "gravity": gravity, "uniform": uniform}
    records = [{"waypoints": np.asarray(track).tolist(), **model} for track in tracks]
    with tempfile.TemporaryDirectory() as folder:
        given, times = Path(folder) / "tracks.json", Path(folder) / "times.json"
        given.write_text(json.dumps(records), encoding="utf-8")
        run_apart("casadi", "casadi_least_time.py", given, times)
        return [Refereed(**each) for each in json.loads(times.read_text(encoding="utf-8"))]
