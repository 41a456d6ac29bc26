"""`load_lsc_mission`: missions of the LSC planner as scenarios."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from drake_rho.formats.lsc import Mission, Quadrotor, parse_mission, parse_world
from drake_rho.formats.texts import in_file, text_of, text_or_none
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.maps.octomaps import ENDINGS as OCTOMAPS
from drake_rho.scenario.records import (
    Box,
    Grid,
    Limits,
    Scenario,
    Separation,
    State,
    Vehicle,
    Voxels,
)


@checked
def load_lsc_mission(path: str | Path, *, grid: Grid, world: str | Path | None = None) -> Scenario:
    """Read a mission of the LSC planner; `drake_rho.formats.lsc` describes the formats.

    Vehicles are named by type and number, such as `crazyflie-1`, and have their own limits where
    their types differ. The separation is that of the LSC planner: two radii, and `downwash` times
    as much vertically. Where agents differ in these, it is twice the largest horizontal and
    vertical extent of any agent, which is safe, but more than that planner requires of smaller
    agents. Obstacles are the boxes of the world, numbered like its rows, or its map, followed by
    those of the mission. Every vehicle's least distance from obstacles is the radius of its type.

    Args:
        path: of the JSON file.
        grid: knots and step, which a mission does not have.
        world: path of a CSV file without header, with one box per row: its centre x, y, z and its
            sides x, y, z [m]; or of an OctoMap (.bt or .ot), in which unknown cells are free, as
            they are for that planner. Only the mission's own obstacles if not given.

    Raises:
        ScenarioError: a file cannot be read, is malformed, or contains something that a scenario
            cannot represent. The error's field is that of the file, such as
            `m.json: agents[3].start` or `w.csv: line 3`.
    """
    path = Path(path)
    obstacles = () if world is None else _obstacles(Path(world))
    name = path.stem if world is None else f"{path.stem} in {Path(world).stem}"
    with in_file(path):
        return _scenario(name, grid, parse_mission(text_of(path, "JSON file")), obstacles)


def is_lsc_mission(path: str | Path) -> bool:
    """Return whether a file is JSON with agents, which no scenario has; it may be malformed."""
    text = (text_or_none(path) or "").lstrip()
    return text.startswith("{") and _AGENTS.search(text) is not None


_AGENTS = re.compile(r'"agents"\s*:')
_OF_A_SCENARIO = re.compile(r"^scenario\.vehicles\[(\d+)\]\.(start|goal)\.position$")


def _obstacles(path: Path) -> tuple[Box | Voxels, ...]:
    """Return the boxes of a CSV file, or an OctoMap."""
    if path.suffix.lower() in OCTOMAPS:
        return (Voxels.from_octomap(path, unknown="free"),)
    with in_file(path):
        return parse_world(text_of(path, "CSV file"))


def _scenario(name: str, grid: Grid, mission: Mission, world: tuple[Box | Voxels, ...]) -> Scenario:
    kinds = [mission.quadrotors[agent.type] for agent in mission.agents]
    alike = all(kind.limits == kinds[0].limits for kind in kinds)
    vehicles = tuple(
        Vehicle(
            f"{agent.type}-{number}",
            State(agent.start),
            State(agent.goal),
            None if alike else kind.limits,
            kind.radius,
        )
        for agent, number, kind in zip(mission.agents, mission.numbers, kinds, strict=True)
    )
    low, high = mission.world[0].dimension[:3], mission.world[0].dimension[3:]
    limits = dataclasses.replace(kinds[0].limits if alike else Limits(), position=Box(low, high))
    obstacles = (*world, *(obstacle.box for obstacle in mission.obstacles))
    try:
        return Scenario(name, grid, vehicles, limits, obstacles, _separation(mission, kinds))
    except ScenarioError as error:
        field = _OF_A_SCENARIO.sub(r"agents[\1].\2", error.field)
        raise ScenarioError(field, error.value, error.expected) from None


def _separation(mission: Mission, kinds: list[Quadrotor]) -> Separation:
    """Return a separation that contains every pair's, and equals it if agents are alike."""
    horizontal = max(kind.radius for kind in kinds)
    vertical = max(
        kind.radius * (kind.downwash if agent.downwash is None else agent.downwash)
        for agent, kind in zip(mission.agents, kinds, strict=True)
    )
    return Separation(2.0 * horizontal, vertical / horizontal)
