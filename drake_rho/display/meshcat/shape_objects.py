"""Shapes and maps as objects in Meshcat, around the origin of their paths."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch

import numpy as np
from pydrake import geometry
from pydrake.geometry import Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_rho.display.common.map_faces import map_faces
from drake_rho.display.common.shape_faces import fan, surface
from drake_rho.display.meshcat.meshes import columns, faceted
from drake_rho.display.meshcat.tree import ROOT, Tree
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.shapes.base import Shape, Solid
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere


def put_map(solid: Map, tree: Tree, path: str) -> None:
    """Add the surface of a map at a path of the scene tree, coloured by height."""
    faces = map_faces(solid)
    vertices, triangles = faces.mesh()
    mesh, colours = columns(vertices, triangles), np.asfortranarray(faces.colours(vertices).T)
    tree.meshcat.SetTriangleColorMesh(f"{ROOT}/{path}", *mesh, colours)
    _shade_flat(tree, path)


def _shade_flat(tree: Tree, path: str) -> None:
    """Shade an object's faces flat although they share vertices, for small pages."""
    tree.meshcat.SetProperty(f"{ROOT}/{path}/<object>", "material.flatShading", True)


@singledispatch
def put(shape: Solid, tree: Tree, path: str, colour: Rgba) -> None:
    """Add a bounded shape at a path of the scene tree, with its centre at the path's origin.

    Shapes that Drake does not have are drawn by the faces of their `surface`.
    """
    raise NotImplementedError(f"shape: got a {type(shape).__name__}, expected a shape or a map")


@put.register
def _(shape: Map, tree: Tree, path: str, colour: Rgba) -> None:
    tree.add_mesh(path, columns(*map_faces(shape).mesh()), colour)
    _shade_flat(tree, path)


@put.register
def _(shape: Shape, tree: Tree, path: str, colour: Rgba) -> None:
    put_faces(surface(shape).faces, tree, path, colour)


def put_faces(faces: Sequence[FloatArray], tree: Tree, path: str, colour: Rgba) -> None:
    """Add convex polygons [m], each of shape (n, 3), at a path of the scene tree."""
    tree.add_mesh(path, faceted(np.concatenate([fan(face) for face in faces])), colour)


@put.register
def _(shape: Sphere, tree: Tree, path: str, colour: Rgba) -> None:
    tree.add_ball(path, shape.radius, colour)


@put.register
def _(shape: Ellipsoid, tree: Tree, path: str, colour: Rgba) -> None:
    tree.meshcat.SetObject(f"{ROOT}/{path}", geometry.Ellipsoid(*shape.semi_axes), colour)


@put.register
def _(shape: Box, tree: Tree, path: str, colour: Rgba) -> None:
    box = geometry.Box(*(2.0 * shape.extent))
    tree.meshcat.SetObject(f"{ROOT}/{path}", box, colour)


@put.register
def _(shape: Cylinder, tree: Tree, path: str, colour: Rgba) -> None:
    if shape.height is None:
        raise ValueError("shape: got an infinite cylinder, expected one with a height")
    drawn = geometry.Cylinder(shape.radius, shape.height)
    tree.meshcat.SetObject(f"{ROOT}/{path}", drawn, colour)
    along = np.eye(3)["xyz".index(shape.axis)]  # Drake's cylinders lie along z
    turn = RigidTransform(RotationMatrix.MakeFromOneVector(along, 2), np.zeros(3))
    tree.meshcat.SetTransform(f"{ROOT}/{path}", turn)
