"""Triangle meshes as obstacles: solids where they are watertight, else surfaces."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST, BoolArray, FloatArray, record
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.mesh_files import read_mesh
from drake_rho.scenario.maps.parts import Triangles
from drake_rho.scenario.maps.shells import Shells
from drake_rho.scenario.maps.source import Source, absolute, named, source_of
from drake_rho.scenario.maps.stored import NumberRows, WholeRows
from drake_rho.scenario.poses import AnyPose, pose_of

_SAME = 1e-9
"""Distance at which vertices count as one, in longest sides of the mesh's bounding box: programs
round them so."""
_SINGLE = 2.0**-22
"""Distance at which vertices count as one if the mesh is watertight then, in largest coordinates:
twice the largest difference of two numbers that are equal but for rounding to single precision, as
files of STL and glTF have them."""


@record
class Mesh(Map):
    """Union of triangles, and the inside of a mesh that is watertight.

    Examples:
        >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
        >>> pyramid = rho.Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> pyramid.is_watertight, float(pyramid.signed_distance(np.array([0.1, 0.1, -2.0])))
        (True, 2.0)
    """

    vertices: NumberRows
    """positions of the vertices [m], shape (V, 3)"""
    triangles: WholeRows
    """numbers of the three vertices of each triangle, from 0, shape (F, 3)"""
    source: Source | None = None
    """file that it was read from, if any"""

    if TYPE_CHECKING:

        def __init__(
            self,
            vertices: npt.ArrayLike,
            triangles: npt.ArrayLike,
            source: Source | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _has_triangles(self) -> Mesh:
        if len(self.triangles) == 0:
            raise ScenarioError("triangles", Description("none"), "at least one triangle")
        if self.triangles.min() < 0 or self.triangles.max() >= len(self.vertices):
            wrong = (self.triangles < 0) | (self.triangles >= len(self.vertices))
            row = int(np.argmax(wrong.any(axis=1)))
            expected = f"numbers of vertices, from 0 to {len(self.vertices) - 1}"
            raise ScenarioError(f"triangles[{row}]", self.triangles[row].tolist(), expected)
        if not np.ptp(self.corners.reshape(-1, 3), axis=0).any():
            expected = "vertices that are not all at one place"
            raise ScenarioError("vertices", self.vertices[0].tolist(), expected)
        return self

    @classmethod
    @checked
    def load(cls, path: str | Path, scale: float = 1.0, pose: AnyPose = None) -> Mesh:
        """Return the triangles of all geometries in a mesh file.

        Args:
            path: of an .obj, .stl, .ply, .gltf, .glb or .dae file. Axes are those of the file; in
                glTF files y is up, which a pose can turn.
            scale: length of the file's unit [m], times which lengths are read. COLLADA files (.dae)
                name their unit, so that they are in metres before.
            pose: pose of the scaled mesh, a 4 x 4 matrix or Drake's
                `RigidTransform`.

        Raises:
            ScenarioError: the file cannot be read, is damaged or has no triangles; the scale is
                not positive; or the extra `maps` is not installed.
        """
        if isinstance(scale, bool) or not 1.0 / LARGEST <= scale <= LARGEST:
            raise ScenarioError("scale", scale, "a length of the file's unit above 0 m")
        found, placed = read_mesh(path), pose_of(pose)
        arguments = {"scale": float(scale)} | placed.arguments()
        source = source_of("mesh", absolute(Path(path)), arguments, found.beside)
        try:
            made = cls(placed.moved(scale * found.vertices), found.triangles)
        except ScenarioError as error:
            raise ScenarioError(named(path), error.value, error.expected) from None
        return made.read_from(source)

    def __str__(self) -> str:
        """Return a description: 'watertight mesh of 12 triangles around [0.0, 0.0, 0.0]'."""
        kind = "watertight mesh" if self.is_watertight else "surface"
        center = np.round(self.center, 3).tolist()
        return f"{kind} of {len(self.triangles)} triangles around {center}"

    def described_near(self, x: FloatArray) -> str:
        """Return a description that names the nearest triangle."""
        return f"triangle {int(self.parts.nearest(x))} of a {self}"

    @property
    def _arrays(self) -> tuple[np.ndarray | None, ...]:
        """The numbers that describe it."""
        return self.vertices, self.triangles

    @cached_property
    def corners(self) -> FloatArray:
        """Positions of the corners of the triangles [m], shape (F, 3, 3)."""
        corners: FloatArray = self.vertices[self.triangles]
        return corners

    @cached_property
    def parts(self) -> Triangles:
        """The triangles."""
        return Triangles(self.corners).of(self)

    @property
    def cover(self) -> Triangles:
        """The triangles, which are convex parts already."""
        return self.parts

    @cached_property
    def is_watertight(self) -> bool:
        """Whether every edge joins two triangles, so that all of them enclose an inside.

        Vertices within a billionth of the longest side of each other count as one, and so do those
        that differ by no more than single precision rounds if that closes the mesh. A duplicate
        triangle may count once, and a triangle without area does not count.
        """
        return self._shells.are_closed

    @property
    def moved_vertices(self) -> int:
        """Number of vertices that count as one with others, which are elsewhere but for rounding.

        It is 0 if the mesh is watertight without them.
        """
        return self._shells.moved

    @cached_property
    def _shells(self) -> Shells:
        """Its triangles with coincident vertices joined, and which of them enclose an inside."""
        longest = 2.0 * float(self.extent.max())
        single = _SINGLE * float(np.abs(self.vertices).max())
        same = _SAME * longest
        return Shells.of(self.vertices, self.triangles, same, max(same, single))

    def _inside(self, x: FloatArray, distances: FloatArray) -> FloatArray:
        """Return distances, negative inside closed shells."""
        if not self._shells.enclosing.any():
            return distances
        within = np.all(np.abs(x) <= self.extent, axis=-1)
        if not within.any():
            return distances
        signs = np.ones(within.shape)
        signs[within] = np.where(self._is_inside(x[within]), -1.0, 1.0)
        return signs * distances

    def _way_out(self, x: FloatArray) -> FloatArray:
        """Return unit vectors to the nearest point of a triangle."""
        return -self.parts.local_outward(x)

    def _is_inside(self, x: FloatArray) -> BoolArray:
        """Return a mask of the positions (Q, 3), relative to the centre, inside closed shells.

        A vertical ray from inside crosses the surface an odd number of times. Where solids
        overlap, it leaves more of them than it enters. Both triangles of an edge see it as the same
        numbers, so that a ray never passes between them.
        """
        parts = self.parts
        upper = np.concatenate([x[:, :2], np.full((len(x), 1), parts.tree.upper[2] + 1.0)], axis=1)
        rays, numbers = parts.tree.pairs(x, upper, np.zeros(len(x)))
        among = self._shells.enclosing[numbers]
        rays, numbers = rays[among], numbers[among]
        corners = self._shells.vertices[self._shells.triangles[numbers]] - self.center
        points = x[rays]
        crossed = np.zeros(len(rays), dtype=bool)
        for k in range(3):
            crossed ^= _crosses(corners[:, k], corners[:, (k + 1) % 3], points)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        height = np.einsum("pi,pi->p", corners[:, 0] - points, normals)
        height = height / np.where(normals[:, 2] != 0.0, normals[:, 2], 1.0)
        above = crossed & (normals[:, 2] != 0.0) & (height > 0.0)
        count = len(x)
        crossings = np.bincount(rays[above], minlength=count)
        leaving = np.bincount(rays[above], np.sign(normals[above, 2]), minlength=count)
        inside: BoolArray = (crossings % 2 == 1) | (leaving != 0.0)
        return inside


def _crosses(one: FloatArray, other: FloatArray, x: FloatArray) -> BoolArray:
    """Return a mask of the edges that, seen from above, pass x (P, 3) at larger x coordinates."""
    swapped = (one[:, 1] > other[:, 1]) | ((one[:, 1] == other[:, 1]) & (one[:, 0] > other[:, 0]))
    low = np.where(swapped[:, None], other, one)  # the same for both triangles of an edge
    high = np.where(swapped[:, None], one, other)
    spans = (low[:, 1] <= x[:, 1]) & (x[:, 1] < high[:, 1])
    rise = np.where(spans, high[:, 1] - low[:, 1], 1.0)
    at = low[:, 0] + (x[:, 1] - low[:, 1]) / rise * (high[:, 0] - low[:, 0])
    crosses: BoolArray = spans & (x[:, 0] < at)
    return crosses
