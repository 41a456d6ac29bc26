"""The command line: `drake-rho reproduce | plan | fly | verify | show | schema`.

Exit status: 0 all constraints hold; 1 some do not; 2 bad input; 3 there is no plan; 4 the solvers
failed numerically; 130 interrupted; 141 the reader of the output has gone.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
import webbrowser
import zipfile
from collections.abc import Callable
from enum import StrEnum
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import typer
from pydrake.solvers import ClarabelSolver, OsqpSolver
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from drake_rho.assurance.study import REPEATS, run_study
from drake_rho.assurance.verification import verify
from drake_rho.motion.files import load, save
from drake_rho.motion.plan import Flight, Plan
from drake_rho.planning.convex import plan_convex
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.rho import free_reference, plan_rho, tail_reference
from drake_rho.planning.scp import plan_scp
from drake_rho.scenario.errors import DrakeRhoError
from drake_rho.scenario.files import check_replaceable, load_scenario, replacing, scenario_schema

app = typer.Typer(
    help="Plan cooperative trajectories for several UAVs by convex optimisation.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
T = TypeVar("T")
_out = Console()
_err = Console(stderr=True)


class Method(StrEnum):
    """Planners by their names on the command line."""

    AUTO = "auto"
    CONVEX = "convex"
    SCP = "scp"


class Solver(StrEnum):
    """Solvers by their names on the command line."""

    CLARABEL = "clarabel"
    OSQP = "osqp"


class Reference(StrEnum):
    """References of a window by their names on the command line."""

    FREE = "free"
    TAIL = "tail"


_SOLVERS = {Solver.CLARABEL: ClarabelSolver, Solver.OSQP: OsqpSolver}
_REFERENCES = {Reference.FREE: free_reference, Reference.TAIL: tail_reference}

ScenarioArgument = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="A library scenario, as 'paper', or a YAML file.")
]
OutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="Keep the result in this file (.npz).")
]
MethodOption = Annotated[
    Method,
    typer.Option(
        help="One linearisation of the obstacles (convex, the paper's), or iterated to convergence "
        "with ways round the obstacles where the first has no solution (scp), or convex and, "
        "where that has no solution, scp (auto)."
    ),
]
SolverOption = Annotated[Solver, typer.Option(help="Solver of the quadratic programs.")]


@app.command()
def reproduce(
    figures: Annotated[Path, typer.Option(help="Folder for the sixteen figures.")] = Path(
        "figures"
    ),
) -> int:
    """Run the paper's four examples, draw Figs 3 to 18, check what the paper says it found."""
    # matplotlib takes longer to load than the other commands take to run
    from drake_rho.display.figures import NUMBERS, write_figures
    from drake_rho.display.tables import claims_table, study_table

    figures.mkdir(parents=True, exist_ok=True)
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=_err, transient=True) as progress:
        task = progress.add_task("planning", total=4 * REPEATS + len(NUMBERS))

        def advance(done: str) -> None:
            progress.update(task, advance=1, description=done)

        study = run_study(advance)
        write_figures(study, figures, advance)
    _out.print(study_table(study), claims_table(study), sep="\n")
    _out.print(f"{len(NUMBERS)} figures in {figures}", soft_wrap=True)
    return 0 if all(example.report.ok for example in study.examples) else 1


@app.command()
def plan(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    method: MethodOption = Method.AUTO,
    solver: SolverOption = Solver.CLARABEL,
    step: Annotated[
        list[float] | None,
        typer.Option(
            help="With convex: a further step, in seconds, to try if there is no plan; repeatable."
        ),
    ] = None,
) -> int:
    """Plan a scenario in one piece, verify the plan and print the report."""
    if step and method is Method.SCP:
        raise ValueError(f"--step: got {step[0]:g} with --method {method}, expected method convex")
    asked = load_scenario(scenario)
    _check_writable(output)
    chosen = _SOLVERS[solver]()
    with _err.status("planning"):
        planned = _by_method(
            method,
            lambda: plan_convex(asked, steps=step or (), solver=chosen),
            lambda: plan_scp(asked, solver=chosen),
        )
    return _finish(planned, output)


@app.command()
def fly(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    replan_every: Annotated[int, typer.Option(help="Steps flown of each window.")] = 5,
    method: MethodOption = Method.AUTO,
    reference: Annotated[
        Reference,
        typer.Option(
            help="Linearise each window around its own solution without obstacles (the paper's) "
            "or around the tail of the previous prediction."
        ),
    ] = Reference.FREE,
    solver: SolverOption = Solver.CLARABEL,
) -> int:
    """Fly a scenario with a receding horizon, verify the flight and print the report."""
    asked = load_scenario(scenario)
    _check_writable(output)
    options: dict[str, Any] = {
        "replan_every": replan_every,
        "reference": _REFERENCES[reference],
        "solver": _SOLVERS[solver](),
    }
    with _err.status("flying"):
        flight = _by_method(
            method,
            lambda: plan_rho(asked, planner=plan_convex, **options),
            lambda: plan_rho(asked, planner=plan_scp, **options),
        )
    return _finish(flight, output)


@app.command("verify")
def verify_file(
    file: Annotated[Path, typer.Argument(help="A plan or flight kept by 'plan' or 'fly'.")],
) -> int:
    """Judge every constraint of a plan or flight anew and print the report."""
    return _report(load(file))


