"""Iterations of fleets whose vehicles are not all coupled: around references that cost less.

A linearisation around a plan moves each vehicle by as much as its half of what is between two
leaves. References find out first where that leads (`group_references`), as they are approximate
and fast; one program with hard rows for every vehicle then makes the last of them a plan.
"""

from __future__ import annotations

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import DEFAULTS
from drake_rho.planning.constraints.coupling import decoupled
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.scp.fleet_steps import FleetSteps
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.restoration import restore_feasibility
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray

_OFFSET, _STEPS = 7, 10
"""Steps of a restoration that count as taken when a reference is restored, which is too close to
something by little, and bound on those after them."""


class AroundReferences:
    """Improvements of a fleet's plan, linearised around references that cost less than it.

    Args:
        subproblem: of a scenario with a separation, its pairs not all coupled.
        most: bound on the vehicles of a group, where groups are asked for.
    """

    def __init__(self, subproblem: Subproblem, most: int = DEFAULTS.max_group) -> None:
        self._subproblem = subproblem
        size = most if subproblem.coupling.in_groups else 1
        self._groups = InGroups(subproblem.problem, size, subproblem.backend)

    def __call__(self, plan: Plan, vehicles: IntArray, tolerance: float) -> tuple[Plan, bool]:
        """Return a better plan, as every `Improvement` does, around a reference if that is of use.

        The plan itself is given where references cost no less by the tolerance, unless it is the
        first: restorations and callers may have found it by other means.
        """
        subproblem, spent = self._subproblem, Statistics()
        try:
            reference = self._groups.reference(plan, tolerance)
            spent = reference.statistics
            first = subproblem.planes is None
            if not first and reference.cost >= (1.0 - tolerance) * plan.cost:
                return plan.with_statistics(spent), False
            subproblem.begin_with(self._groups.active)
            apart = self._apart(reference.with_statistics(Statistics()))
            spent += apart.statistics
            after = subproblem.around(apart)
            spent += after.statistics
            if after.cost < plan.cost:
                change = abs(reference.cost - after.cost)
                converged = self._groups.converged and change <= tolerance * reference.cost
                return after.with_statistics(spent), converged
        except (InfeasibleError, SolverError) as error:
            spent += error.statistics
        after = subproblem.around(plan, vehicles)
        return after.with_statistics(spent + after.statistics), False

    def _apart(self, reference: Plan) -> Plan:
        """Return a reference that keeps every constraint: around it there is a plan."""
        if self._subproblem.holds(reference):
            return reference
        apart = Subproblem(self._subproblem.problem, decoupled, self._subproblem.backend)
        return restore_feasibility(
            apart, reference, step=FleetSteps(apart), offset=_OFFSET, most=_STEPS
        )
