"""`Show`: pads, formations and how vehicles fly between them, from a file or from Python."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.context import Context
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import (
    Colour,
    Count,
    FloatArray,
    Margin,
    Name,
    NotNegative,
    Positive,
    read_only,
    record,
)
from drake_rho.scenario.files import parsed_file, yaml_content
from drake_rho.scenario.records import Limits, Obstacle, Separation
from drake_rho.scenario.refusals import scenario_error
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.worlds import Obstacles
from drake_rho.shows.formations import AnyFormation

OFF = "#000000"
"""Colour of lights that are off."""


@record
class Scene:
    """Formation that is held for a while.

    Examples:
        >>> ring = rho.formations.Ring(12, radius=5.0, center=[0, 0, 10])
        >>> rho.Scene("ring", ring, hold=4.0).hold
        4.0
    """

    name: Name
    """name in reports and on the time bar, unique in the show"""
    formation: AnyFormation
    """points, at most one for each pad; other vehicles wait above their pads"""
    hold: NotNegative = 0.0
    """least time at rest in the formation [s], rounded up to whole steps"""
    transition: Positive | None = None
    """time of the flight to the formation [s], rounded to whole steps; the least that is found if
    not given"""
    colours: tuple[Colour, ...] = ("#ffffff",)
    """colours of the lights as #rrggbb, one for all points or one for each; lights of vehicles that
    wait are off"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            formation: AnyFormation,
            hold: float = 0.0,
            transition: float | None = None,
            colours: Sequence[str] = (),
        ) -> None: ...

    def __post_init__(self) -> None:
        points = len(self.formation.positions)
        if len(self.colours) not in (1, points):
            expected = f"one, or one for each of the {points} points"
            raise ScenarioError("colours", Description(f"{len(self.colours)} colours"), expected)

    @property
    def lights(self) -> tuple[str, ...]:
        """Colour of the light at each point."""
        points = len(self.formation.positions)
        return self.colours * points if len(self.colours) == 1 else self.colours


@record
class TakeOff:
    """Vertical flight of all vehicles from their pads, in groups; landings are its mirror image.

    Vehicles keep their distances from each other as long as the pads do, whenever they fly.
    """

    height: Positive
    """height above the pads at which vehicles assemble and, where a formation does not need them,
    wait [m]"""
    at_once: Annotated[Count, Field(ge=1)] | None = None
    """number of vehicles that take off at the same time, in the order of the pads; all if not
    given"""
    every: NotNegative = 0.0
    """time between the take-offs of two groups [s], rounded up to whole steps"""


