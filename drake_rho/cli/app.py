"""What all commands share: options, and what there is without a command."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

import drake_rho
from drake_rho.cli.console import answer
from drake_rho.cli.documents import Listed
from drake_rho.cli.failures import InterruptedByUserError

Command = Callable[..., int]
Groups = dict[str, tuple[Command, ...]]

_WORDS = "Plan cooperative trajectories for several UAVs by convex optimisation."
_FIRST = {
    "drake-rho plan paper -o plan.npz": "plan the paper's scenario, keep the plan",
    "drake-rho show plan.npz": "see it fly in the browser",
    "drake-rho plan --help": "all that can be asked of it",
}
"""What to type first."""

# The manner of speaking is taken from the words themselves (`Manner.adopt`), as errors in them
# have it too; these are for typer, which has to accept and to explain the options.
JsonOption = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print one JSON document in place of words.",
        rich_help_panel="Options of every command",
    ),
]
QuietOption = Annotated[
    bool,
    typer.Option(
        "--quiet",
        help="Print only what was asked for, and errors; the status tells the rest.",
        rich_help_panel="Options of every command",
    ),
]
_SHARED = [
    inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=option)
    for name, option in (("as_json", JsonOption), ("quiet", QuietOption))
]


def app_of(groups: Groups) -> typer.Typer:
    """The application of some commands, group by group, each named as its function."""
    app = typer.Typer(help=_WORDS, pretty_exceptions_enable=False)

    @app.callback(invoke_without_command=True)
    def alone(
        context: typer.Context,
        version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
        as_json: JsonOption = False,
        quiet: QuietOption = False,
    ) -> int:
        if version:
            answer(_listed(groups), f"drake-rho {drake_rho.__version__}")
            raise typer.Exit
        if context.invoked_subcommand is None:
            answer(_listed(groups), _orientation(groups))
        return 0

    for group, commands in groups.items():
        for command in commands:
            app.command(command.__name__, rich_help_panel=group)(_with_shared_options(command))
    return app


def _with_shared_options(command: Command) -> Command:
    """A command that takes the options of every command beside its own."""

    @functools.wraps(command)
    def run(*, as_json: bool, quiet: bool, **given: Any) -> int:
        try:
            return command(**given)
        except KeyboardInterrupt:
            raise InterruptedByUserError from None

    own = inspect.signature(command, eval_str=True)
    run.__signature__ = own.replace(parameters=[*own.parameters.values(), *_SHARED])  # type: ignore[attr-defined]  # for typer
    return run


def _listed(groups: Groups) -> Listed:
    names = {each.__name__: _first_line(each) for group in groups.values() for each in group}
    return Listed(version=drake_rho.__version__, commands=names)


def _orientation(groups: Groups) -> str:
    """What there is, and where to begin."""
    wide = max(len(words) for words in _FIRST)
    lines = [f"drake-rho {drake_rho.__version__}", _WORDS, "", "To begin with:"]
    lines += [f"  {words:<{wide}}  {what}" for words, what in _FIRST.items()]
    for group, commands in groups.items():
        lines += ["", f"{group}:"]
        lines += [f"  {each.__name__:<9}  {_first_line(each)}" for each in commands]
    return "\n".join([*lines, "", "drake-rho COMMAND --help tells more of each."])


def _first_line(command: Command) -> str:
    return (command.__doc__ or "").splitlines()[0]
