"""Costs of every term of an objective, beside CVXPY and beside `rho.program`."""

from __future__ import annotations

import dataclasses
import math
import statistics
import time

from pydrake.solvers import ClarabelSolver, SolverOptions
from rich.progress import track

import drake_rho as rho
from benchmarks.objective_scenes import convex
from benchmarks.peers import cvxpy_objective
from benchmarks.tables import Cell, Goal, Table

EQUAL, EQUAL_PROGRAM = 1e-6, 1e-7
"""Goals: largest relative differences of costs."""

COLUMNS = (
    "scenes",
    "number",
    "with a plan",
    "same verdict",
    "verified",
    "median difference from CVXPY",
    "largest difference from CVXPY",
    "largest difference from rho.program",
    "median seconds",
    "median seconds of CVXPY",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One scene by all three."""

    kind: str
    """the term beside effort, or 'several terms'"""
    cost: float
    """cost of the plan; infinite if there is none [m²/s⁴]"""
    peer: float
    """cost of CVXPY's program; infinite without a solution [m²/s⁴]"""
    program: float
    """cost of `rho.program`, solved by Clarabel; infinite without a solution [m²/s⁴]"""
    ok: bool
    """whether the plan is verified"""
    seconds: float
    """time of `rho.plan_convex` [s]"""
    peer_seconds: float
    """time of CVXPY, with writing the program [s]"""

    def difference(self, other: float) -> float:
        """Relative difference of the cost from another; infinite if one of them is infinite."""
        if math.isinf(self.cost) and math.isinf(other):
            return 0.0
        return abs(self.cost / other - 1.0) if math.isfinite(other) else math.inf


def run(seeds: int = 60) -> Table:
    """Plan `seeds` scenes by all three, one after the other."""
    laps = [_lap(seed) for seed in track(range(seeds), "objectives")]
    kinds = list(dict.fromkeys(each.kind for each in laps))
    rows = [_row(kind, [each for each in laps if each.kind == kind]) for kind in kinds]
    from_peer = [each.difference(each.peer) for each in laps]
    from_program = [each.difference(each.program) for each in laps]
    return Table(
        name="objective_convex",
        title="Every term of an objective, beside CVXPY and a program of Drake's",
        columns=COLUMNS,
        rows=(*rows, _row("all", laps)),
        notes=(_WORK,),
        goals=(
            Goal("relative difference from CVXPY, largest", EQUAL, max(from_peer)),
            Goal("relative difference from rho.program", EQUAL_PROGRAM, max(from_program)),
            Goal("plans that are not verified", 0, sum(not each.ok for each in laps)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "cvxpy", "clarabel"),
    )


def _lap(seed: int) -> Lap:
    scenario = convex(seed)
    began = time.process_time()
    try:
        plan = rho.plan_convex(scenario)
    except rho.InfeasibleError:
        plan = None
    planned = time.process_time()
    peer = cvxpy_objective.least_cost(scenario)
    solved = time.process_time()
    terms = [term for term, weight in scenario.objective.weights._asdict().items() if weight]
    alone = [term for term in terms if term != "effort"] or ["effort"]
    return Lap(
        kind=alone[0].replace("_", " ") if len(alone) == 1 else "several terms",
        cost=math.inf if plan is None else plan.cost,
        peer=peer,
        program=_by_program(scenario),
        ok=plan is None or rho.verify(plan).ok,
        seconds=planned - began,
        peer_seconds=solved - planned,
    )


def _by_program(scenario: rho.Scenario) -> float:
    """Return the cost of `rho.program`; infinite if Clarabel finds no solution."""
    program, options = rho.program(scenario), SolverOptions()
    for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
        options.SetOption(ClarabelSolver.id(), name, 1e-10)
    for each in (options, None):  # where it does not reach these, its defaults
        result = ClarabelSolver().Solve(program.prog, None, each)
        if result.is_success():
            return program.plan(result).cost
    return math.inf


def _row(kind: str, laps: list[Lap]) -> tuple[Cell, ...]:
    differences = [each.difference(each.peer) for each in laps]
    return (
        kind,
        len(laps),
        sum(math.isfinite(each.cost) for each in laps),
        sum(math.isinf(each.cost) == math.isinf(each.peer) for each in laps),
        sum(each.ok for each in laps),
        statistics.median(differences),
        max(differences),
        max(each.difference(each.program) for each in laps),
        statistics.median(each.seconds for each in laps),
        statistics.median(each.peer_seconds for each in laps),
    )


_WORK = f"""\
One to six vehicles between random states, 3 to 100 m, in 2 to 20 s on 10 to 60 knots, half of them
on a clock that begins at 1000 s, of weights from 0.1 to 10; boxes of velocity, norms of
acceleration and jerk, balls and links as requirements. One term beside a little effort, or several
of random weights. Constraints at the knots. CVXPY's program has states as variables, and Clarabel's
tolerances are {cvxpy_objective.TOLERANCE:g}; that of `rho.program` has accelerations only. Times
are of the processor."""
