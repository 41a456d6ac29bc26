"""Surfaces of maps for drawing: merged rectangles of cells, or triangles, coloured by height."""

from __future__ import annotations

import dataclasses
from functools import cached_property, singledispatch

import numpy as np

from drake_rho.display.common.shape_faces import clipped, fan
from drake_rho.display.common.style import height_colours
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.maps.cells import exposed, joined, unique
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.records import Scenario

_MOST_FACES = 60_000
"""Largest number of drawn faces; larger maps have cells or vertices merged."""
_BANDS = 12
"""Number of height bands for the colours of a tall rectangle."""
_FINEST = 256
"""Number of cells along a mesh's longest side, for merging its vertices at first and for filling
its inside where it is cut."""


@dataclasses.dataclass(frozen=True, eq=False)
class MapFaces:
    """Faces of a map: triangles or rectangles, all with the same number C of corners."""

    corners: FloatArray
    """corners relative to the centre of the map, counter-clockwise as seen from outside [m],
    shape (F, C, 3)"""
    lowest: float
    """height of the lowest point of the map over its centre [m]"""
    highest: float
    """height of the highest point of the map over its centre [m]"""
    merged: float = 0.0
    """side of the cells into which cells or vertices were merged to draw fewer faces [m]; 0 if the
    surface is exact"""

    @cached_property
    def normals(self) -> FloatArray:
        """Normals whose lengths are the areas of the faces [m²], shape (F, 3)."""
        corners = self.corners
        across = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])
        normals: FloatArray = across / 2.0
        return normals

    def colours(self, corners: FloatArray) -> FloatArray:
        """Return the height colours of positions relative to the centre (..., 3), (..., 3)."""
        return height_colours(corners[..., 2], self.lowest, self.highest)

    def in_bands(self) -> FloatArray:
        """Return the faces with tall rectangles cut into height bands, for one colour per face.

        Returns:
            Corners relative to the centre [m], shape (F, C, 3).
        """
        corners = self.corners
        if corners.shape[1] != 4 or len(corners) == 0 or self.highest <= self.lowest:
            return corners
        rises = np.abs(corners[:, [1, 3], 2] - corners[:, :1, 2])
        turned = rises[:, 1] > rises[:, 0]  # so that the first side is the steeper one
        corners = np.where(turned[:, None, None], np.roll(corners, 1, axis=1), corners)
        parts = rises.max(axis=1) / (self.highest - self.lowest) * _BANDS
        counts = np.maximum(np.ceil(parts - 1e-9).astype(np.int64), 1)
        face = np.repeat(np.arange(len(corners)), counts)
        number = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
        begin, end = ((number + more) / counts[face] for more in (0.0, 1.0))
        first, second, third, fourth = np.moveaxis(corners[face], 1, 0)
        one, other = second - first, third - fourth
        at = (first + begin[:, None] * one, first + end[:, None] * one)
        opposite = (fourth + end[:, None] * other, fourth + begin[:, None] * other)
        return np.stack([*at, *opposite], axis=1)

    def mesh(self) -> tuple[FloatArray, IntArray]:
        """Return shared vertices (V, 3) [m], and triangles as indices of them (T, 3)."""
        points = self.corners.reshape(-1, 3)
        numbers = _same(points)
        firsts = np.unique(numbers, return_index=True)[1]
        of = numbers.reshape(-1, self.corners.shape[1])
        fans = [of[:, [0, k, k + 1]] for k in range(1, of.shape[1] - 1)]
        return points[firsts], np.concatenate(fans)


def _same(rows: FloatArray) -> IntArray:
    """Return a number for each row (M, D), the same for rows equal up to rounding."""
    size = float(np.abs(rows).max()) or 1.0
    rounded = np.rint(rows / size * 2.0**30).astype(np.int64)
    numbers: IntArray = np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1)
    return numbers


def has_map(scenario: Scenario) -> bool:
    """Return whether any obstacle is a map."""
    return any(isinstance(obstacle.shape, Map) for obstacle in scenario.bodies)


def map_faces(solid: Map, between: tuple[float, float] | None = None) -> MapFaces:
    """Return the surface of a map, or of a slice of it.

    Args:
        solid: the map.
        between: lower and upper height over its centre [m]. The slice has all cells that meet this
            range. Triangles are cut off, and the inside is filled at the upper height.
    """
    lowest, highest = -float(solid.extent[2]), float(solid.extent[2])
    corners, merged = _faces(solid, between or (lowest, highest))
    return MapFaces(corners, lowest, highest, merged)


@singledispatch
def _faces(solid: Map, between: tuple[float, float]) -> tuple[FloatArray, float]:
    """Return faces (F, C, 3) and the side of the cells used for merging [m]."""
    raise NotImplementedError(f"solid: got a {type(solid).__name__}, expected Voxels or a Mesh")


