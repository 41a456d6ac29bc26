"""Feasibility restoration of fleets: steps that separate vehicles.

While violations of the separation are large, a step needs no plan, only the next reference. It is
found as in `group_references`, by dual programs in which the penalty bounds the multipliers. Once
the violations are small, violating vehicles get programs with hard rows, solved by the requested
solver, and the other vehicles keep their feasible motions. The iterations that follow plan all
vehicles with that solver.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.close_pairs import NO_APPROACHES, CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.constraints.close_pairs import max_pair_margin, pairs_within
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.restoration import SoftRows
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray

_GROUP = 3
"""Largest number of vehicles in a group while few pairs are too close."""

_INFEASIBLE_GROUP, _NEIGHBOURHOOD = 8, 1.05
"""Largest number of vehicles in a group after hard rows were infeasible with the motions of the
neighbours fixed; and the distance, in required distances, within which vehicles are neighbours.
Without these groups, one vehicle of ten thousand, in between others, took twenty more steps."""

_GROUPED_FRACTION = 0.25
"""Largest fraction of a fleet at which violating vehicles are brought apart in groups. Groups with
many rows take long, and while many vehicles violate something every solution is provisional."""

_ROUNDS = 4
"""Rounds of rows in a step. The first steps have fewer, since their solutions are provisional. With
two rounds in every step, two fifths of a large fleet continue to violate the separation: a vehicle
that moves away from one meets another."""

_NO_VEHICLES = np.zeros(0, dtype=int)


class FleetSteps:
    """Steps of a fleet's restoration, found as references in groups where these suffice.

    Violated obstacles and dynamically inconsistent positions need programs with slack (`SoftRows`).

    Args:
        subproblem: the decoupled subproblem of a scenario with a separation.
    """

    max_growth = 1e3  # a penalty beyond the gain of any violation only costs digits

    def __init__(self, subproblem: Subproblem) -> None:
        self._subproblem, self._soft = subproblem, SoftRows(subproblem)
        problem = subproblem.problem
        separation = problem.pair_search.separation
        margin = max_pair_margin(separation, problem.margins.inner)
        self._required = separation.distance + margin
        self._groups = InGroups(problem, _GROUP, subproblem.backend)

    def __call__(self, reference: Plan, penalty: float, number: int) -> Plan:
        """Return the plan of a step, as every `Step` does; it may violate limits until the last."""
        found, infeasible = self._subproblem.violations(reference), _NO_VEHICLES
        if len(found.inside) + len(found.inconsistent) > 0:
            return self._soft(reference, penalty, number)
        if found.is_nearly_clear:
            try:
                return self._subproblem.solve_around(reference, found.vehicles)
            except InfeasibleError as error:  # hard rows come too early
                index_of = self._subproblem.problem.scenario.index_of
                infeasible = np.sort([index_of(name) for name in error.conflicts])
            except SolverError:
                pass
        try:
            return self._grouped(reference, penalty, number, infeasible)
        except SolverError:
            return self._soft(reference, penalty, number)

    def _grouped(self, reference: Plan, penalty: float, number: int, infeasible: IntArray) -> Plan:
        """Return the motions of violating vehicles at a penalty; others keep the reference.

        Args:
            reference: the motion to linearise around.
            penalty: the cost of each metre of violation.
            number: the number of the step.
            infeasible: vehicles whose programs with hard rows have no solution; their neighbours
                are planned together with them.

        Raises:
            SolverError: the multipliers of a group are not found.
        """
        found, motion = self._subproblem.violations(reference), reference.motion()
        near = self._neighbours(motion, infeasible)
        approaches = near.merged(found.pairs)
        few = len(found.vehicles) <= _GROUPED_FRACTION * len(self._subproblem.problem)
        self._groups.regroup(
            approaches if few else near,
            2.0 * self._required,
            _GROUP if len(infeasible) == 0 else _INFEASIBLE_GROUP,
        )
        motion, spent = self._groups.solve_around(
            motion,
            penalty=penalty,
            one_normal=number == 0,
            vehicles=np.unique(np.concatenate([found.vehicles, infeasible, near.one, near.other])),
            approaches=approaches,
            rounds=min(number + 1, _ROUNDS),
        )
        return Plan.from_motion(self._subproblem.problem.scenario, motion, spent)

    def _neighbours(self, motion: Motion, infeasible: IntArray) -> CloseApproaches:
        """Return the close approaches of infeasible vehicles and their neighbours."""
        if len(infeasible) == 0:
            return NO_APPROACHES
        problem = self._subproblem.problem
        scenario = problem.scenario
        return pairs_within(
            problem.pair_search,
            motion,
            _NEIGHBOURHOOD * self._required,
            between=scenario.between_knots,
            of=infeasible,
            open_end=scenario.fleet.open_end,
        )
