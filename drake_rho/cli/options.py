"""The words of the command line: names of choices, and what a scenario argument can be."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from typing import Annotated

import typer

from drake_rho.planning.horizon.windows import Planner, free_reference, tail_reference
from drake_rho.planning.options import DEFAULTS, Options
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.progress import Progress
from drake_rho.scenario.files import library, load_scenario
from drake_rho.scenario.problems.missions import is_lsc_mission, load_lsc_mission
from drake_rho.scenario.records import Grid, Scenario


class Method(StrEnum):
    """Planners by their names on the command line."""

    AUTO = "auto"
    CONVEX = "convex"
    SCP = "scp"


class Solver(StrEnum):
    """Solvers by their names on the command line."""

    CLARABEL = "clarabel"
    OSQP = "osqp"
    DAQP = "daqp"


class Reference(StrEnum):
    """References of a window by their names on the command line."""

    FREE = "free"
    TAIL = "tail"


class FigureFormat(StrEnum):
    """Formats of figures by their endings."""

    PNG = "png"
    PDF = "pdf"
    SVG = "svg"


REFERENCES = {Reference.FREE: free_reference, Reference.TAIL: tail_reference}


def _completed(begun: str) -> list[str]:
    """Scenarios whose names begin so: those of the library; shells complete files themselves."""
    return [name for name in library() if name.startswith(begun)]


ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        autocompletion=_completed,
        help=f"A library scenario ({', '.join(library())}), a YAML file, or a mission of the LSC "
        "planner (.json), which needs --duration and --step.",
    ),
]
DurationOption = Annotated[
    float | None, typer.Option(help="Duration of the flight of a mission, in seconds.")
]
StepOption = Annotated[
    float | None, typer.Option(help="Step of the flight of a mission, in seconds.")
]
WorldOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Boxes that are in the way of a mission: a CSV without header, one box a row, its "
        "middle x, y, z and its sides x, y, z in metres.",
    ),
]
OutputOption = Annotated[
    str | None,
    typer.Option("--output", "-o", metavar="FILE", help="Keep the result in this file (.npz)."),
]
FiguresOption = Annotated[
    str | None,
    typer.Option(
        metavar="FOLDER", help="Folder for figures of the result, made if it is not there."
    ),
]
FormatOption = Annotated[
    FigureFormat | None, typer.Option("--format", help="Of the figures; png if not given.")
]
WidthOption = Annotated[
    float | None,
    typer.Option(
        "--width",
        metavar="INCHES",
        help="Of the figures, 3 to 20: 3.5 fits one column of a journal of the IEEE; if not given, "
        "7.16, both.",
    ),
]
ReplanEveryOption = Annotated[int, typer.Option(help="Steps flown of each window.")]
MethodOption = Annotated[
    Method,
    typer.Option(
        help="One linearisation of the obstacles (convex, the paper's), or iterated to convergence "
        "with ways round the obstacles where the first has no solution (scp), or what the Python "
        "functions do by themselves (auto): scp, and in a flight convex and, for windows in which "
        "that has no solution, scp."
    ),
]
TimeLimitOption = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="After this time the best plan or bound so far is the result; without one, the error "
        "says what was being done. Ctrl-C does the same at once.",
    ),
]
MaxMemoryOption = Annotated[
    float,
    typer.Option(
        metavar="BYTES",
        help="Memory that the search for ways round the obstacles may take, at least 1e7 (10 MB).",
    ),
]
SolverOption = Annotated[Solver, typer.Option(help="Solver of the quadratic programs.")]


def planners(
    method: Method, progress: Progress, options: Options = DEFAULTS
) -> tuple[Planner, Planner | None]:
    """What plans a window, and what does where that has no solution."""
    iterated = partial(best_plan, progress=progress, options=options)
    if method is Method.AUTO:
        return plan_convex, iterated
    return (plan_convex, None) if method is Method.CONVEX else (iterated, None)


def read(
    source: str, duration: float | None, step: float | None, world: str | None = None
) -> Scenario:
    """The scenario of a name or file; a mission's has the grid and the world that are asked for.

    Raises:
        ScenarioError: there is no such scenario, or it is not a valid one, or the step does not
            divide the duration.
        ValueError: an option is missing for a mission, or given for what is none.
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
    """See that no option of missions is given for what has its own grid and obstacles.

    Raises:
        ValueError: one is.
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
