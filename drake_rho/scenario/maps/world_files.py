"""Files of a world and their references, checked before any parser reads them.

A world can name further files anywhere on the machine, and even on the network. Only those in the
folder of its own file are read. Collision geometries that no obstacle can represent are refused
here, since Drake silently ignores some of them.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote
from xml.etree.ElementTree import Element, tostring

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.source import absolute, checked_file, named
from drake_rho.scenario.maps.world_xml import ENDINGS, PARTS, check_geometries, check_size, parsed
from drake_rho.system.files import read_bytes

_MOST = 1_500
"""Largest number of links, collision geometries or other parts of a world, counted once per
inclusion. The time to read them grows with the square of their number."""

_MOST_FILES = 10_000
"""Largest number of inclusions of files."""

_FILES = "inclusions of files"
"""Name of inclusions among the counted parts of a world."""

_DEEPEST = 100
"""Largest depth of files included in each other."""


@dataclasses.dataclass
class WorldFiles:
    """Files that a world consists of, all of them in one folder."""

    path: Path
    """absolute path of the world's own file"""
    packages: dict[str, Path] = dataclasses.field(default_factory=dict)
    """folders of the packages and models to which it refers, by their names"""
    _counts: dict[Path, Counter[str]] = dataclasses.field(default_factory=dict)
    """numbers of inclusions, links and other parts in a file, with those in included files"""
    _trees: dict[Path, Element] = dataclasses.field(default_factory=dict)
    """content of the files in SDF"""
    _targets: list[tuple[Element, Path]] = dataclasses.field(default_factory=list)
    """elements of SDF that refer to a file, and the file"""
    _mesh_folders: list[Path] = dataclasses.field(default_factory=list)
    """folders of meshes named by MJCF files, for themselves and for the files they include"""

    @property
    def folder(self) -> Path:
        """Folder in which all of its files are."""
        return self.path.parent

    def look_through(self, path: Path, below: tuple[Path, ...] = ()) -> Counter[str]:
        """Return the numbers of a file's inclusions and parts, and check the included files.

        Args:
            path: of the file.
            below: files that include it.

        Raises:
            ScenarioError: a file is damaged, refers to something outside of the folder, includes
                itself, has too many parts, or a collision geometry that cannot be represented.
        """
        if path in self._counts:
            return self._counts[path]
        if path in below:
            raise ScenarioError(named(path), Description("a file that includes itself"), "an end")
        if len(below) > _DEEPEST:
            depth = Description(f"more than {_DEEPEST} files that include each other")
            raise ScenarioError(named(path), depth, "fewer")
        tree = parsed(path)
        check_geometries(path, tree)
        if tree.tag == "sdf":
            self._trees[path] = tree
        self._mesh_folders += _mesh_folders(tree, path.parent)
        count = Counter({_FILES: 1}) + Counter(
            each.tag for each in tree.iter() if each.tag in PARTS
        )
        for each in _references(tree):
            bases = [path.parent, *([] if each.is_included else self._mesh_folders)]
            found = self._found(each.text, bases, path)
            if each.is_included:
                found = [_model(one) for one in found]
                for one in found:
                    count += self.look_through(one, (*below, path))
            else:
                for one in found:
                    self._check_mesh(one)
            if each.element is not None:
                self._targets.append((each.element, found[0]))
        for kind, number in count.items():
            if number > (most := _MOST_FILES if kind == _FILES else _MOST):
                given = Description(f"a world of {number} {kind}")
                raise ScenarioError(named(path), given, f"at most {most}")
        self._counts[path] = count
        return count

    def copied(self, folder: Path) -> dict[Path, Path]:
        """Write copies of the files in SDF, and return them by their originals.

        They refer to each other and to meshes by absolute paths. Other paths would be looked for
        in the working directory and on the whole machine before the folder of the world.
        """
        names = enumerate(self._trees)
        copies = {path: folder / f"{number}.sdf" for number, path in names}
        for element, target in self._targets:
            element.text = str(copies.get(target, target))
        for path, copy in copies.items():
            copy.write_bytes(tostring(self._trees[path]))
        return copies

    def _found(self, text: str, bases: list[Path], user: Path) -> list[Path]:
        """Return the files that a reference may mean, which are all in the folder."""
        given = Description(f"a reference to {text}")
        where = f"only files in {named(self.folder)}, by paths relative to it"
        name = re.match(r"(?:package|model)://([\w-][\w.-]*)(/.*)?$", text)
        if name is not None:
            bases, rest = [self._package(name[1], user)], (name[2] or "").lstrip("/")
        elif "\\" in text or re.match(r"[A-Za-z][\w+.-]*:", text):
            raise ScenarioError(named(user), given, where)
        else:
            rest = text
        paths = [base / each for base in bases for each in dict.fromkeys([rest, unquote(rest)])]
        try:
            inside = all(path.resolve().is_relative_to(self.folder) for path in paths)
            there = [_by_name(path) for path in paths if path.exists()]
        except (OSError, RuntimeError, ValueError):  # links in a circle, null characters, length
            inside = False
        if not inside or Path(rest).is_absolute() or Path(unquote(rest)).is_absolute():
            raise ScenarioError(named(user), given, where)
        if not there:
            raise ScenarioError(named(user), Description(f"{given}, which is not there"), where)
        for path in there:
            if not path.is_dir():
                check_size(path)
        return list(dict.fromkeys(there))

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
        content = read_bytes(path) if path.suffix.lower() in (".obj", ".gltf") else b""
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
    """Return the files of a world after checking that all are harmless.

    Raises:
        ScenarioError: one is missing, too large, damaged or outside of the folder of the world.
    """
    files = WorldFiles(checked_file(path, ENDINGS))
    check_size(files.path)
    files.look_through(files.path)
    return files


