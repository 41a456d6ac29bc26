"""Shapes as objects in Meshcat, around the origin of their paths."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch

import numpy as np
from pydrake import geometry
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_rho.display.common.shape_faces import surface
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.shapes.base import Shape
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere


@singledispatch
def put(shape: Shape, meshcat: Meshcat, path: str, colour: Rgba) -> None:
    """Add a bounded shape at a path of the scene tree, with its centre at the path's origin.

    Shapes without an object of Drake's are drawn by the faces of their `surface`.
    """
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
