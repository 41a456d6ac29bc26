"""Collision geometries of SDF, URDF and MJCF files, as shapes where Drake's parser places them.

This is the only module of maps that uses Drake, whose parser reads these formats; it is loaded only
when a world is read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError, shorten
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.libraries import quiet
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.mesh_files import read_mesh
from drake_rho.scenario.maps.source import named, unreadable
from drake_rho.scenario.maps.world_files import WorldFiles, world_files
from drake_rho.scenario.maps.world_solids import OF_DRAKE, Y_UP
from drake_rho.scenario.maps.world_xml import no_shape
from drake_rho.scenario.poses import Pose
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.capsules import Capsule
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.posed import Posed
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere

GROUND = (200.0, 200.0, 1.0)
"""Sides of the box that stands for an endless plane [m], with its top in the plane."""

_ALONG = 1e-12
"""Largest deviation of a rotation's entries from whole numbers to count as turning axes into
axes."""

_LEFT_OUT = re.compile("(geom type|fromto tag|mesh asset|unknown mesh).*ignored")
"""Warnings of Drake that a geometry is left out."""


class Geometry(NamedTuple):
    """Collision geometry of a world."""

    name: str
    """name of the body and, after it, of the geometry"""
    shape: Solid
    """shape or mesh, where the world places it"""


class Contents(NamedTuple):
    """Content of a world's file."""

    geometries: list[Geometry]
    """collision geometries in the order of the file"""
    skipped: list[str]
    """elements of the files that are not read"""


def read_world(path: str | Path, pose: Pose, resource_path: Sequence[str | Path] = ()) -> Contents:
    """Return the collision geometries of a world in its default configuration.

    Args:
        path: of an .sdf, .urdf or MJCF .xml file.
        pose: pose of the world.
        resource_path: further folders of models.

    Raises:
        ScenarioError: the file cannot be read, has no collision geometry, or one that cannot be
            represented, or refers to files that are in none of the folders.
    """
    files = world_files(path, resource_path)
    with TemporaryDirectory() as folder, quiet("drake") as warnings:
        copies = files.copied(Path(folder))
        try:
            found = list(_geometries(files, copies.get(files.path, files.path), pose))
        except ScenarioError:
            raise
        except (RuntimeError, ValueError, SystemExit) as error:  # the last is a check of Drake's
            reason = re.sub(r"^Failure at .*?: condition", "condition", str(error))
            for original, copy in copies.items():
                reason = reason.replace(f"/{copy}", original.name).replace(f"{copy}", original.name)
            reason = reason.replace(f"{folder}/", "")  # meshes of polylines
            raise unreadable(files.path, reason, "an SDF, URDF or MJCF file") from None
    for text in warnings:
        if _LEFT_OUT.search(text):
            raise unreadable(files.path, text, "geometries that Drake reads")
    if not found:
        given = Description("no collision geometry")
        raise ScenarioError(named(path), given, "a world with something to collide with")
    return Contents(found, files.skipped)


def _geometries(files: WorldFiles, path: Path, pose: Pose) -> Iterator[Geometry]:
    """Return every collision geometry in the order of the file.

    Shapes of Drake do not outlive its scene graph, so they are converted here.

    Args:
        files: of the world.
        path: of the world's own file, or of its copy.
        pose: pose of the world.
    """
    from pydrake.geometry import Role, SceneGraph
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant, scene = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene)
    plant.set_adjacent_bodies_collision_filters(False)  # one for each pair of welded bodies
    parser = Parser(plant)
    packages = parser.package_map()
    for name in packages.GetPackageNames():  # some of these would be downloaded
        packages.Remove(name)
    for name, folder in files.packages.items():
        packages.Add(name, str(folder))
    parser.AddModels(str(path))
    plant.Finalize()
    context, inspector = plant.CreateDefaultContext(), scene.model_inspector()
    for each in sorted(inspector.GetAllGeometryIds(Role.kProximity), key=lambda id: id.get_value()):
        body = plant.GetBodyFromFrameId(inspector.GetFrameId(each))
        own = inspector.GetName(each).rpartition("::")[2]
        here = plant.EvalBodyPoseInWorld(context, body) @ inspector.GetPoseInFrame(each)
        of_world = body.index() == plant.world_body().index()
        name = own if of_world else f"{body.scoped_name().get_full()}::{own}"
        turn, at = here.rotation().matrix(), np.array(here.translation())
        if pose.rotation is not None:
            turn = pose.rotation @ turn
        at = pose.moved(at[None])[0]
        yield Geometry(name, _placed(files.path, name, inspector.GetShape(each), turn, at))


