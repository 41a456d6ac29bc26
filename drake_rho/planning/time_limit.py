"""Time limits: until when planners may look, asked for between the steps of whatever takes long.

The end is known to the whole call, however deep it is, and to nothing else: nobody hands it on.
"""

from __future__ import annotations

import functools
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

from drake_rho.planning.errors import OutOfTimeError
from drake_rho.planning.options import Options
from drake_rho.planning.progress import Progress

_ENDS: ContextVar[float] = ContextVar("_ENDS", default=math.inf)
"""When time is up, on the clock of `time.perf_counter`."""

_STOPPED = threading.Event()
"""Whether whoever waits wants what there is now."""

_STOPPABLE: ContextVar[bool] = ContextVar("_STOPPABLE", default=False)
"""Whether someone may want that."""

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def seconds_left() -> float:
    """Return how much time is left [s], at most zero if none is; infinite without a limit."""
    return -math.inf if _STOPPED.is_set() else _ENDS.get() - time.perf_counter()


def check_time() -> None:
    """See that there is time left.

    Raises:
        OutOfTimeError: there is none.
    """
    if seconds_left() <= 0.0:
        raise OutOfTimeError


@contextmanager
def within_time(seconds: float | None) -> Iterator[None]:
    """Let everything in the block take at most some time, or less where less was left before."""
    if seconds is None:
        yield
        return
    before = _ENDS.set(min(_ENDS.get(), time.perf_counter() + seconds))
    try:
        yield
    finally:
        _ENDS.reset(before)


@contextmanager
def stoppable() -> Iterator[Callable[[], None]]:
    """Give the block a function that ends all time limits at once, as Ctrl-C may call it."""
    before = _STOPPABLE.set(True)
    try:
        yield _STOPPED.set
    finally:
        _STOPPED.clear()
        _STOPPABLE.reset(before)


def with_time_limit(planner: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return a planner that keeps to its `options.time_limit`, or its `time_limit`.

    An `OutOfTimeError` tells the last words on what was being done.
    """

    @functools.wraps(planner)
    def run(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        given: dict[str, Any] = kwargs
        options: Options | None = given.get("options")
        seconds = given.get("time_limit") if options is None else options.time_limit
        if seconds is not None and not seconds > 0.0:
            raise ValueError(f"time_limit: got {seconds!r}, expected seconds above 0, or None")
        if seconds is None and seconds_left() == math.inf and not _STOPPABLE.get():
            return planner(*args, **kwargs)
        heard = _Heard(given.get("progress"))
        if "progress" in planner.__annotations__:
            kwargs["progress"] = heard
        try:
            with within_time(seconds):
                return planner(*args, **kwargs)
        except OutOfTimeError as error:
            raise error.while_doing(heard.last, seconds) from None

    return run


class _Heard:
    """Progress that is handed on, of which the last words are kept."""

    def __init__(self, progress: Progress | None) -> None:
        self.last, self._progress = "", progress

    def __call__(self, words: str) -> None:
        """Take some words."""
        self.last = words
        if self._progress is not None:
            self._progress(words)
