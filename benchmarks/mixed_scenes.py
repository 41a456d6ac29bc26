"""Random scenes that mix every kind of requirement: what planners return, and what they miss.

Each scene is drawn around a motion that is known to hold (`tests/mixed.py`). Plans are judged by
`verify` and by dense samples with formulas of their own (`tests/judged.py`).
"""

from __future__ import annotations

import dataclasses
import time
import traceback
import warnings
from collections.abc import Callable

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.tables import Cell, Goal, Table
from tests.judged import violations
from tests.mixed import Mixed, mixed

LIMIT = 20.0
"""Time limit of a call [s]."""

_FIRST = 10_000
"""First seed: earlier scenes were used to improve the planners."""

_ERRORS = (rho.InfeasibleError, rho.OutOfTimeError, rho.SolverError)
"""Errors that every planner documents."""

_LONGER = 1.002
"""Ratio of a least time to a known one up to which it counts as no longer."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What one planner made of one scene."""

    planner: str
    """name of the planner"""
    seed: int
    """seed of the scene"""
    fault: str
    """refused, sampled, error, proved, missed or longer; empty for a plan that holds, or for an
    error of a planner that need not find one"""
    text: str
    """what it is, in a line"""
    seconds: float
    """processor time [s]"""


def run(seeds: int) -> Table:
    """Plan scenes, as many as given, on all cores."""
    found = on_all_cores(outcomes, range(_FIRST, _FIRST + seeds), "scenes")
    return table_of(
        [each for some in found for each in some],
        "mixed_scenes",
        "Random scenes that mix every kind of requirement",
    )


def outcomes(seed: int) -> list[Outcome]:
    """Return what the planners made of a scene: those of less work at each, others at some."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.DrakeRhoWarning)
        return outcomes_of(mixed(seed), seed)


def outcomes_of(scene: Mixed, seed: int) -> list[Outcome]:
    """Return what the planners made of a scene with this seed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.DrakeRhoWarning)
        return [
            _outcome(name, each, scene, seed)
            for name, (every, each) in PLANNERS.items()
            if seed % every == 0
        ]


def _options() -> rho.Options:
    return rho.Options(time_limit=LIMIT)


PLANNERS: dict[str, tuple[int, Callable[[rho.Scenario], rho.Plan | rho.Flight]]] = {
    "plan": (1, lambda scenario: rho.plan(scenario, options=_options())),
    "plan_convex": (1, lambda scenario: rho.plan_convex(scenario, options=_options())),
    "plan, DAQP": (5, lambda scenario: rho.plan(scenario, solver="daqp", options=_options())),
    "plan, decoupled": (
        5,
        lambda scenario: rho.plan(scenario, coupling="decoupled", options=_options()),
    ),
    "plan_rho": (2, lambda scenario: rho.plan_rho(scenario, options=_options())),
    "plan_minimum_time": (4, lambda scenario: rho.plan_minimum_time(scenario, options=_options())),
}
"""Planners, and of how many scenes each has one."""

_COMPLETE = ("plan", "plan, DAQP", "plan_minimum_time")
"""Planners that look for a plan until there is one."""


def _outcome(
    name: str, planner: Callable[[rho.Scenario], rho.Plan | rho.Flight], scene: Mixed, seed: int
) -> Outcome:
    """Return what a planner made of a scene."""
    began = time.process_time()
    try:
        # the convex planner takes no waypoints without times
        scenario = scene.known.scenario if name == "plan_convex" else scene.scenario
        fault, text = _judged(planner(scenario), name, scene)
    except _ERRORS as error:
        fault, text = "", str(error)
        if scene.is_certain:
            proved = getattr(error, "is_proved", False)
            fault = "proved" if proved else "missed" * (name in _COMPLETE)
    except rho.ScenarioError as error:
        unbounded = name == "plan_minimum_time" and "bounds" in str(error)
        refused = any(word in error.field for word in _REFUSED)
        fault, text = "" if unbounded or refused else "error", str(error)
    except Exception as error:  # every other one is a fault, whatever it is
        where = traceback.extract_tb(error.__traceback__)[-1]
        fault, text = "error", f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})"
    return Outcome(name, seed, fault, text[:150], time.process_time() - began)


def _judged(planned: rho.Plan | rho.Flight, name: str, scene: Mixed) -> tuple[str, str]:
    """Return the fault of a plan or of a flight, and what it is."""
    plan = planned.plan if isinstance(planned, rho.Flight) else planned
    report, sampled = rho.verify(planned), violations(plan)
    if not report.ok:
        return "refused", "; ".join(each.what for each in report.checks if not each.holds)
    if sampled:
        return "sampled", sampled[0]
    ratio = plan.scenario.grid.duration / scene.scenario.grid.duration
    if name == "plan_minimum_time" and scene.is_certain and ratio > _LONGER:
        return "longer", f"{ratio:.4f} of the known time"
    return "", ""


_REFUSED = ("objective", "penalty")
"""Words of fields that planners of least time, and of free waypoint times, refuse."""

_FAULTS = ("refused", "sampled", "error", "proved", "missed", "longer")


def table_of(found: list[Outcome], name: str, title: str) -> Table:
    """Return the table of outcomes."""
    counts = {
        planner: [sum(e.fault == f for e in found if e.planner == planner) for f in _FAULTS]
        for planner in PLANNERS
    }
    rows = list[tuple[Cell, ...]]()
    for planner, counted in counts.items():
        seconds = sorted(each.seconds for each in found if each.planner == planner)
        if seconds:
            middle = seconds[len(seconds) // 2]
            rows.append((planner, len(seconds), *counted, round(middle, 3), round(seconds[-1], 1)))
    total = {f: sum(each.fault == f for each in found) for f in _FAULTS}
    searched = sum(each.planner in _COMPLETE for each in found)
    faults = [
        f"- {each.planner}, {each.seed}: {each.fault}: {each.text}" for each in found if each.fault
    ]
    return Table(
        name=name,
        title=title,
        columns=("planner", "scenes", *_FAULTS, "median_seconds", "worst_seconds"),
        rows=tuple(rows),
        notes=(_ABOUT, "\n".join(faults) or "No faults."),
        goals=(
            Goal("plans that `verify` refuses", 0.0, total["refused"]),
            Goal("plans that samples refuse", 0.0, total["sampled"]),
            Goal("undocumented errors", 0.0, total["error"]),
            Goal("known motions that are said to be proved impossible", 0.0, total["proved"]),
            Goal("known motions missed [%]", 0.5, 100.0 * total["missed"] / max(searched, 1)),
            Goal("least times more than 0.2 % above a known one", 0.0, total["longer"]),
        ),
    )


_ABOUT = f"""\
Smooth motions of one to three vehicles on 6 to 24 knots, of millimetres to kilometres, on clocks
from 0 to Unix time. Around each, up to seven kinds of requirements that it satisfies: boxes,
norms, tilts, jerks; obstacles of all shapes at rest and in motion, uncertain and active for a
while; voxels and triangles; convex sets of positions, velocities, accelerations, thrusts and
jerks, of vehicles, pairs and beside tracks, for a while; waypoints with and without times;
separation; averages; wind.
Refused: `verify` says that the plan does not hold. Sampled: 64 samples of each step and formulas of
their own say so. Missed: an error where a motion is known, counted where no margin is kept for
averages or wind, in {LIMIT:g} s. Proved: such an error that claims a proof. Longer: a least time
more than 0.2 % above the known one. Seconds are processor times."""
