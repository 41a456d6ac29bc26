"""The commands, each a function."""

from __future__ import annotations

import json
import logging
import sys
import webbrowser
import zipfile
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.status import Status

from drake_rho.cli.campaigns import campaign, results
from drake_rho.cli.checks import (
    asked_drawing,
    check_interface,
    check_kept,
    check_rate,
    check_writable,
    drawing_in,
)
from drake_rho.cli.console import (
    err,
    finish,
    on_interrupt,
    out,
    report,
    say,
    status_of,
)
from drake_rho.cli.export import export
from drake_rho.cli.options import (
    PLANNERS,
    REFERENCES,
    SOLVERS,
    DurationOption,
    FiguresOption,
    FormatOption,
    Method,
    MethodOption,
    OutputOption,
    Reference,
    ReplanEveryOption,
    ScenarioArgument,
    Solver,
    SolverOption,
    StepOption,
    WidthOption,
    WorldOption,
    read,
    refuse_options,
)
from drake_rho.cli.simulation import simulate
from drake_rho.cli.streams import pipe_safe
from drake_rho.display.flown import Flown
from drake_rho.motion.files import load
from drake_rho.motion.plan import Plan
from drake_rho.paper.study import REPEATS, run_study
from drake_rho.planning.best import plan as best_plan
from drake_rho.planning.convex import plan_convex
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.rho import plan_rho
from drake_rho.planning.solve import Solver as AnySolver
from drake_rho.scenario.files import replacing, scenario_schema
from drake_rho.scenario.missions import is_lsc_mission
from drake_rho.scenario.records import Scenario

