"""Elements of SDF and URDF that place collision geometries; all others are skipped.

Drake's parser refuses elements that it does not know, while Gazebo ignores them. Visuals, sensors,
plugins and physics collide with nothing, so that only the rest is handed to the parser.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.source import named

_MODEL = {"model", "include", "frame", "joint", "drake:joint"}

_READ = {
    "sdf": {"world", "model"},
    "world": _MODEL,
    "model": _MODEL | {"link", "pose", "static", "origin"},
    "robot": {"link", "joint", "drake:joint"},
    "link": {"collision", "pose", "origin"},
    "pose": set[str](),
}
"""Elements that are read in others, of which all further ones are skipped. Files older than SDF 1.3
have an `origin`, which the parser refuses."""

_NOT_READ = {
    "include": {"plugin"},
    "joint": {"sensor", "physics", "plugin"},
    "collision": {
        "auto_inertia_params",
        "density",
        "drake:proximity_properties",
        "laser_retro",
        "max_contacts",
        "surface",
    },
}
"""Elements that are skipped in others, whose further ones may move or change a geometry."""


def skip_others(path: Path, tree: Element) -> list[str]:
    """Remove all elements that place no collision geometry, and return what they were.

    Args:
        path: of the file.
        tree: content of the file, which is changed.

    Raises:
        ScenarioError: a removed element holds a collision geometry or an inclusion.
    """
    return list(_removed(path, tree)) if tree.tag in ("sdf", "robot") else []


def _removed(path: Path, parent: Element) -> Iterator[str]:
    """Remove elements from an element and from those in it, and return what they were."""
    kept = list[Element]()
    for element in parent:
        known = _READ.get(parent.tag, {element.tag}) - _NOT_READ.get(parent.tag, set())
        if element.tag in known:
            kept.append(element)
            yield from _removed(path, element)
        else:
            _check_harmless(path, element)
            yield f"{_described(element)} in {_described(parent)}"
    parent[:] = kept


def _described(element: Element) -> str:
    """Return the kind and the name of an element, such as 'link arm'."""
    return f"{element.tag} {element.get('name', '')}".strip()


def _check_harmless(path: Path, element: Element) -> None:
    """Check that no obstacle goes with an element that is not read.

    Raises:
        ScenarioError: the element holds a collision geometry or an inclusion.
    """
    for each in element.iter():
        if (each.tag == "collision" and each.find("geometry") is not None) or (
            each.tag == "include" and each.find("uri") is not None
        ):
            given = Description(f"a {_described(each)} in the element {_described(element)}")
            raise ScenarioError(named(path), given, "worlds of models of links")
