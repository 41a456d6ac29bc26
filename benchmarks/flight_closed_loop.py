"""Thousands of flights in wind: violations of constraints, and windows without a plan."""

from __future__ import annotations

import dataclasses
import time
from functools import cache
from itertools import pairwise

import numpy as np
from pydrake.solvers import SolverInterface

import drake_rho as rho
from benchmarks.adversaries import Chaser, WorstAtClosest
from benchmarks.all_cores import on_all_cores
from benchmarks.flown import violations
from benchmarks.tables import Cell, Goal, Table
from benchmarks.windy_worlds import WORLDS
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.horizon.interfaces import Planner
from drake_rho.simulation.closed_loop import fly, fly_plan
from drake_rho.simulation.winds import Wind

FLIGHTS = 10_000
"""Total number of flights, equally many in each world."""

COMPARED = 200
"""Number of them that are flown in Drake's simulator too."""

WINDS = ("random", "gusts", "worst case", "chasing")

_MIX = (*WINDS[:3] * 3, WINDS[3])
"""Kinds of wind of ten flights in a world; chasing takes the longest to simulate."""

VIOLATED = 1e-6
"""Violation that counts, over the limit's scale: twice the package's tolerance, and rounding."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """One flight with margins, and the same wind without them."""

    world: str
    """name of the world"""
    wind: str
    """kind of wind"""
    worst: float
    """largest violation of any limit with margins, as a fraction; negative for a margin"""
    worst_without: float
    """the same for the plan without margins, tracked by the same feedback"""
    kept: int
    """number of windows that kept the previous plan, as there was no new one"""
    without_plan: int
    """number of windows that had neither"""
    beyond_tube: float
    """largest error over the tube's radius at that time, less 1"""
    off_goal: float
    """largest distance from the goal at the end, over the tube's radius there"""
    verified: bool
    """true if `rho.verify` accepts the flight with margins"""
    apart: float
    """largest distance from the same flight in Drake's simulator, over the scene's extent; NaN if
    that was not flown"""
    seconds: float
    """wall time of the flight with margins [s]"""


