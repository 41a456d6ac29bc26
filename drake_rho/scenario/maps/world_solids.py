"""Collision geometries that Drake does not read, written as meshes that it reads."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.maps.mesh_files import ENDINGS, read_mesh
from drake_rho.scenario.maps.polylines import Prism, extruded
from drake_rho.scenario.maps.source import named

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation that Drake applies to glTF files, which have y up."""

OF_DRAKE = (".obj", ".gltf")
"""Endings of meshes that Drake reads."""


@dataclasses.dataclass
class Solids:
    """Polylines of a world, each with the mesh that takes its place."""

    _prisms: list[tuple[Element, Prism]] = dataclasses.field(default_factory=list)
    """elements of polylines, and their meshes"""

    def add_polylines(self, path: Path, tree: Element) -> None:
        """Add the polylines of a file.

        Raises:
            ScenarioError: one is no polygon; the error names its collision geometry.
        """
        for collision in tree.iter("collision"):
            for element in collision.iterfind("geometry/polyline"):
                try:
                    self._prisms.append((element, _prism(element)))
                except ValueError as error:
                    name = collision.get("name", "without a name")
                    given, _, expected = str(error).partition(", expected ")
                    wrong = Description(f"in the collision geometry {name} {given}")
                    raise ScenarioError(named(path), wrong, expected) from None

    def written(self, folder: Path, targets: Iterable[Path]) -> dict[Path, Path]:
        """Write the meshes to a folder, and refer to them where the polylines were.

        Args:
            folder: to write to.
            targets: all files to which the world refers.

        Returns:
            Copies of those targets that are meshes which Drake does not read.

        Raises:
            ScenarioError: a mesh cannot be read.
        """
        for number, (element, prism) in enumerate(self._prisms):
            copy = folder / f"polyline{number}.obj"
            copy.write_text(_obj(prism.vertices, prism.triangles))
            element.clear()
            element.tag = "mesh"
            SubElement(element, "uri").text = str(copy)
            if prism.is_convex:
                SubElement(element, "drake:declare_convex")
        copies = dict[Path, Path]()
        for target in targets:
            ending = target.suffix.lower()
            if ending in ENDINGS and ending not in OF_DRAKE and target not in copies:
                found = read_mesh(target)
                vertices = found.vertices @ Y_UP.T if ending == ".glb" else found.vertices
                copies[target] = folder / f"mesh{len(copies)}.obj"
                copies[target].write_text(_obj(vertices, found.triangles))
        return copies


def _prism(element: Element) -> Prism:
    """Return the solid of a polyline.

    Raises:
        ValueError: it is no polygon with a height.
    """
    rows = [(each.text or "").split() for each in element.findall("point")]
    if not all(len(each) == 2 for each in rows):
        raise ValueError("a point that is not x and y, expected two numbers in a point")
    try:
        corners = np.array(rows, dtype=float).reshape(-1, 2)
        height = float(element.findtext("height", ""))
    except ValueError:
        raise ValueError("a text in the place of a number, expected a polygon") from None
    if not np.isfinite(corners).all() or not np.isfinite(height):
        raise ValueError("a number that is not finite, expected a polygon")
    return extruded(corners, height)


def _obj(vertices: FloatArray, triangles: IntArray) -> str:
    """Return a mesh as the text of an OBJ file, with all digits."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    return "\n".join([*lines, ""])
