"""Collision geometries of worlds in SDF, URDF and MJCF files, as obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, ValidationInfo

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.context import Context, context_of
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import Vector, record
from drake_rho.scenario.maps.source import named
from drake_rho.scenario.maps.worlds import read_world
from drake_rho.scenario.obstacles import AnyObstacle, Obstacle
from drake_rho.scenario.poses import AnyPose, Pose, pose_of
from drake_rho.scenario.refusals import scenario_error
from drake_rho.scenario.rotations import Rotation

_LONGEST = 80
"""Longest name of an obstacle or a skipped element."""


@record
class WorldFile:
    """Reference to the file of a world, whose collision geometries become obstacles."""

    world: Annotated[str, Field(min_length=1)]
    """path of an .sdf, .urdf or MJCF .xml file, relative to the folder of the scenario's file"""
    resource_path: tuple[str, ...] = ()
    """further folders of models that the world may refer to, relative to the same folder"""
    position: Vector | None = None
    """position of the world's origin [m]; the origin if not given"""
    rotation: Rotation | None = None
    """rotation about the world's origin: roll, pitch and yaw [rad], or a matrix; none if not
    given"""


class World(tuple[Obstacle, ...]):
    """Obstacles of a world's file, and what else is in it.

    Attributes:
        skipped: elements of the file that place no collision geometry, such as
            'sensor camera in link base'.
    """

    skipped: tuple[str, ...]

    def __new__(cls, obstacles: Iterable[Obstacle], skipped: Iterable[str] = ()) -> Self:
        """Return the obstacles of a world."""
        found = super().__new__(cls, obstacles)
        found.skipped = tuple(skipped)
        return found


@checked
def load_world(
    path: str | Path,
    pose: AnyPose = None,
    *,
    resource_path: str | Path | Sequence[str | Path] = (),
) -> World:
    """Return the collision geometries of an SDF, URDF or MJCF file as obstacles at rest.

    They are placed by Drake's parser, with all joints in the default configuration. Meshes are
    `Mesh`es, convex ones `Polytope`s, and so are polylines. An endless plane becomes a box of 200 m
    by 200 m, 1 m thick, with the middle of its top at the origin of the plane. Elements of SDF and
    URDF that place no collision geometry are skipped.

    Models are looked for by their names in the folder of the world's file, in `resource_path`, in a
    folder `models` in or beside that of the file, and in those that the environment variables
    `GZ_SIM_RESOURCE_PATH`, `SDF_PATH` and `GAZEBO_MODEL_PATH` list. Nothing else is read, and
    nothing is downloaded.

    Args:
        path: of an .sdf, .urdf or .xml file.
        pose: pose of the world, a 4 x 4 matrix or Drake's `RigidTransform`.
        resource_path: further folder of models, or several.

    Returns:
        Obstacles with the names of their bodies and geometries, in the order of the file, and the
        skipped elements.

    Raises:
        ScenarioError: the file cannot be read, has no collision geometry, or one that no obstacle
            can represent, or refers to files that are in none of the folders.
    """
    folders = [resource_path] if isinstance(resource_path, str | Path) else resource_path
    found = read_world(path, pose_of(pose), folders)
    obstacles = [Obstacle(each.shape, name=_name(each.name)) for each in found.geometries]
    return World(obstacles, map(_name, found.skipped))


def _name(text: str) -> str:
    """Return a printable name: the end of a long one."""
    shown = "".join(each if each.isprintable() else "?" for each in text)
    return shown if len(shown) <= _LONGEST else "…" + shown[1 - _LONGEST :]


def _expanded(value: object, info: ValidationInfo[Context | None]) -> object:
    """Return obstacles, with references to worlds replaced by the obstacles in them."""
    if not isinstance(value, list | tuple):
        return value
    found = list[object]()
    for index, each in enumerate(value):
        if not isinstance(each, Mapping) or "world" not in each:
            found.append(each)
            continue
        try:
            found += _of_reference(each, context_of(info).folder)
        except ScenarioError as error:
            raise error.inside(f"[{index}]") from None
    return tuple(found)


def _of_reference(value: object, folder: Path) -> World:
    try:
        form: WorldFile = TypeAdapter(WorldFile).validate_python(value)
    except ValidationError as error:
        raise scenario_error(error, WorldFile) from None
    pose, resources = (
        Pose(form.rotation, form.position),
        [folder / each for each in form.resource_path],
    )
    try:
        return load_world(folder / form.world, pose, resource_path=resources)
    except ScenarioError as error:
        if error.field == "resource_path":
            raise
        reason = Description(f"{named(form.world)}: {error.value}")
        raise ScenarioError("world", reason, error.expected) from None


Obstacles = Annotated[
    tuple[AnyObstacle, ...],
    BeforeValidator(_expanded, json_schema_input_type=tuple[AnyObstacle | WorldFile, ...]),
]
"""Obstacles; a reference to a world's file stands for all obstacles in it."""
