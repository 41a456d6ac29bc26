"""Fleets whose vehicles are too close to each other, brought apart by references.

While pairs are too close, a step of the restoration needs no plan but something to linearise
around next. So it is found as groups find references (`drake_rho.planning.in_groups`), by programs
in which a penalty bounds multipliers. Not until almost everyone is clear of everyone is there a
program with hard rows for every vehicle, by the solver that was asked for.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.blocks import OnWorkers, executor_of
from drake_rho.planning.close_pairs import separation_of
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.in_groups import InGroups
from drake_rho.planning.keep_apart import decoupled
from drake_rho.planning.solve import Solver
from drake_rho.planning.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_TOGETHER = 5
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
    """

    steepest = 1e3  # more than being too close can gain changes nothing, but takes digits

    def __init__(self, scenario: Scenario, solver: Solver | OnWorkers | None = None) -> None:
        super().__init__(scenario, decoupled, solver)
        self._apart = InGroups(scenario, self._effort, _TOGETHER, executor_of(solver))
        self._found: Plan | None = None
        self._roughly = False
        self._refused: InfeasibleError | SolverError = SolverError("no plan was tried yet")

    def restored(self, reference: Plan, penalty: float, number: int) -> Plan:
        """As for every subproblem; what is not a plan yet need not keep limits."""
        found = self._look_at(reference)
        if len(found.inside) + len(found.unflyable) > 0:
            return super().restored(reference, penalty, number)
        vehicles = found.vehicles
        if found.is_almost_clear(self.scenario):
            try:
                return self._kept(reference, vehicles)
            except InfeasibleError as error:  # not yet
                self._refused = error
                stuck = [self.scenario.index_of(name) for name in error.conflicts]
                vehicles = np.union1d(vehicles, stuck).astype(int)
            except SolverError as error:  # it names nobody: all look for another reference
                self._refused, vehicles = error, np.arange(len(self.labels))
        try:
            return self._brought_apart(reference, penalty, number, vehicles)
        except SolverError:
            return super().restored(reference, penalty, number)

    def holds(self, plan: Plan) -> bool:
        """As for every subproblem, but that after references only hard rows of everyone count."""
        return (plan is self._found or not self._roughly) and super().holds(plan)

    def failure(self, plan: Plan, spent: Statistics) -> InfeasibleError | SolverError | None:
        """What a plan does not keep out of or, if that is nothing, why it was not one."""
        if self.holds(plan) or len(self.in_trouble(plan)) > 0:
            return super().failure(plan, spent)
        self._refused.statistics = spent
        return self._refused

    def _kept(self, reference: Plan, vehicles: IntArray) -> Plan:
        """A plan of everyone, if those that are still in trouble have one: nobody else needs it."""
        if 0 < len(vehicles) < len(self.labels):
            self.around(reference, vehicles)
        self._found = self.around(reference)
        return self._found

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
        self._roughly = True
        return Plan.from_accelerations(self.scenario, motion.accelerations, spent)
