"""`certify`: lower bound on the cost of every plan, and the optimality gap of a given plan.

The bound is the minimum of a Lagrangian (`drake_rho.analysis.lagrangian`), computed in closed form
less a bound on rounding errors. So it does not depend on any solver's tolerance: solvers only
propose the multipliers. A constraint that is left out only lowers the bound. So a bound computed
with some instants of an obstacle is valid for plans that avoid it at every instant.

The bound is valid for plans that satisfy their constraints exactly. A plan that violates them by
the verifier's tolerance, a millionth, may cost less than the bound by about as much.

With a disturbance the bound is valid for every plan that satisfies its tightened constraints as
`verify` checks them. Planners tighten a little more: they use the greatest error radius of a step
throughout the step. A second bound is valid for plans with these margins: it separates the plan's
own suboptimality from the cost of the margins.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import Executor
from contextlib import suppress

from drake_rho.analysis.certificate import Certificate
from drake_rho.analysis.global_search import GlobalSearch, Part, vehicle_costs
from drake_rho.analysis.root_bounds import RootBounds, solved_around
from drake_rho.motion.flight import Flight
from drake_rho.motion.jumps import largest_jump
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.plan import plan_scp
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.system.threads import single_threaded_blas
from drake_rho.verification.verify import verify


@checked
def certify(
    flown: Plan | Flight,
    *,
    solver: Solver | SolverName | None = None,
    gap: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> Certificate:
    """Compute a lower bound on the cost of every plan of a scenario, and the gap of a given plan.

    The multipliers come from iterations to convergence, from this plan and from the one without
    obstacles. Where the Lagrangian is not convex, the multipliers are scaled down and the bound is
    then maximised over them. The bound is valid for any multipliers.

    With a smoothing it is valid for plans that meet the constraints themselves, without margins, as
    this package's planners ensure. Waypoints are an exception: the averages pass them, and the plan
    passes within their margin. A disturbance does not raise this bound.

    With soft limits, cost and bound are those of the accelerations and the prices together. With a
    smoothing the bound leaves these limits out.

    Args:
        flown: any plan or flight of a scenario; it need not be optimal or satisfy its constraints.
            A flight may cost less than any plan, if its windows begin at measured states or with
            thinner tubes than a plan's.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        gap: relative gap, above 0 and below 1, down to which the bound is raised by branch and
            bound over the sides of obstacles and of other vehicles, as by `plan_global`; none if
            not given, which is far faster.
        executor: any PEP 3148 executor that works on the branches; the certificate does not depend
            on the number of workers.
        progress: called with a short description of the current step, as after each linearisation.
        time_limit: seconds, above 0, after which the best bound so far is returned (`cut`), at
            least that of the minimum-effort motions.

    Raises:
        ValueError: a gap is given, and is not above 0 and below 1, or the plan does not satisfy
            its constraints.
        InfeasibleError: no plan was found from which to take multipliers.
        SolverError: the solvers fail numerically.

    Examples:
        >>> certificate = rho.certify(rho.plan(rho.load_scenario("paper")))
        >>> certificate.is_globally_optimal
        True
    """
    return certified(
        flown,
        gap=gap,
        solver=solver,
        executor=executor,
        progress=progress,
        time_limit=time_limit,
    )[0]


def check_gap(gap: float) -> None:
    """Check a relative gap.

    Raises:
        ValueError: it is not above 0 and below 1.
    """
    if not 0.0 < gap < 1.0:
        raise ValueError(f"gap: got {gap!r}, expected a part of the cost above 0 and below 1")


@with_time_limit
@single_threaded_blas
def certified(
    flown: Plan | Flight,
    *,
    gap: float | None,
    solver: Solver | SolverName | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
    of_best: bool = False,
) -> tuple[Certificate, Plan]:
    """Return the certificate of a plan, and the best plan that was found on the way.

    Arguments and errors are those of `certify`; with `of_best`, the certificate is that of the best
    plan.
    """
    if gap is not None:
        check_gap(gap)
    backend = Backend.of(solver)
    plan, report = flown.plan, verify(flown)
    holds = all(check.holds for check in report.checks if check.asked and not check.is_measured)
    jumps = largest_jump(plan) is not None
    if gap is not None and not (holds and not jumps):
        worst = report.violations[0].what if not holds else "jumps to measured states"
        expected = "expected one that satisfies its constraints, or no gap"
        raise ValueError(f"flown: got a plan that violates them ({worst}), {expected}")
    roots = RootBounds(flown, report, backend, progress, searched=gap is not None)
    proofs = roots.proofs
    certificate = Certificate(
        plan.scenario,
        roots.certificates,
        holds,
        roots.not_counted,
        roots.cut,
        jumps,
        proofs=tuple(each for own in proofs for each in own),
    )
    if gap is None or certificate.gap <= gap or roots.cut:
        return certificate, plan
    parts = zip(roots.groups, roots.certificates, proofs, roots.roots, strict=True)
    search = GlobalSearch(
        plan,
        roots.scenario,
        [Part(group, each.lower_bound, root, proofs=own) for group, each, own, root in parts],
        lambda around: solved_around(around, backend, None),
        executor,
        progress,
    )
    search.run(gap)
    best = plan if search.plan is plan else _polished(search.plan, backend)
    costs = vehicle_costs(best)
    own = costs if of_best else roots.costs
    is_better = not of_best and float(costs.sum()) < certificate.cost
    return dataclasses.replace(
        certificate,
        vehicles=roots.with_bounds(search.parts, own),
        cut=search.cut,
        nodes=search.nodes,
        history=tuple(search.history),
        proofs=tuple(each for part in search.parts for each in part.proved),
        better=float(costs.sum()) if is_better else None,
    ), best


def _polished(found: Plan, backend: Backend) -> Plan:
    """Return a plan iterated to convergence from one that was found on the sides of a branch."""
    with suppress(InfeasibleError, SolverError, OutOfTimeError):
        polished = plan_scp(found.scenario, reference=found, solver=backend.solver)
        if vehicle_costs(polished).sum() < vehicle_costs(found).sum() and verify(polished).ok:
            return polished
    return found