def run(flights: int = FLIGHTS) -> Table:
    """Fly all flights on all cores."""
    rounds = -(-flights // (len(WORLDS) * len(_MIX)))
    tasks = [
        (world, wind, number * len(_MIX) + place)
        for number in range(rounds)
        for world in WORLDS
        for place, wind in enumerate(_MIX)
    ][:flights]
    compared = [place % max(1, len(tasks) // COMPARED) == 0 for place in range(len(tasks))]
    cases = [(*task, also) for task, also in zip(tasks, compared, strict=True)]
    found = on_all_cores(_outcome, cases, "flights")
    rows = [
        _row([each for each in found if (each.world, each.wind) == (world, wind)])
        for world in WORLDS
        for wind in WINDS
    ]
    satisfied = sum(each.worst_without <= VIOLATED for each in found) / len(found)
    return Table(
        name="flight_closed_loop",
        title="Flights in wind, with margins and without",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(f"{len(found)} flights. {_ABOUT}", _WORLDS, _LIMITATIONS),
        goals=(
            Goal("flights that break a limit", 0.0, sum(each.worst > VIOLATED for each in found)),
            Goal("flights that `verify` refuses", 0.0, sum(not each.verified for each in found)),
            Goal("distance from the flight in Drake's simulator", 1e-9, _most_apart(found)),
            Goal("windows without a plan", 0.0, sum(each.without_plan for each in found)),
            Goal("error above the tube's radius, over it", 1e-6, _most(found, "beyond_tube")),
            Goal(
                "distance from the goal over the radius there", 1.0 + 1e-6, _most(found, "off_goal")
            ),
            Goal("part of flights without margins that break no limit", 2.0 / 3.0, satisfied),
        ),
    )


COLUMNS = (
    "world",
    "wind",
    "flights",
    "broken",
    "largest_breach",
    "windows_without_plan",
    "windows_kept",
    "largest_over_tube",
    "broken_without_margins",
    "median_seconds",
)


def _row(found: list[Outcome]) -> tuple[Cell, ...]:
    """Return the row of all flights in a world and a kind of wind."""
    return (
        found[0].world,
        found[0].wind,
        len(found),
        sum(each.worst > VIOLATED for each in found),
        _most(found, "worst"),
        sum(each.without_plan for each in found),
        sum(each.kept for each in found),
        1.0 + _most(found, "beyond_tube"),
        sum(each.worst_without > VIOLATED for each in found),
        float(np.median([each.seconds for each in found])),
    )


def _most(found: list[Outcome], field: str) -> float:
    return float(max(getattr(each, field) for each in found))


def _most_apart(found: list[Outcome]) -> float:
    return max(each.apart for each in found if not np.isnan(each.apart))


def _outcome(case: tuple[str, str, int, bool]) -> Outcome:
    return outcome(*case)


def outcome(world: str, kind: str, number: int, compared: bool) -> Outcome:
    """Simulate one flight in a wind that depends on the first three arguments alone.

    Args:
        world: name of the world.
        kind: kind of wind.
        number: number of the flight.
        compared: whether the flight is simulated in Drake too.
    """
    set_up = prepared(world)
    scenario = set_up.scenario
    seed = (list(WORLDS).index(world), WINDS.index(kind), number)
    wind = drawn(kind, set_up, np.random.default_rng(seed))
    began = time.perf_counter()
    flown = fly(
        scenario,
        replan_every=5,
        planner=set_up.planner,
        fallback=set_up.fallback,
        wind=wind,
        rng=np.random.default_rng((*seed, 1)),
    )
    seconds = time.perf_counter() - began
    held = fly_plan(scenario, set_up.without, wind=wind, rng=np.random.default_rng((*seed, 1)))
    radii = flown.radii()
    goals = np.array([vehicle.goal.position for vehicle in scenario.vehicles])
    off = np.linalg.norm(flown.positions[-1] - goals, axis=1).max()
    windows = flown.flight.windows
    without_plan = sum(
        bool(now.infeasible) and not _continues(before, now) for before, now in pairwise(windows)
    )
    return Outcome(
        world,
        kind,
        violations(flown).worst,
        violations(held).worst,
        sum(bool(window.infeasible) for window in windows) - without_plan,
        without_plan,
        float(np.max(flown.errors() / np.maximum(radii, 1e-9)[:, None])) - 1.0,
        float(off / radii[-1]),
        rho.verify(flown).ok,
        _apart(set_up, flown, kind, seed) if compared else np.nan,
        seconds,
    )


def _apart(set_up: SetUp, flown: Simulation, kind: str, seed: tuple[int, ...]) -> float:
    """Return the distance of flights in Drake's simulator and without, over the scene's extent."""
    again = rho.simulate(
        set_up.scenario,
        replan_every=5,
        planner=set_up.planner,
        fallback=set_up.fallback,
        wind=drawn(kind, set_up, np.random.default_rng(seed)),
        rng=np.random.default_rng((*seed, 1)),
    )
    away = np.linalg.norm(again.positions - flown.positions, axis=2).max()
    return float(away / set_up.scenario.fleet.lengths.max())


def _continues(before: rho.Window, now: rho.Window) -> bool:
    """Return whether a window continues the plan of the one before."""
    old, new = before.plan.accelerations, now.plan.accelerations
    return np.array_equal(old[:, old.shape[1] - new.shape[1] :], new)


@dataclasses.dataclass(frozen=True)
class FirstOnce:
    """Planner that plans the whole scenario once: all flights begin with that window."""

    planner: Planner
    """planner of all windows"""
    whole: rho.Scenario
    """the whole scenario"""
    answers: list[rho.Plan | InfeasibleError | SolverError]
    """its plan, once there is one"""

    def __call__(
        self, scenario: rho.Scenario, *, reference: rho.Plan | None, solver: SolverInterface | None
    ) -> rho.Plan:
        """Return a plan; that of the whole scenario is cached."""
        if scenario is not self.whole:
            return self.planner(scenario, reference=reference, solver=solver)
        if not self.answers:
            try:
                self.answers.append(self.planner(scenario, reference=reference, solver=solver))
            except (InfeasibleError, SolverError) as error:
                self.answers.append(error)
        if isinstance(self.answers[0], rho.Plan):
            return self.answers[0]
        raise self.answers[0]


@dataclasses.dataclass(frozen=True)
class SetUp:
    """Common data of all flights in a world."""

    scenario: rho.Scenario
    """scenario with its disturbance"""
    first: rho.Plan
    """plan of the first window, with margins"""
    without: rho.Plan
    """plan of the whole flight, without margins"""
    planner: FirstOnce
    """steps from window to window"""
    fallback: FirstOnce
    """planner of windows"""


@cache
def prepared(world: str) -> SetUp:
    """Return the common data of a world, computed once in each process."""
    scenario = WORLDS[world]()
    planner, fallback = (FirstOnce(each, scenario, []) for each in (rho.plan_convex, rho.plan))
    horizon = rho.RecedingHorizon(scenario, planner=planner, fallback=fallback)
    first = horizon.step(scenario.fleet.start_states, scenario.grid.start).plan
    without = rho.plan(dataclasses.replace(scenario, disturbance=None))
    return SetUp(scenario, first, without, planner, fallback)


def drawn(kind: str, set_up: SetUp, rng: np.random.Generator) -> Wind:
    """Draw a wind of one of `WINDS`, at full strength whenever its kind can be."""
    scenario, grid = set_up.scenario, set_up.scenario.grid
    if kind == "random":
        correlation = grid.duration * 10.0 ** rng.uniform(-2.0, 0.0)
        return rho.winds.coloured_noise(
            scenario, rng, correlation=correlation, intensity=rng.uniform(0.5, 3.0)
        )
    if kind == "gusts":
        duration = grid.duration * rng.uniform(0.05, 0.7)
        begin = grid.start + rng.uniform(0.0, grid.duration - duration)
        return rho.winds.gust(scenario, rng.normal(size=3), begin=begin, duration=duration)
    if kind == "worst case":
        return WorstAtClosest.drawn(scenario, set_up.first, rng)
    return Chaser(scenario, *rng.uniform([0.0, 0.0], [0.8, 2.0 * np.pi]))


_ABOUT = f"""\
In each world the fleet replans every five steps from its estimated states, with `rho.plan_convex`,
and with `rho.plan` where that has no plan; a sampled feedback tracks the plan in between. The
strength of winds is at most the W of the world. Random: coloured noise of any correlation up to
the whole flight, clipped to W. Gusts: one minus a cosine from any direction, up to W, at any time.
Worst case: `rho.worst_case` for each vehicle towards what it comes near to, at a random one of the
instants at which it is near, with the corresponding errors of the estimate. Chasing: at every
instant W towards what is nearest to each vehicle at that time, or at a drawn angle to it.
Otherwise errors of the estimate are drawn uniformly from their balls. A flight is verified by
samples of its true motion twice between any two steps of the simulation, independently of the
package's verifier (`benchmarks/flown.py`): obstacles, separation, boxes of position, velocity and
command, speed and norm of the command, as a fraction of their scale; more than {VIOLATED:g} is a
violation. The package's verifier checks it too. Every fiftieth flight is flown in Drake's
simulator as well, and the two are compared. A window is without a plan if it has neither a new one
nor the rest of the previous one. Without margins: the plan of the same scenario without a
disturbance, tracked by the same feedback in the same wind."""

_WORLDS = """\
Example 4: the paper's, at every instant, W = 2 m/s², a tenth of its acceleration limit; errors of
the estimate, a delay of one sample. Gate: two vehicles through a gap of 0.5 m between two boxes,
in a narrow room, with a speed limit. Crossing: one vehicle among two spheres and one that crosses
its path; errors of the estimate, a delay of one sample. Swap: four vehicles on a circle, 0.5 m
apart, with limits on speed and acceleration; errors of the estimate. Transitions: four vehicles as
in `fleet_b1`, with a position box wider by 0.1 m."""

_LIMITATIONS = """\
Limitations. Five worlds, of point masses. All flights of a world begin with the same first window,
which is planned once. Samples can miss violations between them."""
