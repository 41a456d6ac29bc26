"""The commands `plan`, `fastest` and `fly`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from drake_rho.analysis.minimum_time import plan_minimum_time
from drake_rho.cli.checks import check_outputs, requested_drawing
from drake_rho.cli.console import Work, stopping_early, working
from drake_rho.cli.options import (
    Arrival,
    FiguresOption,
    FormatOption,
    MaxMemoryOption,
    Method,
    MethodOption,
    OutputOption,
    ScenarioArgument,
    Solver,
    SolverOption,
    TimeLimitOption,
    WidthOption,
)
from drake_rho.cli.reports import finish
from drake_rho.cli.sources import read
from drake_rho.cli.windows import takes_windows, windows_of
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.horizon.plan_rho import plan_rho
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.programs.backend import SOLVERS
from drake_rho.planning.programs.backend import Solver as AnySolver
from drake_rho.scenario.records import Scenario


def plan(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    method: MethodOption = Method.AUTO,
    solver: SolverOption = Solver.CLARABEL,
    max_memory: MaxMemoryOption = DEFAULTS.max_memory,
    time_limit: TimeLimitOption = None,
    step: Annotated[
        list[float] | None,
        typer.Option(
            help="Further step in seconds, repeatable: the convex method tries these in turn if "
            "it has no solution with the step of the scenario's grid."
        ),
    ] = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Plan the whole flight of a scenario at once and verify the plan."""
    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    further = list(step or ())
    if further and method is Method.SCP:
        raise ValueError(f"--step: got {further[0]:g} with --method scp, expected method convex")
    options = Options(max_memory=max_memory, time_limit=time_limit)
    problem = read(scenario)
    with working("planning") as work, stopping_early():
        planned = _plan(problem, method, further, SOLVERS[solver](), options, work)
    return finish(planned, output, drawing)


def fastest(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    knots: Annotated[
        int | None,
        typer.Option(min=2, max=100_000, help="Number of knots; by default the scenario's."),
    ] = None,
    arrival: Annotated[
        Arrival,
        typer.Option(help="Whether all vehicles arrive together or each as soon as it can."),
    ] = Arrival.TOGETHER,
    solver: SolverOption = Solver.CLARABEL,
    max_memory: MaxMemoryOption = DEFAULTS.max_memory,
    time_limit: TimeLimitOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Plan a scenario in the least time and verify the plan."""
    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    options = Options(max_memory=max_memory, time_limit=time_limit)
    problem = read(scenario)
    with working("looking for the least time") as work, stopping_early():
        planned = plan_minimum_time(
            problem,
            knots=knots,
            arrival=arrival.value,
            solver=SOLVERS[solver](),
            progress=work,
            options=options,
        )
    return finish(planned, output, drawing)


@takes_windows
def fly(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    *,
    time_limit: TimeLimitOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
    **windows: Any,
) -> int:
    """Plan a scenario with a receding horizon and verify the flight."""
    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    problem = read(scenario)
    with working("planning the first window") as work, stopping_early():
        flight = plan_rho(problem, **windows_of(work, time_limit=time_limit, **windows))
    return finish(flight, output, drawing)


def _plan(
    scenario: Scenario,
    method: Method,
    further: list[float],
    solver: AnySolver,
    options: Options,
    work: Work,
) -> Plan:
    """Plan with a method; if there are further steps, the convex method tries them first."""
    if method is Method.CONVEX or further:
        try:
            return plan_convex(scenario, steps=further, solver=solver, options=options)
        except InfeasibleError as error:
            if method is Method.CONVEX or not error.about_linearisation:
                raise
    return best_plan(scenario, solver=solver, progress=work, options=options)
