"""Conversion of other planners' missions to scenarios."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.octomaps import ENDINGS as OCTOMAPS
from drake_rho.scenario.problems.lsc import Mission, Quadrotor, parse_mission, parse_world
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
from drake_rho.system.files import read_text, reason_of


@checked
def load_lsc_mission(path: str | Path, *, grid: Grid, world: str | Path | None = None) -> Scenario:
    """Read a mission of the LSC planner; `drake_rho.scenario.problems.lsc` describes the formats.

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
    try:
        return _scenario(name, grid, parse_mission(_read(path, "JSON")), obstacles)
    except ScenarioError as error:
        raise _in_file(path, error) from None


def is_lsc_mission(path: str | Path) -> bool:
    """Return whether a file ends in `.json` and has agents, which no scenario has.

    The file may be malformed in other respects.
    """
    path = Path(path)
    if path.suffix.lower() != ".json":
        return False
    try:
        return re.search(r'"agents"\s*:', _read(path, "JSON")) is not None
    except ScenarioError:
        return False


_OF_THE_FILE = re.compile(r"^scenario\.vehicles\[(\d+)\]\.(start|goal)\.position$")


def _obstacles(path: Path) -> tuple[Box | Voxels, ...]:
    """Return the boxes of a CSV file, or an OctoMap."""
    if path.suffix.lower() in OCTOMAPS:
        return (Voxels.from_octomap(path, unknown="free"),)
    try:
        return parse_world(_read(path, "CSV"))
    except ScenarioError as error:
        raise _in_file(path, error) from None


def _in_file(path: Path, error: ScenarioError) -> ScenarioError:
    """Return the error with the file's name and its field in place of the scenario's field."""
    field = _OF_THE_FILE.sub(r"agents[\1].\2", error.field)
    return ScenarioError(f"{path}: {field}" if field else str(path), error.value, error.expected)


def _read(path: Path, kind: str) -> str:
    try:
        return read_text(path)
    except (OSError, ValueError) as error:
        expected = f"a readable {kind} file; {reason_of(error)}"
        raise ScenarioError("", Description("no text"), expected) from None


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
    return Scenario(name, grid, vehicles, limits, obstacles, _separation(mission, kinds))


def _separation(mission: Mission, kinds: list[Quadrotor]) -> Separation:
    """Return a separation that contains every pair's, and equals it if agents are alike."""
    horizontal = max(kind.radius for kind in kinds)
    vertical = max(
        kind.radius * (kind.downwash if agent.downwash is None else agent.downwash)
        for agent, kind in zip(mission.agents, kinds, strict=True)
    )
    return Separation(2.0 * horizontal, vertical / horizontal)
