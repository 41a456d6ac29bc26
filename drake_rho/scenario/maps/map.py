"""Base class of maps: solids of very many parts, each with its own distance."""

from __future__ import annotations

import abc
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.maps.source import Source, hash_of_arrays
from drake_rho.scenario.shapes.base import Solid


class Map(Solid):
    """Union of cells or triangles. Distances are from these, and exact."""

    source: Source | None
    """file that it was read from, if any"""

    @property
    @abc.abstractmethod
    def parts(self) -> Parts:
        """Its cells or triangles."""

    @abc.abstractmethod
    def _inside(self, x: FloatArray, distances: FloatArray) -> FloatArray:
        """Return distances (...) of positions relative to the centre (..., 3), negative inside.

        Args:
            x: positions [m].
            distances: from the nearest part [m].
        """

    @property
    @abc.abstractmethod
    def _arrays(self) -> tuple[np.ndarray | None, ...]:
        """The numbers that describe it."""

    def read_from(self, source: Source) -> Self:
        """Return the map with the file that it was read from."""
        return unchecked(self, source=unchecked(source, read=hash_of_arrays(*self._arrays)))

    @property
    def is_that_of_its_file(self) -> bool:
        """Whether it was read from a file and has not been changed since."""
        return self.source is not None and self.source.read == hash_of_arrays(*self._arrays)

    @cached_property
    def center(self) -> FloatArray:  # type: ignore[override]  # derived here
        """Centre of the bounding box of its parts [m]."""
        return self.parts.center

    @property
    def extent(self) -> FloatArray:
        """Half the sides of the bounding box [m]."""
        return self.parts.extent

    @cached_property
    def size(self) -> float:
        """Length to which the tolerance refers [m]."""
        return self.parts.size

    @property
    def cover_excess(self) -> float:
        """Largest distance of its cover from the map itself [m]; 0 where they are equal."""
        return 0.0

    @property
    def thickness(self) -> float:
        """Least extent of a part of its cover [m]."""
        return self.cover.thickness

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the surface, negative inside."""
        return self._inside(x, self.parts.local_distance(x))

    def distance_up_to(self, x: FloatArray, most: float) -> FloatArray:
        """Return `local_distance`, or a distance from `most` on where that is larger: faster."""
        return self._inside(x, self.parts.distance_up_to(x, max(most, 0.0)))

    @abc.abstractmethod
    def _way_out(self, x: FloatArray) -> FloatArray:
        """Return unit vectors towards the nearest point of the surface, for x (P, 3) inside."""

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return unit vectors from the nearest point; inside, to the nearest of the surface."""
        return self.local_measured(x)[1]

    def local_measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances from the surface, negative inside, and the vectors of `outward`."""
        distances, outward = self.parts.local_measured(x)
        distances = self._inside(x, distances)
        inside = distances < 0.0
        if inside.any():
            outward[inside] = self._way_out(x[inside])
        return distances, outward

    def check_solid(self) -> None:
        """Accept every map: vehicles with a radius keep clear of surfaces too."""
