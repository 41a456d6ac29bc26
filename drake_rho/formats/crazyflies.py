"""`load_crazyflies`: the robots of Crazyswarm2 (crazyflies.yaml) as vehicles.

The file is a mapping with `robots` by name, each with `enabled` and `initial_position` [m], and
with addresses, types and settings, which are not read.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drake_rho.formats.texts import in_file, text_of, text_or_none
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import Boolean, Finite, Name
from drake_rho.scenario.files import yaml_content
from drake_rho.scenario.parts import State, Vehicle
from drake_rho.scenario.refusals import scenario_error

_ROBOTS = re.compile(r"^robots[ \t]*:", re.MULTILINE)


class _Robot(BaseModel):
    """Robot, whose other fields are not read."""

    model_config = ConfigDict(extra="ignore")

    enabled: Boolean
    initial_position: tuple[Finite, Finite, Finite]


class _Robots(BaseModel):
    """Content of the file, whose other fields are not read."""

    model_config = ConfigDict(extra="ignore")

    robots: Annotated[dict[Name, _Robot], Field(max_length=10_000)]


@checked
def load_crazyflies(path: str | Path) -> tuple[Vehicle, ...]:
    """Read the enabled robots of Crazyswarm2's crazyflies.yaml as vehicles.

    Each starts at rest at its initial position, which is its goal too, since the file has no other;
    `dataclasses.replace(vehicle, goal=...)` gives it one. Limits and radius are not in the file.

    Raises:
        ScenarioError: the file cannot be read, is malformed, or enables no robot; the error's field
            names file and field.

    Examples:
        >>> text = "robots: {cf1: {enabled: true, initial_position: [0, 0.5, 0]}}"
        >>> _ = (folder / "crazyflies.yaml").write_text(text)
        >>> (vehicle,) = rho.load_crazyflies(folder / "crazyflies.yaml")
        >>> vehicle.name, vehicle.start.position.tolist()
        ('cf1', [0.0, 0.5, 0.0])
    """
    with in_file(Path(path)):
        content = yaml_content(text_of(Path(path), "crazyflies.yaml"))
        try:
            robots = _Robots.model_validate(content).robots
        except ValidationError as error:
            raise scenario_error(error, _Robots) from None
        found = {name: each.initial_position for name, each in robots.items() if each.enabled}
        if not found:
            expected = "at least one with enabled: true"
            raise ScenarioError("robots", Description("none"), expected)
        return tuple(Vehicle(name, State(at), State(at)) for name, at in found.items())


def is_crazyflies(path: str | Path) -> bool:
    """Return whether a file has robots at its top level, as no scenario; it may be malformed."""
    return _ROBOTS.search(text_or_none(path) or "") is not None
