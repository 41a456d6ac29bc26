"""File formats of the LSC planner (github.com/qwerty35/lsc_planner) and its successor LSC-DR.

A mission file contains, according to the mission reader (`src/mission.cpp`) and
`missions/readme.txt`:

- `quadrotors`: types of vehicles by name, each with `max_vel` [m/s] and `max_acc` [m/s²], which are
  bounds in both directions of each axis, `radius` [m], `downwash`, and `nominal_velocity` [m/s],
  which another planner uses and this module ignores.
- `world`: one element, whose `dimension` gives the least and then the greatest x, y, z [m] of a
  vehicle's centre. The planner does not subtract the radius, and its own missions start closer to
  the sides than that.
- `agents`: each with a `type`, `start` and `goal` [m], at rest at both, and optionally its own
  `cid` (a number, by default its index in the list from 0), `downwash` and `nominal_velocity`. An
  agent's own radius is rejected: the planner reads it only beside a field of another name.
- `obstacles`: boxes at rest, of type `static`, with the centre `pose` and half the sides
  `dimensions` [m]: the planner extends a box that far to both sides of its pose. Moving types are
  ellipsoids that the planner's simulation drives; they are rejected.

A world is a separate file, named on that planner's command line and not in the mission. It is an
octomap file or, since LSC-DR (github.com/qwerty35/lsc_dr_planner, `src/map_manager.cpp`), a CSV
file without header, with one box at rest per row: its centre x, y, z and its whole sides x, y, z
[m]. LSC-DR rasterises such boxes to an octomap of a given resolution; here they are exact.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST, Count, Finite, Name
from drake_rho.scenario.records import Box, Limits
from drake_rho.scenario.refusals import malformed_json, scenario_error

_Size = Annotated[float, Field(ge=1.0 / LARGEST, le=LARGEST, allow_inf_nan=False)]
_Sizes = tuple[_Size, _Size, _Size]
_Point = tuple[Finite, Finite, Finite]


class _Part(BaseModel):
    """Part of a mission, with all required and no unknown fields, and numbers not as strings."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Quadrotor(_Part):
    """Type of vehicle."""

    max_vel: _Sizes
    max_acc: _Sizes
    radius: _Size
    downwash: _Size
    nominal_velocity: Finite

    @property
    def limits(self) -> Limits:
        """Boxes of velocity and acceleration."""
        velocity, acceleration = (
            Box([-most for most in sizes], sizes) for sizes in (self.max_vel, self.max_acc)
        )
        return Limits(velocity=velocity, acceleration=acceleration)


class World(_Part):
    """Bounds of the vehicles' centres."""

    dimension: tuple[Finite, Finite, Finite, Finite, Finite, Finite]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if any(self.dimension[axis] > self.dimension[axis + 3] for axis in range(3)):
            expected = "least x, y, z and then greatest x, y, z, none of them below the least"
            raise ScenarioError("dimension", list(self.dimension), expected)
        return self


class Agent(_Part):
    """Vehicle with its start and goal."""

    type: Name
    cid: Count | None = None
    start: _Point
    goal: _Point
    downwash: _Size | None = None
    nominal_velocity: Finite | None = None


class StaticBox(_Part):
    """Obstacle at rest."""

    type: Literal["static"]
    pose: _Point
    dimensions: _Sizes

    @property
    def box(self) -> Box:
        """Box that extends half the sides in both directions from its centre."""
        middle, half = np.array(self.pose), np.array(self.dimensions)
        return Box(middle - half, middle + half)

    @model_validator(mode="after")
    def _solid(self) -> Self:
        _check_solid(self.box, "dimensions")
        return self


class Mission(_Part):
    """Content of a mission file."""

    quadrotors: dict[str, Quadrotor]
    world: Annotated[tuple[World, ...], Field(min_length=1, max_length=1)]
    agents: Annotated[tuple[Agent, ...], Field(min_length=1)]
    obstacles: tuple[StaticBox, ...]

    @model_validator(mode="after")
    def _agents_are_known_and_distinct(self) -> Self:
        numbers = self.numbers
        for index, agent in enumerate(self.agents):
            if agent.type not in self.quadrotors:
                expected = f"one of the quadrotors: {', '.join(self.quadrotors)}"
                raise ScenarioError(f"agents[{index}].type", agent.type, expected)
            if numbers[index] in numbers[:index]:
                expected = "a number no other agent has"
                raise ScenarioError(f"agents[{index}].cid", numbers[index], expected)
        return self

    @property
    def numbers(self) -> list[int]:
        """Numbers of the agents; the number of an agent without `cid` is its index in the list."""
        given = [agent.cid for agent in self.agents]
        return [index if cid is None else cid for index, cid in enumerate(given)]


def parse_mission(text: str) -> Mission:
    """Return the mission that JSON text describes.

    Raises:
        ScenarioError: the text is not JSON, or not a mission that a scenario can represent.
    """
    try:  # pydantic's own reader would keep the last value of a repeated name
        _check_at_rest(json.loads(text, object_pairs_hook=_each_once))
        return Mission.model_validate_json(text)
    except ScenarioError:
        raise
    except ValidationError as error:
        raise scenario_error(error, Mission) from None
    except (ValueError, RecursionError) as error:
        raise malformed_json(error) from None


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names: set[str] = set()
    for name, value in pairs:
        if name in names:
            raise ScenarioError(name, value, "this name only once")
        names.add(name)
    return dict(pairs)


def _check_at_rest(content: object) -> None:
    """Check that no obstacle moves, before errors about fields of moving types are reported.

    Raises:
        ScenarioError: an obstacle is of a type that moves.
    """
    obstacles = content.get("obstacles") if isinstance(content, dict) else None
    for index, obstacle in enumerate(obstacles if isinstance(obstacles, list) else []):
        kind = obstacle.get("type", "static") if isinstance(obstacle, dict) else "static"
        if kind != "static":
            expected = (
                "static, a box at rest: moving types are defined by that planner's simulation"
            )
            raise ScenarioError(f"obstacles[{index}].type", kind, expected)


def parse_world(text: str) -> tuple[Box, ...]:
    """Return the boxes of a world in the order of its rows; blank lines are skipped.

    Raises:
        ScenarioError: a row is not a box, or there is none; the field names the line, as `line 3`.
    """
    rows = [(number, row) for number, row in enumerate(text.splitlines(), start=1) if row.strip()]
    if not rows:
        raise ScenarioError("", Description("no row"), f"at least one box: {_ROW}")
    return tuple(_box(f"line {number}", row) for number, row in rows)


_ROW = "six numbers and no header, centre x, y, z and whole sides x, y, z in metres"


def _box(line: str, row: str) -> Box:
    try:
        numbers = np.array([float(cell) for cell in row.split(",")])
    except ValueError:
        raise ScenarioError(line, row, _ROW) from None
    if numbers.shape != (6,) or not np.all(np.abs(numbers) <= LARGEST):  # never with a NaN
        raise ScenarioError(line, row, f"{_ROW}, all finite, of at most {LARGEST:g}")
    middle, sides = numbers[:3], numbers[3:]
    if not np.all(sides >= 1.0 / LARGEST):
        raise ScenarioError(line, row, "three sides above 0 after the centre")
    box = Box(middle - sides / 2.0, middle + sides / 2.0)
    _check_solid(box, line)
    return box


def _check_solid(box: Box, field: str) -> None:
    """Check that a box has an interior.

    Raises:
        ScenarioError: the box is flat; the error names `field`.
    """
    try:
        box.check_solid()
    except ScenarioError as error:
        raise ScenarioError(field, error.value, error.expected) from None