app = typer.Typer(
    help="Plan cooperative trajectories for several UAVs by convex optimisation.",
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.command()
def reproduce(
    figures: Annotated[
        str, typer.Option(metavar="FOLDER", help="Folder for the sixteen figures.")
    ] = "figures",
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Run the paper's four examples, draw Figs 3 to 18, check what the paper says it found."""
    # matplotlib takes longer to load than the other commands take to run
    from drake_rho.paper.figures import NUMBERS, write_paper_figures
    from drake_rho.paper.tables import claims_table, study_table

    drawing = drawing_in(figures, file_format, width)
    check_kept(None, drawing)
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task("planning", total=4 * REPEATS + len(NUMBERS))

        def advance(done: str) -> None:
            progress.update(task, advance=1, description=done)

        study = run_study(advance)
        write_paper_figures(
            study, figures, advance, file_format=drawing.file_format, width=drawing.width
        )
    out.print(study_table(study), claims_table(study), sep="\n")
    say(f"{len(NUMBERS)} figures in {figures}")
    return 0 if all(example.report.ok for example in study.examples) else 1


@app.command()
def plan(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    method: MethodOption = Method.AUTO,
    solver: SolverOption = Solver.CLARABEL,
    duration: DurationOption = None,
    step: Annotated[
        list[float] | None,
        typer.Option(
            help="First the step of a mission, in seconds; then, and with a scenario, a further "
            "one for convex to try if there is no plan; repeatable."
        ),
    ] = None,
    world: WorldOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Plan a scenario in one piece, verify the plan and print the report."""
    drawing = asked_drawing(figures, file_format, width)
    check_kept(output, drawing)
    further = list(step or ())
    own_step = further.pop(0) if further and is_lsc_mission(scenario) else None
    if further and method is Method.SCP:
        raise ValueError(f"--step: got {further[0]:g} with --method scp, expected method convex")
    asked = read(scenario, duration, own_step, world)
    with err.status("planning") as status:
        planned = _plan(asked, method, further, SOLVERS[solver](), status)
    return finish(planned, output, drawing)


@app.command()
def fly(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    replan_every: ReplanEveryOption = 5,
    method: MethodOption = Method.AUTO,
    reference: Annotated[
        Reference | None,
        typer.Option(
            help="Linearise each window around its own solution without obstacles (free, the "
            "paper's) or around the tail of the previous prediction; if not given, free, and tail "
            "for vehicles that keep apart."
        ),
    ] = None,
    solver: SolverOption = Solver.CLARABEL,
    duration: DurationOption = None,
    step: StepOption = None,
    world: WorldOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Fly a scenario with a receding horizon, verify the flight and print the report."""
    drawing = asked_drawing(figures, file_format, width)
    check_kept(output, drawing)
    asked = read(scenario, duration, step, world)
    planner, fallback = PLANNERS[method]
    with err.status("flying"):
        flight = plan_rho(
            asked,
            replan_every=replan_every,
            planner=planner,
            fallback=fallback,
            reference=None if reference is None else REFERENCES[reference],
            solver=SOLVERS[solver](),
        )
    return finish(flight, output, drawing)


app.command()(simulate)


@app.command("verify")
def verify_file(
    file: Annotated[Path, typer.Argument(help="A file kept by 'plan', 'fly' or 'simulate'.")],
) -> int:
    """Judge every constraint of a plan, a flight or a simulation anew and print the report."""
    return report(load(file))


@app.command()
def schema() -> int:
    """Print the JSON schema of scenario files."""
    say(json.dumps(scenario_schema(), indent=2, ensure_ascii=False))
    return 0


app.command()(export)
app.command()(campaign)
app.command()(results)


@app.command()
def show(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|FILE",
            help="A scenario, which is then flown first, or a plan, flight or simulation kept in a "
            "file.",
        ),
    ],
    html: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Write one self-contained page here instead of serving."),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Network interface to serve on; '*' is every one.")
    ] = "localhost",
    port: Annotated[
        int,
        typer.Option(
            min=1024, max=65535, help="Port to serve on; the next free one if it is taken."
        ),
    ] = 7000,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    rate: Annotated[
        float | None, typer.Option(help="Seconds of flight in a second of playback, 0.01 to 1000.")
    ] = None,
    trails: Annotated[
        bool | None, typer.Option(help="Draw trails; by default for up to a hundred vehicles.")
    ] = None,
    duration: DurationOption = None,
    step: StepOption = None,
    world: WorldOption = None,
) -> int:
    """Show the swarm in Meshcat: in the browser until interrupted, or as one page in a file."""
    from drake_rho.display.animation import animate

    check_writable(html, (".html", ".htm"), "--html")
    check_interface(host)
    check_rate(rate)
    with err.status("planning"):
        flown = _load_or_fly(source, duration, step, world)
    with err.status("drawing"):
        meshcat = animate(flown, host=host, port=port, rate=rate, trails=trails)
    if html is not None:
        with replacing(html) as file:
            file.write(meshcat.StaticHtml().encode())
        say(f"one page in {html}")
        return 0
    wait_for_the_end = on_interrupt()
    say(f"{meshcat.web_url()}  (Ctrl-C ends)")
    sys.stdout.flush()
    if browser and not webbrowser.open(meshcat.web_url()):
        say("no browser found here: open the address in one")
    wait_for_the_end()
    say("ended")
    return 0


def _plan(
    scenario: Scenario,
    method: Method,
    further: list[float],
    solver: AnySolver,
    status: Status,
) -> Plan:
    """The plan of a method; further steps are tried by the convex one first."""
    if method is Method.CONVEX or further:
        try:
            return plan_convex(scenario, steps=further, solver=solver)
        except InfeasibleError as error:
            if method is Method.CONVEX or not error.about_linearisation:
                raise
    return best_plan(
        scenario, solver=solver, progress=lambda words: status.update(f"planning: {words}")
    )


def _load_or_fly(
    source: str, duration: float | None, step: float | None, world: str | None
) -> Flown:
    """What is in a file, or else a scenario's flight; of a fleet, its plan."""
    if source.endswith(".npz") or zipfile.is_zipfile(source):
        refuse_options(source, duration, step, world)
        return load(source)
    scenario = read(source, duration, step, world)
    if scenario.separation is not None:  # ten windows of sixty vehicles are long to wait for
        return best_plan(scenario)
    return plan_rho(scenario)


def main() -> NoReturn:
    """Run the command line and leave with its exit status."""
    logging.getLogger("drake").setLevel(logging.WARNING)  # what the solvers mutter
    sys.stdout, sys.stderr = pipe_safe(sys.stdout), pipe_safe(sys.stderr)
    sys.exit(status_of(lambda: app(standalone_mode=False)))
