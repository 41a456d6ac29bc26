"""The command `import`: missions and swarms of other programs as scenario files."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from drake_rho.cli.checks import check_writable, options_named
from drake_rho.cli.console import tell, working
from drake_rho.formats.crazyflies import is_crazyflies, load_crazyflies
from drake_rho.formats.lsc_missions import is_lsc_mission, load_lsc_mission
from drake_rho.formats.missions import is_mission, load_mission
from drake_rho.formats.texts import another_file, in_file, text_of
from drake_rho.formats.waypoint_tables import load_waypoints
from drake_rho.scenario.errors import Description, DrakeRhoWarning, ScenarioError
from drake_rho.scenario.files import save_scenario
from drake_rho.scenario.records import Grid, Limits, Scenario, State, Vehicle


@dataclasses.dataclass(frozen=True, kw_only=True)
class Imported:
    """Scenario that was imported."""

    scenario: str
    """name of the scenario"""
    content: str
    """kind of the files"""
    vehicles: int
    """number of vehicles"""
    waypoints: int
    """number of waypoints of all vehicles"""
    obstacles: int
    """number of obstacles"""
    requirements: int
    """number of requirements, as fences and speeds on legs"""
    duration_s: float
    """duration of the flight"""
    step_s: float
    """step of the grid"""
    notes: list[str]
    """warnings, such as of items that are left out, and what the files do not have"""
    file: str
    """path of the scenario's file"""


@dataclasses.dataclass(frozen=True)
class _Given:
    """Options of the command; None where one is not given."""

    duration: float | None
    step: float | None
    max_speed: float | None
    max_acceleration: float | None
    world: str | None

    def grid(self, file: Path, why: str, needed: str = "--duration and --step") -> Grid:
        """Return the grid.

        Args:
            file: the file that is imported.
            why: reason for which options are needed, for errors.
            needed: these options.

        Raises:
            ValueError: an option of it is missing.
            ScenarioError: there is no such grid.
        """
        for option, value in (("--duration", self.duration), ("--step", self.step)):
            if value is None:
                raise ValueError(f"{file}: got no {option}, expected {needed}: {why}")
        with options_named(duration="--duration", step="--step"):
            return Grid.lasting(self.duration or 0.0, step=self.step or 0.0)

    def limits(self, others: Limits) -> Limits:
        """Return the file's limits, overridden by the options.

        Raises:
            ValueError: an option is no limit.
        """
        names = {"max_speed": "--max-speed", "max_acceleration": "--max-acceleration"}
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        with options_named(**names):
            return dataclasses.replace(others, **given)


def _of_missions(files: Sequence[Path], given: _Given) -> Scenario:
    grid = None
    if given.duration is not None or given.step is not None:
        grid = given.grid(files[0], "the grid in place of the one that fits the mission")
    with warnings.catch_warnings(action="ignore"):  # they come again below
        limits = given.limits(load_mission(files).limits)
    return load_mission(files, limits=limits, grid=grid)


def _of_lsc_mission(files: Sequence[Path], given: _Given) -> Scenario:
    grid = given.grid(files[0], "a mission has no grid of its own")
    return load_lsc_mission(files[0], grid=grid, world=given.world)


def _of_robots(files: Sequence[Path], given: _Given) -> Scenario:
    grid, vehicles = given.grid(files[0], "robots have no grid"), load_crazyflies(files[0])
    with in_file(files[0]):
        return Scenario(files[0].stem, grid, vehicles, given.limits(Limits()))


def _of_table(files: Sequence[Path], given: _Given) -> Scenario:
    start, *waypoints = load_waypoints(files[0])
    if not waypoints:
        expected = "a start, waypoints if any, and a goal"
        raise ScenarioError(str(files[0]), Description("one row"), expected)
    *waypoints, goal = waypoints
    begin, needed = 0.0, {"why": "a table without times has no grid"}
    if start.time is not None and goal.time is not None:
        begin, lasting = start.time, goal.time - start.time
        if given.duration is not None:
            expected = f"none: the times of {files[0]} last {lasting:g} s"
            raise ValueError(f"--duration: got {given.duration:g}, expected {expected}")
        given = dataclasses.replace(given, duration=lasting)
        needed = {"why": "a table with times has no grid", "needed": "--step"}
    grid = dataclasses.replace(given.grid(files[0], **needed), start=begin)
    with in_file(files[0]):
        ends = State(start.position), State(goal.position)
        vehicle = Vehicle(files[0].stem, *ends, waypoints=waypoints)
        return Scenario(files[0].stem, grid, [vehicle], given.limits(Limits()))


@dataclasses.dataclass(frozen=True)
class _Kind:
    """Kind of file that is imported."""

    words: str
    """description in messages"""
    is_one: Callable[[Path], bool]
    """whether a file is of this kind, which may be malformed"""
    load: Callable[[Sequence[Path], _Given], Scenario]
    """function that makes the scenario"""
    options: set[str]
    """options that it takes, as fields of those given"""
    several: bool = False
    """whether several files make a scenario"""
    notes: tuple[str, ...] = ()
    """what a scenario lacks"""


