"""The convex problem around one reference after another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.coupling import Coupling, coupled, decoupled, grouped
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
        problem: its separation is left out.
        reference: a motion of the same vehicles on the same grid; None leaves obstacles out.
        backend: Clarabel if not given.

    Raises:
        InfeasibleError: the linearised program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
        ValueError: the reference has other vehicles or another grid.
    """
    planes = CuttingPlanes(problem, backend)
    planes.keep_to(problem.linearized(reference), reference=reference)
    return planes.plan(reference)


def coupling_for(scenario: Scenario, options: Options = DEFAULTS) -> Coupling:
    """Return how a fleet is kept apart by default: the larger it is, the less coupled."""
    count = len(scenario.vehicles)
    if count <= options.max_coupled:
        return coupled
    return grouped if count <= options.max_grouped else decoupled


class Subproblem:
    """Convex subproblems of one problem, solved around one reference after another.

    Rows that are active in one solution are in the next program from the start.

    Args:
        problem: to be solved.
        coupling: how pairs are kept apart, if the scenario requires it.
        backend: Clarabel if not given.

    Attributes:
        problem: as given.
        backend: as given.
        coupling: as given.
        planes: the programs that were solved last; None before the first.
    """

    def __init__(
        self, problem: Problem, coupling: Coupling = coupled, backend: Backend | None = None
    ) -> None:
        self.problem, self.coupling, self.backend = problem, coupling, backend or Backend()
        self.planes: CuttingPlanes | None = None
        self._cones, self._warm = ConicPrograms(problem.effort), list[HalfSpaces]()
        self._looked: tuple[Plan, Violations] | None = None

    def restarted(self) -> Subproblem:
        """Return this subproblem without rows of solutions, to begin from another reference.

        What it found of limits goes on to hold: whose curved sets come to no end as tangent planes.
        """
        fresh = Subproblem(self.problem, self.coupling, self.backend)
        fresh._cones = self._cones
        return fresh

    def begin_with(self, rows: Sequence[HalfSpaces]) -> None:
        """Put rows in the next program from the start, in place of those of the last solution."""
        self._warm = list(rows)

    def around(self, reference: Plan, vehicles: IntArray | None = None) -> Plan:
        """Return the plan of least cost with obstacles and pairs linearised around a reference.

        Where a coupled fleet has none, it has none decoupled either, and then each vehicle's
        reasons can be told.

        Args:
            reference: a motion of the same vehicles on the same grid.
            vehicles: which of them are planned, rising indices; the others fly the reference.

        Raises:
            InfeasibleError: there is none.
            SolverError: the solvers fail numerically.
        """
        constraints = self.problem.linearized(reference, self.coupling, vehicles=vehicles)
        try:
            return self.solved(reference, constraints, vehicles)
        except InfeasibleError:
            if self.problem.scenario.separation is None or not self.coupling.together:
                raise
        other = Subproblem(self.problem, decoupled, self.backend)
        plan = other.around(reference)
        self.planes = other.planes
        return plan

    def solved(
        self, reference: Plan, constraints: Sequence[Constraint], vehicles: IntArray | None = None
    ) -> Plan:
        """Return the plan of least cost with given constraints.

        Args:
            reference: that they are linearised around.
            constraints: all that hold, or may be violated at a penalty.
            vehicles: as for `around`, which also says what is raised.
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
        """Return what a plan violates, looked for once."""
        if self._looked is None or self._looked[0] is not plan:
            self.problem.check_fits(plan)
            self._looked = plan, violations_of(self.problem, plan, self._looked)
        return self._looked[1]

    def holds(self, plan: Plan) -> bool:
        """Return whether a plan violates nothing."""
        return self.violations(plan).none

    @property
    def stopping_together(self) -> IntArray:
        """Labels, the same for vehicles whose iterations stop together, shape (N,)."""
        count = len(self.problem)
        apart = self.problem.scenario.separation is not None
        return np.zeros(count, dtype=int) if apart else np.arange(count)