@record
class Show:
    """Show of a fleet: take-off from pads, formations one after another, landing.

    Examples:
        >>> pads = rho.formations.Grid(3, 2, spacing=2.0)
        >>> ring = rho.formations.Ring(6, radius=3.0, center=[0, 0, 6])
        >>> show = rho.Show(
        ...     "ring",
        ...     pads,
        ...     [rho.Scene("ring", ring, hold=3.0)],
        ...     rho.Limits(max_speed=4.0, max_acceleration=3.0),
        ...     rho.Separation(1.0, downwash=2.0),
        ...     take_off=rho.TakeOff(2.0),
        ... )
        >>> rho.verify(rho.plan_show(show)).ok
        True
    """

    name: Name
    """name of the show and of its plan"""
    pads: AnyFormation
    """places from which vehicles take off, one for each vehicle"""
    scenes: Annotated[tuple[Scene, ...], Field(min_length=1)]
    """formations in their order"""
    limits: Limits
    """limits of every vehicle; its position box is the geofence"""
    separation: Separation
    """required separation of every pair of vehicles, at every instant"""
    step: Positive = 0.25
    """time step h [s]"""
    take_off: TakeOff | None = None
    """vertical take-off and landing; if not given, vehicles fly from the pads to the first
    formation, and wait on their pads where they are not needed"""
    landing: Literal["own", "any"] = "own"
    """whether vehicles land on their own pads or on any"""
    obstacles: Obstacles = ()
    """obstacles at rest, such as no-fly zones"""
    radius: Margin = 0.0
    """least distance of vehicles from obstacles [m]"""
    duration: Positive | None = None
    """longest time of the whole show [s]; any if not given"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            pads: AnyFormation,
            scenes: Sequence[Scene],
            limits: Limits,
            separation: Separation,
            step: float = 0.25,
            take_off: TakeOff | None = None,
            landing: str = "own",
            obstacles: Sequence[Solid | Obstacle] = (),
            radius: float = 0.0,
            duration: float | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        names = [scene.name for scene in self.scenes]
        for index, scene in enumerate(self.scenes):
            field = f"scenes[{index}]"
            if scene.name in names[:index]:
                raise ScenarioError(f"{field}.name", scene.name, "a name of its own")
            points = len(scene.formation.positions)
            if points > len(self.home):
                expected = f"at most {len(self.home)}, one for each pad"
                raise ScenarioError(f"{field}.formation", Description(f"{points} points"), expected)
            check_apart(scene.formation.positions, self.separation, f"{field}.formation")
            if len(self.waiting_for(scene)) + points < len(self.home):
                expected = "pads above which enough vehicles can wait clear of the formation"
                raise ScenarioError(f"{field}.formation", scene.name, expected)
        check_apart(self.home, self.separation, "pads")
        for index, each in enumerate(self.obstacles):
            if isinstance(each, Obstacle) and (each.moves or each.active or each.known_from):
                raise ScenarioError(f"obstacles[{index}]", each, "an obstacle that is at rest")

    @cached_property
    def home(self) -> FloatArray:
        """Positions of the pads [m], shape (N, 3)."""
        return self.pads.positions

    @cached_property
    def waiting_places(self) -> FloatArray:
        """Places above the pads where vehicles assemble and wait [m], shape (N, 3)."""
        height = 0.0 if self.take_off is None else self.take_off.height
        return read_only(self.home + np.array([0.0, 0.0, height]))

    def waiting_for(self, scene: Scene) -> FloatArray:
        """Return the waiting places that are clear of a formation [m], shape (M, 3)."""
        from scipy.spatial import cKDTree  # slow to load, so only where needed

        scaled = self.separation.scaled
        tree = cKDTree(scaled(scene.formation.positions))
        away, _ = tree.query(scaled(self.waiting_places))
        clear: FloatArray = self.waiting_places[away >= self.separation.distance]
        return clear

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names of the vehicles, in the order of the pads."""
        return tuple(f"drone {number + 1}" for number in range(len(self.home)))


def check_apart(positions: FloatArray, separation: Separation, field: str) -> None:
    """Check that points keep the separation from each other.

    Raises:
        ScenarioError: two of them do not; the nearest two are named.
    """
    from scipy.spatial import cKDTree  # slow to load, so only where needed

    if len(positions) < 2:
        return
    scaled = separation.scaled(positions)
    away, nearest = cKDTree(scaled).query(scaled, 2)
    first = int(np.argmin(away[:, 1]))
    if away[first, 1] < separation.distance - separation.tolerance:
        second = int(nearest[first][nearest[first] != first][0])
        a, b = sorted((first, second))
        seen = Description(f"points {a + 1} and {b + 1} at {away[first, 1]:.4g} m")
        factor = separation.distance / max(away[first, 1], 1e-12)
        expected = (
            f"points at least {separation.distance:g} m apart, by the separation; "
            f"{factor:.3g} times as large they are"
        )
        raise ScenarioError(field, seen, expected)


@checked
def load_show(path: str | Path) -> Show:
    """Read a show from a YAML file, and the tables, fonts and drawings beside it.

    Raises:
        ScenarioError: there is no such file, or it is not a valid show.
    """
    return parsed_file(path, "show", "a readable YAML file", show_from_yaml)


def show_from_yaml(text: str, folder: Path = Path()) -> Show:
    """Return the show that a YAML text describes.

    Args:
        text: YAML.
        folder: base of the relative paths of tables, fonts, drawings and maps.

    Raises:
        ScenarioError: the text is not YAML, or not a valid show.
    """
    try:
        return _adapter().validate_python(yaml_content(text), context=Context(folder=folder))
    except ValidationError as error:
        raise scenario_error(error, Show) from None


def show_schema() -> dict[str, Any]:
    """Return the JSON schema of a show file, with the units of every field."""
    return _adapter().json_schema()


def example_show() -> str:
    """Return the YAML text of a complete example show."""
    return (files("drake_rho.shows") / "library" / "example.yaml").read_text(encoding="utf-8")


@cache
def _adapter() -> TypeAdapter[Show]:
    return TypeAdapter(Show)
