"""XML of worlds: parsed without declarations, and looked through for geometries nobody would read.

Drake leaves some collision geometries out without a word, and replaces others; these are refused.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.source import named

ENDINGS = (".sdf", ".urdf", ".xml")
"""Endings of files of worlds: SDF, URDF and MJCF."""

LARGEST = 64 << 20
"""Largest size of a file of a world, and of any that it refers to [bytes]."""

_SHAPES = {"box", "capsule", "cylinder", "ellipsoid", "mesh", "sphere", "empty", "plane"}
"""Collision geometries of SDF and URDF that are read, with and without Drake's prefix."""

_MESHES = (".obj", ".gltf")
"""Endings of meshes to collide with; Drake reads no others as surfaces."""

_NO_SHAPES = {"hfield", "sdf"}
"""Types of geometries of MJCF that are not read."""


_LENGTHS = ("radius", "length", "size", "radii")
"""Dimensions of SDF's shapes; one that is not positive is replaced by 1 m without a word."""


def check_size(path: Path) -> None:
    """Check that a file is not too large to be read."""
    if (size := path.stat().st_size) > LARGEST:
        given = Description(f"a file of {size} bytes")
        raise ScenarioError(named(path), given, f"at most {LARGEST} bytes")


def parsed(path: Path) -> Element:
    """Return the root of an XML file, without declarations of types or entities."""
    builder, parser = TreeBuilder(), expat.ParserCreate()

    def refuse(*_: object) -> None:
        expected = "XML without declarations of types and entities"
        raise ScenarioError(named(path), Description("a DOCTYPE or an ENTITY"), expected)

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler = lambda tag, given: builder.start(tag, given)
    parser.EndElementHandler = lambda tag: builder.end(tag)
    parser.CharacterDataHandler = lambda text: builder.data(text)
    try:
        check_size(path)
        content = path.read_bytes()
        content.decode("utf-8")
        parser.Parse(content, True)
    except (expat.ExpatError, UnicodeDecodeError, OSError, ValueError) as error:
        if isinstance(error, ScenarioError):
            raise
        reason = " ".join(str(error).split())
        raise ScenarioError(
            named(path), Description("a damaged file"), f"XML in UTF-8; {reason}"
        ) from None
    return builder.close()


def check_geometries(path: Path, tree: Element) -> None:
    """Check that all collision geometries can be represented.

    Raises:
        ScenarioError: one cannot; the error names it.
    """
    for collision in tree.iter("collision"):
        name = collision.get("name", "without a name")
        for geometry in collision.iter("geometry"):
            for child in geometry:
                if child.tag.removeprefix("drake:") not in _SHAPES:
                    raise no_shape(path, name, child.tag)
                if child.tag == "mesh" and (ending := _ending(child)) not in _MESHES:
                    kind = f"mesh in {ending or 'a file without ending'}"
                    raise no_shape(path, name, kind)
                lengths = _LENGTHS if child.tag != "plane" else ()  # it is endless
                for length in (each for key in lengths for each in child.iter(key)):
                    _check_lengths(path, name, length)
    for geom in tree.iter("geom"):
        if geom.get("type", "") in _NO_SHAPES:
            raise no_shape(path, geom.get("name", "without a name"), geom.attrib["type"])


def _check_lengths(path: Path, name: str, element: Element) -> None:
    """Check that the lengths in an element of SDF are positive, where they are numbers."""
    text = (element.text or "").strip()
    numbers = list[float]()
    with suppress(ValueError):  # what is no number, the parser refuses
        numbers = [float(each) for each in text.split()]
    if not all(each > 0.0 for each in numbers):
        given = Description(f"{element.tag} {text} of the collision geometry {name}")
        raise ScenarioError(named(path), given, "lengths above 0 m")


def _ending(mesh: Element) -> str:
    """Return the ending of the file that an element of SDF or URDF names."""
    text = mesh.get("filename") or mesh.findtext("uri") or ""
    return Path(text.strip()).suffix.lower()


def no_shape(path: Path, name: str, kind: str) -> ScenarioError:
    """Return the error for a collision geometry that no obstacle can represent."""
    given = Description(f"the collision geometry {name}, of kind {kind}")
    expected = "boxes, spheres, cylinders, capsules, ellipsoids, planes and meshes (.obj, .gltf)"
    return ScenarioError(named(path), given, expected)