def _placed(path: Path, name: str, shape: Any, turn: FloatArray, at: FloatArray) -> Solid:
    """Return the shape of a geometry in the world.

    Raises:
        ScenarioError: there is none; the error names the geometry.
    """
    try:
        found = _shape(shape, turn, at)
        if found is not None:
            found.check_solid()
    except ScenarioError as error:
        given = Description(f"in the collision geometry {name} {shorten(error.value)}")
        raise ScenarioError(named(path), given, error.expected) from None
    if found is None:
        raise no_shape(path, name, type(shape).__name__)
    return found


def _shape(shape: Any, turn: FloatArray, at: FloatArray) -> Solid | None:
    """Return the equivalent of Drake's shape; None if there is none."""
    match type(shape).__name__:
        case "Sphere":
            return Sphere(at, shape.radius())
        case "Box":
            return _box(np.asarray(shape.size()) / 2.0, turn, at)
        case "HalfSpace":
            half = np.array(GROUND) / 2.0
            return _box(half, turn, at - half[2] * turn[:, 2])
        case "Ellipsoid":
            axes = np.array([shape.a(), shape.b(), shape.c()])
            if (along := _along_axes(turn)) is not None:
                return Ellipsoid(at, np.abs(along) @ axes)
            return Posed(Ellipsoid(np.zeros(3), axes), turn, at)
        case "Cylinder":
            return _cylinder(shape.radius(), shape.length(), turn, at)
        case "Capsule":
            half = shape.length() / 2.0 * turn[:, 2]
            return Capsule(at - half, at + half, shape.radius())
        case "Convex":
            hull = shape.GetConvexHull()
            corners = np.array([hull.vertex(k) for k in range(hull.num_vertices())])
            return Polytope(corners @ turn.T + at)
        case "Mesh":
            return _mesh(shape, turn, at)
    return None


def _along_axes(turn: FloatArray) -> FloatArray | None:
    """Return a rotation of axes into axes with whole numbers; None for any other."""
    whole = np.round(turn)
    return whole if np.abs(turn - whole).max() <= _ALONG else None


def _box(half: FloatArray, turn: FloatArray, at: FloatArray) -> Solid:
    if (along := _along_axes(turn)) is not None:
        extent = np.abs(along) @ half
        return Box(at - extent, at + extent)
    return Posed(Box(-half, half), turn, at)


def _cylinder(radius: float, height: float, turn: FloatArray, at: FloatArray) -> Solid:
    for k, axis in enumerate("xyz"):
        if np.abs(np.delete(turn[:, 2], k)).max() <= _ALONG:
            return Cylinder(at, radius, height, axis)  # type: ignore[arg-type]
    return Posed(Cylinder(np.zeros(3), radius, height), turn, at)


def _mesh(shape: Any, turn: FloatArray, at: FloatArray) -> Solid | None:
    """Return the triangles of a mesh's file; None for files that hold volumes."""
    source = shape.source()
    if not source.is_path() or source.extension().lower() not in OF_DRAKE:
        return None
    found = read_mesh(source.path())
    vertices = found.vertices
    if source.extension().lower() == ".gltf":
        vertices = vertices @ Y_UP.T
    return Mesh((vertices * np.asarray(shape.scale3())) @ turn.T + at, found.triangles)
