"""The paper's scenario solved to convergence: the non-convex problem with (8) at the knots."""

from __future__ import annotations

from functools import partial

import drake_rho as rho
from benchmarks.apart import accelerations_apart
from benchmarks.peers import casadi_ipopt, drake_snopt
from benchmarks.race import SAME_INDEX, Entry, peer, race
from benchmarks.ranking import COLUMNS, THIS_PACKAGE, ratio, rounds, rows
from benchmarks.tables import Goal, Table

INDEX = 16741.370096
"""Optimal f [m²/s⁴], proved to be global by `drake_rho.certify`."""

_IPOPT, _SNOPT, _OPENSCVX = "CasADi + IPOPT", "Drake + SNOPT", "OpenSCvx"

_WORK = f"""\
Four vehicles, 49 steps of 1 s, every knot outside the sphere, least index; nothing couples the
vehicles, so each peer solves four programs. IPOPT and SNOPT start from the motion of least index
without the obstacle, as this package does. A time runs from the scenario record to the verified
plan and includes building the programs. All run in one process, OpenSCvx in one of its own beside
it, once a round in turn, after one round that is not counted (imports, first calls). A time counts
if the index is {INDEX} to {SAME_INDEX:g} relative and every constraint is verified."""

_TOLERANCES = """\
Tolerances: this package, Clarabel at 1e-10, stopping when the index falls by less than 1e-9 of it;
IPOPT 1e-8, exact second derivatives, adaptive barrier; SNOPT 1e-8 on optimality and 1e-9 on
feasibility; OpenSCvx 3e-6 on the trust region, its subproblems by Clarabel at 1e-10."""

_LIMITATIONS = """\
Limitations. One small scenario on one machine, whose other work adds noise: trust the ratios
rather than the times. All implementations reach the same optimum here; this need not hold for
other scenarios, as the problem is not convex. SNOPT is given the accelerations alone because it
performs worse with the states; its time depends on the order of the rows by a factor of five, and
the best order found is used. IPOPT runs with MUMPS, the linear solver of CasADi's wheel. OpenSCvx
compiles its program in the round that does not count; scenarios and plans are exchanged with its
process as JSON."""


def run(repetitions: int = 31) -> Table:
    """Time all implementations."""
    entries = [
        Entry(THIS_PACKAGE, rho.plan_scp),
        peer(_IPOPT, casadi_ipopt.solve),
        peer(_SNOPT, drake_snopt.solve),
        peer(_OPENSCVX, partial(accelerations_apart, "openscvx", "benchmarks.peers.openscvx_scp")),
    ]
    results = race(entries, lambda: rho.load_scenario("paper"), INDEX, repetitions)
    best = ratio(results, _IPOPT, _SNOPT, _OPENSCVX)
    return Table(
        name="converged",
        title="The converged problem: obstacles as they are, at the knots",
        columns=COLUMNS,
        rows=rows(results),
        notes=(_WORK, rounds(repetitions), _TOLERANCES, _LIMITATIONS),
        goals=(Goal("this package / the fastest non-convex peer", 1 / 10, best),),
        packages=("drake-rho", "drake", "numpy", "scipy", "casadi", "openscvx"),
    )
