"""Occupied cells of a grid, such as those of an OctoMap, as an obstacle."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray, Positive, Vector, read_only, record
from drake_rho.scenario.maps.cells import covering_boxes, free_neighbours, unique
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.parts import Boxes
from drake_rho.scenario.maps.source import Source
from drake_rho.scenario.maps.stored import WholeRows
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
        different = unique(self.occupied)
        different.setflags(write=False)
        object.__setattr__(self, "occupied", different)
        return self

    def __str__(self) -> str:
        """Return a description: '5487 cells of 0.1 m around [0.0, 0.0, 0.5]'."""
        center = np.round(self.center, 3).tolist()
        return f"{len(self.occupied)} cells of {self.resolution:g} m around {center}"

    def described_near(self, x: FloatArray) -> str:
        """Return a description that names the nearest cell."""
        cell = self.occupied[self.parts.nearest(x)].tolist()
        return f"cell {cell} of {self}"

    @cached_property
    def parts(self) -> Boxes:
        """The cells themselves."""
        return self._boxes(self.occupied, self.occupied + 1)

    @cached_property
    def cover(self) -> Boxes:
        """Boxes whose union is that of the cells."""
        cover = self._boxes(*covering_boxes(self.occupied))
        cover.solid = self
        return cover

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
        """Return distances with those of positions in cells measured from the free cells."""
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
