"""Triangles of COLLADA files (.dae): what is handed to the library that reads them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, tostring

import numpy as np

from drake_rho.scenario.maps.xml_files import parsed

_SKIPPED = {
    "bind_material",
    "contributor",
    "extra",
    "instance_camera",
    "instance_light",
    "library_animations",
    "library_cameras",
    "library_effects",
    "library_images",
    "library_lights",
    "library_materials",
}
"""Elements that are not read, since they hold no triangles."""

_NUMBERS = ("float_array", "matrix", "rotate", "scale", "translate", "p", "h", "vcount")
"""Elements of numbers; the library replaces what is none by zeros, or ends there."""

_MOST_NODES = 10_000
"""Largest number of nodes of a scene, counted once per instance."""


class Collada(NamedTuple):
    """Content of a COLLADA file."""

    content: bytes
    """its geometries and the nodes that place them, in XML"""
    unit: float
    """length of its unit [m]"""


def read_collada(path: Path) -> Collada:
    """Return the content of a COLLADA file after checking that it is as large as it claims.

    Raises:
        ScenarioError: the file is damaged, or declares types or entities.
        ValueError: it has nodes without end, polygons without corners or meshes with bones.
    """
    tree = parsed(path)
    if tree.tag != "COLLADA" or tree.find("scene") is None:
        raise ValueError("it has no scene")
    for element in list(tree.iter()):
        element[:] = [each for each in element if each.tag not in _SKIPPED]
        if element.tag == "instance_controller":
            raise ValueError("it has meshes with bones, which are not read")
        if element.tag in _NUMBERS:
            _check_numbers(element)
        if element.tag == "polylist":
            _check_polygons(element)
    _check_nodes(tree)
    unit = next((each.get("meter", "1") for each in tree.iterfind("asset/unit")), "1")
    if not 0.0 < float(unit) < float("inf"):
        raise ValueError(f"its unit is {unit:.40} m")
    return Collada(tostring(tree), float(unit))


def _check_numbers(element: Element) -> None:
    """Check that the text of an element is finite numbers, and indices are not negative.

    Raises:
        ValueError: it is not so.
    """
    numbers = np.array((element.text or "").split(), dtype=float)
    least = 0.0 if element.tag in ("p", "h", "vcount") else -np.inf
    if not (np.isfinite(numbers) & (numbers >= least)).all():
        raise ValueError(f"the numbers in a {element.tag} are not finite, or negative indices")


def _check_polygons(element: Element) -> None:
    """Check that polygons have as many corners as numbers.

    Raises:
        ValueError: they have more, or fewer than three.
    """
    numbers = sum(len((each.text or "").split()) for each in element.iter("p"))
    counts = [int(each) for each in element.findtext("vcount", "").split()]
    if sum(counts) > numbers or min(counts, default=3) < 3:
        raise ValueError(f"it claims {sum(counts)} corners in {numbers} numbers")


def _check_nodes(tree: Element) -> None:
    """Check that nodes that stand for others come to an end.

    Raises:
        ValueError: they are too many, or one contains itself.
    """
    nodes = {each.get("id", ""): each for each in tree.iter("node")}
    sizes, under_way = dict[str, int](), set[str]()

    def size(name: str) -> int:
        """Return the number of nodes in a node, with all that it stands for."""
        if name not in sizes:
            if name in under_way or len(under_way) > 100:
                raise ValueError("it has nodes in each other without end")
            under_way.add(name)
            sizes[name] = 1 + among(nodes[name].iter() if name in nodes else ())
            under_way.remove(name)
        return sizes[name]

    def among(elements: Iterable[Element]) -> int:
        """Return the number of nodes among elements, with all that they stand for."""
        count = 0
        for each in elements:
            count += each.tag == "node"
            if each.tag == "instance_node":
                count += size(each.get("url", "").removeprefix("#"))
        return count

    if (found := among(tree.iter())) > _MOST_NODES:
        raise ValueError(f"it has {found} nodes, more than {_MOST_NODES}")
