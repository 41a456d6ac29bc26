"""Iterations of fleets whose vehicles are not all coupled: around references that cost less.

A linearisation around a plan moves each vehicle by as much as its half of what is between two
leaves. References find out first where that leads (`group_references`), as they are approximate
and fast; one program with hard rows for every vehicle then makes the last of them a plan.
"""

from __future__ import annotations

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.separation import Coupling
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.options import DEFAULTS
from drake_rho.planning.programs.parallel import OnWorkers
from drake_rho.planning.programs.solve import Solver
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.restoration import Restoration
from drake_rho.planning.scp.sequential_convex import restored
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_BEGUN, _STEPS = 7, 10
"""Steps of a restoration that count as taken when a reference is restored, which is too close to
something by little, and bound on those after them."""


class Improvement(Subproblem):
    """A fleet's convex problems around references.

    Args:
        scenario: what is asked; it has a separation.
        coupling: how pairs are kept apart, not all together.
        solver: a Drake solver or `Daqp()`, perhaps on an executor; Clarabel if not given.
        most: bound on the vehicles of a group, where groups are asked for.
    """

    def __init__(
        self,
        scenario: Scenario,
        coupling: Coupling,
        solver: Solver | OnWorkers | None = None,
        most: int = DEFAULTS.max_group,
    ) -> None:
        super().__init__(scenario, coupling, solver)
        size = most if coupling.in_groups else 1
        self._groups = InGroups(scenario, self._effort, size, solver)

    def improved(self, plan: Plan, vehicles: IntArray, tolerance: float) -> Plan:
        """As for every subproblem, around a reference if that is of use.

        The plan itself is given where references cost no less by the tolerance, unless it is the
        first: restorations and callers may have found it by other means.
        """
        spent = Statistics()
        try:
            reference = self._groups.reference(plan, tolerance)
            spent = reference.statistics
            if self.planes is not None and reference.cost >= (1.0 - tolerance) * plan.cost:
                return plan.with_statistics(spent)
            self._warm = self._groups.active
            apart = self._apart(reference.with_statistics(Statistics()))
            spent += apart.statistics
            after = self.around(apart)
            if after.cost < plan.cost:
                change = abs(reference.cost - after.cost)
                self.settled = self._groups.settled and change <= tolerance * reference.cost
                return after.with_statistics(spent + after.statistics)
            spent += after.statistics
        except (InfeasibleError, SolverError) as error:
            spent += error.statistics
        after = self.around(plan, vehicles)
        return after.with_statistics(spent + after.statistics)

    def _apart(self, reference: Plan) -> Plan:
        """A reference that keeps every constraint, so that the problem around it has a solution."""
        if self.holds(reference):
            return reference
        return restored(reference, Restoration(self.scenario, self._solver, _BEGUN), most=_STEPS)
