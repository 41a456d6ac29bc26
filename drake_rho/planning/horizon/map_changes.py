"""Cells that a newer map adds and removes.

A newer map does not replace an older one, against which the flight so far was planned. Common cells
stay an obstacle. Added cells become an obstacle known from now on, and removed cells one that is
active until now.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import IntArray, unchecked
from drake_rho.scenario.maps.cells import difference
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.shapes.base import Solid


@dataclasses.dataclass
class NewerMap:
    """Newer map, compared with the parts of an older one in turn."""

    added: Map | None
    """what no part has so far; None for nothing"""

    def compared(self, older: Solid) -> tuple[Solid | None, Solid | None]:
        """Return the common and the removed cells of an older part, None for nothing.

        Maps on different grids are compared as a whole.
        """
        newer = self.added
        if newer is None:
            return None, older
        shift = None
        if isinstance(older, Voxels) and isinstance(newer, Voxels):
            shift = _shift(older, newer)
        if shift is None or not (isinstance(older, Voxels) and isinstance(newer, Voxels)):
            same = older == newer
            self.added = None if same else newer
            return (older, None) if same else (None, older)
        cells = newer.occupied + shift
        removed = difference(older.occupied, cells)
        self.added = _of(older, difference(cells, older.occupied))
        if len(removed) == 0:
            return older, None
        return _of(older, difference(older.occupied, removed)), _of(older, removed)


def _of(like: Voxels, cells: IntArray) -> Voxels | None:
    """Return some cells of a map's grid, each once; None for no cells."""
    if len(cells) == 0:
        return None
    cells.setflags(write=False)
    return unchecked(like, occupied=cells, source=None)


def _shift(one: Voxels, other: Voxels) -> IntArray | None:
    """Return by how many cells the indices of two grids differ; None if the grids differ."""
    frame, turned = (np.eye(3) if each.rotation is None else each.rotation for each in (one, other))
    if one.resolution != other.resolution or not np.array_equal(frame, turned):
        return None
    shift = (other.origin - one.origin) @ frame / one.resolution
    whole = np.rint(shift)
    return whole.astype(np.int64) if np.allclose(shift, whole, rtol=0.0, atol=1e-9) else None
