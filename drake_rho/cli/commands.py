"""List of all commands, and the commands `show`, `schema` and `reproduce`."""

from __future__ import annotations

import json
import logging
import sys
import webbrowser
from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import typer
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

from drake_rho.cli.app import app_of
from drake_rho.cli.assign import assign
from drake_rho.cli.campaigns import campaign, results
from drake_rho.cli.checks import (
    check_film_option,
    check_interface,
    check_outputs,
    check_rate,
    check_writable,
    drawing_in,
)
from drake_rho.cli.console import (
    Work,
    answer,
    bar,
    on_interrupt,
    output_mode,
    remark,
    tell,
    warnings_as_lines,
    working,
    write,
)
from drake_rho.cli.documents import content_of
from drake_rho.cli.export import export, formats
from drake_rho.cli.failures import status_of
from drake_rho.cli.headings import HeadingOption, heading_of
from drake_rho.cli.imports import import_
from drake_rho.cli.maps import map as map_
from drake_rho.cli.options import (
    FormatOption,
    MaxAccelerationOption,
    TopicOption,
    TrajectoriesOption,
    WidthOption,
)
from drake_rho.cli.planning import fastest, fly, plan
from drake_rho.cli.simulation import simulate
from drake_rho.cli.sources import load_any, read_or_load
from drake_rho.cli.storyboard import storyboard
from drake_rho.cli.streams import pipe_safe
from drake_rho.cli.study_tables import claims_table, study_table
from drake_rho.cli.verification import certify, diagnose, verify
from drake_rho.motion.flown import Flown, Planned
from drake_rho.paper.study import REPEATS, run_study
from drake_rho.planning.call.options import Options
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.horizon.plan_rho import plan_rho
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.scenario.files import scenario_schema
from drake_rho.scenario.records import Scenario
from drake_rho.system.files import atomic_write

_PREVIEW = 5.0
"""Time limit of planning for the conflicts that a preview marks [s]."""


def reproduce(
    figures: Annotated[
        str, typer.Option(metavar="FOLDER", help="Folder for the sixteen figures.")
    ] = "figures",
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Run the paper's examples, draw its figures and check its claims."""
    # importing matplotlib takes longer than most other commands
    from drake_rho.paper.figures import NUMBERS, write_paper_figures

    drawing = drawing_in(figures, file_format, width)
    check_outputs(None, drawing)
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with bar(*columns) as progress:
        task = progress.add_task("planning", total=4 * REPEATS + len(NUMBERS))

        def advance(done: str) -> None:
            progress.update(task, advance=1, description=done)

        study = run_study(advance)
        drawn = write_paper_figures(
            study, figures, advance, file_format=drawing.file_format, width=drawing.width
        )
    written = f"{len(drawn)} figures in {figures}"
    least = [float(np.min(study.clearances_at_all_times(each))) for each in study.examples]
    examples = [
        {**content_of(each), "clearance_m": clearance}
        for each, clearance in zip(study.examples, least, strict=True)
    ]
    document = {"examples": examples, "claims": study.claims, "figures": drawn}
    status = 0 if all(each.report.ok for each in study.examples) else 1
    tables = study_table(study), "", claims_table(study)
    return tell(document, *tables, written, status=status)


def schema() -> int:
    """Print the JSON schema of scenario files."""
    write(json.dumps(scenario_schema(), indent=2, ensure_ascii=False))
    return 0


def show(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|FILE",
            help="A scenario, which is planned first, or a file with a plan, flight or simulation.",
        ),
    ],
    html: Annotated[
        str | None,
        typer.Option(
            metavar="FILE", help="Write one self-contained page to this file (.html); do not serve."
        ),
    ] = None,
    film: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Write a film to this file (.mp4, which needs ffmpeg, or .gif); do not serve. It "
            "lasts up to 20 s unless --rate is given.",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="WIDTHxHEIGHT",
            help="Size of the film in pixels, as 1920x1080 or, for a phone, 720x1280; 1280x720 "
            "by default, and 840x472 for a .gif.",
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Network interface to serve on; '*' for all interfaces.")
    ] = "localhost",
    port: Annotated[
        int,
        typer.Option(
            min=1024, max=65535, help="Port to serve on; if it is in use, the next free one."
        ),
    ] = 7000,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    rate: Annotated[
        float | None, typer.Option(help="Seconds of flight per second of playback, 0.01 to 1000.")
    ] = None,
    trails: Annotated[
        bool | None, typer.Option(help="Draw trails; by default for up to 100 vehicles.")
    ] = None,
    before: Annotated[
        bool,
        typer.Option(
            "--before",
            help="Show the scenario before it is planned: starts, goals, obstacles, waypoints and "
            "straight lines, with conflicts in red.",
        ),
    ] = False,
    heading: HeadingOption = None,
    scenario: TrajectoriesOption = None,
    max_acceleration: MaxAccelerationOption = None,
    topic: TopicOption = None,
) -> int:
    """Show a scenario or result in the browser, or write a page or film.

    The page is served until the command is interrupted with Ctrl-C.
    """
    from drake_rho.display.viewer.page import viewer_page

    check_writable(html, (".html", ".htm"), "--html")
    check_film_option(film, size)
    check_interface(host)
    check_rate(rate)
    turned = heading_of(heading)
    conflicts = None
    given: Flown | Scenario
    flown: Flown | Scenario
    with working("planning") as work:
        if scenario is None and max_acceleration is None and topic is None:
            given = read_or_load(source)
        else:
            given = load_any(Path(source), scenario, max_acceleration, topic)
        if before:
            flown = given if isinstance(given, Scenario) else given.scenario
            conflicts = _conflicts_of(flown, work)
        else:
            flown = _planned(given, work) if isinstance(given, Scenario) else given
    if conflicts is not None:
        remark(str(conflicts))
    with working("drawing"):
        page = viewer_page(flown, conflicts=conflicts, rate=rate, trails=trails, heading=turned)
    if html is None and film is None:
        return _serve(page, host, port, browser=browser)
    written = []
    if html is not None:
        with atomic_write(html) as file:
            file.write(page.encode())
        written.append(f"one page in {html}")
    if film is not None:
        grid = (flown if isinstance(flown, Scenario) else flown.scenario).grid
        _film(page, film, size, grid.duration, rate)
        written.append(f"a film in {film}")
    return tell({"page": html, "film": film, "url": None}, *written)


