"""Convex subproblem: the problem with obstacles and pairs linearised around a reference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.separation import Coupling, coupled, decoupled, grouped
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.conic import ConicPrograms
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.violations import Violations, violations_of
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario


def plan_around(problem: Problem, reference: Plan | None, backend: Backend | None = None) -> Plan:
    """Return the plan of least cost with obstacles linearised (15) around a reference.

    Args:
        problem: the problem to solve; its separation is omitted.
        reference: a motion of the same vehicles on the same grid; None omits obstacles.
        backend: the solver and its settings; Clarabel if not given.

    Raises:
        InfeasibleError: the linearised program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
        ValueError: the reference has other vehicles or another grid.
    """
    planes = CuttingPlanes(problem, backend)
    planes.keep_to(problem.linearized(reference), reference=reference)
    return planes.plan(reference)


def coupling_for(scenario: Scenario, options: Options = DEFAULTS) -> Coupling:
    """Return the default coupling of a fleet: the larger the fleet, the less coupled."""
    count = len(scenario.vehicles)
    if count <= options.max_coupled:
        return coupled
    return grouped if count <= options.max_grouped else decoupled


class Subproblem:
    """Convex subproblems of one problem, solved around successive references.

    Rows that are active in one solution start the working set of the next.

    Args:
        problem: the problem to solve.
        coupling: the coupling of pairs, if the scenario has a separation.
        backend: the solver and its settings; Clarabel if not given.

    Attributes:
        problem: the problem to solve.
        backend: the solver and its settings.
        coupling: the coupling of pairs.
        planes: the programs that were solved last; None before the first.
    """

    def __init__(
        self, problem: Problem, coupling: Coupling = coupled, backend: Backend | None = None
    ) -> None:
        self.problem, self.coupling, self.backend = problem, coupling, backend or Backend()
        self.planes: CuttingPlanes | None = None
        self._cones, self._warm = ConicPrograms(problem.effort), list[HalfSpaces]()
        self._evaluated: tuple[Plan, Violations] | None = None

    def restarted(self) -> Subproblem:
        """Return this subproblem without the rows of earlier solutions, for another reference.

        The choice of cones stays: these vehicles' curved sets do not converge as tangent planes.
        """
        fresh = Subproblem(self.problem, self.coupling, self.backend)
        fresh._cones = self._cones
        return fresh

    def warm_start(self, rows: Sequence[HalfSpaces]) -> None:
        """Start the next working set with these rows, in place of those of the last solution."""
        self._warm = list(rows)

    def solve_around(self, reference: Plan, vehicles: IntArray | None = None) -> Plan:
        """Return the plan of least cost with obstacles and pairs linearised around a reference.

        If the coupled program of a fleet is infeasible, so are the decoupled ones. They are solved
        then, because their error names the conflict of each vehicle.

        Args:
            reference: a motion of the same vehicles on the same grid.
            vehicles: indices of the planned vehicles, ascending; others keep the reference.

        Raises:
            InfeasibleError: the linearised program has no solution.
            SolverError: the solvers fail numerically.
        """
        if vehicles is not None:
            vehicles = self.problem.with_linked(vehicles)
        constraints = self.problem.linearized(reference, self.coupling, vehicles=vehicles)
        try:
            return self.solve_with(reference, constraints, vehicles)
        except InfeasibleError:
            if self.problem.scenario.separation is None or not self.coupling.together:
                raise
        other = Subproblem(self.problem, decoupled, self.backend)
        plan = other.solve_around(reference)
        self.planes = other.planes
        return plan

    def solve_with(
        self, reference: Plan, constraints: Sequence[Constraint], vehicles: IntArray | None = None
    ) -> Plan:
        """Return the plan of least cost with given constraints.

        Args:
            reference: the plan around which the constraints are linearised.
            constraints: all constraints, hard or soft.
            vehicles: indices of the planned vehicles, ascending; others keep the reference.

        Raises:
            InfeasibleError: the program has no solution.
            SolverError: the solvers fail numerically.
        """
        by_key = {constraint.key: constraint for constraint in constraints}
        planes = CuttingPlanes(
            self.problem,
            self.backend,
            vehicles=vehicles,
            accelerations=reference.accelerations,
            cones=self._cones,
        )
        warm = [by_key[rows.constraint.key].renewed(rows) for rows in self._warm]
        planes.keep_to(constraints, warm=warm, reference=reference)
        self._warm = planes.working.active(planes.motion)
        self.planes = planes
        return planes.plan(reference)

    def violations(self, plan: Plan) -> Violations:
        """Return the violations of a plan; those of the last plan are cached."""
        if self._evaluated is None or self._evaluated[0] is not plan:
            self.problem.check_fits(plan)
            self._evaluated = plan, violations_of(self.problem, plan, self._evaluated)
        return self._evaluated[1]

    def holds(self, plan: Plan) -> bool:
        """Return whether a plan violates nothing."""
        return self.violations(plan).none

    @property
    def converging_together(self) -> IntArray:
        """Labels of vehicles, equal for vehicles that converge together, shape (N,)."""
        if self.problem.scenario.separation is not None:
            return np.zeros(len(self.problem), dtype=int)
        return self.problem.linked_groups
