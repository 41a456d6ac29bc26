"""Fleets whose vehicles are too close to each other, brought apart by references.

While pairs are too close, a step of the restoration needs no plan but something to linearise
around next. So it is found as groups find references (`group_references`), by programs in which a
penalty bounds multipliers. As soon as nobody is too close to others by much, those that still are
have programs with hard rows, by the solver that was asked for, and the others go on flying what
keeps every constraint already. Iterations from there plan everyone by that solver.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.clearance import NONE, CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.constraints.close_pairs import most_beside, pairs_within, separation_of
from drake_rho.planning.constraints.margins import finer_margins_of
from drake_rho.planning.constraints.separation import decoupled
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.programs.parallel import OnWorkers
from drake_rho.planning.programs.solve import Solver
from drake_rho.planning.scp.group_references import InGroups
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_TOGETHER = 3
"""Bound on the vehicles of a group while few pairs are too close."""

_STUCK_TOGETHER, _BESIDE = 8, 1.05
"""The same bound where some are so much in the way of each other that hard rows of them have no
solution while those next to them stay where they are; next to them, in separations, is this. One of
ten thousand that was stuck in between took twenty more steps without."""

_FEW = 0.25
"""Part of a fleet up to which those in trouble are brought apart in groups: groups of many rows
take long, and while many are in trouble all that is found moves on."""

_ROUNDS = 4
"""Rounds of rows in a step; the first steps have fewer, as all that they find moves on. With two
all the time, two fifths of a large fleet stay in trouble: who is kept from one meets another."""

_NOBODY = np.zeros(0, dtype=int)


class Restoration(Subproblem):
    """The steps of a fleet's restoration. What is inside of obstacles is for programs with slack.

    Args:
        scenario: what is asked; it has a separation.
        solver: a Drake solver or `Daqp()`, perhaps on an executor; Clarabel if not given.
        begun: how many steps count as taken before the first.
    """

    steepest = 1e3  # more than being too close can gain changes nothing, but takes digits

    def __init__(
        self, scenario: Scenario, solver: Solver | OnWorkers | None = None, begun: int = 0
    ) -> None:
        super().__init__(scenario, decoupled, solver)
        self.begun = begun
        separation = separation_of(scenario)
        self._kept = separation.distance + most_beside(separation, finer_margins_of(scenario))
        self._apart = InGroups(scenario, self._effort, _TOGETHER, solver)

    def restored(self, reference: Plan, penalty: float, number: int) -> Plan:
        """As for every subproblem; what is not a plan yet need not keep limits."""
        found, stuck = self._look_at(reference), _NOBODY
        if len(found.inside) + len(found.unflyable) > 0:
            return super().restored(reference, penalty, number)
        if found.is_almost_clear(self.scenario):
            try:
                return self.around(reference, found.vehicles)
            except InfeasibleError as error:  # not yet
                stuck = np.sort([self.scenario.index_of(name) for name in error.conflicts])
            except SolverError:
                pass
        try:
            return self._brought_apart(reference, penalty, number, stuck)
        except SolverError:
            return super().restored(reference, penalty, number)

    def _brought_apart(self, reference: Plan, penalty: float, number: int, stuck: IntArray) -> Plan:
        """What those in trouble fly at a penalty, and the others as in the reference.

        Args:
            reference: as for `restored`, as the next two.
            penalty: of each metre.
            number: of the step.
            stuck: who has no motion with hard rows beside the others'; they are planned with them.

        Raises:
            SolverError: the multipliers of a group are not found.
        """
        found, motion = self._look_at(reference), reference.motion()
        beside = self._beside(motion, stuck)
        close = beside.and_also(found.pairs)
        few = len(found.vehicles) <= _FEW * len(self.labels)
        self._apart.regroup(
            close if few else beside,
            2.0 * self._kept,
            _TOGETHER if len(stuck) == 0 else _STUCK_TOGETHER,
        )
        motion, spent = self._apart.around(
            motion,
            penalty=penalty,
            aside=number == 0,
            vehicles=np.unique(np.concatenate([found.vehicles, stuck, beside.one, beside.other])),
            close=close,
            rounds=min(number + 1, _ROUNDS),
        )
        return Plan.from_motion(self.scenario, motion, spent)

    def _beside(self, motion: Motion, stuck: IntArray) -> CloseApproaches:
        """Who comes next to those that are stuck, and when."""
        if len(stuck) == 0:
            return NONE
        separation, between = separation_of(self.scenario), self.scenario.between_knots
        return pairs_within(separation, motion, _BESIDE * self._kept, between=between, of=stuck)
