"""Output of the commands: a JSON document or text, and the progress of the work."""

from __future__ import annotations

import dataclasses
import io
import queue
import re
import signal
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.progress import Progress, ProgressColumn
from rich.segment import Segment
from rich.status import Status
from rich.table import Table
from rich.text import Text

from drake_rho.cli.documents import content_of, json_of
from drake_rho.planning.call.time_limit import stoppable
from drake_rho.scenario.errors import DrakeRhoWarning

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Characters that control a terminal (move the cursor, colour or reorder text), except ends of
lines and tabs."""


def escaped(text: str) -> str:
    r"""Return text with escapes, such as `\x1b`, in place of characters that control a terminal.

    Names and messages may come from untrusted files. The escapes are valid in JSON too: its writer
    leaves unescaped only characters that have four-digit escapes here.
    """

    def written(found: re.Match[str]) -> str:
        number = ord(found[0])
        return f"\\x{number:02x}" if number < 0x20 else f"\\u{number:04x}"

    return _CONTROL.sub(written, text)


class _Screen(Console):
    """Console that escapes terminal control characters in texts, tables and bars.

    Its own colours and cursor movements stay.
    """

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Return the segments of a printed object or of a part of it."""
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else escaped(text), style, control)


out = _Screen()
err = _Screen(stderr=True)

_AWAKE = 0.5
"""Longest time after which a command that waits looks for a signal [s]."""

_PIPED = 100
"""Width of texts and tables in files and pipes, in columns."""


@dataclasses.dataclass
class OutputMode:
    """Form of the output, the same for a whole run of the command line."""

    as_json: bool = False
    """one JSON document on standard output, and nothing else there"""
    quiet: bool = False
    """answers and errors only"""

    @contextmanager
    def of(self, arguments: Sequence[str]) -> Iterator[None]:
        """Set the mode of a command line for the block, even of an invalid one.

        Errors in the command line are then printed in the mode that it requests.
        """
        options = arguments[: arguments.index("--")] if "--" in arguments else arguments
        self.as_json, self.quiet = "--json" in options, "--quiet" in options
        err.quiet = self.quiet
        try:
            yield
        finally:
            self.as_json = self.quiet = err.quiet = False


output_mode = OutputMode()


def write(text: str, console: Console = out) -> None:
    """Print text unchanged on a console of any width, without markup and without wrapping."""
    console.file.write(f"{escaped(text)}\n")
    console.file.flush()


def say(text: str, console: Console = out) -> None:
    """Print text, wrapped between words; only errors in files and pipes are one line each."""
    if console.is_terminal:
        console.print(Text(text, overflow="ignore"))
    else:
        write(text if console is err else "\n".join(map(_wrapped, text.splitlines())), console)


def _wrapped(line: str) -> str:
    """Return a line for files and pipes, wrapped between words, its further lines indented.

    Lines with columns, at least two spaces apart, remain as they are.
    """
    if "  " in line.strip():
        return line
    indent = line[: len(line) - len(line.lstrip())] + "  "
    return textwrap.fill(
        line,
        _PIPED,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
    )


def columns() -> int:
    """Return the width of texts and tables on standard output, in columns."""
    return out.width if out.is_terminal else _PIPED


def remark(text: str) -> None:
    """Print a remark that is not part of the result; with --json, on standard error."""
    if not output_mode.quiet:
        say(text, err if output_mode.as_json else out)


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print each warning of the package in one line on standard error; with --quiet none."""
    printed = set[str]()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        *_: object,
        **named: object,
    ) -> None:
        text = f"drake-rho: warning: {' '.join(str(message).split())}"
        if not issubclass(category, DrakeRhoWarning):
            say(warnings.formatwarning(message, category, filename, lineno).rstrip(), err)
        elif text not in printed and not output_mode.quiet:
            say(text, err)
        printed.add(text)

    with warnings.catch_warnings():
        warnings.simplefilter("always", DrakeRhoWarning)
        warnings.showwarning = show
        yield


def answer(content: object, *text: str | Table, status: int = 0) -> int:
    """Print the answer to a question, as a document or as text, and return the exit status.

    Args:
        content: record or mapping to print as a document.
        text: text to print otherwise.
        status: exit status of the command, the first key of its document.
    """
    if output_mode.as_json:
        found = content if isinstance(content, Mapping) else content_of(content)
        write(json_of({"status": status, **found}))
        return status
    for each in text:
        say(each) if isinstance(each, str) else _print_table(each)
    return status


def tell(content: object, *text: str | Table, status: int = 0) -> int:
    """Print the outcome of an action as `answer` does; with --quiet print no text.

    The exit status alone then gives the outcome.
    """
    return answer(content, *(() if output_mode.quiet else text), status=status)


def plain_table(*heads: str, texts: int = 1) -> Table:
    """Return a table without lines, the one style of all tables.

    Args:
        heads: heads of the columns, without markup; none if the table has no heads.
        texts: number of columns of text, from the left; the others are numbers.
    """
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=bool(heads))
    for number, head in enumerate(heads):
        table.add_column(escape(head), justify="left" if number < texts else "right")
    return table


def _print_table(table: Table) -> None:
    """Print a table, folded to `columns`."""
    if out.is_terminal:
        out.print(table)
        return
    text = io.StringIO()
    _Screen(file=text, width=_PIPED).print(table)
    for line in text.getvalue().splitlines():
        write(line.rstrip())


class Work:
    """Line of the terminal that names the current step; passed on as `progress=`."""

    def __init__(self, step: str, status: Status) -> None:
        self._step, self._status = step, status

    def __call__(self, step: str) -> None:
        """Show that this step has begun."""
        self._step = step
        self._status.update(Text(step))

    def detail(self, part: str) -> None:
        """Show this part of the current step."""
        self._status.update(Text(f"{self._step}: {part}"))


@contextmanager
def working(step: str) -> Iterator[Work]:
    """Show the current step of the block on standard error if that is a terminal."""
    with err.status(Text(step)) as status:
        yield Work(step, status)


@contextmanager
def stopping_early() -> Iterator[None]:
    """Let Ctrl-C stop the planning in the block with the best plan so far.

    A second Ctrl-C ends the command.
    """
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
    """Return a progress bar on standard error, hidden without a terminal and with --quiet."""
    hidden = output_mode.quiet or not err.is_terminal
    return Progress(*columns, console=err, transient=True, disable=hidden)


def on_interrupt() -> Callable[[], None]:
    """Make SIGINT (Ctrl-C) and SIGTERM end only the returned wait, from now on.

    This holds also in background jobs, for which shells have these signals ignored.
    """
    # an event's lock may be held when the signal comes; this queue's `put` is reentrant
    ended = queue.SimpleQueue[None]()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.put(None))

    def wait() -> None:
        while True:  # a signal just before a wait without an end would not wake it
            with suppress(queue.Empty):
                return ended.get(timeout=_AWAKE)

    return wait
