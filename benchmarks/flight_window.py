"""Time of a window, from measured states to the plan that is flown."""

from __future__ import annotations

import dataclasses

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.fleet_b1 import DURATIONS, STEP
from benchmarks.one_core import one_core
from benchmarks.stopwatch import Stopwatch, Taken, median
from benchmarks.tables import Cell, Goal, Table

FLIGHTS = 5
"""Number of flights of each fleet, the first of which is not timed."""

COLUMNS = (
    "fleet",
    "vehicles",
    "steps",
    "windows",
    "median_processor_ms",
    "median_wall_ms",
    "worst_processor_ms",
    "kept",
    "too_late",
)


def run() -> Table:
    """Time windows that begin where wind has driven the fleet, on one core."""
    fleets = (example_4(), transitions())
    with one_core():
        times = [windows(fleet) for fleet in track(fleets, "fleets")]
    rows = tuple(_row(fleet, each) for fleet, each in zip(fleets, times, strict=True))
    medians = [1e3 * median(taken for taken, _ in each).processor for each in times]
    return Table(
        name="flight_window",
        title="A window, from states to the plan",
        columns=COLUMNS,
        rows=rows,
        notes=(_ABOUT, _LIMITATIONS),
        goals=(
            Goal("4 vehicles, median [ms]", 20.0, medians[0]),
            Goal("20 vehicles with separation, median [ms]", 200.0, medians[1]),
        ),
    )


def example_4() -> rho.Scenario:
    """Return the paper's Example 4 with wind of a hundredth of its acceleration."""
    paper = rho.load_scenario("paper")
    around = rho.Disturbance(0.2, feedback_every=0.25)
    return dataclasses.replace(paper, name="Example 4", disturbance=around)


def transitions() -> rho.Scenario:
    """Return twenty vehicles of B1, with slack for the tube at starts and goals."""
    around = rho.Disturbance(0.1, feedback_every=0.1, share=0.2)
    drawn = rho.random_transitions(
        20,
        np.random.default_rng(0),
        duration=DURATIONS[20],
        step=STEP,
        separation=rho.Separation(0.39, downwash=2.0),
        name="random transitions",
    )
    room = drawn.limits.position or rho.flight_cube(4.0)
    limits = dataclasses.replace(
        drawn.limits, position=rho.Box(room.lower - 0.04, room.upper + 0.04)
    )
    apart = rho.Separation(0.35, downwash=2.0)
    return dataclasses.replace(drawn, limits=limits, separation=apart, disturbance=around)


def windows(scenario: rho.Scenario) -> list[tuple[Taken, bool]]:
    """Return times of the windows of some flights, and which of them kept the previous plan.

    Each begins somewhere in the tube around the plan of the one before: at an estimated error drawn
    uniformly from the balls of both radii. The first window of a flight, which is planned before it
    begins, is not timed.
    """
    rng, found = np.random.default_rng(0), list[tuple[Taken, bool]]()
    for number in range(FLIGHTS):
        flown = _fly(scenario, rng)
        found += flown if number else []
    return found


def _fly(scenario: rho.Scenario, rng: np.random.Generator) -> list[tuple[Taken, bool]]:
    horizon, found = rho.RecedingHorizon(scenario), []
    horizon.step(scenario.fleet.start_states, scenario.grid.start)
    for knot in horizon.knots[1:]:
        last, now = horizon.windows[-1], scenario.grid.times[knot]
        k, tube = knot - last.first_knot, rho.error_tube(last.plan.scenario)
        p, v = last.plan.positions[:, k], last.plan.velocities[:, k]
        p = p + float(tube.position(now)) * _in_balls(rng, len(p))
        v = v + float(tube.velocity(now)) * _in_balls(rng, len(v))
        watch = Stopwatch()
        window = horizon.step(np.concatenate([p, v], axis=1), now)
        found.append((watch.taken(), bool(window.infeasible)))
    return found


def _in_balls(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return points of the unit ball, shape (count, 3)."""
    points = rng.normal(size=(count, 3))
    lengths = np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(points / lengths * np.cbrt(rng.uniform(size=(count, 1))))


def _row(scenario: rho.Scenario, found: list[tuple[Taken, bool]]) -> tuple[Cell, ...]:
    times = [each for each, _ in found]
    processor, wall = median(times).both
    between = scenario.grid.step * 5.0
    return (
        scenario.name,
        len(scenario.vehicles),
        scenario.grid.knots - 1,
        len(found),
        1e3 * processor,
        1e3 * wall,
        1e3 * max(each.processor for each in times),
        sum(kept for _, kept in found),
        sum(each.wall > between for each in times),
    )


_ABOUT = """\
`RecedingHorizon.step` with its defaults, a new window every five steps, in a process confined to
one core. Each window begins at errors drawn uniformly from the tube's balls around the plan
before; the first window of a flight does not count. Kept: windows that continued the previous
plan, as there was no new one; they are timed like the others. Too late: windows that took longer
than the five steps until the next."""

_LIMITATIONS = """\
Limitations. Errors of position and velocity are each drawn from their ball, although not every
pair of them can occur together, and independent winds would not drive all vehicles to such errors.
One fleet of each kind."""
