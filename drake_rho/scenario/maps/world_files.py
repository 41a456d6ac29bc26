"""What the files of a world refer to, looked through before anything else reads them.

A world can name further files anywhere on the machine, and even on the network. Only those in the
folder of its own file are read. Collision geometries that no obstacle can represent are refused
here, since Drake leaves some of them out without a word.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.source import checked_file, named

ENDINGS = (".sdf", ".urdf", ".xml")
"""Endings of files of worlds: SDF, URDF and MJCF."""

LARGEST = 64 << 20
"""Largest size of a file of a world, and of any that it refers to [bytes]."""

_MOST = 10_000
"""Largest number of files that are included, each as often as it is."""

_SHAPES = {"box", "capsule", "cylinder", "ellipsoid", "mesh", "sphere", "empty", "plane"}
"""Collision geometries of SDF and URDF that are read, with and without Drake's prefix."""

_MESHES = (".obj", ".gltf")
"""Endings of meshes to collide with; Drake reads no others as surfaces."""

_NO_SHAPES = {"hfield", "sdf"}
"""Types of geometries of MJCF that are not read."""


@dataclasses.dataclass
class WorldFiles:
    """Files that a world consists of, all of them in one folder."""

    path: Path
    """absolute path of the world's own file"""
    packages: dict[str, Path] = dataclasses.field(default_factory=dict)
    """folders of the packages and models to which it refers, by their names"""
    _counts: dict[Path, int] = dataclasses.field(default_factory=dict)
    """number of inclusions in a file, those in included files among them"""

    @property
    def folder(self) -> Path:
        """Folder in which all of its files are."""
        return self.path.parent

    def look_through(self, path: Path, below: tuple[Path, ...] = ()) -> int:
        """Return the number of files that one includes, and look through these as well.

        Args:
            path: of the file.
            below: files that include it.

        Raises:
            ScenarioError: a file is damaged, refers to something outside of the folder, includes
                itself, or has a collision geometry that cannot be represented.
        """
        if path in self._counts:
            return self._counts[path]
        if path in below:
            raise ScenarioError(named(path), Description("a file that includes itself"), "an end")
        tree = _parsed(path)
        _check_geometries(path, tree)
        count = 1
        for text, is_included, bases in _references(tree, path.parent):
            for found in self._found(text, bases, path):
                if is_included:
                    count += sum(self.look_through(each, (*below, path)) for each in _models(found))
                else:
                    self._check_mesh(found)
        if count > _MOST:
            given = Description(f"{count} inclusions of files")
            raise ScenarioError(named(path), given, f"at most {_MOST}")
        self._counts[path] = count
        return count

    def _found(self, text: str, bases: list[Path], user: Path) -> list[Path]:
        """Return the files that a reference may mean, which are all in the folder."""
        given = Description(f"a reference to {text}")
        where = f"only files in {named(self.folder)}, by paths relative to it"
        name = re.match(r"(?:package|model)://([\w-][\w.-]*)(/.*)?$", text)
        if name is not None and name[2] is None and text.startswith("model:"):
            expected = f"{text}/, with a slash, by which Drake's parser finds it"
            raise ScenarioError(named(user), given, expected)
        if name is not None:
            bases, rest = [self._package(name[1], user)], (name[2] or "").lstrip("/")
        elif "\\" in text or re.match(r"[A-Za-z][\w+.-]*:", text):
            raise ScenarioError(named(user), given, where)
        else:
            rest = text
        paths = [base / each for base in bases for each in {rest, unquote(rest)}]
        try:
            inside = all(path.resolve().is_relative_to(self.folder) for path in paths)
        except (OSError, RuntimeError, ValueError):  # links in a circle, null characters
            inside = False
        if not inside or Path(rest).is_absolute() or Path(unquote(rest)).is_absolute():
            raise ScenarioError(named(user), given, where)
        there = [path.resolve() for path in paths if path.exists()]
        if not there:
            raise ScenarioError(named(user), Description(f"{given}, which is not there"), where)
        for path in there:
            if path.is_file():
                _check_size(path)
        return there

    def _package(self, name: str, user: Path) -> Path:
        """Return the folder of a package or model: one in the folder of the world, or itself."""
        for path in (self.folder / name, self.folder):
            if path.name == name and path.is_dir() and path.resolve().is_relative_to(self.folder):
                self.packages[name] = path.resolve()
                return path
        given = Description(f"a reference to {name}, which is not there")
        raise ScenarioError(named(user), given, f"a folder {name} in {named(self.folder)}")

    def _check_mesh(self, path: Path) -> None:
        """Check that a mesh refers to nothing outside of the folder either."""
        content = path.read_bytes() if path.suffix.lower() in (".obj", ".gltf") else b""
        texts = list[str]()
        if path.suffix.lower() == ".obj":
            found = re.findall(rb"^\s*mtllib\s+(.*?)\s*$", content, re.MULTILINE)
            texts = [each.decode(errors="replace") for each in found]
        elif content:
            try:
                texts = [each for each in _uris(json.loads(content)) if each[:5] != "data:"]
            except (ValueError, RecursionError):
                given = Description("a damaged file")
                raise ScenarioError(named(path), given, "a mesh in glTF") from None
        for text in texts:
            if path.suffix.lower() == ".gltf" or (path.parent / text).exists():
                self._found(text, [path.parent], path)  # materials of an OBJ need not be there
            elif Path(text).is_absolute() or ".." in Path(text).parts:
                given = Description(f"a reference to {text}")
                raise ScenarioError(named(path), given, f"only files in {named(self.folder)}")


