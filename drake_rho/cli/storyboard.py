"""The command `storyboard`: a whole show, from the take-off to the landing."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from drake_rho.cli.campaigns import worker_pool
from drake_rho.cli.checks import check_outputs, requested_drawing
from drake_rho.cli.console import answer, stopping_early, working, write
from drake_rho.cli.options import (
    FiguresOption,
    FormatOption,
    OutputOption,
    Solver,
    SolverOption,
    TimeLimitOption,
    WidthOption,
    WorkersOption,
)
from drake_rho.cli.reports import finish
from drake_rho.cli.sources import refuse_empty_file
from drake_rho.planning.call.options import Options
from drake_rho.planning.programs.backend import SOLVERS
from drake_rho.scenario.errors import ScenarioError


def storyboard(
    show: Annotated[
        str | None, typer.Argument(metavar="SHOW", help="A show (YAML file); see --example.")
    ] = None,
    output: OutputOption = None,
    solver: SolverOption = Solver.CLARABEL,
    workers: WorkersOption = None,
    time_limit: TimeLimitOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
    example: Annotated[
        bool, typer.Option("--example", help="Print a complete show and exit.")
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of shows and exit.")
    ] = False,
) -> int:
    """Plan a show, from pads through formations and back, and verify it.

    Workers plan transitions side by side, with --solver daqp only.
    """
    from drake_rho.shows.certificate import certify_show
    from drake_rho.shows.plan_show import plan_show
    from drake_rho.shows.show import example_show, load_show, show_schema

    if schema:
        write(json.dumps(show_schema(), indent=2, ensure_ascii=False))
        return 0
    if example:
        return answer({"content": example_show()}, example_show().rstrip("\n"))
    if show is None:
        raise ValueError("storyboard: got no SHOW, expected a YAML file; see --example")
    if workers is not None and solver is not Solver.DAQP:
        raise ValueError(f"--workers: got it with --solver {solver}, expected --solver daqp")
    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    try:
        loaded = load_show(show)
    except ScenarioError as error:
        refuse_empty_file(show, error, "show", "drake-rho storyboard --schema")
        raise
    with working("assigning places") as work, stopping_early(), worker_pool(workers) as executor:
        planned = plan_show(
            loaded,
            solver=SOLVERS[solver](),
            executor=executor,
            progress=work,
            options=Options(time_limit=time_limit),
        )
    return finish(planned, output, drawing, certificate=certify_show(loaded, planned))
