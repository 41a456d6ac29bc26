"""Fleets whose vehicles are too close to each other, brought apart by references.

While pairs are too close, a step of the restoration needs no plan but something to linearise
around next. So it is found as groups find references (`drake_rho.planning.in_groups`), by programs
in which a penalty bounds multipliers. As soon as nobody is too close to others by much, those that
still are have programs with hard rows, by the solver that was asked for, and the others go on
flying what keeps every constraint already. Iterations from there plan everyone by that solver.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.blocks import OnWorkers, executor_of
from drake_rho.planning.close_pairs import separation_of
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.in_groups import InGroups
from drake_rho.planning.keep_apart import decoupled
from drake_rho.planning.solve import Solver
from drake_rho.planning.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_TOGETHER = 3
"""Bound on the vehicles of a group while few pairs are too close."""

_FEW = 0.25
"""Part of a fleet up to which those in trouble are brought apart in groups: groups of many rows
take long, and while many are in trouble all that is found moves on."""

_ROUNDS = 4
"""Rounds of rows in a step; the first steps have fewer, as all that they find moves on. With two
all the time, two fifths of a large fleet stay in trouble: who is kept from one meets another."""


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
        self._apart = InGroups(scenario, self._effort, _TOGETHER, executor_of(solver))

    def restored(self, reference: Plan, penalty: float, number: int) -> Plan:
        """As for every subproblem; what is not a plan yet need not keep limits."""
        found = self._look_at(reference)
        if len(found.inside) + len(found.unflyable) > 0:
            return super().restored(reference, penalty, number)
        vehicles = found.vehicles
        if found.is_almost_clear(self.scenario):
            try:
                return self.around(reference, vehicles)
            except InfeasibleError as error:  # not yet
                stuck = [self.scenario.index_of(name) for name in error.conflicts]
                vehicles = np.union1d(vehicles, stuck).astype(int)
            except SolverError:
                pass
        try:
            return self._brought_apart(reference, penalty, number, vehicles)
        except SolverError:
            return super().restored(reference, penalty, number)

    def _brought_apart(
        self, reference: Plan, penalty: float, number: int, vehicles: IntArray
    ) -> Plan:
        """What some vehicles fly at a penalty, and the others as in the reference.

        Raises:
            SolverError: the multipliers of a group are not found.
        """
        pairs, few = self._look_at(reference).pairs, len(vehicles) <= _FEW * len(self.labels)
        within = 2.0 * separation_of(self.scenario).distance
        self._apart.regroup(pairs if few else pairs.select(slice(0)), within)
        motion, spent = self._apart.around(
            reference.motion(),
            penalty=penalty,
            aside=number == 0,
            vehicles=vehicles,
            rounds=min(number + 1, _ROUNDS),
        )
        return Plan.from_accelerations(self.scenario, motion.accelerations, spent)
