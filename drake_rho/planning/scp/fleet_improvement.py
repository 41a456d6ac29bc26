"""Improvement of fleets by linearisation around cheaper references.

In a decoupled linearisation each vehicle of a pair can use only half of the slack between the two.
Approximate, fast references first explore where repeated linearisation leads (`group_references`).
One program with hard rows for every vehicle then turns the last reference into a plan.
"""

from __future__ import annotations

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import DEFAULTS
from drake_rho.planning.constraints.separation import decoupled
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.scp.fleet_steps import FleetSteps
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.restoration import restore_feasibility
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray


class AroundReferences:
    """Improvement of a fleet's plan by linearisation around cheaper references.

    Args:
        subproblem: the subproblem of a scenario with a separation, its pairs not all coupled.
        most: the largest number of vehicles in a group, if the coupling is in groups.
    """

    def __init__(self, subproblem: Subproblem, most: int = DEFAULTS.max_group) -> None:
        self._subproblem = subproblem
        size = most if subproblem.coupling.in_groups else 1
        self._groups = InGroups(subproblem.problem, size, subproblem.backend)

    def __call__(self, plan: Plan, vehicles: IntArray, tolerance: float) -> tuple[Plan, bool]:
        """Return a better plan, found around a cheaper reference if there is one.

        Args, returns and errors are those of `Improvement`. If no reference costs less by the
        tolerance, the given plan is returned, except in the first iteration: a restoration or the
        caller may have found that plan by other means.
        """
        subproblem, spent = self._subproblem, Statistics()
        try:
            reference = self._groups.reference(plan, tolerance)
            spent = reference.statistics
            first = subproblem.planes is None
            if not first and reference.cost >= (1.0 - tolerance) * plan.cost:
                return plan.with_statistics(spent), False
            subproblem.warm_start(self._groups.active)
            restored = self._restored(reference.with_statistics(Statistics()))
            spent += restored.statistics
            after = subproblem.solve_around(restored)
            spent += after.statistics
            if after.cost < plan.cost:
                change = abs(reference.cost - after.cost)
                converged = self._groups.converged and change <= tolerance * reference.cost
                return after.with_statistics(spent), converged
        except (InfeasibleError, SolverError) as error:
            spent += error.statistics
        after = subproblem.solve_around(plan, vehicles)
        return after.with_statistics(spent + after.statistics), False

    def _restored(self, reference: Plan) -> Plan:
        """Return a reference that satisfies every constraint, so that a plan exists around it."""
        if self._subproblem.holds(reference):
            return reference
        halves = Subproblem(self._subproblem.problem, decoupled, self._subproblem.backend)
        # penalties begin late in their sequence, since violations are small already
        return restore_feasibility(halves, reference, step=FleetSteps(halves), offset=7, most=10)
