"""Shapes and maps as objects in Meshcat, around the origin of their paths."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch

import numpy as np
import numpy.typing as npt
from pydrake import geometry
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_rho.display.common.map_faces import map_faces
from drake_rho.display.common.shape_faces import surface
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.shapes.base import Shape, Solid
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere


def put_map(solid: Map, meshcat: Meshcat, path: str) -> None:
    """Add the surface of a map at a path of the scene tree, coloured by height."""
    faces = map_faces(solid)
    vertices, triangles = faces.mesh()
    colours = np.asfortranarray(faces.colours(vertices).T)
    meshcat.SetTriangleColorMesh(path, *_columns(vertices, triangles), colours)
    _shade_flat(meshcat, path)


def _columns(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, npt.NDArray[np.int32]]:
    """Return a mesh in the order that Drake requires."""
    return np.asfortranarray(vertices.T), np.asfortranarray(triangles.T.astype(np.int32))


def _shade_flat(meshcat: Meshcat, path: str) -> None:
    """Shade an object's faces flat although they share vertices, for small pages."""
    meshcat.SetProperty(f"{path}/<object>", "material.flatShading", True)


@singledispatch
def put(shape: Solid, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    """Add a bounded shape at a path of the scene tree, with its centre at the path's origin.

    Shapes that Drake does not have are drawn by the faces of their `surface`.
    """
    raise NotImplementedError(f"shape: got a {type(shape).__name__}, expected a shape or a map")


@put.register
def _(shape: Map, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    meshcat.SetTriangleMesh(path, *_columns(*map_faces(shape).mesh()), rgba=colour)
    _shade_flat(meshcat, path)


@put.register
def _(shape: Shape, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    put_faces(surface(shape).faces, meshcat, path, colour)


def put_faces(faces: Sequence[FloatArray], meshcat: Meshcat, path: str, colour: Rgba) -> None:
    """Add convex polygons [m], each of shape (n, 3), at a path of the scene tree."""
    # no shared vertices, so that faces are shaded flat
    corners = np.concatenate(
        [face[[0, k, k + 1]] for face in faces for k in range(1, len(face) - 1)]
    )
    triangles = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    mesh = np.asfortranarray(corners.T), np.asfortranarray(triangles.T)
    meshcat.SetTriangleMesh(path, *mesh, rgba=colour)


@put.register
def _(shape: Sphere, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    meshcat.SetObject(path, geometry.Sphere(shape.radius), colour)


@put.register
def _(shape: Ellipsoid, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    meshcat.SetObject(path, geometry.Ellipsoid(*shape.semi_axes), colour)


@put.register
def _(shape: Box, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    meshcat.SetObject(path, geometry.Box(*(2.0 * shape.extent)), colour)


@put.register
def _(shape: Cylinder, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    if shape.height is None:
        raise ValueError("shape: got an infinite cylinder, expected one with a height")
    meshcat.SetObject(path, geometry.Cylinder(shape.radius, shape.height), colour)
    along = np.eye(3)["xyz".index(shape.axis)]  # Drake's cylinders lie along z
    turn = RotationMatrix.MakeFromOneVector(along, 2)
    meshcat.SetTransform(path, RigidTransform(turn, np.zeros(3)))
