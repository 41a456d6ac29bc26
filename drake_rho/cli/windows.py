"""Options of windows, which `fly` and `simulate` share."""

from __future__ import annotations

import inspect
from enum import StrEnum
from functools import partial
from typing import Annotated, Any

import typer

from drake_rho.cli.console import Work
from drake_rho.cli.options import (
    MaxMemoryOption,
    Method,
    MethodOption,
    Solver,
    SolverOption,
)
from drake_rho.planning.call.options import DEFAULTS as PLANNING
from drake_rho.planning.call.options import Options
from drake_rho.planning.horizon.settings import DEFAULTS, Windows, by_names
from drake_rho.planning.planners.plan import plan
from drake_rho.planning.programs.backend import SOLVERS
from drake_rho.scenario.arguments import passes_to


class Reference(StrEnum):
    """References of a window, by their names on the command line."""

    FREE = "free"
    TAIL = "tail"


def windows_of(
    work: Work,
    *,
    replan_every: Annotated[
        int, typer.Option(help="Steps that are flown of each window before the next is planned.")
    ] = DEFAULTS["replan_every"],
    free_final_time: Annotated[
        bool,
        typer.Option(
            "--free-final-time",
            help="Windows arrive at the earliest knot for which a plan is found, and vehicles then "
            "rest; by default all arrive at the last knot.",
        ),
    ] = DEFAULTS["free_final_time"],
    method: MethodOption = Method.AUTO,
    reference: Annotated[
        Reference | None,
        typer.Option(
            help="Reference around which a window is linearised. free: its own solution without "
            "obstacles, as in the paper. tail: the rest of the previous prediction. By default "
            "tail for scenarios with a separation, free otherwise."
        ),
    ] = None,
    contingencies: Annotated[
        bool,
        typer.Option(
            "--contingencies",
            help="Every window also plans how to brake to rest, clear of all that is known, which "
            "is flown where something seen late leaves no plan.",
        ),
    ] = DEFAULTS["contingencies"],
    latency: Annotated[
        float,
        typer.Option(
            help="Seconds that planning a window takes: windows are planned that much ahead, from "
            "predicted states.",
        ),
    ] = DEFAULTS["latency"],
    bounded_cost: Annotated[
        bool,
        typer.Option(
            "--bounded-cost",
            help="A new plan is accepted only if it costs no more than the rest of the previous "
            "one, moved to the measured states, so that the cost of the flight has a bound.",
        ),
    ] = DEFAULTS["bounded_cost"],
    solver: SolverOption = Solver.CLARABEL,
    max_memory: MaxMemoryOption = PLANNING.max_memory,
    time_limit: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Time limit of planning each window, after which the previous plan is continued.",
        ),
    ] = None,
) -> Windows:
    """Return the settings of windows given by the options.

    Raises:
        ScenarioError: a memory or time limit is out of bounds.
    """
    options = Options(max_memory=max_memory, time_limit=time_limit)
    iterated = partial(plan, progress=work.detail, options=options)
    return {
        "replan_every": replan_every,
        "free_final_time": free_final_time,
        **by_names(method, reference, iterated),
        "solver": SOLVERS[solver](),
        "progress": work,
        "options": options,
        "contingencies": contingencies,
        "latency": latency,
        "bounded_cost": bounded_cost,
    }


takes_windows = passes_to(windows_of)
"""Decorator of commands with `**windows`, which get the options of windows."""


def refuse_windows(source: str, windows: dict[str, Any]) -> None:
    """Check that no window option is given for a tracked plan, which has no windows.

    Args:
        source: file with the plan.
        windows: options of windows.

    Raises:
        ValueError: an option differs from its default.
    """
    for name, each in inspect.signature(windows_of).parameters.items():
        if name in windows and windows[name] != each.default:
            expected = f"a scenario with it: the plan in {source} is flown as it is"
            option = f"--{name.replace('_', '-')}"
            raise ValueError(f"{option}: got {windows[name]}, expected {expected}")
