"""Occupied cells of a grid, such as those of an OctoMap, as an obstacle."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    FloatArray,
    IntArray,
    Positive,
    Vector,
    read_only,
    record,
)
from drake_rho.scenario.maps.cells import covering_boxes, free_neighbours, unique
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.octomaps import read_leaves
from drake_rho.scenario.maps.parts import Boxes
from drake_rho.scenario.maps.point_clouds import cells_of_points, read_points
from drake_rho.scenario.maps.source import Source, absolute, named, source_of
from drake_rho.scenario.maps.stored import WholeRows
from drake_rho.scenario.poses import AnyPose, Pose, pose_of
from drake_rho.scenario.rotations import Rotation


@record
class Voxels(Map):
    """Union of closed cubes, the occupied cells of a regular grid.

    Cell (i, j, k) reaches from (i, j, k) to (i + 1, j + 1, k + 1) times the resolution, turned by
    the rotation, from the origin.

    Examples:
        >>> wall = rho.Voxels([[0, 0, 0], [0, 0, 1]], resolution=0.5)
        >>> float(wall.signed_distance(np.array([2.0, 0.25, 0.25])))
        1.5
    """

    occupied: WholeRows
    """indices of the occupied cells, each once, shape (M, 3)"""
    resolution: Positive
    """side of the cells [m]"""
    origin: Vector = dataclasses.field(default_factory=lambda: read_only([0.0, 0.0, 0.0]))
    """position of the lower corner of cell (0, 0, 0) [m]"""
    rotation: Rotation | None = None
    """rotation of the grid about the origin: a matrix, or roll, pitch and yaw [rad]; none if not
    given"""
    source: Source | None = None
    """file that it was read from, if any"""

    if TYPE_CHECKING:

        def __init__(
            self,
            occupied: npt.ArrayLike,
            resolution: float,
            origin: npt.ArrayLike = ...,
            rotation: npt.ArrayLike | None = None,
            source: Source | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _has_cells(self) -> Voxels:
        if len(self.occupied) == 0:
            raise ScenarioError("occupied", Description("no cells"), "at least one occupied cell")
        try:
            different = unique(self.occupied)
        except ScenarioError as error:
            raise error.inside("occupied") from None
        different.setflags(write=False)
        object.__setattr__(self, "occupied", different)
        return self

    @classmethod
    @checked
    def from_octomap(
        cls,
        path: str | Path,
        unknown: Literal["free", "occupied"] | None = None,
        pose: AnyPose = None,
    ) -> Voxels:
        """Return the occupied cells of an OctoMap, at its finest resolution.

        Args:
            path: of a .bt or .ot file.
            unknown: treatment of unobserved cells in the bounding box of the observed ones: "free"
            or "occupied". There is no default, since either may be wrong.
            pose: pose of the map, a 4 x 4 matrix or Drake's `RigidTransform`.

        Raises:
            ScenarioError: `unknown` is not given, in which case the error says what the file
                holds; the file cannot be read, is damaged or too large; or the extra `maps` is
                not installed.
        """
        leaves = read_leaves(path)
        if unknown is None:
            holds = f"{leaves.occupied} occupied, {leaves.free} free and {leaves.unknown} unknown"
            expected = f"'free' or 'occupied': the file has {holds} cells in its bounding box"
            raise ScenarioError("unknown", Description("nothing"), expected)
        placed = pose_of(pose)
        try:
            cells = leaves.cells(unknown)
        except ScenarioError as error:
            raise error.inside(named(path)) from None
        arguments = {"unknown": unknown} | placed.arguments()
        source = source_of("octomap", absolute(Path(path)), arguments)
        return cls._placed(cells, leaves.resolution, placed, source)

    @classmethod
    def from_points(
        cls, points: npt.ArrayLike | str | Path, resolution: float, pose: AnyPose = None
    ) -> Voxels:
        """Return the cells of a grid that hold a point of a cloud.

        Args:
            points: positions [m], shape (P, 3), or the path of a .pcd, .ply, .xyz or .npy file.
                Points with a coordinate that is not finite are left out.
            resolution: side of the cells [m].
            pose: pose of the cloud, a 4 x 4 matrix or Drake's `RigidTransform`.

        Raises:
            ScenarioError: there are no points; the file cannot be read or is damaged; or the extra
                `maps`, which PCD and PLY need, is not installed.

        Examples:
            >>> len(rho.Voxels.from_points([[0.1, 0.1, 0.1], [0.2, 0, 0], [1, 0, 0]], 0.5).occupied)
            2
        """
        side, placed = _side(resolution), pose_of(pose)
        if not isinstance(points, str | Path):
            return cls._placed(cells_of_points(points, side), side, placed, None)
        try:
            cells = cells_of_points(read_points(points), side)
        except ScenarioError as error:
            inside = error.field == "points"
            raise (error.inside(named(points)) if inside else error) from None
        arguments = {"resolution": side} | placed.arguments()
        source = source_of("points", absolute(Path(points)), arguments)
        return cls._placed(cells, side, placed, source)

    @classmethod
    def from_grid(
        cls, array: npt.ArrayLike, resolution: float, origin: npt.ArrayLike = (0.0, 0.0, 0.0)
    ) -> Voxels:
        """Return the cells of an occupancy grid that are True.

        Args:
            array: True where a cell is occupied, with axes x, y and z.
            resolution: side of the cells [m].
            origin: position of the lower corner of cell (0, 0, 0) [m].

        Raises:
            ScenarioError: the array is no grid of True and False, or has no occupied cell.

        Examples:
            >>> str(rho.Voxels.from_grid(np.ones((4, 2, 1), dtype=bool), 0.5))
            '8 cells of 0.5 m around [1.0, 0.5, 0.25]'
        """
        grid = np.asarray(array)
        if grid.ndim != 3 or grid.dtype != np.bool_:
            given = Description(f"an array of shape {grid.shape} and type {grid.dtype}")
            raise ScenarioError("array", given, "True and False in an array of shape (X, Y, Z)")
        return cls(np.argwhere(grid), _side(resolution), origin)

    @classmethod
    def _placed(
        cls, cells: IntArray, resolution: float, pose: Pose, source: Source | None
    ) -> Voxels:
        origin = np.zeros(3) if pose.position is None else pose.position
        try:
            made = cls(cells, resolution, origin, pose.rotation)
        except ScenarioError as error:
            where = "" if source is None else named(source.path)
            raise ScenarioError(where or error.field, error.value, error.expected) from None
        return made if source is None else made.read_from(source)

    def __str__(self) -> str:
        """Return a description: '5487 cells of 0.1 m around [0.0, 0.0, 0.5]'."""
        center = np.round(self.center, 3).tolist()
        return f"{len(self.occupied)} cells of {self.resolution:g} m around {center}"

    def described_near(self, x: FloatArray) -> str:
        """Return a description that names the nearest cell."""
        cell = self.occupied[self.parts.nearest(x)].tolist()
        return f"cell {cell} of {self}"

    @property
    def _arrays(self) -> tuple[np.ndarray | None, ...]:
        """The numbers that describe it."""
        return self.occupied, np.array(self.resolution), self.origin, self.rotation

    @cached_property
    def parts(self) -> Boxes:
        """The cells themselves."""
        return self._boxes(self.occupied, self.occupied + 1)

    @cached_property
    def cover(self) -> Boxes:
        """Boxes whose union is that of the cells."""
        return self._boxes(*covering_boxes(self.occupied)).of(self)

    @cached_property
    def _around(self) -> Boxes:
        """Free cells that touch an occupied one; their nearest points are on the surface."""
        free = free_neighbours(self.occupied)
        return self._boxes(free, free + 1)

    def _boxes(self, lower: IntArray, upper: IntArray) -> Boxes:
        h = np.float64(self.resolution)
        if self.rotation is None:
            return Boxes(h * lower + self.origin, h * upper + self.origin)
        return Boxes(h * lower, h * upper, self.rotation, self.origin)

    def _inside(self, x: FloatArray, distances: FloatArray) -> FloatArray:
        """Return distances; for positions in cells, minus the distance from the free cells."""
        inside = distances <= 0.0
        if not inside.any():
            return distances
        around = self._around
        depths = around.local_distance(x[inside] + (self.center - around.center))
        distances = np.array(distances)
        distances[inside] = -np.maximum(depths, 0.0)
        return distances

    def _way_out(self, x: FloatArray) -> FloatArray:
        """Return unit vectors to the nearest free cell."""
        around = self._around
        return -around.local_outward(x + (self.center - around.center))


def _side(resolution: object) -> float:
    """Return a resolution as a number.

    Raises:
        ScenarioError: it is none, or not positive.
    """
    side = np.nan
    if isinstance(resolution, Real) and not isinstance(resolution, bool):
        side = float(resolution)
    if not 1.0 / LARGEST <= side <= LARGEST:
        raise ScenarioError("resolution", resolution, "a side of the cells above 0 m")
    return side
