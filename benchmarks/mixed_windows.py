"""Windows of random combinations of abilities: none raises, plans hold, records are what was flown.

Scenes are those of `tests/mixed.py`, with obstacles that become known in flight. States are as
planned, off the plan within a tube or outside, or not measured at all.
"""

from __future__ import annotations

import dataclasses
import traceback
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.tables import Goal, Table
from drake_rho.scenario.fields import unchecked
from tests.judged import violations
from tests.mixed import mixed

LIMIT = 5.0
"""Time limit of a window [s]."""

SAME = 1e-9
"""Difference from the own integration, as a part of the largest position or velocity."""

_FIRST = 20_000
"""First seed."""

Array = np.ndarray


@dataclasses.dataclass(frozen=True)
class Loop:
    """What one flight in windows did."""

    seed: int
    """seed of the scene and of the states"""
    windows: int = 0
    """number of windows; 0 where the first had no plan"""
    kept: int = 0
    """number of windows that kept the previous plan"""
    without: int = 0
    """number of windows without a plan that holds, which say so"""
    raised: str = ""
    """error of a window after the first; empty if there was none"""
    broken: int = 0
    """number of windows whose plan does not hold, though they say that it does"""
    off: float = 0.0
    """difference of the record from the own integration, as a part of the largest value"""
    fault: str = ""
    """what is broken, in a line"""


def run(flights: int) -> Table:
    """Fly scenes, as many as given, on all cores."""
    return _table(on_all_cores(loop, range(_FIRST, _FIRST + flights), "flights"))


def loop(seed: int) -> Loop:
    """Return what a flight did; the same seed gives the same one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.DrakeRhoWarning)
        rng = np.random.default_rng([47, seed])
        scenario = _seen_late(rng, mixed(seed).scenario)
        horizon = _horizon(rng, scenario)
        try:
            if horizon is None:
                return Loop(seed)
            horizon.step(scenario.fleet.start_states, scenario.grid.start)
        except (rho.InfeasibleError, rho.SolverError, rho.OutOfTimeError, rho.ScenarioError):
            return Loop(seed)
        return _flown(rng, horizon, seed)


def _seen_late(rng: np.random.Generator, scenario: rho.Scenario) -> rho.Scenario:
    """Return the scenario in which some obstacles become known in flight."""
    grid = scenario.grid
    obstacles = tuple(
        dataclasses.replace(each, known_from=grid.start + rng.uniform(0.1, 0.8) * grid.duration)
        if rng.random() < 0.3 and grid.start >= 0.0 and each.seen_at is None
        else each
        for each in scenario.bodies
    )
    return dataclasses.replace(scenario, obstacles=obstacles)


def _horizon(rng: np.random.Generator, scenario: rho.Scenario) -> rho.RecedingHorizon | None:
    """Return a horizon with random abilities; None where the scenario does not allow them."""
    every = int(rng.integers(1, 6))
    given: dict[str, Any] = {
        "replan_every": every,
        "free_final_time": bool(rng.random() < 0.3),
        "contingencies": bool(rng.random() < 0.4),
        "bounded_cost": bool(rng.random() < 0.2),
        "fallback": None if rng.random() < 0.3 else rho.plan,
        "planner": rho.plan if rng.random() < 0.3 else rho.plan_convex,
        "options": rho.Options(time_limit=LIMIT),
    }
    if rng.random() < 0.3:
        given["latency"] = float(rng.choice([0.3, 0.9])) * every * scenario.grid.step
    try:
        return rho.RecedingHorizon(scenario, **given)
    except (ValueError, rho.ScenarioError):
        return None


def _states(rng: np.random.Generator, horizon: rho.RecedingHorizon, knot: int) -> Array:
    """Return measured states near the planned ones."""
    planned, times = np.array(horizon.planned(knot)), horizon.scenario.grid.times
    drawn = rng.random()
    scale = np.repeat([np.ptp(planned[:, :3]) + 1e-3, np.abs(planned[:, 3:]).max()], 3)
    if drawn < 0.4:
        return planned
    if drawn < 0.8:
        around = rho.error_tube(horizon.scenario) if horizon.scenario.disturbance else None
        off = (
            1e-3 * scale
            if around is None
            else np.full(6, 0.3 * float(around.position(times[knot : knot + 1]).max()))
        )
        return np.asarray(planned + off * rng.uniform(-1.0, 1.0, planned.shape) / 2.0)
    if drawn < 0.9:
        return np.asarray(planned + 0.2 * scale * rng.normal(size=planned.shape))
    planned[rng.integers(len(planned))] = np.nan
    return planned


def _flown(rng: np.random.Generator, horizon: rho.RecedingHorizon, seed: int) -> Loop:
    """Return what the windows after the first did."""
    times = horizon.scenario.grid.times
    raised = ""
    for knot in horizon.knots[1:]:
        try:
            horizon.step(_states(rng, horizon, knot), times[knot])
        except Exception as error:  # none is documented
            where = traceback.extract_tb(error.__traceback__)[-1]
            raised = f"{type(error).__name__}: {str(error)[:80]} ({where.name}:{where.lineno})"
            break
    windows = horizon.windows
    promised = _promised(windows)
    broken = [fault for each in promised if (fault := _fault(*each))]
    return Loop(
        seed,
        len(windows),
        sum(window.kept for window in windows),
        len(windows) - len(promised),
        raised,
        len(broken),
        _difference(horizon.flight, horizon),
        broken[0] if broken else "",
    )


def _promised(windows: Sequence[rho.Window]) -> list[tuple[rho.Window, rho.Plan]]:
    """Return the windows whose plans are said to hold, each with the plan that its own is part of.

    A rest of a plan holds if the plan does, with the tolerances of the plan.
    """
    found, holds, whole = list[tuple[rho.Window, rho.Plan]](), True, windows[0].plan
    for window in windows:
        holds = not window.infeasible or window.stopping or (window.kept and holds)
        whole = whole if window.kept else window.plan
        if holds:
            found.append((window, whole))
    return found


def _fault(window: rho.Window, whole: rho.Plan) -> str:
    """Return what a window's plan violates, though it says that it holds; empty if nothing."""
    if window.off_tube or window.not_avoided:
        return ""
    plan = _of_known(whole, window.plan.scenario.grid.start)
    found = [each.what for each in rho.verify(plan).checks if each.asked and not each.holds]
    if not found and plan.scenario.smoothing is None:
        found = violations(plan)
    if window.stopping:  # a contingency promises nothing that belongs to the mission
        asked = enumerate(plan.scenario.requirements, start=1)
        timed = [each.called(number) for number, each in asked if each.active is not None]
        mission = "goal", "waypoint", *timed
        found = [each for each in found if not any(word in each for word in mission)]
    return found[0] if found else ""