@_faces.register
def _(solid: Voxels, between: tuple[float, float]) -> tuple[FloatArray, float]:
    cells, side = solid.occupied, 1
    turn = np.eye(3) if solid.rotation is None else solid.rotation
    up = solid.resolution * turn[2]
    height = solid.origin[2] - solid.center[2]
    while True:
        middles = (cells + 0.5) * side @ up + height
        reach = side * np.abs(up).sum() / 2.0 - 1e-9 * solid.resolution
        inside = (middles + reach > between[0]) & (middles - reach < between[1])
        faces = _rectangles(cells[inside])
        if len(faces) <= _MOST_FACES:
            break
        cells, side = unique(cells // 2), 2 * side
    h = solid.resolution
    corners = (h * side * faces) @ turn.T + (solid.origin - solid.center)
    return corners, h * side if side > 1 else 0.0


def _rectangles(cells: IntArray) -> FloatArray:
    """Return the open sides of cells as rectangles, in cells, shape (F, 4, 3).

    Neighbouring sides in one plane are joined: to rows along one axis, then equal rows along the
    other, in whichever order of the axes gives fewer rectangles.
    """
    found = [np.zeros((0, 4, 3))]
    for axis, side in np.ndindex(3, 2):
        open_cells = exposed(cells, axis, 2 * side - 1) if len(cells) else cells
        if len(open_cells) == 0:
            continue
        one, other = (axis + 1) % 3, (axis + 2) % 3
        both = (joined(open_cells, order) for order in ((one, other), (other, one)))
        lower, upper = min(both, key=lambda boxes: len(boxes[0]))
        ring = np.stack([lower, lower, lower, lower], axis=1).astype(np.float64)
        ring[:, 1:3, one] = upper[:, None, one]
        ring[:, 2:4, other] = upper[:, None, other]
        ring[:, :, axis] = (upper if side else lower)[:, None, axis]
        found.append(ring if side else ring[:, ::-1])
    return np.concatenate(found)


@_faces.register
def _(solid: Mesh, between: tuple[float, float]) -> tuple[FloatArray, float]:
    corners, merged = _fewer_triangles(solid)
    corners = corners - solid.center
    low, high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    whole = (low >= between[0]) & (high <= between[1])
    through = ~whole & (low < between[1]) & (high > between[0])
    lower, upper = np.array([[-np.inf] * 3, [np.inf] * 3])
    lower[2], upper[2] = between
    polygons = [clipped(triangle, lower, upper) for triangle in corners[through]]
    fans = [fan(each) for each in polygons if len(each) > 2]
    caps = [] if high.max() <= between[1] else [_cap(solid, between[1])]
    return np.concatenate([corners[whole], *fans, *caps]), merged


def _cap(solid: Mesh, height: float) -> FloatArray:
    """Return the inside of a watertight mesh at a height over its centre, in squares: (F, 3, 3)."""
    if not solid.is_watertight:
        return np.zeros((0, 3, 3))
    side = 2.0 * float(solid.extent[:2].max()) / _FINEST
    counts = np.maximum(np.ceil(2.0 * solid.extent[:2] / side - 1e-9), 1).astype(np.int64)
    cells = np.array(list(np.ndindex(*counts, 1)))
    corner = np.append(-solid.extent[:2], height)
    middles = corner + side * (cells + np.array([0.5, 0.5, 0.0]))
    cells = cells[solid.local_distance(middles) < 0.0]
    if len(cells) == 0:
        return np.zeros((0, 3, 3))
    low, high = (corner + side * each * [1, 1, 0] for each in joined(cells, (0, 1)))
    right = np.where([True, False, True], high, low)
    left = np.where([False, True, True], high, low)
    halves = (np.stack(each, axis=1) for each in ((low, right, high), (low, high, left)))
    return np.concatenate(list(halves))


def _fewer_triangles(solid: Mesh) -> tuple[FloatArray, float]:
    """Return triangles (F, 3, 3), with vertices merged within cells if there are too many."""
    corners, fine = solid.corners, _FINEST
    side = 0.0
    while len(corners) > _MOST_FACES:
        side = 2.0 * float(solid.extent.max()) / fine
        numbers = _same(np.floor(solid.vertices / side))
        sums = np.stack([np.bincount(numbers, weights=x) for x in solid.vertices.T], axis=1)
        middles = sums / np.bincount(numbers)[:, None]
        triangles = numbers[solid.triangles]
        triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
        triangles = triangles[np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]]
        corners, fine = middles[triangles], fine // 2
    return corners, side
