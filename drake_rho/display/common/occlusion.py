"""Positions behind the faces of a map, from the viewpoint of all pictures."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from drake_rho.display.common.style import view
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.box_tree import BoxTree

_BEHIND = 1e-6
"""Least depth behind a face that counts as behind it, over the size of all."""
_AT_ONCE = 4096
"""Number of positions that are looked at together, which bounds the memory."""


class Occlusion:
    """Faces as they are seen: across, upwards, and towards the viewer.

    Args:
        corners: of flat convex faces [m], shape (F, C, 3).
    """

    def __init__(self, corners: FloatArray) -> None:
        self._axes: FloatArray = np.stack(view(), axis=1)
        seen = corners @ self._axes
        sides = np.roll(seen, -1, axis=1) - seen
        normals = np.cross(sides[:, 0], sides[:, 1])
        size = float(np.ptp(corners.reshape(-1, 3), axis=0).max(initial=0.0)) or 1.0
        facing = np.abs(normals[:, 2]) > 1e-6 * np.linalg.norm(normals, axis=1)
        self._seen, self._sides, self._normals = seen[facing], sides[facing], normals[facing]
        self._deep = _BEHIND * size

    @cached_property
    def _tree(self) -> BoxTree:
        return BoxTree(self._seen.min(axis=1), self._seen.max(axis=1))

    def hides(self, x: FloatArray) -> BoolArray:
        """Return which positions (M, 3) in the coordinates of the corners are behind a face."""
        points = x @ self._axes
        hidden = np.zeros(len(x), dtype=np.bool_)
        for first in range(0, len(x) if len(self._seen) else 0, _AT_ONCE):
            here = slice(first, first + _AT_ONCE)
            hidden[here] = self._hides(points[here])
        return hidden

    def _hides(self, points: FloatArray) -> BoolArray:
        above = points.copy()
        above[:, 2] = np.maximum(points[:, 2], self._tree.upper[2]) + 1.0
        which, faces = self._tree.pairs(points, above, np.zeros(len(points)))
        off = points[which, None] - self._seen[faces]
        sides = self._sides[faces]
        turns = sides[..., 0] * off[..., 1] - sides[..., 1] * off[..., 0]
        normals = self._normals[faces]
        within = np.all(turns * np.sign(normals[:, 2:]) >= 0.0, axis=1)
        depths = np.einsum("pi,pi->p", off[:, 0], normals) / normals[:, 2]
        hidden = np.zeros(len(points), dtype=np.bool_)
        hidden[which[within & (depths < -self._deep)]] = True
        return hidden
