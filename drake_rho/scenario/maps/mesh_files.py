"""Triangles of mesh files: OBJ, STL, PLY, glTF and COLLADA."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError, shorten
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.libraries import library, quiet
from drake_rho.scenario.maps.claims import check_gltf, check_ply
from drake_rho.scenario.maps.collada import read_collada
from drake_rho.scenario.maps.source import absolute, checked_file, named, unreadable
from drake_rho.scenario.maps.stored import MOST
from drake_rho.system.files import read_bytes

ENDINGS = (".obj", ".stl", ".ply", ".gltf", ".glb", ".dae")
"""Endings of mesh files."""

_FEW = 1_000_000
"""Number of triangles up to which a file may repeat them, whatever its size."""

_EXPECTED = "a mesh of triangles"
_NO_VERTEX = "a face has a vertex that is not there"


class MeshFile(NamedTuple):
    """Triangles of all geometries of a file, each where the file places it."""

    vertices: FloatArray
    """positions, in the unit of the file, or in metres if the file names its unit, shape (V, 3)"""
    triangles: IntArray
    """numbers of the vertices of each triangle, shape (F, 3)"""
    beside: tuple[str, ...]
    """names of further files that were read, relative to the file's folder"""


def read_mesh(path: str | Path) -> MeshFile:
    """Return the triangles of a mesh file, without colours and textures.

    A glTF file may keep its numbers in further files; those have to be in its folder.

    Raises:
        ScenarioError: the file cannot be read, is damaged or has no triangles, or the extra `maps`
            is not installed.
    """
    path = checked_file(path, ENDINGS)
    ending, beside, unit = path.suffix.lower(), _Beside(path), 1.0
    trimesh = library("trimesh")
    if ending == ".dae":
        library("collada")  # trimesh asks for it too late for an error of its own
    try:
        if ending == ".dae":
            content, unit = read_collada(path)
        else:
            content = read_bytes(path)
        check = {".ply": check_ply, ".gltf": check_gltf, ".glb": check_gltf}.get(ending)
        if check is not None:
            check(content)
        # numbers that are not finite are refused below
        with np.errstate(all="ignore"), quiet("trimesh"):
            scene = trimesh.load_scene(
                io.BytesIO(content),
                file_type=ending[1:],
                resolver=beside,
                process=False,  # which would merge vertices and remove NaN
                skip_materials=True,
                **({"ignore_broken": False} if ending == ".dae" else {}),
            )
            vertices, triangles = _merged(scene, trimesh.Trimesh, max(_FEW, len(content)))
    except ScenarioError:
        raise
    except Exception as error:  # readers of damaged files may raise almost anything
        reason = _NO_VERTEX if isinstance(error, IndexError) and ending == ".obj" else error
        raise unreadable(path, reason, _EXPECTED) from None
    if len(triangles) == 0:
        raise ScenarioError(named(path), Description("no triangles"), _EXPECTED)
    if not np.isfinite(vertices).all():
        row = int(np.argmin(np.isfinite(vertices).all(axis=1)))
        given = Description(f"vertex {row + 1} at {vertices[row].tolist()}")
        raise ScenarioError(named(path), given, "finite coordinates")
    return MeshFile(unit * vertices, triangles, tuple(sorted(beside.read)))


def _merged(scene: Any, kind: Any, most: int) -> tuple[FloatArray, IntArray]:
    """Return the vertices and triangles of all meshes of a scene, placed by its nodes.

    Args:
        scene: as read by the library.
        kind: of its meshes.
        most: largest number of vertices or triangles, which nodes may repeat.
    """
    vertices, triangles = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    count = total = 0
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, kind):  # points and lines
            continue
        total += len(mesh.faces)
        if max(total, count + len(mesh.vertices)) > min(MOST, most):
            raise ValueError(f"it has more than {min(MOST, most)} triangles or vertices")
        placed = np.asarray(mesh.vertices) @ matrix[:3, :3].T + matrix[:3, 3]
        vertices.append(placed)
        triangles.append(np.asarray(mesh.faces, dtype=np.int64) + count)
        count += len(placed)
    return np.concatenate(vertices), np.concatenate(triangles)


class _Beside:
    """Files of numbers in the folder of a mesh; trimesh asks for them by name."""

    def __init__(self, path: Path) -> None:
        self._folder, self._mesh = path.parent, named(path)
        self.read = set[str]()

    def __getitem__(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            ScenarioError: it is outside of the folder, no buffer, or cannot be read.
        """
        path = absolute(self._folder / unquote(name))
        if not path.resolve().is_relative_to(self._folder) or not path.is_relative_to(self._folder):
            given = Description(f"a reference to {shorten(name)}, a file elsewhere")
            raise ScenarioError(self._mesh, given, f"only files in {named(self._folder)}")
        content = read_bytes(checked_file(path, (".bin", ".glbin")))
        self.read.add(path.relative_to(self._folder).as_posix())
        return content
