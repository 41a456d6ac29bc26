"""Public worlds, meshes and OctoMaps, read or refused, beside an independent reader.

FILES holds, each a copy of the files of a public repository:

- `worlds/NAME/`: SDF worlds, with their models in `worlds/NAME/models` (PX4-gazebo-models,
  gcs-science-robotics); they are not changed, and files in `tools` folders are not worlds;
- `meshes/NAME/`: OBJ, STL, PLY, GLB, glTF and DAE (trimesh's `models`);
- `octomaps/NAME/`: .bt and .ot (OctoMap's examples).
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

import drake_rho as rho
from benchmarks.race import Skipped
from benchmarks.tables import Cell, Goal, Table

MESHES = (".obj", ".stl", ".ply", ".glb", ".gltf", ".dae")
"""Endings of meshes that `Mesh.load` reads."""

BOUNDS = 1e-9
"""Largest difference of bounds, in the sizes of meshes."""


def run(folder: Path | None) -> Table:
    """Read every file, and compare counts and bounds with another reader's."""
    if folder is None or not folder.is_dir():
        raise Skipped("give a folder of worlds, meshes and OctoMaps: --files FOLDER")
    rows, wrong, seen = list[tuple[Cell, ...]](), list[str](), 0
    for kind, files, check in (
        ("world", _worlds(folder / "worlds"), _world),
        ("mesh", _of(folder / "meshes", MESHES), _mesh),
        ("OctoMap", _of(folder / "octomaps", (".bt", ".ot")), _octomap),
    ):
        for name in dict.fromkeys(each[0] for each in files):
            here = [path for source, path in files if source == name]
            found = [_judged(path, folder, check) for path in here]
            seen += len(found)
            refused = [each for each in found if each[0] == "refused"]
            other = [each[1] for each in found if each[0] == "different"]
            wrong += other
            read = len(found) - len(refused) - len(other)
            slowest = max(each[2] for each in found)
            rows.append((kind, name, len(found), read, len(refused), len(other), slowest))
            _REASONS[f"{kind}, {name}"] = [each[1] for each in refused]
    if not seen:
        raise Skipped(f"{folder}: no worlds, meshes or OctoMaps")
    return Table(
        name="clients_worlds",
        title="Worlds, meshes and OctoMaps of others",
        columns=("kind", "of", "files", "read", "refused", "different", "slowest [s]"),
        rows=tuple(rows),
        notes=(_WORK, *_reasons(), *wrong),
        goals=(Goal("files whose counts or bounds differ, or other errors", 0, len(wrong)),),
        packages=("drake-rho", "drake", "numpy", "trimesh", "octomap-python", "pycollada"),
    )


_REASONS: dict[str, list[str]] = {}

_WORK = """\
Worlds: the number of collision geometries, with those of included models, is counted by an XML
parser alone. Meshes: bounds and the number of triangles are those of trimesh, loaded as scenes, in
the unit of a COLLADA file; a file may be refused only if trimesh finds no triangle in it either.
OctoMaps: the occupied volume is that of octomap-python's iterator over leaves. Refused is a file
with one line that names it and the reason. Models are looked for in the folder of models only."""


def _reasons() -> list[str]:
    return [f"Refused, {kind}: " + "; ".join(each) for kind, each in _REASONS.items() if each]


def _judged(path: Path, folder: Path, check: Callable[[Path], str]) -> tuple[str, str, float]:
    """Return read, refused or different, with the reason, and seconds."""
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            different = check(path)
    except rho.ScenarioError as error:
        text = str(error)
        one = str(path) in text and "\n" not in text
        said = text.replace(f"{path.parent}/", "").replace(f"{folder}/", "")
        return "refused" if one else "different", said[:200], time.perf_counter() - began
    except Exception as error:
        said = f"{path.relative_to(folder)}: {type(error).__name__}: {str(error)[:200]}"
        return "different", said, time.perf_counter() - began
    seconds = time.perf_counter() - began
    return (
        ("different", f"{path.relative_to(folder)}: {different}", seconds)
        if different
        else (
            "read",
            "",
            seconds,
        )
    )


