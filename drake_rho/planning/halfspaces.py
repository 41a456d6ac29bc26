"""Linear constraints on motions: half-spaces normal · quantity(time) >= bound.

Boxes (4) to (7) have this form, and obstacles (8) when made linear by (15). Which constraint asks
for which half-spaces, and when a motion breaks them, is in `drake_rho.planning.constraints`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from drake_rho.motion.dynamics import RESPONSES, Motion
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid, Quantity


@dataclasses.dataclass(frozen=True)
class HalfSpaces:
    """Rows normal · quantity(vehicle, time) >= bound, all of one constraint."""

    name: str
    """what the constraint is called in messages"""
    quantity: Quantity
    """what is bounded"""
    vehicles: IntArray
    """whose, as indices into the scenario's vehicles, shape (R,)"""
    times: FloatArray
    """when [s], shape (R,)"""
    normals: FloatArray
    """in which direction, unit vectors, shape (R, 3)"""
    bounds: FloatArray
    """least value along the normal, in the quantity's unit, shape (R,)"""
    tolerances: FloatArray
    """how far below the bound still counts as held, in the quantity's unit, shape (R,)"""

    def __len__(self) -> int:
        """R."""
        return len(self.times)

    def margins(self, motion: Motion) -> FloatArray:
        """How far above its bound each row is, in the quantity's unit, shape (R,).

        Args:
            motion: of all vehicles of the scenario.
        """
        values = motion.each_at(self.quantity, self.vehicles, self.times)
        margins: FloatArray = np.einsum("ri,ri->r", self.normals, values) - self.bounds
        return margins

    def responses(self, grid: Grid) -> FloatArray:
        """What one unit of each acceleration adds along the normal, shape (R, K-1), by (10)-(11).

        The same along every axis, so row r stands for responses[r, j] normals[r] · a[j].
        """
        return RESPONSES[self.quantity](grid.step, grid.knots, self.times)

    def sparse_responses(self, grid: Grid) -> csr_array:
        """The same as a sparse array, for many rows: those of jerk have two entries each."""
        if self.quantity not in ("acceleration", "jerk"):
            return csr_array(self.responses(grid))
        count, k = len(self), np.rint(self.times / grid.step).astype(int)
        rows = np.arange(count)
        if self.quantity == "acceleration":
            return csr_array((np.ones(count), (rows, k)), shape=(count, grid.knots - 1))
        inner = k > 0
        entries = np.concatenate([np.ones(count), -np.ones(np.count_nonzero(inner))]) / grid.step
        where = (np.concatenate([rows, rows[inner]]), np.concatenate([k, k[inner] - 1]))
        return csr_array((entries, where), shape=(count, grid.knots - 1))

    def of(self, vehicle: int) -> HalfSpaces:
        """Only the rows of one vehicle."""
        return self.select(self.vehicles == vehicle)

    def select(self, rows: BoolArray | IntArray) -> HalfSpaces:
        """Only some of the rows."""
        return dataclasses.replace(
            self,
            vehicles=self.vehicles[rows],
            times=self.times[rows],
            normals=self.normals[rows],
            bounds=self.bounds[rows],
            tolerances=self.tolerances[rows],
        )

    @classmethod
    def joined(cls, parts: Sequence[HalfSpaces]) -> HalfSpaces:
        """Rows of one constraint, one part after the other."""
        return dataclasses.replace(
            parts[0],
            vehicles=np.concatenate([part.vehicles for part in parts]),
            times=np.concatenate([part.times for part in parts]),
            normals=np.concatenate([part.normals for part in parts]),
            bounds=np.concatenate([part.bounds for part in parts]),
            tolerances=np.concatenate([part.tolerances for part in parts]),
        )
