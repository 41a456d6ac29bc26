"""Least times of random scenes that mix every kind, beside known motions and shorter plans."""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Iterator

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.tables import Cell, Goal, Table
from tests.mixed import Mixed, mixed, timed

LIMIT = 60.0
"""Time limit of a call [s]."""

_FIRST = 30_000
"""First seed."""

_CLOSE = 2e-3
"""Relative difference of a least time from the least known one that counts as none."""

_SHORTER = (0.998, 0.99, 0.97, 0.93, 0.85, 0.7)
"""Parts of a least time in which a plan is looked for, until there is none."""

_ERRORS = (rho.InfeasibleError, rho.OutOfTimeError, rho.SolverError, rho.ScenarioError)

COLUMNS = (
    "beside",
    "scenes",
    "least time longer by > 0.2 %",
    "largest",
    "no least time",
    "median [s]",
    "worst [s]",
)


@dataclasses.dataclass(frozen=True)
class Compared:
    """Least time of one scene, and the least known times."""

    seed: int
    """seed of the scene"""
    least: float | None
    """least time found, as a part of the known motion's; None without a plan that holds"""
    shorter: float = 1.0
    """least part of the least time in which `rho.plan` finds a plan that holds, which chooses the
    waypoints' times; 1 if there is none"""
    given: float = 1.0
    """the same with times of the waypoints as the known motion has them, in proportion"""
    seconds: float = 0.0
    """processor time of the least time [s]"""
    text: str = ""
    """error without a plan, in a line"""

    @property
    def longer(self) -> dict[str, float]:
        """Relative excess over the least time known by each means; infinite without a plan."""
        if self.least is None:
            return dict.fromkeys(_MEANS, float("inf"))
        times = self.least, 1.0 / self.shorter, 1.0 / self.given
        return {name: each - 1.0 for name, each in zip(_MEANS, times, strict=True)}


_MEANS = ("the known motion", "`rho.plan`, fewer seconds", "`rho.plan`, given times")


def run(scenes: int) -> Table:
    """Plan scenes, as many as given, on all cores."""
    found = on_all_cores(drawn, range(_FIRST, _FIRST + scenes), "scenes")
    return _table([each for each in found if each is not None])


def drawn(seed: int) -> Compared | None:
    """Return the comparison in a scene; None where nothing bounds how fast vehicles fly."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.DrakeRhoWarning)
        scene = mixed(seed, leave_out=("smoothing", "disturbance"))
        began = time.process_time()
        try:
            plan = rho.plan_minimum_time(scene.scenario, options=rho.Options(time_limit=LIMIT))
        except _ERRORS as error:
            if isinstance(error, rho.ScenarioError) and "bounds" in str(error):
                return None
            return Compared(seed, None, text=f"{type(error).__name__}: {error}"[:150])
        seconds = time.process_time() - began
        if not rho.verify(plan).ok:
            return Compared(seed, None, text="the plan does not hold")
        step = plan.scenario.grid.step
        return Compared(
            seed,
            step / scene.scenario.grid.step,
            _least_part(scene.scenario, step, _SHORTER),
            min(_least_part(each, step, (part,)) for part, each in _with_times(scene, step)),
            seconds,
        )


def _with_times(scene: Mixed, step: float) -> Iterator[tuple[float, rho.Scenario]]:
    """Yield parts of a least time with the scene in which waypoints have the known times."""
    grid, passing = scene.scenario.grid, timed(scene.scenario, scene.known).vehicles
    for part in _SHORTER[:3]:
        ratio = part * step / grid.step
        vehicles = [
            dataclasses.replace(
                given,
                waypoints=tuple(
                    _earlier(way, known, grid, ratio)
                    for way, known in zip(given.waypoints, own.waypoints, strict=True)
                ),
            )
            for given, own in zip(scene.scenario.vehicles, passing, strict=True)
        ]
        shorter = dataclasses.replace(grid, step=ratio * grid.step)
        try:
            yield part, dataclasses.replace(scene.scenario, grid=shorter, vehicles=tuple(vehicles))
        except rho.ScenarioError:  # a time that is given is after the end
            yield 1.0, scene.scenario


def _earlier(
    waypoint: rho.Waypoint, known: rho.Waypoint, grid: rho.Grid, ratio: float
) -> rho.Waypoint:
    """Return a waypoint with a time in proportion to the known one, unless it has a time."""
    if waypoint.time is not None or known.time is None:
        return waypoint
    return dataclasses.replace(waypoint, time=grid.start + ratio * (known.time - grid.start))


def _least_part(scenario: rho.Scenario, step: float, parts: tuple[float, ...]) -> float:
    """Return the least of the parts of a step, tried in turn, with which there is a plan, or 1."""
    least = 1.0
    for part in parts:
        try:
            shorter = dataclasses.replace(scenario.grid, step=part * step)
            plan = rho.plan(scenario.on_grid(shorter), options=rho.Options(time_limit=LIMIT))
        except _ERRORS:
            break
        if not rho.verify(plan).ok:
            break
        least = part
    return least


def _table(found: list[Compared]) -> Table:
    seconds = sorted(each.seconds for each in found)
    without = [each for each in found if each.least is None]
    rows, worst = list[tuple[Cell, ...]](), list[str]()
    for name in _MEANS:
        longer = {each.seed: each.longer[name] for each in found if each.least is not None}
        above = {seed: more for seed, more in longer.items() if more > _CLOSE}
        worst += [f"- {name}, scene {seed}: {more:.2%}" for seed, more in above.items()]
        count = len(longer), len(above), max(longer.values()), len(without)
        rows.append((name, *count, seconds[len(seconds) // 2], seconds[-1]))
    worst += [f"- scene {each.seed}: {each.text}" for each in without]
    count_above = sum(max(each.longer.values()) > _CLOSE for each in found if each.least)
    return Table(
        name="time_known",
        title="Least times of random scenes, beside what is known of them",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_WORK, "\n".join(["Longer, or none:", "", *worst]) if worst else "No faults."),
        goals=(
            Goal("least times more than 0.2 % above the least known", 0.0, count_above),
            Goal("scenes without a least time", 0.0, len(without)),
        ),
    )


_WORK = f"""\
Scenes of `mixed_scenes` without smoothing and wind, in which something bounds how fast vehicles
fly. Beside each least time T: the time of the motion that the scene was drawn around; plans of
`rho.plan` with the same knots in {", ".join(f"{each:g}" for each in _SHORTER)} of T, until there is
none; the same with the known motion's times of waypoints, in proportion. Calls have {LIMIT:g} s."""
