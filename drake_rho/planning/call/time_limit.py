"""Time limits of planners, checked between the steps of long computations.

A deadline is a context variable, visible to all functions within a call without an argument.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.work_limit import work_left
from drake_rho.planning.errors import OutOfTimeError

_ENDS: ContextVar[float] = ContextVar("_ENDS", default=math.inf)
"""Deadline on the clock of `time.perf_counter` [s]."""


class _Stop:
    """Request for the best result so far, in a variable that is read fast and by all threads."""

    requested = False

    def request(self) -> None:
        """Let all deadlines pass at once."""
        self.requested = True


_STOP = _Stop()
"""Request of a caller, which Ctrl-C makes."""

_STOPPABLE: ContextVar[bool] = ContextVar("_STOPPABLE", default=False)
"""True while a caller may request `_STOP`."""

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def seconds_left() -> float:
    """Return the time left [s]: zero or less after the deadline, infinite without one."""
    return -math.inf if _STOP.requested else _ENDS.get() - time.perf_counter()


def check_time() -> None:
    """Raise an error if no time or no work is left.

    Raises:
        OutOfTimeError: the deadline has passed, or a bound on the work is reached.
    """
    if seconds_left() <= 0.0 or work_left() <= 0.0:
        raise OutOfTimeError


def within_time(seconds: float | None) -> AbstractContextManager[None]:
    """Set a deadline for the block; an earlier one that is in force stays.

    An `OutOfTimeError` that the block raises contains the time limit.

    Args:
        seconds: duration until the deadline [s]; None for no further deadline.
    """
    return _NO_DEADLINE if seconds is None else _deadline(seconds)


_NO_DEADLINE = nullcontext()


@contextmanager
def _deadline(seconds: float) -> Iterator[None]:
    before = _ENDS.set(min(_ENDS.get(), time.perf_counter() + seconds))
    try:
        yield
    except OutOfTimeError as error:
        raise error.while_doing("", seconds) from None
    finally:
        _ENDS.reset(before)


@contextmanager
def stoppable() -> Iterator[Callable[[], None]]:
    """Provide the block with a function that lets all deadlines pass at once, for use by Ctrl-C."""
    before = _STOPPABLE.set(True)
    try:
        yield _STOP.request
    finally:
        _STOP.requested = False
        _STOPPABLE.reset(before)


def with_time_limit(planner: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return a planner that respects its argument `options.time_limit`, or `time_limit`.

    An `OutOfTimeError` that it raises contains the last progress text.
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
        recorded = _Recorded(given.get("progress"))
        if "progress" in planner.__annotations__:
            kwargs["progress"] = recorded
        try:
            with within_time(seconds):
                return planner(*args, **kwargs)
        except OutOfTimeError as error:
            raise error.while_doing(recorded.last, None) from None

    return run


class _Recorded:
    """Progress function that remembers the last text and passes all texts on."""

    def __init__(self, progress: Progress | None) -> None:
        self.last, self._progress = "", progress

    def __call__(self, words: str) -> None:
        """Remember a text and pass it on."""
        self.last = words
        if self._progress is not None:
            self._progress(words)
