"""Keep in a ball: the largest speed, by tangent planes where a motion is faster."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.half_spaces import BROKEN, Constraint, HalfSpaces, near
from drake_rho.planning.keep_in import QUANTITIES
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.fleet import Norms
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInBall(Constraint):
    """The norm of a quantity of every vehicle is at most a given one.

    Where a value x is longer, the half-space -x / norm(x) · value >= -most supports the ball at
    the point nearest to x. Velocities are linear between knots and their norm convex, so it is
    largest at a knot.
    """

    norms: Norms
    """how long at most"""
    times: FloatArray
    """knots at which it is asked, the inner ones [s], shape (K-2,)"""

    def violated(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Tangent planes at the knots where a value is too long."""
        values = motion.values(self.quantity)[vehicles, 1:-1]
        lengths = np.sqrt(np.einsum("pti,pti->pt", values, values))
        most = (self.norms.most + BROKEN * self.norms.tolerances)[vehicles, None]
        broken = lengths > most
        runs = np.repeat(np.arange(len(vehicles)), len(self.times))
        broken = near(broken.reshape(-1), runs, reach).reshape(broken.shape) & (lengths > 0.0)
        which, knots = np.nonzero(broken)
        own = vehicles[which]
        return HalfSpaces(
            self,
            vehicles=own,
            partners=own,
            sides=np.zeros(len(own), dtype=int),
            times=self.times[knots],
            normals=-values[which, knots] / lengths[which, knots, None],
            bounds=-self.norms.most[own],
            tolerances=self.norms.tolerances[own],
        )


def balls_of(scenario: Scenario) -> list[Constraint]:
    """The limits on norms that the vehicles have to keep to."""
    speeds = scenario.fleet.max_speeds()
    if speeds is None:
        return []
    return [
        KeepInBall(
            number=len(QUANTITIES),
            name="maximum speed",
            quantity="velocity",
            curved=True,
            norms=speeds,
            times=scenario.grid.times[1:-1],
        )
    ]
