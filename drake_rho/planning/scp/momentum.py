"""References ahead of the latest plan, where linearisations converge slowly.

Around edges and corners a linearisation moves a plan a little further the way of the one before, a
hundred times and more. The half-spaces around any reference are subsets of what (8) allows, so a
reference may as well lie ahead of the plan, in the direction of its last change. The factors are
Nesterov's, with the restarts of O'Donoghue and Candès (2015): a vehicle whose cost does not fall is
linearised around its plan again.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_PLAIN, _FAR = 10, 1e-3
"""Linearisations around the latest plan, and the relative fall of the cost in a later one from
which on references are ahead. Most scenarios converge without."""


class Momentum:
    """Choice of the next reference, for each vehicle.

    Args:
        vehicles: number of vehicles, N.

    Attributes:
        ahead: mask of the vehicles that the last reference was ahead of, shape (N,).
    """

    def __init__(self, vehicles: int) -> None:
        self.ahead: BoolArray = np.zeros(vehicles, dtype=bool)
        self._terms: FloatArray = np.ones(vehicles)  # of the sequence t with t² - t = (last t)²
        self._before: FloatArray | None = None
        self._steps, self._begun = 0, False

    def reference(self, plan: Plan, vehicles: IntArray, fall: float | None) -> Plan:
        """Return the next reference; vehicles that are not planned again keep the plan.

        Args:
            plan: the latest plan.
            vehicles: indices of the vehicles to plan again.
            fall: relative decrease of the cost in the last linearisation, if there was one.
        """
        before, self._before = self._before, plan.accelerations
        self.ahead[:] = False
        self._steps += 1
        self._begun |= fall is not None and self._steps > _PLAIN and fall > _FAR
        if before is None or not self._begun:
            return plan
        following = (1.0 + np.sqrt(1.0 + 4.0 * self._terms**2)) / 2.0
        factors = np.zeros(len(before))
        factors[vehicles] = ((self._terms - 1.0) / following)[vehicles]
        self._terms = following
        self.ahead[:] = factors > 0.0
        if not self.ahead.any():
            return plan
        change = factors[:, None, None] * (plan.accelerations - before)
        return Plan.from_accelerations(plan.scenario, plan.accelerations + change)

    def restart(self, vehicles: IntArray) -> None:
        """Begin again with references that are the plan of these vehicles."""
        self._terms[vehicles] = 1.0