def _of_known(plan: rho.Plan, time: float) -> rho.Plan:
    """Return a plan as one of the scenario with the obstacles known at a time."""
    scenario = plan.scenario
    known = tuple(each for each in scenario.bodies if each.known_from <= time)
    return dataclasses.replace(plan, scenario=unchecked(scenario, obstacles=known))


def _difference(flight: rho.Flight, horizon: rho.RecedingHorizon) -> float:
    """Return how far a record is from an own integration, as a part of the flight's largest."""
    if horizon.scenario.smoothing is not None:
        return 0.0  # averages of all windows' accelerations, which other tests integrate
    grid, windows = horizon.scenario.grid, horizon.windows
    ends = [*(window.first_knot for window in windows[1:]), grid.knots - 1]
    parts = np.array([0.1, 0.5, 0.9])
    s = (parts * grid.step)[:, None, None]
    off, largest = np.zeros(2), np.full(2, 1e-300)
    for window, end in zip(windows, ends, strict=True):
        p, v = window.plan.positions[:, 0], window.plan.velocities[:, 0]
        for k in range(window.first_knot, end):
            a = window.plan.accelerations[:, k - window.first_knot]
            found = flight.sampled((k + parts) * grid.step)
            own = np.moveaxis(np.stack([p + s * v + s**2 / 2.0 * a, v + s * a]), 2, 1)
            told = found.positions, found.velocities
            off = np.maximum(off, np.abs(own - told).max(axis=(1, 2, 3)))
            largest = np.maximum(largest, np.abs(own).max(axis=(1, 2, 3)))
            p, v = p + grid.step * v + grid.step**2 / 2.0 * a, v + grid.step * a
    return float((off / largest).max())


def _table(found: list[Loop]) -> Table:
    """Return the table of flights."""
    flights = [each for each in found if each.windows > 0]
    counts = [
        sum(getattr(each, name) for each in flights)
        for name in ("windows", "kept", "without", "broken")
    ]
    raised = sum(bool(each.raised) for each in flights)
    off = max((each.off for each in flights), default=0.0)
    faults = [
        f"- {each.seed}: {each.raised or each.fault or f'record off by {each.off:.2g}'}"
        for each in flights
        if each.raised or each.broken or each.off > SAME
    ]
    return Table(
        name="mixed_windows",
        title="Windows of random combinations of abilities",
        columns=("flights", "windows", "kept", "without_plan", "broken", "raised", "record_off"),
        rows=((len(flights), *counts, raised, off),),
        notes=(
            f"{len(found) - len(flights)} scenes more have no first plan. {_ABOUT}",
            "\n".join(faults) or "No faults.",
        ),
        goals=(
            Goal("flights in which a window raises", 0.0, raised),
            Goal("windows whose plan does not hold though they say so", 0.0, counts[3]),
            Goal("records beside the own integration", SAME, off),
        ),
    )


_ABOUT = """\
Scenes that mix every kind of requirement, a third of whose obstacles become known in flight.
Windows every one to five steps; free final times, contingencies, latencies, bounded costs,
fallbacks and planners at random. States as planned (two in five), off it by a little or within the
tube (two in five), far off, or not measured. Broken: `verify` or dense samples refuse the plan of a
window that has a plan of its own, keeps the previous one or flies a contingency, where no vehicle
is off its tube. Record: positions and velocities of `flight.at` beside sums of (1) and (2) from the
first states of each window."""
