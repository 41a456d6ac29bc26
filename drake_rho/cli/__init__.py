"""The command line: `drake-rho COMMAND`; docs/command_line.md has commands, statuses, documents."""

import os
import signal
from types import FrameType
from typing import NoReturn

__all__ = ["main"]

_INTERRUPTED = 130
"""The status after Ctrl-C, as in `drake_rho.cli.failures`, which is not loaded yet."""


def main() -> NoReturn:
    """Run the command line and leave with its exit status.

    To load it takes a second, in which Ctrl-C ends it at once: an exception would come out of any
    of the packages that are being loaded, some of which make another error of it.
    """
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    from drake_rho.cli.commands import main as run  # what takes the second

    signal.signal(signal.SIGINT, usual)
    run()


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"drake-rho: interrupted\n")
    os._exit(_INTERRUPTED)