class _Reference(NamedTuple):
    """Reference to a file in another one."""

    text: str
    """path or address as it is written"""
    is_included: bool
    """whether the file is part of the world, not a mesh"""
    element: Element | None = None
    """element of SDF that contains the text"""


def _references(tree: Element) -> Iterator[_Reference]:
    """Return all references to files in the content of a file."""
    is_mjcf = tree.tag in ("mujoco", "mujocoinclude")
    for element in tree.iter():
        if is_mjcf:
            for key, text in element.items():
                if key.startswith("file") or (element.tag == "compiler" and key.endswith("dir")):
                    yield _Reference(text.strip(), element.tag in ("include", "model"))
            continue
        if "filename" in element.attrib and element.tag != "plugin":
            yield _Reference(element.attrib["filename"].strip(), False)
        for child in element:
            if child.tag == "uri" and element.tag != "script":  # scripts are of another viewer
                yield _Reference((child.text or "").strip(), element.tag == "include", child)


def _mesh_folders(tree: Element, folder: Path) -> list[Path]:
    """Return the folders named by MJCF, base folders of its paths of meshes."""
    compilers = tree.iter("compiler") if tree.tag in ("mujoco", "mujocoinclude") else ()
    texts = [text for each in compilers for key, text in each.items() if key.endswith("dir")]
    return [folder / each for each in texts]


def _by_name(path: Path) -> Path:
    """Return the absolute path of a folder, or of a file by the name given."""
    return path.resolve() if path.is_dir() else absolute(path)


def _model(path: Path) -> Path:
    """Return the file of an included path; for a folder, the file of the latest version."""
    if not path.is_dir():
        return path
    config = path / "model.config"
    if not config.is_file():
        raise ScenarioError(named(path), Description("no model.config"), "the folder of a model")
    versions = {each.get("version", ""): each.text for each in parsed(config).iter("sdf")}
    if not versions or not all(re.fullmatch(r"\d+(\.\d+)*", each) for each in versions):
        given = Description("no sdf element with a version")
        raise ScenarioError(named(config), given, "the configuration of a model")
    latest = max(versions, key=lambda each: [int(part) for part in each.split(".")])
    found = path / (versions[latest] or "").strip()
    if not found.is_file() or not found.resolve().is_relative_to(path):
        given = Description(f"a reference to {versions[latest]}")
        raise ScenarioError(named(config), given, f"a file in {named(path)}")
    return absolute(found)


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
