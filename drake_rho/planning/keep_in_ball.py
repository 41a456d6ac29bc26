"""Keep in a ball: the largest speed, by tangent planes where a motion is faster."""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.half_spaces import BROKEN, Constraint, HalfSpaces, near
from drake_rho.planning.keep_in import QUANTITIES
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.fleet import Norms
from drake_rho.scenario.records import Scenario

_SOFT_ROUNDS = 16
"""Rounds in which tangent planes of a ball that may be left are added. Where nothing but violations
costs anything, solutions jump about, and their tangent planes come to an end late."""

_SOFT_PRECISION = 1e-3
"""Part of its radius by which a ball that may be left is left without another tangent plane."""

_GRID = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
_FACES = _GRID[np.any(_GRID, axis=1)]
_FACES /= np.linalg.norm(_FACES, axis=1, keepdims=True)
"""Inward normals of a polyhedron around the ball, shape (26, 3)."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInBall(Constraint):
    """The norm of a quantity of every vehicle is at most a given one.

    Where a value x is longer, the half-space -x / norm(x) · value >= -most supports the ball at
    the point nearest to x. Velocities are linear between knots and their norm convex, so it is
    largest at a knot.

    Each round adds the tangent planes of what is still too long, and divides the excess by four
    or more: between two tangent planes at an angle of 2 φ a value is longer by φ² / 2, and the next
    tangent plane halves the angle.
    """

    norms: Norms
    """how long at most"""
    times: FloatArray
    """knots at which it is asked, the inner ones [s], shape (K-2,)"""
    precision: float = 0.0
    """part of the greatest norm that values may be longer by without another row"""

    def violated(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Tangent planes at the knots where a value is too long."""
        values = motion.values(self.quantity)[vehicles, 1:-1]
        lengths = np.sqrt(np.einsum("pti,pti->pt", values, values))
        most = self.norms.most * (1.0 + self.precision) + BROKEN * self.norms.tolerances
        broken = lengths > most[vehicles, None]
        if not broken.any():
            return self.none
        runs = np.repeat(np.arange(len(vehicles)), len(self.times))
        broken = near(broken.reshape(-1), runs, reach).reshape(broken.shape) & (lengths > 0.0)
        which, knots = np.nonzero(broken)
        normals = -values[which, knots] / lengths[which, knots, None]
        rows = self.rows(vehicles[which], self.times[knots], normals)
        return rows if np.isinf(self.penalty) else self._with_faces(rows)

    def _with_faces(self, rows: HalfSpaces) -> HalfSpaces:
        """The rows, and at their instants those of a polyhedron around the ball.

        Without it a motion that only violations cost anything may fly off to where a half-space
        is still open.
        """
        every = np.tile(np.arange(len(rows)), len(_FACES))
        normals = np.repeat(_FACES, len(rows), axis=0)
        return rows.and_also(self.rows(rows.vehicles[every], rows.times[every], normals))

    def rows(self, vehicles: IntArray, times: FloatArray, normals: FloatArray) -> HalfSpaces:
        """Tangent planes of given vehicles at given times, (R,), with inward normals, (R, 3)."""
        return HalfSpaces(
            self,
            vehicles=vehicles,
            partners=vehicles,
            sides=np.zeros(len(vehicles), dtype=int),
            times=times,
            normals=normals,
            bounds=-self.norms.most[vehicles],
            tolerances=self.norms.tolerances[vehicles],
        )

    def softened(self, penalty: float) -> Self:
        """This ball, to be left at a cost; how far it is left is known to a part."""
        soft = super().softened(penalty)
        rounds = min(self.rounds, _SOFT_ROUNDS)
        return dataclasses.replace(soft, rounds=rounds, precision=_SOFT_PRECISION)


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
            times=scenario.grid.elapsed[1:-1],
        )
    ]
