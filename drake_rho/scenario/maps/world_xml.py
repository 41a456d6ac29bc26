"""Checks of the XML of worlds for geometries that are never read.

Drake silently ignores some collision geometries, and replaces others; these are refused.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from xml.etree.ElementTree import Element

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.mesh_files import ENDINGS as MESHES
from drake_rho.scenario.maps.source import named

ENDINGS = (".sdf", ".urdf", ".xml")
"""Endings of files of worlds: SDF, URDF and MJCF."""

_SHAPES = {
    "box",
    "capsule",
    "cylinder",
    "ellipsoid",
    "empty",
    "mesh",
    "plane",
    "polyline",
    "sphere",
}
"""Collision geometries of SDF and URDF that are read, with and without Drake's prefix."""

PARTS = {"link", "collision", "joint", "frame", "model", "body", "geom", "site"}
"""Elements limited in number in a world."""

_ATTRIBUTES = {"relative_to", "rotation_format", "degrees"}
"""Attributes of poses. An unknown one of an element in an inclusion ends Drake's process."""

_WITH_FRAMES = ("1.5", "1.6")
"""Versions of SDF in which poses have an attribute `frame`."""

_NO_SHAPES = {"hfield", "sdf"}
"""Types of geometries of MJCF that are not read."""

_NO_ELEMENTS = {"attach", "composite", "flexcomp"}
"""Elements of MJCF that make geometries, and that Drake silently ignores."""

_PARENTS = {
    "geom": {"body", "default", "mujocoinclude", "worldbody"},
    "body": {"body", "mujocoinclude", "worldbody"},
    "worldbody": {"mujoco", "mujocoinclude"},
}
"""Elements of MJCF in which others are read; in any other they are silently ignored."""

_LENGTHS = {
    "box": ("size",),
    "capsule": ("radius", "length"),
    "cylinder": ("radius", "length"),
    "ellipsoid": ("a", "b", "c"),
    "polyline": ("height",),
    "sphere": ("radius",),
}
"""Dimensions of shapes; one that is missing or not positive may silently become 1 m."""


def check_geometries(path: Path, tree: Element) -> None:
    """Check that all collision geometries can be represented.

    Raises:
        ScenarioError: one cannot be represented; the error names it.
    """
    for parent in tree.iter():
        for collision in parent.findall("collision"):
            name = collision.get("name", "without a name")
            shapes = [shape for geometry in collision.iter("geometry") for shape in geometry]
            if len(shapes) != 1 or parent.tag != "link":
                kinds = ", ".join(shape.tag for shape in shapes) or "nothing"
                given = Description(f"the collision geometry {name} in a {parent.tag}, of {kinds}")
                raise ScenarioError(named(path), given, "one shape, in a link")
            _check_shape(path, name, shapes[0])
    if tree.tag == "sdf":
        _check_inclusions(path, tree)
    if tree.tag in ("mujoco", "mujocoinclude"):
        _check_mjcf(path, tree)


def _check_inclusions(path: Path, tree: Element) -> None:
    """Check that elements in inclusions have no attributes that Drake does not know."""
    of_pose = _ATTRIBUTES | ({"frame"} if tree.get("version") in _WITH_FRAMES else set())
    for element in (each for include in tree.iter("include") for each in include):
        known = of_pose if element.tag == "pose" else set[str]()
        for key in sorted(element.attrib.keys() - known):
            given = Description(f"the attribute {key} of a {element.tag} in an include")
            raise ScenarioError(named(path), given, "attributes of SDF")


def _check_mjcf(path: Path, tree: Element) -> None:
    """Check that all geometries of MJCF are read as they are written."""
    for parent in tree.iter():
        for element in parent:
            if element.tag in _NO_ELEMENTS or parent.tag not in _PARENTS.get(
                element.tag, {parent.tag}
            ):
                given = Description(f"the element {element.tag} in a {parent.tag}")
                raise ScenarioError(named(path), given, "bodies of geometries written out")
    for geom in tree.iter("geom"):
        name = geom.get("name", "without a name")
        if geom.get("type") in _NO_SHAPES:
            raise no_shape(path, name, geom.attrib["type"])
        if any(each < 0.0 for each in _numbers(geom.get("size", ""))):
            given = Description(f"size {geom.attrib['size']} of the collision geometry {name}")
            raise ScenarioError(named(path), given, "lengths above 0 m")


def _check_shape(path: Path, name: str, shape: Element) -> None:
    """Check that a collision geometry of SDF or URDF is read as it is written."""
    kind = shape.tag.removeprefix("drake:")
    if kind not in _SHAPES:
        raise no_shape(path, name, shape.tag)
    if kind == "mesh" and (ending := _ending(shape)) not in MESHES:
        raise no_shape(path, name, f"mesh in {ending or 'a file without ending'}")
    if shape.find("submesh") is not None:
        raise no_shape(path, name, "submesh")
    given = {each.tag: each.text or "" for each in shape} | shape.attrib
    for key in ("radii",) if "radii" in given else _LENGTHS.get(kind, ()):
        numbers = _numbers(given.get(key, ""))
        if not numbers or not all(each > 0.0 for each in numbers):
            value = given.get(key, "").strip() or "missing"
            wrong = Description(f"{key} {value} of the collision geometry {name}")
            raise ScenarioError(named(path), wrong, "lengths above 0 m")


def _numbers(text: str) -> list[float]:
    """Return the numbers in a text; none if something else is in it."""
    with suppress(ValueError):
        return [float(each) for each in text.split()]
    return []


def _ending(mesh: Element) -> str:
    """Return the ending of the file that an element of SDF or URDF names."""
    text = mesh.get("filename") or mesh.findtext("uri") or ""
    return Path(text.strip()).suffix.lower()


def no_shape(path: Path, name: str, kind: str) -> ScenarioError:
    """Return the error for a collision geometry that no obstacle can represent."""
    given = Description(f"the collision geometry {name}, of kind {kind}")
    solids = "boxes, spheres, cylinders, capsules, ellipsoids, planes, polylines"
    expected = f"{solids} and meshes ({', '.join(MESHES)})"
    return ScenarioError(named(path), given, expected)
