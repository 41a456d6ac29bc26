"""Missions of other planners as scenarios."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from drake_rho.scenario.errors import ScenarioError, Words
from drake_rho.scenario.lsc import Mission, Quadrotor, parse_mission
from drake_rho.scenario.records import (
    Box,
    Grid,
    Limits,
    Scenario,
    Separation,
    State,
    Vehicle,
)


def load_lsc_mission(path: str | Path, *, grid: Grid) -> Scenario:
    """Read a mission of the LSC planner (`drake_rho.scenario.lsc` tells the format).

    Vehicles are called by type and number, as `crazyflie-1`, and have limits of their own where
    their types differ. The separation is that of the LSC planner: two radii, and `downwash` times
    as much above each other. Where agents differ in these it is twice the largest extent beside
    and above an agent, which is safe, and for the smaller ones more than that planner asks.

    Args:
        path: of the JSON file.
        grid: knots and step, which a mission does not have.

    Raises:
        ScenarioError: the file cannot be read, is malformed, or asks for what a scenario cannot
            hold; the field is that of the file, as `m.json: agents[3].start`.
    """
    path = Path(path)
    try:
        return _scenario(path.stem, grid, parse_mission(_read(path)))
    except ScenarioError as error:
        field = _OF_THE_FILE.sub(r"agents[\1].\2", error.field)
        where = f"{path}: {field}" if field else str(path)
        raise ScenarioError(where, error.value, error.expected) from None


def is_lsc_mission(path: str | Path) -> bool:
    """Whether a file ends in `.json` and has agents, which no scenario has; it may be malformed."""
    path = Path(path)
    if path.suffix.lower() != ".json":
        return False
    try:
        return re.search(r'"agents"\s*:', _read(path)) is not None
    except ScenarioError:
        return False


_OF_THE_FILE = re.compile(r"^scenario\.vehicles\[(\d+)\]\.(start|goal)\.position$")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a UTF-8 text file"
        raise ScenarioError("", Words("no text"), f"a readable JSON file; {reason}") from None


def _scenario(name: str, grid: Grid, mission: Mission) -> Scenario:
    kinds = [mission.quadrotors[agent.type] for agent in mission.agents]
    alike = all(kind.limits == kinds[0].limits for kind in kinds)
    vehicles = tuple(
        Vehicle(
            f"{agent.type}-{number}",
            State(agent.start),
            State(agent.goal),
            None if alike else kind.limits,
        )
        for agent, number, kind in zip(mission.agents, mission.numbers, kinds, strict=True)
    )
    low, high = mission.world[0].dimension[:3], mission.world[0].dimension[3:]
    limits = dataclasses.replace(kinds[0].limits if alike else Limits(), position=Box(low, high))
    return Scenario(name, grid, vehicles, limits, separation=_separation(mission, kinds))


def _separation(mission: Mission, kinds: list[Quadrotor]) -> Separation:
    """An ellipsoid that holds those of all pairs, theirs if all agents are alike."""
    beside = max(kind.radius for kind in kinds)
    above = max(
        kind.radius * (kind.downwash if agent.downwash is None else agent.downwash)
        for agent, kind in zip(mission.agents, kinds, strict=True)
    )
    return Separation(2.0 * beside, above / beside)