def _serve(page: str, host: str, port: int, *, browser: bool) -> int:
    """Serve a page until Ctrl-C or a request to terminate."""
    from drake_rho.display.viewer.serve import serve

    server = serve(page, host=host, port=port)
    wait_for_interrupt = on_interrupt()
    document = {"page": None, "film": None, "url": server.url}
    answer(document, f"{server.url}  (Ctrl-C stops)")
    sys.stdout.flush()
    if browser and not webbrowser.open(server.url):
        remark("no browser found on this machine: open the address in a browser")
    wait_for_interrupt()
    server.close()
    remark("stopped")
    return 0


def _film(page: str, path: str, size: str | None, duration: float, rate: float | None) -> None:
    """Write a film of a page with a progress display."""
    from drake_rho.display.viewer.film import Footage, size_of, write_film

    pixels = None if size is None else size_of(size)
    footage = Footage.of(duration, Path(path).suffix.lower(), rate)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    with bar(*columns, TimeElapsedColumn()) as progress:
        task = progress.add_task("filming", total=len(footage.times))
        write_film(page, path, footage, size=pixels, progress=lambda: progress.advance(task))


def _conflicts_of(scenario: Scenario, work: Work) -> InfeasibleError | None:
    """Return the error of an infeasible scenario; None if there is a plan or time is over."""
    try:
        best_plan(scenario, progress=work, options=Options(time_limit=_PREVIEW))
    except InfeasibleError as error:
        return error
    except (OutOfTimeError, SolverError):
        return None
    return None


def _planned(scenario: Scenario, work: Work) -> Planned:
    """Fly a scenario; with a separation, plan it instead."""
    if scenario.separation is not None:  # planning ten windows of sixty vehicles takes long
        return best_plan(scenario, progress=work)
    return plan_rho(scenario, progress=work)


GROUPS = {
    "Plan and fly": (plan, fastest, fly, simulate, assign, storyboard),
    "Verify and explain": (verify, certify, diagnose),
    "Import, show and export": (import_, show, map_, export),
    "Run campaigns": (campaign, results),
    "Reference": (formats, schema, reproduce),
}
"""Commands by group, in the order in which they are listed."""

app = app_of(GROUPS)


def main() -> NoReturn:
    """Run the command line and exit with its status."""
    logging.getLogger("drake").setLevel(logging.WARNING)  # hides informational output of solvers
    sys.stdout, sys.stderr = pipe_safe(sys.stdout), pipe_safe(sys.stderr)
    with output_mode.of(sys.argv[1:]), warnings_as_lines():
        sys.exit(status_of(lambda: app(standalone_mode=False)))
