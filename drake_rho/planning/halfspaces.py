"""Linear constraints on motions: half-spaces normal · quantity(time) >= bound.

Boxes (4) to (7) have this form, and obstacles (8) and pairs of vehicles when made linear by (15).
Which constraint asks for which half-spaces, and when a motion breaks them, is in
`drake_rho.planning.constraints` and `drake_rho.planning.separation`.
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
    """Rows normal · quantity(vehicle, time) >= bound, all of one constraint.

    The rows of a constraint that couples vehicles bound the quantity of a vehicle less that of
    its partner.
    """

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
    partners: IntArray | None = None
    """the other vehicles, where a row is about two, shape (R,)"""
    coupled: bool = False
    """whether the rows bound the difference to the partner, rather than the vehicle alone"""
    price: float = np.inf
    """what the index may rise for each unit that a row gives way; infinite if it must not"""

    def __len__(self) -> int:
        """R."""
        return len(self.times)

    def margins(self, motion: Motion) -> FloatArray:
        """How far above its bound each row is, in the quantity's unit, shape (R,).

        Args:
            motion: of all vehicles of the scenario.
        """
        values = motion.each_at(self.quantity, self.vehicles, self.times)
        if self.coupled and self.partners is not None:
            values = values - motion.each_at(self.quantity, self.partners, self.times)
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
            partners=None if self.partners is None else self.partners[rows],
        )

    def numbered(self, numbers: IntArray) -> HalfSpaces:
        """The same with other indices: that of vehicle i becomes numbers[i]."""
        partners = None if self.partners is None else numbers[self.partners]
        return dataclasses.replace(self, vehicles=numbers[self.vehicles], partners=partners)

    @classmethod
    def joined(cls, parts: Sequence[HalfSpaces]) -> HalfSpaces:
        """Rows of one constraint, one part after the other."""
        partners = [part.partners for part in parts if part.partners is not None]
        return dataclasses.replace(
            parts[0],
            vehicles=np.concatenate([part.vehicles for part in parts]),
            times=np.concatenate([part.times for part in parts]),
            normals=np.concatenate([part.normals for part in parts]),
            bounds=np.concatenate([part.bounds for part in parts]),
            tolerances=np.concatenate([part.tolerances for part in parts]),
            partners=np.concatenate(partners) if partners else None,
        )


def near(marked: BoolArray, reach: int) -> BoolArray:
    """What is marked and its neighbours up to `reach` away along the last axis."""
    count = marked.shape[-1]
    reach = min(reach, count)
    before = np.zeros((*marked.shape[:-1], count + 2 * reach + 1), dtype=int)
    before[..., reach + 1 : count + reach + 1] = np.cumsum(marked, axis=-1)
    before[..., count + reach + 1 :] = before[..., count + reach, None]
    return before[..., 2 * reach + 1 :] > before[..., :count]