def world_files(path: str | Path) -> WorldFiles:
    """Return the files of a world once all of them are found to be harmless.

    Raises:
        ScenarioError: one is missing, too large, damaged or outside of the folder of the world.
    """
    files = WorldFiles(checked_file(path, ENDINGS))
    _check_size(files.path)
    files.look_through(files.path)
    return files


def _check_size(path: Path) -> None:
    if (size := path.stat().st_size) > LARGEST:
        given = Description(f"a file of {size} bytes")
        raise ScenarioError(named(path), given, f"at most {LARGEST} bytes")


def _parsed(path: Path) -> Element:
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
        _check_size(path)
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


def _references(tree: Element, folder: Path) -> Iterator[tuple[str, bool, list[Path]]]:
    """Return references to files, whether each is included, and folders they may be relative to."""
    if tree.tag in ("mujoco", "mujocoinclude"):
        dirs = [
            text
            for each in tree.iter("compiler")
            for key, text in each.items()
            if key.endswith("dir")
        ]
        for element in tree.iter():
            bases = [folder, *(folder / each for each in dirs if element.tag != "include")]
            for key, text in element.items():
                if key.startswith("file") or (element.tag == "compiler" and key.endswith("dir")):
                    yield text.strip(), element.tag in ("include", "model"), bases
        return
    for element in tree.iter():
        if "filename" in element.attrib and element.tag != "plugin":
            yield element.attrib["filename"].strip(), False, [folder]
        for child in element:
            if child.tag == "uri" and element.tag != "script":  # scripts are of another viewer
                yield (child.text or "").strip(), element.tag == "include", [folder]


def _models(path: Path) -> list[Path]:
    """Return the files that an included path stands for: those that a folder's config names."""
    if not path.is_dir():
        return [path]
    config = path / "model.config"
    if not config.is_file():
        raise ScenarioError(named(path), Description("no model.config"), "the folder of a model")
    tree = _parsed(config)
    named_files = list(tree.iter("sdf"))
    whole = tree.tag == "model" and tree.find("name") is not None
    if not whole or not named_files or any(each.get("version") is None for each in named_files):
        # Drake's parser ends the whole process where something is missing
        expected = "a model with a name, and an sdf with a version"
        raise ScenarioError(named(config), Description("another file"), expected)
    found = [path / (each.text or "").strip() for each in named_files]
    for each in found:
        if not each.is_file() or not each.resolve().is_relative_to(path):
            given = Description(f"a reference to {each.name}")
            raise ScenarioError(named(config), given, f"a file in {named(path)}")
    return [each.resolve() for each in found]


def _check_geometries(path: Path, tree: Element) -> None:
    """Check that all collision geometries can be represented.

    Raises:
        ScenarioError: one cannot; the error names it.
    """
    for collision in tree.iter("collision"):
        for geometry in collision.iter("geometry"):
            for child in geometry:
                if child.tag.removeprefix("drake:") not in _SHAPES:
                    raise no_shape(path, collision.get("name", "without a name"), child.tag)
                for size in (*child.findall("*"), child):
                    _check_size_of(path, collision, size)
                if child.tag == "mesh" and (ending := _ending(child)) not in _MESHES:
                    kind = f"mesh in {ending or 'a file without ending'}"
                    raise no_shape(path, collision.get("name", "without a name"), kind)
    for geom in tree.iter("geom"):
        kind = geom.get("type", "")
        if kind in _NO_SHAPES:
            raise no_shape(path, geom.get("name", "without a name"), kind)


def _check_size_of(path: Path, collision: Element, size: Element) -> None:
    """Check that the dimensions of a geometry are above 0; Drake's parser takes others for 1 m.

    Raises:
        ScenarioError: one is not.
    """
    texts = [size.get(name, "") for name in ("radius", "length", "size")]
    if size.tag in ("radius", "length", "size", "radii"):
        texts.append(size.text or "")
    for text in texts:
        if any(number.startswith("-") or not number.strip("0.") for number in text.split()):
            given = Description(f"the collision geometry {collision.get('name')} of size {text}")
            raise ScenarioError(named(path), given, "dimensions above 0")


def _ending(mesh: Element) -> str:
    """Return the ending of the file that an element of SDF or URDF names."""
    text = mesh.get("filename") or mesh.findtext("uri") or ""
    return Path(text.strip()).suffix.lower()


def no_shape(path: Path, name: str, kind: str) -> ScenarioError:
    """Return the error for a collision geometry that no obstacle can represent."""
    given = Description(f"the collision geometry {name}, of kind {kind}")
    expected = "boxes, spheres, cylinders, capsules, ellipsoids, planes and meshes (.obj, .gltf)"
    return ScenarioError(named(path), given, expected)


def _uris(value: object) -> Iterator[str]:
    """Return all values of keys `uri` in the content of a JSON file."""
    if isinstance(value, dict):
        for key, each in value.items():
            if key == "uri" and isinstance(each, str):
                yield each
            else:
                yield from _uris(each)
    elif isinstance(value, list):
        for each in value:
            yield from _uris(each)
