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
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from drake_rho.analysis.ascent import CONVERGED, Ascent, best_bound
from drake_rho.analysis.certificate import Certificate, VehicleCertificate
from drake_rho.analysis.lagrangian import Proposal
from drake_rho.motion.costs import costs_of
from drake_rho.motion.flight import Flight
from drake_rho.motion.jumps import largest_jump
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import ALONE
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import seconds_left, with_time_limit
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.plan import plan_scp
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.smoothing import largest_accelerations
from drake_rho.system.threads import single_threaded_blas
from drake_rho.verification.report import Report
from drake_rho.verification.verify import verify

MOST_CERTIFIED_TOGETHER = 25
"""Largest number of vehicles for which the bound includes the separation of pairs; for larger
fleets it leaves it out."""


_MAX_POLISHINGS = 30
"""Largest number of linearisations that bring a fleet's plan to a certificate's precision."""


@checked
@with_time_limit
@single_threaded_blas
def certify(
    flown: Plan | Flight,
    *,
    solver: Solver | SolverName | None = None,
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
        progress: called with a short description of the current step, as after each linearisation.
        time_limit: seconds, above 0, after which the best bound so far is returned (`cut`), at
            least that of the minimum-effort motions.

    Raises:
        InfeasibleError: no plan was found from which to take multipliers.
        SolverError: the solvers fail numerically.

    Examples:
        >>> certificate = rho.certify(rho.plan(rho.load_scenario("paper")))
        >>> certificate.is_globally_optimal
        True
    """
    backend = Backend.of(solver)
    plan = flown.plan
    scenario, vehicles = _before_averages(plan.scenario), len(plan.scenario.vehicles)
    dropped = list[str]()
    if vehicles > MOST_CERTIFIED_TOGETHER and scenario.separation is not None:
        scenario = scenario.without_separation()  # the bound is lower, but still valid
        dropped.append("the separation")
    start = Plan.from_accelerations(scenario, plan.accelerations)
    cut, proposals = False, list[CuttingPlanes]()
    try:
        for each in _converged(start, backend.solver, progress):
            proposals.append(_solved_around(each, backend, progress))
    except OutOfTimeError:
        cut = True
    efforts = costs_of(scenario, Problem.of(scenario).effort.motion)
    report = verify(flown)
    costs = costs_of(scenario, plan) + _prices(report)
    certificates, left_out = list[VehicleCertificate](), set[str]()
    groups = _groups(vehicles, proposals)
    for number, group in enumerate(groups, start=1):
        name = scenario.vehicles[group[0]].name
        name = name if len(group) == 1 else f"{name} and {len(group) - 1} more"
        task = f"bounding the cost of {name} ({number} of {len(groups)})"
        tell(progress, task)
        cost, disturbed = float(np.sum(costs[group])), scenario.disturbance is not None
        if not proposals:
            effort = float(np.sum(efforts[group]))
            certificates.append(_by_effort(name, cost, effort, disturbed=disturbed))
            continue
        ascent = Ascent(progress, task, cost, len(proposals) * (2 if disturbed else 1))
        # excesses of averages are not those of the relaxation
        priced = plan.scenario.smoothing is None
        proposed = [Proposal.of(solved, group, priced=priced) for solved in proposals]
        left_out |= set[str]().union(*(each.left_out for each in proposed))
        bound = planned = _bound(proposed, ascent)
        if disturbed:
            looser = [
                Proposal.of(solved, group, as_planned=False, priced=priced) for solved in proposals
            ]
            bound = _bound(looser, ascent)
        certificates.append(
            _by_multipliers(name, cost, proposed[0], bound, planned if disturbed else None)
        )
    names = [scenario.obstacle_name(number) for number, _ in scenario.known]
    not_counted = (*dropped, *(name for name in names if name in left_out))
    cut = cut or seconds_left() <= 0.0
    holds = all(check.holds for check in report.checks if check.asked and not check.is_measured)
    jumps = largest_jump(plan) is not None
    return Certificate(plan.scenario, tuple(certificates), holds, not_counted, cut, jumps)


def _prices(report: Report) -> FloatArray:
    """Return the price of the soft limits for each vehicle [m²/s⁴], shape (N,)."""
    prices = dict.fromkeys(report.scenario.names, 0.0)
    for check in report.exceeded:
        prices[check.vehicle] += check.price or 0.0
    return np.array(list(prices.values()))


def _before_averages(scenario: Scenario) -> Scenario:
    """Return a relaxation without smoothing or disturbance, which every plan satisfies.

    The averages pass the waypoints, and a plan stays within the margin of its averages, which
    follows from the limits. Nothing is tightened for a disturbance, whose tube is around them.
    """
    if scenario.smoothing is None:
        return scenario
    margins = scenario.smoothing.margins(largest_accelerations(scenario.fleet))
    vehicles = tuple(
        dataclasses.replace(
            vehicle,
            waypoints=tuple(
                dataclasses.replace(each, within=each.within + margin)
                for each in vehicle.waypoints
                if margin < np.inf
            ),
        )
        for vehicle, margin in zip(scenario.vehicles, margins.tolist(), strict=True)
    )
    return scenario.derived(vehicles=vehicles, smoothing=None, disturbance=None)


def _by_effort(name: str, cost: float, effort: float, *, disturbed: bool) -> VehicleCertificate:
    """Return the certificate of a group from its minimum effort alone, without multipliers."""
    bound = effort * (1.0 - CONVERGED)
    return VehicleCertificate(
        vehicle=name,
        cost=cost,
        lower_bound=bound,
        least_eigenvalue=2.0,
        stationarity=1.0,
        complementarity=0.0,
        planned_bound=bound if disturbed else None,
    )


def _bound(proposed: Sequence[Proposal], ascent: Ascent) -> float:
    """Return the best lower bound on a group's cost [m²/s⁴]."""
    return max(0.0, *(best_bound(each, ascent) for each in proposed))


def _by_multipliers(
    name: str, cost: float, here: Proposal, bound: float, planned: float | None
) -> VehicleCertificate:
    """Return the certificate of a group from its bounds and its Lagrangian at the plan."""
    stationarity, complementarity = here.kkt_residuals()
    return VehicleCertificate(
        vehicle=name,
        cost=cost,
        lower_bound=bound,
        least_eigenvalue=2.0 * here.curvature,
        stationarity=stationarity,
        complementarity=complementarity,
        planned_bound=planned,
    )


def _converged(plan: Plan, solver: Solver | None, progress: Progress | None) -> Iterator[Plan]:
    """Yield plans iterated to convergence: from this one, if possible, and without a reference."""
    found = False
    with suppress(InfeasibleError, SolverError):  # this may fail from a plan with violations
        yield plan_scp(plan.scenario, reference=plan, solver=solver, progress=progress)
        found = True
    try:
        other = plan_scp(plan.scenario, solver=solver, progress=progress)
    except (InfeasibleError, SolverError):
        if not found:
            raise
    else:
        yield other


def _solved_around(plan: Plan, backend: Backend, progress: Progress | None) -> CuttingPlanes:
    """Return the programs around a plan, iterated to the precision that a certificate needs.

    If they are infeasible, any margins on a finer partition of the steps are used instead: the plan
    may satisfy its constraints with these only.
    """
    problem = Problem.of(plan.scenario)
    try:
        return _solved(problem, plan, backend, progress)
    except InfeasibleError:
        if (finer := problem.with_finer_margins()) is None:
            raise
        return _solved(finer, plan, backend, progress)


def _solved(
    problem: Problem, plan: Plan, backend: Backend, progress: Progress | None
) -> CuttingPlanes:
    """Return the programs around a plan, with a problem's margins."""
    subproblem = Subproblem(problem, coupled, backend)
    everyone = np.zeros(len(problem), dtype=int)  # the multipliers of all are wanted
    sequential_convex(
        subproblem, plan, ALONE, labels=everyone, most=_MAX_POLISHINGS, progress=progress
    )
    if subproblem.planes is None:
        subproblem.solve_around(plan)  # raises the error that ended the iteration
    assert subproblem.planes is not None  # noqa: S101  # solved above
    return subproblem.planes


def _groups(vehicles: int, proposals: Sequence[CuttingPlanes]) -> list[IntArray]:
    """Return the groups of vehicles that share a program in any proposal."""
    label = np.arange(vehicles)
    for solved in proposals:
        for vehicle in range(vehicles):
            met = np.unique(label[solved.working.group(vehicle)])
            label[np.isin(label, met)] = met[0]
    return [np.flatnonzero(label == each) for each in np.unique(label)]
