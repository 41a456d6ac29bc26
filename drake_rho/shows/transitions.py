"""Transitions of a show: flights of all vehicles from rest to rest, each in few steps."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.call.work_limit import within_work
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.plan import plan
from drake_rho.planning.programs.backend import Solver, SolverName
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Box, Grid, Limits, Scenario, State, Vehicle
from drake_rho.scenario.times import steps_lasting
from drake_rho.shows.assignment import least_times
from drake_rho.shows.show import Show

_WORK = 60.0
"""Work on one number of steps [rounds]: most plans take less than a third of it."""

_LONGER = 1.06
"""Ratio of successive durations that are tried."""

_LONGEST = 3.0
"""Largest duration that is tried, as a multiple of the shortest."""

_SPARE = 1e-6
"""Part of every limit of speed, acceleration and jerk that transitions leave free: accepted
violations are relative to the flight's mean acceleration, which is less over a whole show."""


@dataclasses.dataclass(frozen=True)
class Transition:
    """Flight of all vehicles to their places in the next scene."""

    show: Show
    """the show"""
    name: str
    """name of the scene to which it leads"""
    starts: FloatArray
    """positions at the beginning [m], shape (N, 3)"""
    goals: FloatArray
    """positions at the end [m], shape (N, 3)"""
    duration: float | None = None
    """given duration [s]; None for the least that is found"""
    colours: tuple[str, ...] = ()
    """colour of each vehicle's light in the scene, if it leads to one"""

    @property
    def least(self) -> float:
        """Lower bound of the duration [s]."""
        return float(least_times(self.goals - self.starts, self.show.limits).max())

    def scenario(self, steps: int) -> Scenario:
        """Return the scenario of the transition in a number of steps."""
        show = self.show
        vehicles = [
            Vehicle(name, State(start), State(goal), radius=show.radius)
            for name, start, goal in zip(show.vehicles, self.starts, self.goals, strict=False)
        ]
        return Scenario(
            f"{show.name}: to {self.name}",
            Grid(show.step, steps + 1),
            vehicles,
            _reduced(show.limits),
            show.obstacles,
            show.separation,
        )

    def steps_tried(self) -> Iterator[int]:
        """Yield the numbers of steps that are tried, from the least."""
        step = self.show.step
        if self.duration is not None:
            yield max(round(self.duration / step), 1)
            return
        fewest = max(steps_lasting(self.least, step), 2)
        last, longest = fewest, math.ceil(_LONGEST * fewest) + 4
        while last <= longest:
            yield last
            last = max(last + 1, round(last * _LONGER))

    def planned(self, solver: Solver | SolverName | None, options: Options | None) -> Plan:
        """Return the plan with the fewest steps found.

        A plan is sought for growing numbers of steps, with a bound on the work for each but the
        last, so that the result is the same on every machine.

        Raises:
            InfeasibleError: no number of steps that was tried has a plan.
            OutOfTimeError: time was up before there was a plan.
        """
        tried = list(self.steps_tried())
        for steps in tried[:-1]:
            try:
                with within_work(_WORK):
                    return plan(self.scenario(steps), solver=solver, options=options)
            except (InfeasibleError, SolverError):
                continue
            except OutOfTimeError:
                check_time()  # raises if it was not the bound on the work
        return plan(self.scenario(tried[-1]), solver=solver, options=options)


def _reduced(limits: Limits) -> Limits:
    """Return limits whose bounds on speeds, accelerations and jerks are slightly smaller."""
    smaller: dict[str, Any] = {}
    for name in ("velocity", "acceleration", "jerk", "max_speed", "max_acceleration", "max_jerk"):
        limit = getattr(limits, name)
        if isinstance(limit, Box):
            smaller[name] = Box(limit.lower * (1.0 - _SPARE), limit.upper * (1.0 - _SPARE))
        elif limit is not None:
            smaller[name] = limit * (1.0 - _SPARE)
    return dataclasses.replace(limits, **smaller)
