"""Drake system that commands the headings of vehicles along the planned motion in force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from drake_rho.motion.headings import STEP, Direction, angles, headings, turned
from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray


class HeadingSource(LeafSystem):
    """Headings that follow the planned motion at a limited rate, as those of exports.

    A vehicle begins in the direction in which the first plan departs. Every `STEP` it turns towards
    the planned direction of that time, so that it is there a step later.

    Ports: input `nominal` (9N), as of a `RecedingHorizonController`; output `heading` (2N: heading
    [rad] and rate [rad/s] of each vehicle in turn).

    Args:
        plan: first plan.
        directions: direction of each vehicle.
    """

    def __init__(self, plan: Plan, directions: Sequence[Direction]) -> None:
        super().__init__()
        self._directions, count = directions, len(directions)
        self._turning = [i for i, each in enumerate(directions) if not isinstance(each, float)]
        self.first: FloatArray = headings(plan, np.zeros(1), directions)[:, 0]
        self._nominal = self.DeclareVectorInputPort("nominal", 9 * count)
        state = np.concatenate([self.first, np.zeros(count), [0.0]])  # the last is its time
        self.DeclareDiscreteState(state)
        if self._turning:
            self.DeclarePeriodicDiscreteUpdateEvent(STEP, 0.0, self._update)
        self.DeclareVectorOutputPort("heading", 2 * count, self._report)

    def _update(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        now, rates = self._at(context)
        planned = self._nominal.Eval(context).reshape(-1, 1, 9)
        targets = angles(planned[..., :3], planned[..., 3:6], self._directions)[:, 0]
        own = now[self._turning]
        rates[self._turning] = (turned(own, targets, STEP) - own) / STEP
        discrete.set_value(np.concatenate([now, rates, [context.get_time()]]))
        return EventStatus.Succeeded()

    def _at(self, context: Context) -> tuple[FloatArray, FloatArray]:
        """Return headings [rad] and rates [rad/s], shape (N,) each."""
        *values, since = context.get_discrete_state_vector().CopyToVector()
        then, rates = np.array(values).reshape(2, -1)
        return then + (context.get_time() - since) * rates, rates

    def _report(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.stack(self._at(context), axis=1).reshape(-1))
