"""Arguments and options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from drake_rho.scenario.files import library


class Method(StrEnum):
    """Planners, by their names on the command line."""

    AUTO = "auto"
    CONVEX = "convex"
    SCP = "scp"


class Solver(StrEnum):
    """Solvers, by their names on the command line."""

    CLARABEL = "clarabel"
    OSQP = "osqp"
    DAQP = "daqp"


class Arrival(StrEnum):
    """Arrivals of several vehicles."""

    TOGETHER = "together"
    EACH = "each"


class FigureFormat(StrEnum):
    """Formats of figures, by their file endings."""

    PNG = "png"
    PDF = "pdf"
    SVG = "svg"


def _completed(beginning: str) -> list[str]:
    """List library scenarios with this beginning; shells complete file names themselves."""
    return [name for name in library() if name.startswith(beginning)]


ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|FILE",
        autocompletion=_completed,
        help=f"A library scenario ({', '.join(library())}), a YAML file, a file saved by 'plan', "
        "'fly' or 'simulate', whose scenario is taken, or a mission of QGroundControl (.plan) or "
        "MAVLink (.waypoints), flown at up to the file's speed, else 5 m/s, and 2.5 m/s². 'import' "
        "writes other missions as YAML files.",
    ),
]
ResultArgument = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="A file (.npz) saved by 'plan', 'fly' or 'simulate', or a plan exported as JSON; with "
        "--scenario trajectories of another program.",
    ),
]
TrajectoriesOption = Annotated[
    str | None,
    typer.Option(
        "--scenario",
        metavar="SCENARIO|FILE",
        help="Scenario for trajectories of another program: FILE is then a CSV table of positions, "
        "polynomials of Crazyswarm, a show of Skybrush (.skyc), or a log of ROS 2 or PX4: a file, "
        "or a folder or an archive (.zip) of them.",
    ),
]
MaxAccelerationOption = Annotated[
    float | None,
    typer.Option(
        metavar="M/S2", help="For samples: bound on the acceleration between them, in m/s²."
    ),
]
TopicOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="VEHICLE=TOPIC",
        help="For logs of ROS 2, repeatable: topic or child frame of a vehicle.",
    ),
]
OutputOption = Annotated[
    str | None,
    typer.Option("--output", "-o", metavar="FILE", help="Save the result to this file (.npz)."),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=1024,
        help="Number of worker processes on this machine; by default the process of the command "
        "works alone.",
    ),
]
FiguresOption = Annotated[
    str | None,
    typer.Option(
        metavar="FOLDER", help="Folder for figures of the result, created if it does not exist."
    ),
]
FormatOption = Annotated[
    FigureFormat | None, typer.Option("--format", help="Format of the figures; png by default.")
]
WidthOption = Annotated[
    float | None,
    typer.Option(
        "--width",
        metavar="INCHES",
        help="Width of the figures, 3 to 20 inches; by default 7.16, the width of two columns of "
        "an IEEE journal. One column is 3.5.",
    ),
]
MethodOption = Annotated[
    Method,
    typer.Option(
        help="convex: one linearisation of the obstacles, as in the paper. scp: linearisations "
        "iterated to convergence, from paths around the obstacles if the first has no solution. "
        "auto: scp for a plan; for the windows of a flight convex, and scp if that has no solution."
    ),
]
TimeLimitOption = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Time limit. The result is the best plan or bound found by then; if there is none, "
        "the error names the step that was running. Ctrl-C does the same at once.",
    ),
]
MaxMemoryOption = Annotated[
    float,
    typer.Option(
        metavar="BYTES",
        help="Memory limit of the search for paths around obstacles, at least 1e7 (10 MB).",
    ),
]
SolverOption = Annotated[Solver, typer.Option(help="Solver of the quadratic programs.")]
