"""The commands `plan`, `fastest`, `fly` and `assign`."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from drake_rho.analysis.minimum_time import plan_minimum_time
from drake_rho.cli.assigned import Assigned, assigned
from drake_rho.cli.checks import check_outputs, check_writable, requested_drawing
from drake_rho.cli.console import Work, answer, stopping_early, tell, working
from drake_rho.cli.options import (
    Arrival,
    DurationOption,
    FiguresOption,
    FormatOption,
    MaxMemoryOption,
    Method,
    MethodOption,
    OutputOption,
    ScenarioArgument,
    Solver,
    SolverOption,
    StepOption,
    TimeLimitOption,
    WidthOption,
    WorldOption,
)
from drake_rho.cli.reports import finish
from drake_rho.cli.sources import read
from drake_rho.cli.windows import takes_windows, windows_of
from drake_rho.motion.costs import cost_of
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.horizon.plan_rho import plan_rho
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.planners.assignment import assign_goals, assignment
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.programs.backend import SOLVERS
from drake_rho.planning.programs.backend import Solver as AnySolver
from drake_rho.scenario.files import save_scenario
from drake_rho.scenario.problems.missions import is_lsc_mission
from drake_rho.scenario.records import Scenario


def plan(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    method: MethodOption = Method.AUTO,
    solver: SolverOption = Solver.CLARABEL,
    max_memory: MaxMemoryOption = DEFAULTS.max_memory,
    time_limit: TimeLimitOption = None,
    duration: DurationOption = None,
    step: Annotated[
        list[float] | None,
        typer.Option(
            help="Step in seconds, repeatable. For a mission, the first is the step of its grid. "
            "The others (for a scenario, all) are further steps, which the convex method tries in "
            "turn if it has no solution with the step of the grid."
        ),
    ] = None,
    world: WorldOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Plan the whole flight of a scenario at once and verify the plan."""
    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    further = list(step or ())
    own_step = further.pop(0) if further and is_lsc_mission(scenario) else None
    if further and method is Method.SCP:
        raise ValueError(f"--step: got {further[0]:g} with --method scp, expected method convex")
    options = Options(max_memory=max_memory, time_limit=time_limit)
    problem = read(scenario, duration, own_step, world)
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
    duration: DurationOption = None,
    step: StepOption = None,
    world: WorldOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Plan a scenario in the least time and verify the plan."""
    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    options = Options(max_memory=max_memory, time_limit=time_limit)
    problem = read(scenario, duration, step, world)
    with working("looking for the least time") as work, stopping_early():
        planned = plan_minimum_time(
            problem,
            knots=knots,
            arrival=arrival.value,
            solver=SOLVERS[solver](),
            progress=work,
            options=options,
        )
    return finish(planned, output, drawing, least_time=True)


@takes_windows
def fly(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    *,
    time_limit: TimeLimitOption = None,
    duration: DurationOption = None,
    step: StepOption = None,
    world: WorldOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
    **windows: Any,
) -> int:
    """Plan a scenario with a receding horizon and verify the flight."""
    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    problem = read(scenario, duration, step, world)
    with working("planning the first window") as work, stopping_early():
        flight = plan_rho(problem, **windows_of(work, time_limit=time_limit, **windows))
    return finish(flight, output, drawing)


def assign(
    scenario: ScenarioArgument,
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Save the scenario to this file (.yaml)."
        ),
    ] = None,
    duration: DurationOption = None,
    step: StepOption = None,
    world: WorldOption = None,
) -> int:
    """Exchange goals between vehicles to minimise their total effort."""
    check_writable(output, (".yaml", ".yml"), "--output")
    problem = read(scenario, duration, step, world)
    with working("assigning goals"):
        given, better = assignment(problem), assign_goals(problem)
    if output is not None:
        save_scenario(better, output)
    document = assigned(problem, given, (_effort(problem), _effort(better)), output)
    if output is None:
        return answer(document, *_summary(document))
    return tell(document, *_summary(document), f"saved to {output}")


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


def _effort(scenario: Scenario) -> float:
    """Return the least cost of all motions from the starts to the goals [m²/s⁴]."""
    return cost_of(scenario.fleet, MinimumEffort.of(scenario).motion.accelerations)


def _summary(found: Assigned) -> list[str | Table]:
    """Return the least effort and a table of the vehicles whose goals change."""
    effort = f"least effort {found.effort:.6g} m²/s⁴"
    moved = [each for each in found.vehicles if each.goal_of != each.vehicle]
    if not moved:
        return [f"{found.scenario}: every vehicle keeps its goal; {effort}"]
    heading = (
        f"{found.scenario}: {len(moved)} of {len(found.vehicles)} vehicles have another goal; "
        f"{effort} instead of {found.effort_before:.6g} m²/s⁴"
    )
    table = Table("vehicle", "goal of", "position \\[m]")
    for each in moved:
        position = "  ".join(f"{value:.4g}" for value in each.goal_m)
        table.add_row(escape(each.vehicle), escape(each.goal_of), position)
    return [heading, table]
