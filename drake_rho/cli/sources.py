"""Reading of the scenarios and files that are arguments of commands."""

from __future__ import annotations

import os
import zipfile
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path

from drake_rho.formats.missions import is_mission, load_mission
from drake_rho.motion.documents import is_exported
from drake_rho.motion.files import PlanFileError, load
from drake_rho.motion.flown import Flown
from drake_rho.motion.tables import is_table
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.files import library, load_scenario
from drake_rho.scenario.problems.missions import is_lsc_mission, load_lsc_mission
from drake_rho.scenario.records import Grid, Scenario
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


def load_result(path: Path) -> Flown:
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


def read(
    source: str, duration: float | None, step: float | None, world: str | None = None
) -> Scenario:
    """Read a scenario by name, from a file, or from the file of a plan, flight or simulation.

    Options give a mission of the LSC planner its grid and world; one of a ground station has a grid
    unless they give one.

    Raises:
        PlanFileError: the file of a result cannot be read.
        ScenarioError: there is no such scenario, the scenario is invalid, or the step does not
            divide the duration.
        ValueError: an option of missions is missing for a mission, or given otherwise.
    """
    if is_mission(source):
        return _load_mission(source, duration, step, world)
    if not is_lsc_mission(source):
        given = load(source) if is_result(source) else _load_scenario(source)
        refuse_options(source, duration, step, world)
        return given if isinstance(given, Scenario) else given.scenario
    if duration is None or step is None:
        missing = "--step" if duration is not None else "--duration"
        expected = "--duration and --step: a mission has no grid of its own"
        raise ValueError(f"{source}: got no {missing}, expected {expected}")
    return load_lsc_mission(source, grid=Grid.lasting(duration, step=step), world=world)


def _load_mission(
    source: str, duration: float | None, step: float | None, world: str | None
) -> Scenario:
    """Load a mission of a ground station.

    Raises:
        ScenarioError: the mission cannot be read.
        ValueError: there is a world, or one option of a grid without the other.
    """
    if world is not None:
        refuse_options(source, None, None, world)
    if duration is None and step is None:
        return load_mission(source)
    if duration is None or step is None:
        missing = "--step" if duration is not None else "--duration"
        raise ValueError(f"{source}: got no {missing}, expected --duration and --step, or neither")
    return load_mission(source, grid=Grid.lasting(duration, step=step))


def read_or_load(
    source: str, duration: float | None, step: float | None, world: str | None
) -> Scenario | Flown:
    """Read a scenario, or load a plan, a flight or a simulation, which takes no mission options.

    Raises:
        PlanFileError: the file of a result cannot be read.
        ScenarioError: there is no such scenario, or it is invalid.
        ValueError: an option of missions is missing for a mission, or given otherwise.
    """
    if not is_result(source):
        return read(source, duration, step, world)
    flown = load(source)
    refuse_options(source, duration, step, world)
    return flown


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


def refuse_options(
    source: str, duration: float | None, step: float | None, world: str | None
) -> None:
    """Check that no mission option is given for a source with its own grid and obstacles.

    Raises:
        ValueError: an option of missions is given.
    """
    for option, value, own in (
        ("--duration", duration, "a grid"),
        ("--step", step, "a grid"),
        ("--world", world, "obstacles"),
    ):
        if value is not None:
            given = f"{value:g}" if isinstance(value, float) else repr(value)
            expected = f"a mission (.json) with it: {source} has {own} of its own"
            raise ValueError(f"{option}: got {given}, expected {expected}")
