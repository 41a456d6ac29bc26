"""Steps of the restoration of a fleet, whose vehicles are too close to each other.

While pairs are too close by much, a step needs no plan but something to linearise around next. So
it is found as groups find references (`group_references`), by programs in which a penalty bounds
multipliers. As soon as pairs are nearly apart, violating vehicles have programs with hard rows, by
the solver that was asked for, and the others go on flying what violates nothing. Iterations from
there plan everyone by that solver.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.close_pairs import NO_APPROACHES, CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.constraints.close_pairs import max_pair_margin, pairs_within, separation_of
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.restoration import SoftRows
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray

_TOGETHER = 3
"""Bound on the vehicles of a group while few pairs are too close."""

_FAILING_TOGETHER, _BESIDE = 8, 1.05
"""The same bound where hard rows have no solution while the vehicles next to the failing ones fly
on as they did; and how close, in required distances, is next to. Without it one vehicle of ten
thousand, in between others, took twenty more steps."""

_FEW = 0.25
"""Part of a fleet up to which violating vehicles are brought apart in groups: groups of many rows
take long, and while many vehicles violate something all that is found moves on."""

_ROUNDS = 4
"""Rounds of rows in a step; the first steps have fewer, as all that they find moves on. With two
all the time, two fifths of a large fleet go on violating their separation: a vehicle that is kept
from one meets another."""

_NOBODY = np.zeros(0, dtype=int)


class FleetSteps:
    """Steps of a fleet's restoration, found as references in groups where that is enough.

    Obstacles that are violated, and positions that are dynamically inconsistent, are for programs
    with slack (`SoftRows`).

    Args:
        subproblem: decoupled, of a scenario with a separation.
    """

    steepest = 1e3  # more than being too close can gain changes nothing, but takes digits

    def __init__(self, subproblem: Subproblem) -> None:
        self._subproblem, self._soft = subproblem, SoftRows(subproblem)
        problem = subproblem.problem
        separation = separation_of(problem.scenario)
        margin = max_pair_margin(separation, problem.margins.inner)
        self._required = separation.distance + margin
        self._groups = InGroups(problem, _TOGETHER, subproblem.backend)

    def __call__(self, reference: Plan, penalty: float, number: int) -> Plan:
        """Return a step's plan, as every `Step` does; it need not keep limits before it is one."""
        found, failing = self._subproblem.violations(reference), _NOBODY
        if len(found.inside) + len(found.inconsistent) > 0:
            return self._soft(reference, penalty, number)
        if found.is_nearly_clear:
            try:
                return self._subproblem.around(reference, found.vehicles)
            except InfeasibleError as error:  # not yet
                names = self._subproblem.problem.scenario.index_of
                failing = np.sort([names(name) for name in error.conflicts])
            except SolverError:
                pass
        try:
            return self._apart(reference, penalty, number, failing)
        except SolverError:
            return self._soft(reference, penalty, number)

    def _apart(self, reference: Plan, penalty: float, number: int, failing: IntArray) -> Plan:
        """Return what violating vehicles fly at a penalty, the others flying the reference.

        Args:
            reference: as for every step, as the next two.
            penalty: of each metre.
            number: of the step.
            failing: vehicles without a motion with hard rows beside the others, which are planned
                with them.

        Raises:
            SolverError: the multipliers of a group are not found.
        """
        found, motion = self._subproblem.violations(reference), reference.motion()
        beside = self._beside(motion, failing)
        close = beside.union(found.pairs)
        few = len(found.vehicles) <= _FEW * len(self._subproblem.problem)
        self._groups.regroup(
            close if few else beside,
            2.0 * self._required,
            _TOGETHER if len(failing) == 0 else _FAILING_TOGETHER,
        )
        motion, spent = self._groups.around(
            motion,
            penalty=penalty,
            one_normal=number == 0,
            vehicles=np.unique(np.concatenate([found.vehicles, failing, beside.one, beside.other])),
            close=close,
            rounds=min(number + 1, _ROUNDS),
        )
        return Plan.from_motion(self._subproblem.problem.scenario, motion, spent)

    def _beside(self, motion: Motion, failing: IntArray) -> CloseApproaches:
        """Return who comes next to failing vehicles, and when."""
        if len(failing) == 0:
            return NO_APPROACHES
        scenario = self._subproblem.problem.scenario
        return pairs_within(
            separation_of(scenario),
            motion,
            _BESIDE * self._required,
            between=scenario.between_knots,
            of=failing,
        )
