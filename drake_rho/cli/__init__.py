"""The command line `drake-rho COMMAND`.

docs/command_line.md describes the commands, their exit statuses and their JSON documents.
"""

import os
import signal
from types import FrameType
from typing import NoReturn

__all__ = ["main"]

_INTERRUPTED = 130
"""Exit status after Ctrl-C; repeats `drake_rho.cli.failures.INTERRUPTED`, not imported yet."""


def main() -> NoReturn:
    """Run the command line and exit with its status.

    Importing the commands takes a second. Ctrl-C during the import exits at once, because a
    KeyboardInterrupt inside an import is turned into another error by some packages.
    """
    previous = signal.getsignal(signal.SIGINT)
    if previous is signal.default_int_handler:
        signal.signal(signal.SIGINT, _exit)
    from drake_rho.cli.commands import main as run  # the import that takes a second

    signal.signal(signal.SIGINT, previous)
    run()


def _exit(number: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"drake-rho: interrupted\n")
    os._exit(_INTERRUPTED)
