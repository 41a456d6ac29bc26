"""The paper's Example 4, the whole receding horizon, from the scenario to the verified flight."""

from __future__ import annotations

import drake_rho as rho
from benchmarks.peers import (
    cvxpy_joint,
    cvxpy_parametrised,
    cvxpy_rebuilt,
    daqp_direct,
    drake_plain,
    osqp_direct,
)
from benchmarks.race import SAME_INDEX, Entry, peer, race
from benchmarks.ranking import COLUMNS, THIS_PACKAGE, ratio, rounds, rows
from benchmarks.tables import Goal, Table

INDEX = 17027.239234
"""f of Example 4 [m²/s⁴]."""

_WITH_DAQP = "this package with Daqp"
_REBUILT = "CVXPY + Clarabel, rebuilt for each solve"
_PARAMETRISED = "CVXPY + Clarabel, parametrised (DPP)"
_JOINT = "CVXPY + Clarabel, all vehicles in one problem"
_DAQP = "DAQP by hand, condensed"

_WORK = f"""\
Four vehicles, 49 steps of 1 s, ten windows of five steps; each window is solved without the
obstacle, (8) is linearised around that solution, and the window is solved again. A time runs from
the scenario record to the verified flight: every implementation's includes its own building and
compiling, making the plan from the accelerations, and this package's `verify`. All run in one
process, once a round in turn, after one round that is not counted (imports, first calls). A time
counts if the index is {INDEX} to {SAME_INDEX:g} relative and every constraint is verified."""

_TOLERANCES = """\
Tolerances: this package and plain Drake, Clarabel at 1e-10; CVXPY, Clarabel at its own 1e-8; OSQP
1e-3 m absolute and 1e-6 relative, polished; DAQP by hand at its own 1e-6, through this package at
1e-10."""

_LIMITATIONS = """\
Limitations. One small scenario on one machine, whose other work adds noise: trust the ratios
rather than the times, and the least time where it is far from the median. No box is active on this
data, which this package exploits (it adds only rows that turn out to be violated) while the peers
carry all rows. This package solves larger programs on all cores, whose times add up; CVXPY, OSQP,
DAQP and plain Drake solve one program after the other. The peers do not check solutions
before they are flown, find no reason for an infeasible program, and keep no record of windows. The
DAQP peer is tuned beyond common use (matrices set up once a length, bounds updated, rows written
in place); one plain call of `daqp.solve` a program with concatenated rows takes about twice as
long. The solver's own time is the one that Clarabel or DAQP reports, summed over programs that may
have run in parallel, so the part outside it is a lower bound."""


def run(repetitions: int = 31) -> Table:
    """Time all implementations."""
    entries = [
        Entry(THIS_PACKAGE, lambda scenario: rho.plan_rho(scenario, replan_every=5)),
        Entry(
            _WITH_DAQP, lambda scenario: rho.plan_rho(scenario, replan_every=5, solver=rho.Daqp())
        ),
        peer(_DAQP, daqp_direct.fly),
        peer("OSQP by hand, sparse, polished", osqp_direct.fly),
        peer("Drake + Clarabel, plain loops", drake_plain.fly),
        peer(_REBUILT, cvxpy_rebuilt.fly),
        peer(_PARAMETRISED, cvxpy_parametrised.fly),
        peer(_JOINT, cvxpy_joint.fly),
    ]
    results = race(entries, lambda: rho.load_scenario("paper"), INDEX, repetitions)
    ours = results[0]
    goals = (
        Goal("this package / CVXPY + Clarabel, rebuilt", 1 / 50, ratio(results, _REBUILT)),
        Goal("this package / CVXPY, parametrised", 1 / 50, ratio(results, _PARAMETRISED)),
        Goal("this package / CVXPY, all vehicles in one problem", 1 / 50, ratio(results, _JOINT)),
        Goal("this package / DAQP called by hand", 1.2, ratio(results, _DAQP)),
        Goal(
            "this package with Daqp / DAQP called by hand",
            1.0,
            ratio(results, _DAQP, ours=_WITH_DAQP),
        ),
        Goal(
            "time outside the solver's own / total",
            1 / 2,
            ours.outside_solver if ours.counts else None,
        ),
    )
    return Table(
        name="example_4",
        title="Example 4, the whole receding horizon",
        columns=COLUMNS,
        rows=rows(results),
        notes=(_WORK, rounds(repetitions), _TOLERANCES, _LIMITATIONS),
        goals=goals,
        packages=("drake-rho", "drake", "numpy", "scipy", "cvxpy", "clarabel", "osqp", "daqp"),
    )