def _of(folder: Path, endings: tuple[str, ...]) -> list[tuple[str, Path]]:
    files = sorted(folder.rglob("*")) if folder.is_dir() else []
    return [
        (path.relative_to(folder).parts[0], path)
        for path in files
        if path.is_file() and path.suffix.lower() in endings
    ]


def _worlds(folder: Path) -> list[tuple[str, Path]]:
    """Return worlds: of a repository with a folder `worlds` these, else all SDF files."""
    found = list[tuple[str, Path]]()
    for name, path in _of(folder, (".sdf",)):
        own = folder / name / "worlds"
        if own in path.parents or not own.is_dir():
            found.append((name, path))
    return found


def _world(path: Path) -> str:
    models = next(each for each in path.parents if each.parent.name == "worlds") / "models"
    world = rho.load_world(path, resource_path=models if models.is_dir() else ())
    expected = _collisions(ElementTree.parse(path).getroot(), models)  # noqa: S314  # bounded
    if expected == len(world):
        return ""
    return f"{len(world)} obstacles, {expected} collision geometries"


def _collisions(element: Any, models: Path) -> int:
    """Return the number of collision geometries below an element, by its XML alone."""
    count = 0
    for each in element:
        if each.tag == "include":
            model = models / (each.findtext("uri") or "").strip().removeprefix("model://")
            inner = ElementTree.parse(model / "model.sdf").getroot()  # noqa: S314
            count += _collisions(inner, models)
        elif each.tag == "collision":
            count += 1
        elif each.tag in ("world", "model", "link"):
            count += _collisions(each, models)
    return count


def _mesh(path: Path) -> str:
    parts = _parts(path)
    try:
        mesh = rho.Mesh.load(path)
    except rho.ScenarioError as error:
        if parts:
            return f"refused ({error}), trimesh has triangles"
        raise
    count = sum(len(part.faces) for part in parts)
    corners = np.concatenate([part.triangles.reshape(-1, 3) for part in parts])
    theirs = _metres(path) * np.array([corners.min(axis=0), corners.max(axis=0)])
    used = mesh.vertices[mesh.triangles].reshape(-1, 3)
    ours = np.array([used.min(axis=0), used.max(axis=0)])
    size = float(np.ptp(theirs, axis=0).max())
    apart = float(np.abs(ours - theirs).max())
    if len(mesh.triangles) != count:
        return f"{len(mesh.triangles)} triangles, trimesh has {count}"
    return f"bounds differ by {apart:.2g} of {size:.2g}" if apart > BOUNDS * size else ""


def _parts(path: Path) -> list[Any]:
    """Return the meshes of a file with triangles, as trimesh places them; none if it fails."""
    import trimesh

    library: Any = trimesh
    try:
        found = library.load_scene(path).dump()
    except Exception:  # of any kind, on a damaged file
        return []
    return [part for part in found if len(getattr(part, "faces", ()))]


def _metres(path: Path) -> float:
    """Return the unit of a COLLADA file by its XML [m], which trimesh only notes; else 1."""
    if path.suffix.lower() != ".dae":
        return 1.0
    root = ElementTree.parse(path).getroot()  # noqa: S314
    units = [each for each in root.iter() if each.tag.endswith("}unit")]
    return float(units[0].get("meter", 1.0)) if units else 1.0


def _octomap(path: Path) -> str:
    import octomap

    tree: Any = octomap.OcTree(0.1)
    if path.suffix == ".bt":
        tree.readBinary(str(path).encode())
    else:
        tree = octomap.AbstractOcTree.read(str(path).encode())
    theirs = sum(leaf.getSize() ** 3 for leaf in tree.begin_leafs() if tree.isNodeOccupied(leaf))
    cells = rho.Voxels.from_octomap(path, unknown="free")
    ours = len(cells.occupied) * cells.resolution**3
    if abs(ours - theirs) <= 1e-6 * theirs:
        return ""
    return f"{ours:.6g} m³ occupied, octomap-python has {theirs:.6g} m³"