@app.command()
def schema() -> int:
    """Print the JSON schema of scenario files."""
    _print(json.dumps(scenario_schema(), indent=2, ensure_ascii=False))
    return 0


@app.command()
def show(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|FILE",
            help="A scenario, which is then flown first, or a plan or flight kept in a file.",
        ),
    ],
    html: Annotated[
        Path | None, typer.Option(help="Write one self-contained page here instead of serving.")
    ] = None,
    host: Annotated[
        str, typer.Option(help="Network interface to serve on; '*' is every one.")
    ] = "localhost",
    port: Annotated[
        int, typer.Option(help="Port to serve on; the next free one if it is taken.")
    ] = 7000,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    rate: Annotated[
        float | None, typer.Option(help="Seconds of flight in a second of playback.")
    ] = None,
) -> int:
    """Show the swarm in Meshcat: in the browser until interrupted, or as one page in a file."""
    from drake_rho.display.animation import animate

    _check_writable(html, "--html")
    with _err.status("planning"):
        flown = _load_or_fly(source)
    with _err.status("drawing"):
        meshcat = animate(flown, host=host, port=port, rate=rate)
    if html is not None:
        with replacing(html) as file:
            file.write(meshcat.StaticHtml().encode())
        _print(f"one page in {html}")
        return 0
    _print(f"{meshcat.web_url()}  (Ctrl-C ends)")
    sys.stdout.flush()
    if browser and not webbrowser.open(meshcat.web_url()):
        _print("no browser found here: open the address in one")
    _wait_for_interrupt()
    _print("ended")
    return 0


def _wait_for_interrupt() -> None:
    """Until Ctrl-C or a request to end, also where a shell in the background has them ignored."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    while not ended.wait(3600.0):
        pass


def _by_method(method: Method, convex: Callable[[], T], scp: Callable[[], T]) -> T:
    """What the chosen method finds; `auto` is the first or, if that has none, the second."""
    if method is Method.SCP:
        return scp()
    try:
        return convex()
    except InfeasibleError as error:
        if method is Method.CONVEX or not error.about_linearisation:
            raise
        _err.print("the convex method has no plan here; trying ways round the obstacles (scp)")
        return scp()


def _load_or_fly(source: str) -> Plan | Flight:
    """The plan or flight in a file, or else a scenario's flight."""
    if source.endswith(".npz") or zipfile.is_zipfile(source):
        return load(source)
    scenario = load_scenario(source)
    return _by_method(
        Method.AUTO, lambda: plan_rho(scenario), lambda: plan_rho(scenario, planner=plan_scp)
    )


def _finish(planned: Plan | Flight, output: Path | None) -> int:
    """Report on what was planned and keep it, whether or not it holds."""
    if output is not None:  # before anything is said: a closed pipe must not lose the work
        save(planned, output)
    status = _report(planned)
    if output is not None:
        _print(f"kept in {output}")
    return status


def _report(planned: Plan | Flight) -> int:
    whole = planned.plan if isinstance(planned, Flight) else planned
    report = verify(whole)
    _print(str(report))
    numbers = whole.statistics
    _print(
        f"index {whole.cost:.6f} m²/s⁴; step {whole.scenario.grid.step:g} s; "
        f"{numbers.programs} programs, {numbers.seconds:.3f} s, {numbers.solver}"
    )
    if isinstance(planned, Flight):
        kept = [window for window in planned.windows if window.infeasible]
        _print(f"{len(planned.windows)} windows, {len(kept)} of them without a plan of their own")
        for window in kept:
            _print(f"  from knot {window.first_knot + 1}, along the previous: {window.infeasible}")
    if not numbers.converged:
        _print("the iteration was stopped before the index settled")
    return 0 if report.ok else 1


def _check_writable(output: Path | None, option: str = "--output") -> None:
    """Find out before the work, not after it, that its result cannot be kept."""
    if output is None:
        return
    try:
        check_replaceable(output)
    except OSError as error:
        reason = error.strerror or "not a regular file"
        raise ValueError(f"{option}: got {output}, expected a file to write ({reason})") from None


def _print(text: str) -> None:
    """As it is: names of vehicles are no markup, and a table's lines are not folded."""
    _out.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)


def main() -> NoReturn:
    """Run the command line and leave with its exit status."""
    logging.getLogger("drake").setLevel(logging.WARNING)  # what the solvers mutter
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a terminal that lacks a sign shows another
            stream.reconfigure(errors="replace")
    sys.exit(_run())


def _run() -> int:
    try:
        status = app(standalone_mode=False)
    except InfeasibleError as error:
        with _err.status("finding out why"):
            reason = error.diagnosis
        _err.print(str(reason or error), markup=False, emoji=False, highlight=False, soft_wrap=True)
        return 3
    except SolverError as error:
        return _complain(error, 4)
    except BrokenPipeError:  # whoever read our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (DrakeRhoError, ValueError, OSError) as error:
        return _complain(error, 2)
    except MemoryError:
        return _complain("out of memory: the scenario is too large for this machine", 2)
    except Exception as error:
        # A word on the command line that typer does not accept. Its exceptions have no public
        # name that holds from version to version; this method sets them apart.
        if not hasattr(error, "format_message"):
            raise
        return _complain(error.format_message() or "see drake-rho --help", 2)
    return int(status or 0)


def _complain(error: object, status: int) -> int:
    words = " ".join(str(error).split())
    _err.print(f"drake-rho: {words}", markup=False, emoji=False, highlight=False, soft_wrap=True)
    return status
