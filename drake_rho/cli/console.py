"""What the commands say: a document or words, and what is being done."""

from __future__ import annotations

import dataclasses
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, ProgressColumn
from rich.status import Status
from rich.table import Table
from rich.text import Text

from drake_rho.cli.documents import Document
from drake_rho.planning.time_limit import stoppable

out = Console()
err = Console(stderr=True)


@dataclasses.dataclass
class Manner:
    """How the commands speak, the same for all of one run."""

    as_json: bool = False
    """one JSON document on standard output, and nothing else there"""
    quiet: bool = False
    """results and errors only"""

    def adopt(self, words: Sequence[str]) -> None:
        """Take it from a command line, which need not make sense otherwise: errors have it too."""
        options = words[: words.index("--")] if "--" in words else words
        self.as_json, self.quiet = "--json" in options, "--quiet" in options
        err.quiet = self.quiet


manner = Manner()


def write(text: str, console: Console = out) -> None:
    """Print text unchanged on a console of any width: no markup in names, nothing folded."""
    console.file.write(f"{text}\n")
    console.file.flush()


def say(text: str, console: Console = out) -> None:
    """Print words, which a terminal has folded between two of them; elsewhere unchanged."""
    if console.is_terminal:
        console.print(Text(text, overflow="ignore"))
    else:
        write(text, console)


def remark(text: str) -> None:
    """Say something that is not the result."""
    if not manner.quiet:
        say(text, err if manner.as_json else out)


def answer(document: Document, *words: str | Table) -> int:
    """Say what was asked for, as a document or in words, and return its status."""
    if manner.as_json:
        write(document.to_json())
        return document.status
    for each in words:
        say(each) if isinstance(each, str) else out.print(each)
    return document.status


def tell(document: Document, *words: str | Table) -> int:
    """The same of what a command has done, where the status may be all that is wanted."""
    return answer(document, *(() if manner.quiet else words))


class Work:
    """What is under way, in a line of the terminal; called as `progress=`."""

    def __init__(self, words: str, status: Status) -> None:
        self._part, self._status = words, status

    def __call__(self, words: str) -> None:
        """From now on this is done."""
        self._part = words
        self._status.update(Text(words))

    def detail(self, words: str) -> None:
        """This is done within what is done."""
        self._status.update(Text(f"{self._part}: {words}"))


@contextmanager
def working(words: str) -> Iterator[Work]:
    """Show on standard error, if it is a terminal, what is under way in the block."""
    with err.status(Text(words)) as status:
        yield Work(words, status)


@contextmanager
def stopping_early() -> Iterator[None]:
    """Let Ctrl-C end the planning in the block with the best there is; a second one ends it all."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is signal.SIG_IGN:
        yield
        return
    with stoppable() as stop:

        def on_first(*_: object) -> None:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            stop()

        signal.signal(signal.SIGINT, on_first)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def bar(*columns: ProgressColumn) -> Progress:
    """A bar on standard error, if it is a terminal and progress is wanted."""
    hidden = manner.quiet or not err.is_terminal
    return Progress(*columns, console=err, transient=True, disable=hidden)


def on_interrupt() -> Callable[[], None]:
    """From now on Ctrl-C, or a request to end, ends nothing but the wait that is returned.

    Also where a shell in the background has them ignored.
    """
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())

    def wait() -> None:
        while not ended.wait(3600.0):
            pass

    return wait
