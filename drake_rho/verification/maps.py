"""Cells and triangles of a map near a motion, for the verification between the knots.

A plan is verified against the map itself: each step of a motion is compared with each nearby cell
or triangle. The distance from one of these is convex, as for a shape, so the same branch and bound
finds its minimum. The planners' convex cover of the map is not used here.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.parts import Boxes, Parts, Triangles, nearest_on_triangles
from drake_rho.verification.steps import Steps

_ROUNDING = 1e-9
"""Relative rounding error of a distance, so that the nearest part counts as near."""


@dataclasses.dataclass(frozen=True)
class Encounters:
    """Pairs of a step of a motion and a nearby cell or triangle of a map."""

    pieces: IntArray
    """index of the step among all given steps, shape (M,)"""
    steps: Steps
    """steps relative to the cells, or stacked with the constant corners of triangles, (M, D)"""
    parts: Parts
    """the cells or triangles"""

    def distance(self, x: FloatArray) -> FloatArray:
        """Return distances of the steps' positions (..., D) from their cells or triangles."""
        if isinstance(self.parts, Boxes):
            return distance_from_box(x[..., :3], x[..., 3:])
        flat = x.reshape(-1, 12)
        nearest = nearest_on_triangles(flat[:, 3:].reshape(-1, 3, 3), flat[:, :3])
        return np.asarray(np.linalg.norm(flat[:, :3] - nearest, axis=1).reshape(x.shape[:-1]))


def distance_from_box(x: FloatArray, extent: FloatArray) -> FloatArray:
    """Return signed distances from a box around the origin [m].

    They are lower bounds of the signed distances from any set inside the box.

    Args:
        x: positions [m], shape (..., 3).
        extent: half the sides of the box [m], shape (3,), or of a box for each position, of the
            shape of x; may be infinite.
    """
    beyond = np.abs(x) - extent
    outside = np.sqrt(np.sum(np.maximum(beyond, 0.0) ** 2, axis=-1))
    distance: FloatArray = outside + np.minimum(beyond.max(axis=-1), 0.0)
    return distance


def encounters(solid: Map, steps: Steps, within: FloatArray) -> Encounters:
    """Return the cells or triangles near each step.

    Args:
        solid: the map.
        steps: M motions relative to its centre.
        within: distance that counts as near, for each step [m], shape (M,); if infinite, the
            nearest part at the beginning of a step and all that may be nearer during it.
    """
    parts = solid.parts
    p, v, a, higher = (parts.in_frame(each) for each in (steps.p, steps.v, steps.a, steps.higher))
    ends = p + v + a / 2.0 + higher.sum(axis=1)
    bulge = steps.acceleration_norms / 8.0  # greatest distance of a curve from its chord
    finite = np.isfinite(p).all(axis=1) & np.isfinite(ends).all(axis=1)
    radii = np.maximum(within, 0.0) + bulge
    endless = np.flatnonzero(np.isinf(radii) & finite)
    if len(endless) > 0:
        nearest = np.abs(solid.parts.local_distance(steps.p[endless]))
        radii[endless] = nearest * (1.0 + _ROUNDING) + bulge[endless]
    finite &= np.isfinite(radii)
    some = np.flatnonzero(finite)
    lower, upper = np.minimum(p, ends)[some], np.maximum(p, ends)[some]
    which, numbers = parts.tree.pairs(lower, upper, radii[some])
    which = some[which]
    if not finite.all():  # NaN is compared with one part, so that the result is NaN too
        lost = np.flatnonzero(~finite)
        which = np.concatenate([which, lost])
        numbers = np.concatenate([numbers, np.zeros(len(lost), dtype=np.int64)])
    p, v, a = p[which], v[which], a[which]
    if isinstance(parts, Boxes):
        fixed, p = parts.halves[numbers], p - parts.centers[numbers]
    else:
        assert isinstance(parts, Triangles)  # noqa: S101  # there are no other parts
        fixed = parts.corners[numbers].reshape(-1, 9)
    still = np.zeros_like(fixed)
    beside = (np.hstack([p, fixed]), np.hstack([v, still]), np.hstack([a, still]))
    more = np.zeros((len(fixed), higher.shape[1], fixed.shape[1]))
    higher = np.concatenate([higher[which], more], axis=2)
    return Encounters(which, Steps(*beside, higher), parts)