def _is_table(path: Path) -> bool:
    """Return whether a file is a table by its name: tables have nothing else in common."""
    return path.suffix.lower() == ".csv"


_STAY = "the goals are the starts, so that vehicles stay: the file has no others"
_LIMITS = {"max_speed", "max_acceleration"}
_KINDS = (
    _Kind("a mission of QGroundControl or MAVLink", is_mission, _of_missions, _LIMITS, True),
    _Kind("a mission of the LSC planner", is_lsc_mission, _of_lsc_mission, {"world"}),
    _Kind("crazyflies.yaml of Crazyswarm2", is_crazyflies, _of_robots, _LIMITS, notes=(_STAY,)),
    _Kind("a table of waypoints (.csv)", _is_table, _of_table, _LIMITS),
)


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="A mission of QGroundControl (.plan) or MAVLink (.waypoints), or several, one for "
            "each vehicle; a mission of the LSC planner (.json); crazyflies.yaml of Crazyswarm2, "
            "whose enabled robots become vehicles; or a table of waypoints (.csv), from start to "
            "goal.",
        ),
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Required. File of the scenario (.yaml)."
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            help="Duration of the flight, in seconds; with --step, the time grid. Missions of "
            "QGroundControl and MAVLink have a grid and times of waypoints without it, tables with "
            "times a duration; all others need both."
        ),
    ] = None,
    step: Annotated[float | None, typer.Option(help="Step of the grid, in seconds.")] = None,
    max_speed: Annotated[
        float | None,
        typer.Option(
            help="Speed limit, in m/s. Without it, missions of QGroundControl and MAVLink have the "
            "file's, else 5 m/s; robots and tables have none."
        ),
    ] = None,
    max_acceleration: Annotated[
        float | None,
        typer.Option(
            help="Acceleration limit, in m/s²; 2.5 by default for missions of QGroundControl and "
            "MAVLink."
        ),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Obstacles of a mission of the LSC planner: an OctoMap (.bt or .ot), whose "
            "unknown cells are free; or a CSV file without header, one box per row, its centre "
            "x, y, z and its side lengths x, y, z in metres.",
        ),
    ] = None,
) -> int:
    """Write missions or robots of other programs as a scenario file."""
    if output is None:
        raise ValueError("import: got no --output, expected --output FILE, a scenario (.yaml)")
    check_writable(output, (".yaml", ".yml"), "--output")
    kind = _kind_of(files)
    given = _Given(duration, step, max_speed, max_acceleration, world)
    _check_options(files[0], kind, given)
    with working("reading"), _recorded() as told:
        scenario = kind.load(files, given)
    save_scenario(scenario, output)
    notes = [*(str(each.message) for each in told), *kind.notes]
    if scenario.separation is None and len(scenario.vehicles) > 1:
        notes.append("vehicles do not avoid each other: the scenario has no separation")
    document = Imported(
        scenario=scenario.name,
        content=kind.words,
        vehicles=len(scenario.vehicles),
        waypoints=sum(len(each.waypoints) for each in scenario.vehicles),
        obstacles=len(scenario.obstacles),
        requirements=len(scenario.requirements),
        duration_s=scenario.grid.duration,
        step_s=scenario.grid.step,
        notes=notes,
        file=output,
    )
    return tell(document, str(scenario), *(f"note: {each}" for each in notes), f"saved to {output}")


def _kind_of(files: Sequence[Path]) -> _Kind:
    """Return the kind of files, which is the same for all.

    Raises:
        ScenarioError: a file cannot be read, or is of no kind that is imported.
        ValueError: files of different kinds, or of a kind that has one file, are given.
    """
    kinds = list[_Kind]()
    for file in files:
        words = ", or ".join(each.words for each in _KINDS)
        with in_file(file):
            text = text_of(file, f"file: {words}")
            kind = next((each for each in _KINDS if each.is_one(file)), None)
            if kind is None:
                raise ScenarioError("", another_file(text), words)
        kinds.append(kind)
        if kind is not kinds[0]:
            raise ValueError(f"{file}: got {kind.words}, expected {kinds[0].words} as {files[0]}")
    if len(files) > 1 and not kinds[0].several:
        raise ValueError(f"import: got {len(files)} files, expected one with {kinds[0].words}")
    return kinds[0]


def _check_options(file: Path, kind: _Kind, given: _Given) -> None:
    """Check that a kind of file takes the options that are given.

    Raises:
        ValueError: it does not take one of them.
    """
    for name in sorted({"world", *_LIMITS} - kind.options):
        if (value := getattr(given, name)) is not None:
            option = "--" + name.replace("_", "-")
            raise ValueError(f"{option}: got {value}, expected none with {file}, {kind.words}")


def _recorded() -> warnings.catch_warnings[list[warnings.WarningMessage]]:
    """Return a context that records all warnings of the package."""
    return warnings.catch_warnings(record=True, action="always", category=DrakeRhoWarning)
