"""The typer application: options shared by all commands, and the output without a command."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer
from rich.table import Table

import drake_rho
from drake_rho.cli.console import answer
from drake_rho.cli.failures import InterruptedByUserError

Command = Callable[..., int]
Groups = dict[str, tuple[Command, ...]]

_DESCRIPTION = "Plan cooperative trajectories for several UAVs by convex optimisation."
_FIRST_STEPS = {
    "drake-rho plan paper -o plan.npz": "plan the paper's scenario, save the plan",
    "drake-rho show plan.npz": "show it in the browser",
    "drake-rho plan --help": "list all options of plan",
}
"""Commands for a new user, each with its description."""

# `OutputMode.of` reads --json and --quiet from the command line itself, so that errors in the
# command line obey them too. These declarations make typer accept and document the options.
JsonOption = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print one JSON document instead of text.",
        rich_help_panel="Options of every command",
    ),
]
QuietOption = Annotated[
    bool,
    typer.Option(
        "--quiet",
        help="Print answers and errors only; the exit status carries the verdict.",
        rich_help_panel="Options of every command",
    ),
]
_SHARED = [
    inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=option)
    for name, option in (("as_json", JsonOption), ("quiet", QuietOption))
]


def app_of(groups: Groups) -> typer.Typer:
    """Return the application with the given groups of commands, each named after its function."""
    app = typer.Typer(help=_DESCRIPTION, pretty_exceptions_enable=False)

    @app.callback(invoke_without_command=True)
    def without_command(
        context: typer.Context,
        version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
        as_json: JsonOption = False,
        quiet: QuietOption = False,
    ) -> int:
        if version:
            answer(_listed(groups), f"drake-rho {drake_rho.__version__}")
            raise typer.Exit
        if context.invoked_subcommand is None:
            answer(_listed(groups), *_overview(groups))
        return 0

    for group, commands in groups.items():
        for command in commands:
            app.command(_name(command), rich_help_panel=group)(_with_shared_options(command))
    return app


def _with_shared_options(command: Command) -> Command:
    """Return the command with the options of every command added to its own."""

    @functools.wraps(command)
    def run(*, as_json: bool, quiet: bool, **given: Any) -> int:
        try:
            return command(**given)
        except KeyboardInterrupt:
            raise InterruptedByUserError from None

    own, hints = inspect.signature(command), inspect.get_annotations(command, eval_str=True)
    options = [each.replace(annotation=hints[name]) for name, each in own.parameters.items()]
    run.__signature__ = own.replace(parameters=[*options, *_SHARED])  # type: ignore[attr-defined]  # for typer
    return run


def _listed(groups: Groups) -> dict[str, object]:
    names = {_name(each): _first_line(each) for group in groups.values() for each in group}
    return {"version": drake_rho.__version__, "commands": names}


def _overview(groups: Groups) -> list[str | Table]:
    """Return the first steps and the list of commands, group by group."""
    printed: list[str | Table] = [f"drake-rho {drake_rho.__version__}", _DESCRIPTION]
    printed += ["", "First steps:", _two_columns(_FIRST_STEPS)]
    longest = max(len(_name(each)) for commands in groups.values() for each in commands)
    for group, commands in groups.items():
        described = {_name(each): _first_line(each) for each in commands}
        printed += ["", f"{group}:", _two_columns(described, longest)]
    return [*printed, "", "drake-rho COMMAND --help describes a command and its options."]


def _two_columns(rows: dict[str, str], width: int | None = None) -> Table:
    """Return a table without lines: keys, in a column at least this wide, and their values."""
    table = Table(box=None, show_header=False, padding=(0, 0, 0, 2))
    table.add_column(no_wrap=True, min_width=width)
    table.add_column()
    for key, value in rows.items():
        table.add_row(key, value)
    return table


def _name(command: Command) -> str:
    """Return the name of a command, its function's without a trailing underscore."""
    return command.__name__.rstrip("_")


def _first_line(command: Command) -> str:
    return (command.__doc__ or "").splitlines()[0]
