"""The format of mission files of the LSC planner (github.com/qwerty35/lsc_planner).

What its reader (`src/mission.cpp`) and its `missions/readme.txt` say a file holds:

- `quadrotors`: types of vehicles by name, each with `max_vel` [m/s] and `max_acc` [m/s²], which are
  bounds in both directions of each axis, `radius` [m], `downwash`, and `nominal_velocity` [m/s],
  which is for another planner and not used here.
- `world`: one element, its `dimension` the least x, y, z and the greatest [m] that a vehicle's
  centre may have: the planner takes no radius off, and its own missions start closer to the sides.
- `agents`: each of a `type`, with `start` and `goal` [m], from rest to rest, and if wanted its own
  `cid` (a number, else its place in the list from 0), `downwash` and `nominal_velocity`. A radius
  of an agent's own is refused: the planner reads it only beside a field of another name.
- `obstacles`: boxes, moving obstacles and trajectories in other files, none of which a scenario can
  hold. They are refused. Worlds kept in octomap files are named on that planner's command line,
  not in the mission.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from drake_rho.scenario.errors import ScenarioError, Words
from drake_rho.scenario.fields import LARGEST, Count, Finite, Name, scenario_error
from drake_rho.scenario.records import Box, Limits

_Size = Annotated[float, Field(ge=1.0 / LARGEST, le=LARGEST, allow_inf_nan=False)]
_Sizes = tuple[_Size, _Size, _Size]
_Point = tuple[Finite, Finite, Finite]


class _Part(BaseModel):
    """A part of a mission: complete, with nothing unknown in it, numbers written as numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Quadrotor(_Part):
    """A type of vehicle."""

    max_vel: _Sizes
    max_acc: _Sizes
    radius: _Size
    downwash: _Size
    nominal_velocity: Finite

    @property
    def limits(self) -> Limits:
        """The boxes of velocity and acceleration."""
        velocity, acceleration = (
            Box([-most for most in sizes], sizes) for sizes in (self.max_vel, self.max_acc)
        )
        return Limits(velocity=velocity, acceleration=acceleration)


class World(_Part):
    """Where centres of vehicles may be."""

    dimension: tuple[Finite, Finite, Finite, Finite, Finite, Finite]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if any(self.dimension[axis] > self.dimension[axis + 3] for axis in range(3)):
            expected = "least x, y, z and then greatest x, y, z, none of them below the least"
            raise ScenarioError("dimension", list(self.dimension), expected)
        return self


class Agent(_Part):
    """A vehicle with its start and goal."""

    type: Name
    cid: Count | None = None
    start: _Point
    goal: _Point
    downwash: _Size | None = None
    nominal_velocity: Finite | None = None


def _none(obstacles: list[Any]) -> list[Any]:
    for obstacle in obstacles[:1]:
        named = isinstance(obstacle, dict) and "type" in obstacle
        field, value = ("[0].type", obstacle["type"]) if named else ("[0]", obstacle)
        expected = "no obstacle: a scenario holds spheres, a mission boxes and what moves"
        raise ScenarioError(field, value, expected)
    return obstacles


class Mission(_Part):
    """What a file holds."""

    quadrotors: dict[str, Quadrotor]
    world: Annotated[tuple[World, ...], Field(min_length=1, max_length=1)]
    agents: Annotated[tuple[Agent, ...], Field(min_length=1)]
    obstacles: Annotated[list[Any], AfterValidator(_none)]

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
        """Numbers of the agents; an agent without `cid` has that of its place in the list."""
        given = [agent.cid for agent in self.agents]
        return [index if cid is None else cid for index, cid in enumerate(given)]


def parse_mission(text: str) -> Mission:
    """The mission that `text` describes.

    Raises:
        ScenarioError: the text is not JSON, or not a mission that a scenario can hold.
    """
    try:  # pydantic's own reader would keep the last of a doubled name
        json.loads(text, object_pairs_hook=_each_once)
        return Mission.model_validate_json(text)
    except ScenarioError:
        raise
    except ValidationError as error:
        raise scenario_error(error, Mission) from None
    except (ValueError, RecursionError) as error:
        raise ScenarioError("", Words("broken JSON"), f"JSON; {error}") from None


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names: set[str] = set()
    for name, value in pairs:
        if name in names:
            raise ScenarioError(name, value, "this name once")
        names.add(name)
    return dict(pairs)
