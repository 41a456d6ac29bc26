"""Wall time and memory errors of the planners that users call."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import ParamSpec, Protocol, Self, TypeVar

from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError


class _Planned(Protocol):
    """A plan, a window or a flight."""

    def lasting(self, seconds: float) -> Self:
        """Return a copy with another wall time [s]."""
        ...


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result", bound=_Planned)


def with_wall_time(planner: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return a planner that records its wall time in `Statistics.seconds`.

    The statistics of errors contain the time too. A `MemoryError` becomes a `SolverError`.
    """

    @functools.wraps(planner)
    def run(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        began = time.perf_counter()
        try:
            planned = planner(*args, **kwargs)
        except (InfeasibleError, SolverError, OutOfTimeError) as error:
            seconds = time.perf_counter() - began
            spent = dataclasses.replace(error.statistics, seconds=seconds)
            raise error.replaced(statistics=spent) from error.__cause__
        except MemoryError as error:
            spent = Statistics(seconds=time.perf_counter() - began)
            raise SolverError("the planner ran out of memory", spent) from error
        return planned.lasting(time.perf_counter() - began)

    return run
