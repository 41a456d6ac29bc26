"""Reading of the scenarios and files that are arguments of commands."""

from __future__ import annotations

from pathlib import Path

from drake_rho.display.common.drawable import Flown
from drake_rho.motion.files import PlanFileError, load
from drake_rho.motion.tables import is_table
from drake_rho.scenario.files import load_scenario
from drake_rho.scenario.problems.missions import is_lsc_mission, load_lsc_mission
from drake_rho.scenario.records import Grid, Scenario

_RESULT_FILES = "a file saved by plan, fly or simulate (.npz), or a plan exported as JSON (.json)"


def load_result(path: Path) -> Flown:
    """Load a plan, flight or simulation from a file.

    Raises:
        PlanFileError: the file cannot be read, or is of another kind.
    """
    try:
        return load(path)
    except PlanFileError as error:
        if path.is_file() and is_table(path.read_text(encoding="utf-8-sig", errors="replace")):
            got = "a table of states (CSV), which has no scenario"
            raise PlanFileError(f"{path}: got {got}, expected {_RESULT_FILES}") from None
        raise error from None


def read(
    source: str, duration: float | None, step: float | None, world: str | None = None
) -> Scenario:
    """Read the scenario of a name or file; a mission gets the grid and the world of the options.

    Raises:
        ScenarioError: there is no such scenario, the scenario is invalid, or the step does not
            divide the duration.
        ValueError: an option of missions is missing for a mission, or given for a scenario.
    """
    if not is_lsc_mission(source):
        scenario = load_scenario(source)
        refuse_options(source, duration, step, world)
        return scenario
    if duration is None or step is None:
        missing = "--step" if duration is not None else "--duration"
        expected = "--duration and --step: a mission has no grid of its own"
        raise ValueError(f"{source}: got no {missing}, expected {expected}")
    return load_lsc_mission(source, grid=Grid.lasting(duration, step=step), world=world)


def refuse_options(
    source: str, duration: float | None, step: float | None, world: str | None
) -> None:
    """Check that no option of missions is given for a source with a grid and obstacles of its own.

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
