"""Options of windows, which `fly` and `simulate` share."""

from __future__ import annotations

import dataclasses
import inspect
from enum import StrEnum
from functools import partial
from typing import Annotated, Any, cast

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
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.horizon.settings import PlainSettings, Windows, by_names
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
    method: MethodOption = Method.AUTO,
    reference: Annotated[
        Reference | None,
        typer.Option(
            help="Reference around which a window is linearised. free: its own solution without "
            "obstacles, as in the paper. tail: the rest of the previous prediction. By default "
            "tail for scenarios with a separation, free otherwise."
        ),
    ] = None,
    solver: SolverOption = Solver.CLARABEL,
    max_memory: MaxMemoryOption = PLANNING.max_memory,
    time_limit: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Time limit of planning each window, after which the previous plan is continued.",
        ),
    ] = None,
    **plain: Any,
) -> Windows:
    """Return the settings of windows given by the options.

    Raises:
        ScenarioError: a memory or time limit is out of bounds.
    """
    options = Options(max_memory=max_memory, time_limit=time_limit)
    iterated = partial(plan, progress=work.detail, options=options)
    named = by_names(method, reference, iterated)
    given = {"solver": SOLVERS[solver](), "progress": work, "options": options}
    return cast(Windows, {**plain, **named, **given})


def _plain_option(name: str) -> inspect.Parameter:
    """Return the option of a plain setting, with type and default of `RecedingHorizon`."""
    of_windows = inspect.signature(RecedingHorizon, eval_str=True).parameters[name]
    description = PlainSettings.__pydantic_fields__[name].description.removeprefix("whether ")  # type: ignore[attr-defined]  # every record has it
    words = f"{description[0].upper()}{description[1:]}."
    option = typer.Option(f"--{name.replace('_', '-')}", help=" ".join(words.split()))
    return of_windows.replace(annotation=Annotated[of_windows.annotation, option])


_WORK, *_NAMED, _ = inspect.signature(windows_of, eval_str=True).parameters.values()
_PLAIN = [_plain_option(field.name) for field in dataclasses.fields(PlainSettings)]
windows_of.__signature__ = inspect.Signature([_WORK, *_PLAIN, *_NAMED])  # type: ignore[attr-defined]  # `inspect` reads it

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
