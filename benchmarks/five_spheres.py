"""One vehicle past five spheres on 61 knots, beside IPOPT."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

import drake_rho as rho
from benchmarks.peers import casadi_ipopt
from benchmarks.race import Entry, Result, race
from benchmarks.ranking import THIS_PACKAGE
from benchmarks.sampling import sample
from benchmarks.tables import Cell, Goal, Table

_KNOTS, _IPOPT = "this package, at the knots", "CasADi + IPOPT, at the knots"
_DAQP = "this package with Daqp"

COLUMNS = (
    "implementation",
    "median, processor [s]",
    "least, processor [s]",
    "median, wall [s]",
    "ratio",
    "index f [m²/s⁴]",
    "inside a sphere between knots [mm]",
    "note",
)


def scenario() -> rho.Scenario:
    """Return a flight of 20 m in 12 s, past five spheres on its way."""
    rng = np.random.default_rng(0)
    along = np.linspace(3.0, 17.0, 5)
    centers = np.column_stack([along, rng.uniform(-0.8, 0.8, (5, 2))])
    spheres = [rho.Sphere(center, 1.2) for center in centers]
    limits = rho.Limits(
        position=rho.Box([-1.0, -5.0, -5.0], [21.0, 5.0, 5.0]),
        velocity=rho.Box([-4.0] * 3, [4.0] * 3),
        acceleration=rho.Box([-4.0] * 3, [4.0] * 3),
    )
    vehicle = rho.Vehicle("UAV", rho.State([0, 0, 0]), rho.State([20, 0, 0]))
    return rho.Scenario("five spheres", rho.Grid(0.2, 61), [vehicle], limits, spheres)


def at_knots(given: rho.Scenario) -> rho.Scenario:
    """Return a scenario whose constraints hold at the knots only."""
    return dataclasses.replace(given, between_knots=False)


def run(repetitions: int = 31) -> Table:
    """Time this package at every instant and at the knots, and IPOPT."""
    plans: dict[str, Callable[[rho.Scenario], rho.Plan]] = {
        THIS_PACKAGE: rho.plan,
        _DAQP: lambda given: rho.plan(given, solver="daqp"),
        _KNOTS: lambda given: rho.plan(at_knots(given)),
        _IPOPT: _by_ipopt,
    }
    entries = [Entry(name, plan) for name, plan in plans.items()]
    results = race(entries, scenario, None, repetitions)
    cuts = {name: -sample(plan(scenario())).clearance for name, plan in plans.items()}
    by_name = {result.name: result for result in results}
    ours, knots, peer = (by_name[name].median.processor for name in (THIS_PACKAGE, _KNOTS, _IPOPT))
    ranked = sorted(results, key=lambda each: each.median.processor)
    return Table(
        name="five_spheres",
        title="One vehicle past five spheres, 61 knots",
        columns=COLUMNS,
        rows=tuple(_row(each, ours, cuts[each.name]) for each in ranked),
        notes=(f"Times are of {repetitions} rounds.", _WORK, _LIMITATIONS),
        goals=(
            Goal("at the knots / IPOPT", 1.0, knots / peer),
            Goal("every instant / IPOPT at the knots", 1.0, ours / peer),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "daqp", "casadi"),
    )


def _by_ipopt(given: rho.Scenario) -> rho.Plan:
    return rho.Plan.from_accelerations(at_knots(given), casadi_ipopt.solve(given))


def _row(result: Result, ours: float, inside: float) -> tuple[Cell, ...]:
    median = result.median
    return (
        result.name,
        median.processor,
        result.least,
        median.wall,
        median.processor / ours,
        f"{result.laps[0].index:.4f}",
        1e3 * inside,
        "" if result.verified else "a constraint is violated: time does not count",
    )


_WORK = """\
From rest to rest, 20 m in 12 s, in steps of 0.2 s, past five spheres of 1.2 m whose centres are up
to 0.8 m beside the straight way; boxes limit position, velocity and acceleration. A time runs from
the scenario record to the verified plan and includes building the programs; all run in one process,
once a round in turn, after one round that does not count. Plans are verified at the knots or at
every instant, as planned. How far they are inside of a sphere (negative: beyond) is of 100 samples
a step, by code of the benchmarks. The ratio is that of processor times, to this package's at every
instant, which `rho.plan` plans by default. Tolerances are those of `converged`, and 1e-3 of the
index by `rho.plan`."""

_LIMITATIONS = """\
Limitations. One scene. The problem is not convex: the implementations may end in different optima,
which the index shows. IPOPT starts from the motion of least index without spheres and limits."""
