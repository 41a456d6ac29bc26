"""Tests of when a feasibility restoration is given up."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

PATIENCE = 20
"""Penalties after which a restoration is given up if there are no fewer violating vehicles."""

_STALLED, _FALL = 4, 0.98
"""Penalties after which it is given up, where nobody has to keep apart, if the worst violation has
not fallen to this part: what is left then is the least that linearising around it leads to."""

_SAME, _ARRIVED = 0.05, 3
"""Part of the least extent of anything avoided by which motions may differ that come to the same
end; and the penalties after which that can be told."""


class DeadEnds:
    """Ends of restorations of one scenario without a plan, each once.

    Args:
        scenario: of the restorations.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._near = _SAME * least_extent(scenario)
        self._positions = list[FloatArray]()

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._positions)

    def is_near(self, plan: Plan) -> bool:
        """Return whether a plan is close to one of them all the time."""
        return any(np.abs(plan.positions - end).max() < self._near for end in self._positions)

    def add(self, plan: Plan) -> None:
        """Note where a restoration ended, unless one has ended there."""
        if not self.is_near(plan):
            self._positions.append(plan.positions)


class Patience:
    """Test of when a restoration is given up.

    Args:
        subproblem: that is restored.
        dead_ends: of others before it, if there are any.
    """

    def __init__(self, subproblem: Subproblem, dead_ends: DeadEnds | None) -> None:
        self._subproblem, self._dead_ends = subproblem, dead_ends
        apart = subproblem.problem.scenario.separation is not None
        self._left, self._worst = len(subproblem.problem) + 1, np.inf
        self._steps = self._since_left = self._since_worst = 0
        self._apart = apart

    def ends(self, plan: Plan) -> bool:
        """Return whether the next penalty is not worth its time after this plan."""
        found = self._subproblem.violations(plan)
        left, worst = len(found.vehicles), found.worst
        self._steps += 1
        self._since_left += 1
        self._since_worst += 1
        if worst < _FALL * self._worst or left < self._left:
            self._worst, self._since_worst = worst, 0
        if left < self._left:
            self._left, self._since_left = left, 0
        stalled = self._since_worst >= _STALLED and not self._apart
        if self._since_left >= PATIENCE or stalled:
            return True
        known = self._dead_ends
        return known is not None and self._steps >= _ARRIVED and known.is_near(plan)


def least_extent(scenario: Scenario) -> float:
    """Return the least extent of anything that is avoided [m]."""
    extents = [float(obstacle.shape.extent.min()) for _, obstacle in scenario.known]
    if scenario.separation is not None:
        extents.append(scenario.separation.distance)
    return min(extents, default=float(scenario.fleet.lengths.max()))
