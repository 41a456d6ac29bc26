"""The command line: `drake-rho COMMAND`; docs/command_line.md has commands, statuses, documents."""

from drake_rho.cli.commands import main

__all__ = ["main"]
