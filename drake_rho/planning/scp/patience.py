"""Stopping criteria of a feasibility restoration that makes no progress."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

PATIENCE = 20
"""Penalties without a decrease in violating vehicles after which a restoration stops."""

_STALLED, _FALL = 4, 0.98
"""Penalties after which a restoration without a separation stops unless the worst violation has
fallen to this fraction. The violation has then converged to the least that linearisation finds."""

_SAME, _SETTLING = 0.05, 3
"""Largest difference between motions that count as the same dead end, as a fraction of the least
extent of anything avoided; and the penalties after which this is tested."""


class DeadEnds:
    """Distinct motions at which restorations of one scenario ended without a plan.

    Args:
        scenario: the scenario of the restorations.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._near = _SAME * least_extent(scenario)
        self._positions = list[FloatArray]()

    def __len__(self) -> int:
        """Return the number of dead ends."""
        return len(self._positions)

    def is_near(self, plan: Plan) -> bool:
        """Return whether a plan is close to some dead end at every knot."""
        return any(np.abs(plan.positions - end).max() < self._near for end in self._positions)

    def add(self, plan: Plan) -> None:
        """Add the plan at which a restoration ended, unless it is close to a known dead end."""
        if not self.is_near(plan):
            self._positions.append(plan.positions)


class Patience:
    """Stopping test of one restoration.

    Args:
        subproblem: the subproblem that the restoration solves.
        dead_ends: the dead ends of earlier restorations, if there are any.
    """

    def __init__(self, subproblem: Subproblem, dead_ends: DeadEnds | None) -> None:
        self._subproblem, self._dead_ends = subproblem, dead_ends
        self._has_separation = subproblem.problem.scenario.separation is not None
        self._fewest, self._worst = len(subproblem.problem) + 1, np.inf
        self._steps = self._since_fewest = self._since_worst = 0

    def ends(self, plan: Plan) -> bool:
        """Return whether the restoration stops after this plan, since it makes no progress."""
        found = self._subproblem.violations(plan)
        number, worst = len(found.vehicles), found.worst
        self._steps += 1
        self._since_fewest += 1
        self._since_worst += 1
        if worst < _FALL * self._worst or number < self._fewest:
            self._worst, self._since_worst = worst, 0
        if number < self._fewest:
            self._fewest, self._since_fewest = number, 0
        stalled = self._since_worst >= _STALLED and not self._has_separation
        if self._since_fewest >= PATIENCE or stalled:
            return True
        known = self._dead_ends
        return known is not None and self._steps >= _SETTLING and known.is_near(plan)


def least_extent(scenario: Scenario) -> float:
    """Return the least extent of any obstacle or of the separation [m]."""
    extents = [scenario.fleet.extent_to_evade(body.shape) for _, body in scenario.avoided]
    if scenario.separation is not None:
        extents.append(scenario.separation.distance)
    return min(extents, default=float(scenario.fleet.lengths.max()))
