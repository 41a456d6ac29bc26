"""The motions that break a scenario least, where it has no plan."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import repeat

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.catalogue import convex_constraints
from drake_rho.planning.constraints.goals import goals_of
from drake_rho.planning.constraints.separation import decoupled
from drake_rho.planning.constraints.tightening import starts_beyond_limits
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.programs.solve import Solver
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.sequential_convex import iterate, restored
from drake_rho.planning.scp.subproblem import Subproblem, constraints_around
from drake_rho.scenario.records import Scenario

_PENALTIES = 8
"""Penalties after which what is still too close stays so. Larger ones make it no smaller, and other
constraints less exact."""


def minimum_violation(scenario: Scenario, solver: Solver | None = None) -> Plan:
    """The plan that breaks goals and constraints least in total, each in its own scale.

    Acceleration boxes are kept, since they can always be met by themselves, and pairs are not
    looked at. Obstacles are linearised around the plan that breaks the rest least.

    Args:
        scenario: what is asked.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.

    Raises:
        SolverError: the solvers fail numerically.
    """
    subproblem = ElasticSubproblem(scenario, solver=solver)
    motion = MinimumEffort.of(scenario).motion
    start = Plan(scenario, motion.positions, motion.velocities, motion.accelerations)
    return iterate(subproblem, start, 1.0, repeat(1.0, 2 if scenario.known else 1))


class ElasticSubproblem(Subproblem):
    """Goals and constraints around a reference, all of which may be broken at a cost."""

    def restored(self, reference: Plan, penalty: float, number: int) -> Plan:
        """The least violation; the first time, obstacles are not looked at."""
        around = reference if number > 0 else None
        constraints = elastic(self.scenario, constraints_around(self.scenario, around), penalty)
        planes = elastic_planes(self.scenario, self._solver)
        planes.keep_to(constraints)
        return planes.plan(reference)

    def holds(self, plan: Plan) -> bool:
        """False, so that every penalty is gone through."""
        return False

    def failure(self, plan: Plan, spent: Statistics) -> InfeasibleError | None:
        """None: the least violation is the answer, however large it is."""
        return None


class LenientSubproblem(Subproblem):
    """Feasibility restoration that ends with what is left of the breaches, rather than an error.

    Vehicles that begin beyond limits of position or velocity come back at the cost of a breach.
    """

    def _limits(self, penalty: float) -> list[Constraint]:
        limits = convex_constraints(self.scenario)
        if not starts_beyond_limits(self.scenario):
            return limits
        return [
            each.softened(penalty) if each.quantity in ("position", "velocity") else each
            for each in limits
        ]

    def failure(self, plan: Plan, spent: Statistics) -> InfeasibleError | None:
        """Limits broken that may not be; what comes least too close is an answer."""
        motion, everyone = plan.motion(), np.arange(len(plan.accelerations))
        broken: dict[str, tuple[str, ...]] = {}
        for limit in self._limits(1.0):
            rows = limit.violated(motion, everyone)
            rows = rows.select(rows.margins(motion) < -rows.tolerances)
            for vehicle in np.unique(rows.vehicles) if np.isinf(limit.penalty) else ():
                name = self.scenario.vehicles[vehicle].name
                broken[name] = (*broken.get(name, ()), limit.name)
        return InfeasibleError(broken, statistics=spent) if broken else None


def minimum_breach(plan: Plan, solver: Solver | None = None) -> Plan:
    """A plan that keeps goals and limits, and comes as little as can be too close to the rest.

    The total over obstacles, pairs and instants is made small, linearised again and again.

    Args:
        plan: a motion that keeps goals and limits.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.

    Raises:
        InfeasibleError: the motion breaks limits, and no other was found.
    """
    subproblem = LenientSubproblem(plan.scenario, decoupled, solver)
    return restored(plan, subproblem, most=_PENALTIES)


def elastic(
    scenario: Scenario, constraints: Sequence[Constraint], penalty: float = 1.0
) -> list[Constraint]:
    """The goals and some constraints, to be broken at a penalty for each scale of a quantity.

    The scale is the largest of the vehicles'. Acceleration boxes remain as they are; curved sets
    of accelerations do not, since tangent planes would come to an end late where nothing but
    violations costs anything.
    """
    goals = goals_of(scenario)
    unit = float(scenario.fleet.scale("acceleration").max())
    return [
        each
        if each.quantity == "acceleration" and not each.curved
        else each.softened(penalty * unit**2 / float(scenario.fleet.scale(each.quantity).max()))
        for each in [*goals, *constraints]
    ]


def elastic_planes(
    scenario: Scenario,
    solver: Solver | None = None,
    vehicles: Sequence[int] | None = None,
) -> CuttingPlanes:
    """Programs in which only violations cost anything, and goals may be missed."""
    effort = MinimumEffort.of(scenario)
    return CuttingPlanes(
        scenario,
        solver,
        effort=effort.without_goals(),
        vehicles=None if vehicles is None else np.array(vehicles),
        accelerations=effort.motion.accelerations,
        linear=True,
    )
