"""Files of a world and their references, checked before any parser reads them.

A world can name further files anywhere on the machine, and even on the network. Only those in the
folder of its own file and in folders of resources are read. Collision geometries that no obstacle
can represent are refused here, since Drake silently ignores some of them.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote
from xml.etree.ElementTree import Element, tostring

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.resources import Named, Resources
from drake_rho.scenario.maps.source import absolute, checked_file, named
from drake_rho.scenario.maps.world_elements import skip_others
from drake_rho.scenario.maps.world_solids import Solids
from drake_rho.scenario.maps.world_xml import ENDINGS, PARTS, check_geometries
from drake_rho.scenario.maps.xml_files import check_size, parsed
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
    """Files that a world consists of, all of them in its folders of resources."""

    path: Path
    """absolute path of the world's own file"""
    resources: Resources
    """folders that the files are in, the world's own first"""
    packages: dict[str, Path] = dataclasses.field(default_factory=dict)
    """folders of the packages and models to which it refers, by their names"""
    skipped: list[str] = dataclasses.field(default_factory=list)
    """elements that place no collision geometry, in the order in which they are found"""
    _on_servers: dict[str, None] = dataclasses.field(default_factory=dict)
    """addresses of files that are only on a server, in the order in which they are found"""
    _solids: Solids = dataclasses.field(default_factory=Solids)
    """meshes that Drake does not read, and polylines"""
    _counts: dict[Path, Counter[str]] = dataclasses.field(default_factory=dict)
    """numbers of inclusions, links and other parts in a file, with those in included files"""
    _trees: dict[Path, Element] = dataclasses.field(default_factory=dict)
    """content of the files in SDF and URDF"""
    _targets: list[tuple[_Reference, Path]] = dataclasses.field(default_factory=list)
    """references to files in these, and the files"""
    _mesh_folders: list[Path] = dataclasses.field(default_factory=list)
    """folders of meshes named by MJCF files, for themselves and for the files they include"""

    def look_through(self, path: Path, below: tuple[Path, ...] = ()) -> Counter[str]:
        """Return the numbers of a file's inclusions and parts, and check the included files.

        Args:
            path: of the file.
            below: files that include it.

        Raises:
            ScenarioError: a file is damaged, refers to something outside of the folders, includes
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
        self.skipped += skip_others(path, tree)
        check_geometries(path, tree)
        self._solids.add_polylines(path, tree)
        if tree.tag in ("sdf", "robot"):
            self._trees[path] = tree
        self._mesh_folders += _mesh_folders(tree, path.parent)
        count = Counter({_FILES: 1}) + Counter(
            each.tag for each in tree.iter() if each.tag in PARTS
        )
        for each in _references(tree):
            count += self._followed(each, (*below, path))
        for kind, number in count.items():
            if number > (most := _MOST_FILES if kind == _FILES else _MOST):
                given = Description(f"a world of {number} {kind}")
                raise ScenarioError(named(path), given, f"at most {most}")
        self._counts[path] = count
        return count

    def check_servers(self) -> None:
        """Check that nothing is only on a server.

        Raises:
            ScenarioError: something is; the error names all of it.
        """
        if self._on_servers:
            number = f"{len(self._on_servers)} reference{'s'[: len(self._on_servers) != 1]}"
            given = Description(f"{number} to models that are only on a server")
            expected = f"copies, in folders of their names in a resource path, of {self._servers}"
            raise ScenarioError(named(self.path), given, expected)

    @property
    def _servers(self) -> str:
        return ", ".join(self._on_servers)

    def copied(self, folder: Path) -> dict[Path, Path]:
        """Write copies of the files in SDF and URDF, and return them by their originals.

        They refer to each other and to meshes by absolute paths. Other paths would be looked for
        in the working directory and on the whole machine before the folder of the world.
        """
        copies = {
            path: folder / f"{number}.{'urdf' if tree.tag == 'robot' else 'sdf'}"
            for number, (path, tree) in enumerate(self._trees.items())
        }
        copies |= self._solids.written(folder, [target for _, target in self._targets])
        for reference, target in self._targets:
            reference.point_to(copies.get(target, target))
        for path, tree in self._trees.items():
            copies[path].write_bytes(tostring(tree))
        return copies

    def _followed(self, reference: _Reference, below: tuple[Path, ...]) -> Counter[str]:
        """Return the numbers of inclusions and parts behind a reference, after checking its files.

        Args:
            reference: in the last of the files below.
            below: files that include each other, down to the one with the reference.
        """
        path, count = below[-1], Counter[str]()
        bases = [path.parent, *([] if reference.is_included else self._mesh_folders)]
        found = self._found(reference.text, bases, path)
        if reference.is_included:
            found = [_model(one) for one in found]
            for one in found:
                count += self.look_through(one, below)
        else:
            for one in found:
                self._check_mesh(one)
        if reference.element is not None and found:
            self._targets.append((reference, found[0]))
        return count

    def _found(self, text: str, bases: list[Path], user: Path) -> list[Path]:
        """Return the files that a reference may mean, all of them in folders of resources.

        There are none if the reference is the address of a server and there is no copy.
        """
        given = Description(f"a reference to {text}")
        where = f"only files in {self.resources}, by paths relative to the world"
        by_name = Named.of(text)
        if by_name is not None:
            package = self._package(by_name, user)
            if package is None:
                self._on_servers[text] = None
                return []
            bases, rest = [package], by_name.rest
        elif "\\" in text or re.match(r"[A-Za-z][\w+.-]*:", text):
            raise ScenarioError(named(user), given, where)
        else:
            rest = text
        paths = [base / each for base in bases for each in dict.fromkeys([rest, unquote(rest)])]
        try:
            inside = all(self.resources.has(path) for path in paths)
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

    def _package(self, package: Named, user: Path) -> Path | None:
        """Return the folder of a package or model; None if it is only on a server."""
        found = self.resources.folder_of(package.name)
        if found is not None:
            self.packages[package.name] = found.resolve()
        elif not package.is_on_server:
            given = Description(f"a reference to {package.name}, which is not there")
            expected = f"a folder {package.name} in one of {self.resources}"
            raise ScenarioError(named(user), given, expected)
        return found

    def _check_mesh(self, path: Path) -> None:
        """Check that a mesh refers to nothing outside of the folders either."""
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
                raise ScenarioError(named(path), given, f"only files in {self.resources}")


def world_files(path: str | Path, resource_path: Sequence[str | Path] = ()) -> WorldFiles:
    """Return the files of a world after checking that all are harmless.

    Args:
        path: of the world's own file.
        resource_path: further folders of models.

    Raises:
        ScenarioError: one is missing, too large, damaged or outside of the folders.
    """
    own = checked_file(path, ENDINGS)
    files = WorldFiles(own, Resources.of(own, resource_path))
    check_size(files.path)
    files.look_through(files.path)
    files.check_servers()
    return files


class _Reference(NamedTuple):
    """Reference to a file in another one."""

    text: str
    """path or address as it is written"""
    is_included: bool
    """whether the file is part of the world, not a mesh"""
    element: Element | None = None
    """element of SDF that contains the text, or of URDF that has it as its file name"""

    def point_to(self, path: Path) -> None:
        """Write the absolute path of a file in the place of the text."""
        if self.element is not None and "filename" in self.element.attrib:
            self.element.set("filename", str(path))
        elif self.element is not None:
            self.element.text = str(path)


def _references(tree: Element) -> Iterator[_Reference]:
    """Return all references to files in the content of a file."""
    is_mjcf = tree.tag in ("mujoco", "mujocoinclude")
    for element in tree.iter():
        if is_mjcf:
            for key, text in element.items():
                if key.startswith("file") or (element.tag == "compiler" and key.endswith("dir")):
                    yield _Reference(text.strip(), element.tag in ("include", "model"))
            continue
        if "filename" in element.attrib:
            yield _Reference(element.attrib["filename"].strip(), False, element)
        for child in element:
            if child.tag == "uri":
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
    versions = {each.get("version", "0"): each.text for each in parsed(config).iter("sdf")}
    if not versions or not all(re.fullmatch(r"\d+(\.\d+)*", each) for each in versions):
        given = Description("no sdf element, or one with a version that is no number")
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
