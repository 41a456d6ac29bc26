"""Transitions of a show: flights of all vehicles from rest to rest, each in few steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.call.work_limit import within_work
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.first_plan import FirstPlan
from drake_rho.planning.planners.plan import plan
from drake_rho.planning.problem import Problem, with_finer_margins
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Box, Grid, Limits, Scenario, State, Vehicle
from drake_rho.scenario.times import steps_lasting
from drake_rho.shows.assignment import least_times
from drake_rho.shows.show import Show
from drake_rho.system.threads import single_threaded_blas

_SLACKS = 0.01, 0.03, 0.1, 0.3, 1.0, 3.0
"""Slacks of the longest flight that are tried, relative to its least time, after the fewest steps:
without any slack, vehicles can hardly evade each other."""

_MORE = 4, 12
"""Numbers of steps beyond these that are tried at last: limits of jerk and tilt, which least times
leave out, take time however short the way is."""

_WORK = 60.0
"""Work on one number of steps [rounds]: most plans take less than 20."""

_FIRST_PROGRAMS = 20_000
"""Programs of single vehicles that are solved for the fewest steps, a smaller bound in large
fleets."""

_TIGHT = {2000: 2, 4000: 4}
"""How many of the fewest numbers of steps are not tried in fleets of more than so many vehicles. Of
2025 vehicles, they took two thirds of the time and had no plan within the bounds on work; of 5041,
many violated the separation with 10 % of slack, and a plan was soon found with 30 %."""

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

    @property
    def _skipped(self) -> int:
        """How many of the fewest numbers of steps are not tried."""
        return max((most for size, most in _TIGHT.items() if len(self.starts) > size), default=0)

    def scenario(self, steps: int) -> Scenario:
        """Return the scenario of the transition in a number of steps."""
        show = self.show
        vehicles = [
            Vehicle(name, State(start), State(goal), radius=show.radius)
            for name, start, goal in zip(show.vehicles, self.starts, self.goals, strict=False)
        ]
        return Scenario(
            self.name,
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
        last = 1
        for slack in (0.0, *_SLACKS)[self._skipped :]:
            steps = max(steps_lasting(self.least * (1.0 + slack), step), last + 1)
            yield steps
            last = steps
        for more in _MORE:
            yield last + more

    @single_threaded_blas
    def planned(self, solver: Solver | SolverName | None, options: Options | None) -> Plan:
        """Return the plan with the fewest steps found.

        A plan is sought for growing numbers of steps, with a bound on the work for each but the
        last, so that the result is the same on every machine. Small fleets' plans are iterated by
        `plan`; those of large ones are hardly cheaper then.

        Raises:
            InfeasibleError: no number of steps that was tried has a plan.
            OutOfTimeError: time was up before there was a plan.
        """
        options = options or DEFAULTS
        backend = Backend.of(solver, options=options.solver_options)
        found = self._first(backend, options)
        if len(self.starts) > options.max_coupled:
            return found
        return plan(found.scenario, reference=found, solver=solver, options=options)

    def _first(self, backend: Backend, options: Options) -> Plan:
        """Return a plan with the fewest steps found, which is not iterated."""
        search = FirstPlan(backend, options=options)
        *tried, last = self.steps_tried()
        work = _WORK if self._skipped else min(_WORK, _FIRST_PROGRAMS / len(self.starts))
        for steps in tried:
            try:
                with within_work(work):
                    return with_finer_margins(search.of, Problem.of(self.scenario(steps)))
            except (InfeasibleError, SolverError):
                pass
            except OutOfTimeError:
                check_time()  # raises if it was not the bound on the work
            work = _WORK
        return with_finer_margins(search.of, Problem.of(self.scenario(last)))


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
