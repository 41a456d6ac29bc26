"""Reading of the scenarios and files that are arguments of commands."""

from __future__ import annotations

import os
import zipfile
from contextlib import suppress
from difflib import get_close_matches
from functools import partial
from pathlib import Path

from drake_rho.cli.checks import options_named
from drake_rho.formats.crazyflies import is_crazyflies
from drake_rho.formats.load import holds_trajectories, load_trajectories
from drake_rho.formats.lsc_missions import is_lsc_mission
from drake_rho.formats.missions import is_mission, load_mission
from drake_rho.formats.waypoint_tables import load_waypoints
from drake_rho.motion.documents import is_exported
from drake_rho.motion.files import PlanFileError, load
from drake_rho.motion.flown import Flown, Planned
from drake_rho.motion.tables import is_table
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.files import library, load_scenario
from drake_rho.scenario.records import Scenario
from drake_rho.system.files import opened, read_text

_YAML = (".yaml", ".yml")
_RESULT_FILES = "a file saved by plan, fly or simulate (.npz), or a plan exported as JSON (.json)"


def is_result(source: str) -> bool:
    """Return whether a file holds a plan, a flight or a simulation."""
    if source.endswith(".npz"):
        return True
    with suppress(OSError, ValueError), opened(source) as file:
        return zipfile.is_zipfile(file) or is_exported(read_text(source))
    return False


def load_result(path: Path) -> Planned:
    """Load a plan, flight or simulation from a file.

    Raises:
        PlanFileError: the file cannot be read, or is of another kind.
    """
    try:
        return load(path)
    except PlanFileError:
        is_states = False
        with suppress(OSError, ValueError):
            is_states = is_table(read_text(path))
        if is_states:
            got = "a table of states (CSV), which has no scenario"
            raise PlanFileError(f"{path}: got {got}, expected {_RESULT_FILES}") from None
        raise


def load_any(
    file: Path, scenario: str | None, max_acceleration: float | None, topic: list[str] | None
) -> Flown:
    """Load a plan, flight or simulation, or trajectories if their scenario is given.

    Raises:
        PlanFileError: the file cannot be read, is of another kind, or lacks its scenario.
        ValueError: a bound on the acceleration is missing for samples, or an option of trajectories
            is given otherwise.
    """
    if scenario is not None:
        topics = dict(_vehicle_and_topic(each) for each in topic) if topic else None
        problem = read(scenario)
        with options_named(max_acceleration="--max-acceleration", topics="--topic"):
            return load_trajectories(
                file, problem, max_acceleration=max_acceleration, topics=topics
            )
    if max_acceleration is not None or topic:
        option = "--topic" if topic else "--max-acceleration"
        raise ValueError(f"{option}: got no --scenario, expected that of samples")
    try:
        return load_result(file)
    except PlanFileError:
        if not holds_trajectories(file):
            raise
    got = "trajectories without their scenario"
    raise PlanFileError(f"{file}: got {got}, expected it too: --scenario FILE")


def _vehicle_and_topic(text: str) -> tuple[str, str]:
    """Return the parts of VEHICLE=TOPIC.

    Raises:
        ValueError: one of them is missing.
    """
    vehicle, _, topic = text.rpartition("=")
    if not vehicle or not topic:
        raise ValueError(f"--topic: got {text!r}, expected VEHICLE=TOPIC")
    return vehicle, topic


def read(source: str) -> Scenario:
    """Read a scenario by name, or from the file of a scenario, a result or a mission.

    Raises:
        PlanFileError: the file of a result cannot be read.
        ScenarioError: there is no such scenario, or it is invalid.
        ValueError: the file has to be imported first, since it lacks part of a scenario.
    """
    given = read_or_load(source)
    return given if isinstance(given, Scenario) else given.scenario


def read_or_load(source: str) -> Scenario | Planned:
    """Read a scenario or a mission, or load a plan, a flight or a simulation.

    Raises:
        PlanFileError: the file of a result cannot be read.
        ScenarioError: there is no such scenario, or it is invalid.
        ValueError: the file has to be imported first, since it lacks part of a scenario.
    """
    if is_result(source):
        return load(source)
    if is_mission(source):
        return load_mission(source)
    _refuse_imported(source)
    return _load_scenario(source)


def _refuse_imported(source: str) -> None:
    """Refuse files that have no time grid.

    Raises:
        ValueError: the file is one of them; the message has the command that imports it.
    """
    for words, is_one, options in (
        ("a mission of the LSC planner", is_lsc_mission, "--duration S --step S [--world FILE]"),
        ("robots of Crazyswarm2", is_crazyflies, "--duration S --step S"),
        ("a table of waypoints", partial(_is_waypoints, timed=False), "--duration S --step S"),
        ("a table of waypoints with times", partial(_is_waypoints, timed=True), "--step S"),
    ):
        if is_one(source):
            command = f"drake-rho import {source} {options} -o scenario.yaml"
            raise ValueError(f"{source}: got {words}, expected a scenario: {command}")


def _is_waypoints(source: str, *, timed: bool) -> bool:
    """Return whether a file is a table of waypoints, with times or without them."""
    if not source.lower().endswith(".csv"):
        return False
    with suppress(ScenarioError):
        return all((each.time is not None) == timed for each in load_waypoints(source))
    return False


def _load_scenario(source: str) -> Scenario:
    """Load a scenario; if there is none of this name, suggest the nearest name.

    Raises:
        ScenarioError: there is no such scenario, or it is invalid.
    """
    try:
        return load_scenario(source)
    except ScenarioError as error:
        refuse_empty_file(source, error, "scenario", "drake-rho schema")
        nearest = _nearest_name(source)
        if nearest is None or os.path.lexists(source):
            raise
        expected = f"{error.expected}; did you mean {nearest!r}?"
        raise ScenarioError(error.field, error.value, expected) from None


def refuse_empty_file(path: str, error: ScenarioError, kind: str, schema: str) -> None:
    """Raise a clearer error if the cause of `error` is an empty YAML file.

    Args:
        path: path of the file.
        error: the error of loading it.
        kind: kind of the expected content.
        schema: command that prints the fields of that kind.

    Raises:
        ScenarioError: the file holds no value: it is empty or has comments only.
    """
    if error.value is None and error.field in (path, str(Path(path))):
        expected = f"a {kind} in YAML; '{schema}' prints its fields"
        raise ScenarioError(error.field, Description("an empty file"), expected) from None


def _nearest_name(source: str) -> str | None:
    """Return the library scenario or neighbouring YAML file with the most similar name, if any."""
    with suppress(OSError):  # the folder does not exist or cannot be read
        files = [str(each) for each in Path(source).parent.iterdir() if each.suffix in _YAML]
        return next(iter(get_close_matches(source, [*library(), *files], n=1)), None)
    return next(iter(get_close_matches(source, library(), n=1)), None)
