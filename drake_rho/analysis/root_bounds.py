"""Lower bounds on the cost of every plan by Lagrangians alone, without branches.

Each group of vehicles that share a program is bounded by itself. Solvers propose the multipliers
(`solved_around`), and `drake_rho.analysis.ascent` maximises the bound over them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from drake_rho.analysis.ascent import CONVERGED, Ascent, Climb, best_bound
from drake_rho.analysis.branch_and_bound import Relaxation
from drake_rho.analysis.certificate import GLOBAL_GAP, VehicleCertificate
from drake_rho.analysis.global_search import Part, group_name, prices_of
from drake_rho.analysis.lagrangian import Proposal
from drake_rho.analysis.nodes import Node
from drake_rho.analysis.proof import Proved, of_node
from drake_rho.motion.costs import costs_of
from drake_rho.motion.flight import Flight
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import ALONE
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import seconds_left
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.plan import plan_scp
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.smoothing import largest_accelerations
from drake_rho.verification.report import Report

MOST_CERTIFIED_TOGETHER = 25
"""Largest number of vehicles for which the bound includes the separation of pairs; for larger
fleets it leaves it out."""

_MAX_POLISHINGS = 30
"""Largest number of linearisations that bring a fleet's plan to a certificate's precision."""


class RootBounds:
    """Bounds by Lagrangians alone, without branches.

    Args:
        flown: plan or flight.
        report: its report.
        backend: solvers that propose multipliers.
        progress: called with a short description of the current step.
        searched: whether branches follow; then multipliers are proposed around the plan alone.

    Attributes:
        scenario: the relaxation that is bounded.
        groups: groups of vehicles that are bounded together.
        roots: nodes of all motions of each group; none if time was up before there was one.
        certificates: certificate of each group.
        not_counted: names of what the bound leaves out.
        cut: whether time was up.
        costs: cost of each vehicle with the prices of its soft limits [m²/s⁴], shape (N,).
    """

    def __init__(
        self,
        flown: Plan | Flight,
        report: Report,
        backend: Backend,
        progress: Progress | None,
        *,
        searched: bool = False,
    ) -> None:
        plan, vehicles = flown.plan, len(flown.plan.scenario.vehicles)
        self.scenario, self.cut = _before_averages(plan.scenario), False
        dropped, left_out = list[str](), set[str]()
        if vehicles > MOST_CERTIFIED_TOGETHER and self.scenario.separation is not None:
            self.scenario = self.scenario.without_separation()  # the bound is lower, but valid
            dropped.append("the separation")
        scenario, proposals = self.scenario, list[CuttingPlanes]()
        start = Plan.from_accelerations(scenario, plan.accelerations)
        try:
            if searched:
                with suppress(InfeasibleError, SolverError):  # as it may from other margins
                    proposals.append(solved_around(start, backend, progress))
            if not proposals:
                for each in _converged(start, backend.solver, progress):
                    proposals.append(solved_around(each, backend, progress))
        except OutOfTimeError:
            self.cut = True
        efforts = costs_of(scenario, Problem.of(scenario).effort.motion)
        # excesses of averages are not those of the relaxation
        priced, found = plan.scenario.smoothing is None, list[VehicleCertificate]()
        self.costs = costs_of(scenario, plan) + prices_of(report)
        self.groups, self.roots = _groups(vehicles, proposals), list[Node]()
        for number, group in enumerate(self.groups, start=1):
            name = group_name(scenario, group)
            task = f"bounding the cost of {name} ({number} of {len(self.groups)})"
            tell(progress, task)
            cost, disturbed = float(self.costs[group].sum()), scenario.disturbance is not None
            effort = float(np.sum(efforts[group]))
            if not proposals:
                found.append(_by_effort(name, cost, effort, disturbed=disturbed))
                continue
            ascent = Ascent(progress, task, cost, len(proposals) * (2 if disturbed else 1))
            proposed = [Proposal.of(each, group, priced=priced) for each in proposals]
            left_out |= set[str]().union(*(each.left_out for each in proposed))
            node, planned, looser = _bound(proposed, effort, ascent), None, proposed
            if disturbed:
                planned = node.bound
                looser = [
                    Proposal.of(each, group, as_planned=False, priced=priced) for each in proposals
                ]
                node = _bound(looser, effort, ascent)
            node = self._raised(node, group, looser)
            found.append(_by_multipliers(name, cost, proposed[0], node.bound, planned))
            self.roots.append(node)
        names = [scenario.obstacle_name(number) for number, _ in scenario.known]
        self.certificates = tuple(found)
        self.not_counted = (*dropped, *(name for name in names if name in left_out))
        self.cut = self.cut or seconds_left() <= 0.0

    def _raised(self, node: Node, group: IntArray, proposed: Sequence[Proposal]) -> Node:
        """Return a node of a group's motions with violated terms, if its bound leaves a gap."""
        cost = float(self.costs[group].sum())
        if node.bound >= cost * (1.0 - GLOBAL_GAP) or self.scenario.penalties:
            return node
        own = Relaxation(self.scenario.of_vehicles(group.tolist()))
        with suppress(OutOfTimeError):
            return max(node, own.root(proposed, cost), key=lambda each: each.bound)
        return node

    @property
    def proofs(self) -> list[tuple[Proved, ...]]:
        """Branches that prove the bound of each group: one of all motions, if there is a root."""
        if len(self.roots) < len(self.groups):
            return [()] * len(self.groups)
        pairs = zip(self.groups, self.roots, strict=True)
        return [((group, of_node(root)),) for group, root in pairs]

    def with_bounds(
        self, parts: Sequence[Part], costs: FloatArray
    ) -> tuple[VehicleCertificate, ...]:
        """Return certificates with better bounds, of groups that may have been joined.

        Args:
            parts: groups with their bounds.
            costs: cost of each vehicle of the plan [m²/s⁴], shape (N,).
        """
        found = list[VehicleCertificate]()
        for part in sorted(parts, key=lambda each: int(each.group[0])):
            joined = [
                each
                for group, each in zip(self.groups, self.certificates, strict=True)
                if np.isin(group, part.group).all()
            ]
            least = min(each.least_eigenvalue for each in joined)
            planned = [each.planned_bound for each in joined if each.planned_bound is not None]
            found.append(
                VehicleCertificate(
                    vehicle=group_name(self.scenario, part.group),
                    cost=float(costs[part.group].sum()),
                    lower_bound=part.lower,
                    least_eigenvalue=least,
                    stationarity=max(each.stationarity for each in joined),
                    complementarity=max(each.complementarity for each in joined),
                    planned_bound=max(part.lower, sum(planned)) if planned else None,
                )
            )
        return tuple(found)


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


def _bound(proposed: Sequence[Proposal], effort: float, ascent: Ascent) -> Node:
    """Return the node of a group's motions with the best bound, at least the minimum effort."""
    found = list[Node]()
    for each in proposed:
        bound, climb = best_bound(each, ascent)
        found.append(dataclasses.replace(Node.proposed(each), bound=bound, **climb._asdict()))
    best, least = max(found, key=lambda each: each.bound), effort * (1.0 - CONVERGED)
    if best.bound >= least:
        return best
    nothing = Climb(*map(np.zeros_like, (best.weights, best.multipliers, best.at)))
    return dataclasses.replace(best, bound=least, **nothing._asdict())


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


def solved_around(plan: Plan, backend: Backend, progress: Progress | None) -> CuttingPlanes:
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
