"""Maps in scenario files: references to map files, or to maps stored in a plan's file."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, Tag, ValidationInfo
from pydantic.json_schema import SkipJsonSchema

from drake_rho.scenario.context import Context, context_of
from drake_rho.scenario.errors import Description, MapChangedWarning, ScenarioError
from drake_rho.scenario.fields import Positive, Vector, record
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.source import Source, named
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.poses import Pose
from drake_rho.scenario.rotations import Rotation

_File = Annotated[str, Field(min_length=1)]


@record
class OctomapFile:
    """OctoMap in a file of its own."""

    octomap: _File
    """path of a .bt or .ot file, relative to the folder of the scenario's file"""
    unknown: Literal["free", "occupied"] | None = None
    """treatment of unobserved cells; if not given, an error says what the file holds"""
    position: Vector | None = None
    """position of the map's origin [m]; the origin if not given"""
    rotation: Rotation | None = None
    """rotation about the map's origin: roll, pitch and yaw [rad], or a matrix; none if not given"""
    sha256: str | None = None
    """hash of the file; a warning says so where it has changed"""

    def load(self, folder: Path) -> Voxels:
        """Return the map."""
        path, pose = folder / self.octomap, Pose(self.rotation, self.position)
        return Voxels.from_octomap(path, self.unknown, pose)


@record
class PointsFile:
    """Point cloud in a file of its own, as the cells that hold a point."""

    points: _File
    """path of a .pcd, .ply, .xyz or .npy file, relative to the folder of the scenario's file"""
    resolution: Positive
    """side of the cells [m]"""
    position: Vector | None = None
    """position of the cloud's origin [m]; the origin if not given"""
    rotation: Rotation | None = None
    """rotation about the cloud's origin: roll, pitch and yaw [rad], or a matrix; none if not
    given"""
    sha256: str | None = None
    """hash of the file; a warning says so where it has changed"""

    def load(self, folder: Path) -> Voxels:
        """Return the map."""
        path, pose = folder / self.points, Pose(self.rotation, self.position)
        return Voxels.from_points(path, self.resolution, pose)


@record
class MeshFile:
    """Mesh in a file of its own."""

    mesh: _File
    """path of an .obj, .stl, .ply, .gltf, .glb or .dae file, relative to the folder of the
    scenario's file"""
    scale: Positive = 1.0
    """length of the file's unit [m]"""
    position: Vector | None = None
    """position of the mesh's origin [m]; the origin if not given"""
    rotation: Rotation | None = None
    """rotation about the mesh's origin: roll, pitch and yaw [rad], or a matrix; none if not
    given"""
    sha256: str | None = None
    """hash of the file; a warning says so where it has changed"""

    def load(self, folder: Path) -> Mesh:
        """Return the map."""
        return Mesh.load(folder / self.mesh, self.scale, Pose(self.rotation, self.position))


@record
class StoredMap:
    """Map stored once in a plan's file for all scenarios in it."""

    stored_map: int
    """number of the map in the file, from 0"""


_FORMS: dict[str, Callable[..., Any]] = {
    "octomap": OctomapFile,
    "points": PointsFile,
    "mesh": MeshFile,
}
"""Records of map files, by the key that names the path."""

KEYS: Mapping[str, tuple[str, ...]] = {
    "StoredMap": ("stored_map",),
    "MeshFile": ("mesh",),
    "OctomapFile": ("octomap",),
    "PointsFile": ("points",),
}
"""Keys that identify these records in a mapping."""


def _load(form: OctomapFile | PointsFile | MeshFile, info: ValidationInfo[Context | None]) -> Map:
    """Return the map of a reference, and warn if it has changed since the scenario was saved."""
    (key,) = KEYS[type(form).__name__]
    given = getattr(form, key)
    try:
        found: Map = form.load(context_of(info).folder)
    except ScenarioError as error:
        own = error.field if error.field in ("unknown",) else key
        reason = Description(f"{named(given)}: {error.value}") if own == key else error.value
        raise ScenarioError(own, reason, error.expected) from None
    source = found.source
    if form.sha256 is not None and source is not None and form.sha256 != source.sha256:
        text = f"{source.path}: the map has changed since the scenario was saved"
        warnings.warn(MapChangedWarning(text), stacklevel=2)
    return found


def _stored(form: StoredMap, info: ValidationInfo[Context | None]) -> Map:
    """Return a map stored in a plan's file."""
    maps = context_of(info).maps
    if not 0 <= form.stored_map < len(maps):
        expected = f"one of the {len(maps)} maps of the file"
        raise ScenarioError("stored_map", form.stored_map, expected)
    found: Map = maps[form.stored_map]
    return found


if TYPE_CHECKING:
    References = Voxels | Mesh  # the result of validation
else:
    References = (
        Annotated[OctomapFile, AfterValidator(_load), Tag("OctomapFile")]
        | Annotated[PointsFile, AfterValidator(_load), Tag("PointsFile")]
        | Annotated[MeshFile, AfterValidator(_load), Tag("MeshFile")]
        | Annotated[SkipJsonSchema[StoredMap], AfterValidator(_stored), Tag("StoredMap")]
    )
"""References to maps in files, which validation replaces by the maps."""


def reference_to(source: Source, folder: Path) -> OctomapFile | PointsFile | MeshFile:
    """Return the reference to a map's file in a scenario file.

    Args:
        source: of the map.
        folder: of the scenario file.
    """
    try:
        path = os.path.relpath(source.path, folder)
    except ValueError:  # on another drive of Windows
        path = source.path
    name = Path(path).as_posix()
    form: OctomapFile | PointsFile | MeshFile = _FORMS[source.kind](
        **{source.kind: name}, **source.arguments, sha256=source.sha256
    )
    return form
