"""Motion with a variable final time and the times of its waypoints: `Timed`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drake_rho.motion.costs import cost_of
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.motion.smooth import response_of
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.keep_out import KeepOutOfObstacle
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.free_times import FreeTime, Passing
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.times import END_MARGIN

_AFTER = 2.0 * END_MARGIN
"""Least time of flight after a given waypoint time or a requirement's end, in steps. It is
negligible, but constraints then hold at the end of a requirement as at any other instant."""


@dataclasses.dataclass(frozen=True, eq=False)
class Timed:
    """Motion of a scenario with its final time and the times of its waypoints."""

    scenario: Scenario
    """scenario without waypoints; its final time may differ"""
    step: float
    """step of the motion [s]"""
    accelerations: FloatArray
    """accelerations [m/s²], shape (N, K-1, 3)"""
    passing: Passing
    """waypoints with their times"""
    rows: Sequence[HalfSpaces] = ()
    """rows of the last program"""
    reference: Plan | None = None
    """motion to linearise around, possibly dynamically inconsistent; this one if not given"""
    resting: IntArray | None = None
    """knots from which vehicles rest at their goals, shape (N,); None for the last"""
    converged: bool = False
    """whether a search for the least time has converged here"""
    short: float = 0.0
    """sum of the distances by which the last program missed free waypoints [m]"""
    nearer: tuple[int, FloatArray] | None = None
    """number of an obstacle and reductions of the distance from it that each vehicle keeps [m],
    shape (N,); None for none"""

    @cached_property
    def problem(self) -> Problem:
        """Problem in the final time of the motion, with what is required at its waypoints."""
        scenario = self.scenario.ending_with(self.grid)
        if more := self.passing.required(self.grid, scenario.names):
            scenario = scenario.derived(requirements=(*scenario.requirements, *more))
        return Problem.of(scenario)

    @property
    def grid(self) -> Grid:
        """Grid of the motion."""
        return dataclasses.replace(self.scenario.grid, step=self.step)

    @property
    def duration(self) -> float:
        """Final time [s]."""
        return self.step * (self.scenario.grid.knots - 1)

    @property
    def least_factor(self) -> float:
        """Least factor on the squared final time, by the smoothing, given times and dwells."""
        width = self.scenario.averaging_width
        least = max(width / self.step, latest(self.scenario, self.passing) / self.duration)
        return max(least, self.shortest_stop) ** 2 * (1.0 + 1e-9)

    @property
    def shortest_stop(self) -> float:
        """Factor on the step with which a stop's steps at rest last only as long as its dwell."""
        passing = self.passing
        own = (passing.dwells > 0.0) & ~passing.given
        steps = passing.steps_at_rest(self.step)[own]
        return float(np.max(passing.dwells[own] / (self.step * steps), initial=0.0))

    @property
    def missed(self) -> float:
        """Largest miss of a waypoint beyond its tolerance, as a fraction of a motion's length."""
        passing, fleet = self.passing_averaged, self.scenario.fleet
        lengths = np.maximum(fleet.lengths, passing.farthest_from(fleet.start_positions))
        at, _ = passing.states(self.motion)
        beyond = np.linalg.norm(at - passing.positions, axis=1) - passing.within
        return float(np.max(beyond / lengths[passing.vehicles], initial=0.0))

    @property
    def passing_averaged(self) -> Passing:
        """Waypoints of the smooth motion, if there is a smoothing."""
        return dataclasses.replace(self.passing, averaged=self.scenario.smoothing)

    @property
    def passing_tightened(self) -> Passing:
        """Waypoints of `passing_averaged`, tightened by the margins for a disturbance."""
        margins, passing = self.problem.margins, self.passing_averaged
        radii = margins.states.pointwise.at("position", passing.times)
        return dataclasses.replace(passing, within=passing.within - radii)

    @property
    def cost(self) -> float:
        """Cost of the motion [m²/s⁴], (13), with the penalty for missing free waypoints."""
        cost = cost_of(self.scenario, self.motion)
        return cost + self.passing.price * self.short if self.short > 0.0 else cost

    @cached_property
    def motion(self) -> Motion:
        """Motion of all vehicles."""
        return Motion.from_starts(self.scenario.fleet, self.accelerations, self.step)

    def with_stops_at_knots(self) -> Timed:
        """Return the motion as one to linearise around, with its stops at knots."""
        passing = self.passing.with_stops_at_knots(self.step, self.accelerations.shape[1])
        return dataclasses.replace(self, passing=passing)

    def to_rounding(self) -> Timed:
        """Return the motion with the least correction that passes the waypoints to rounding."""
        passing, effort = self.passing_tightened, self.problem.effort
        accelerations = self.accelerations.copy()
        at, _ = passing.states(self.motion)
        away = at - passing.positions
        far = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
        within = np.maximum(passing.within, 0.0)[:, None]
        missed = away * np.maximum(1.0 - within / far, 0.0)
        for i in np.unique(passing.vehicles):
            own = passing.vehicles == i
            rows = response_of("position", passing.averaged, self.grid, passing.times[own])
            lengths = np.linalg.norm(rows, axis=1, keepdims=True)
            ends, values = effort.goals.of(i)
            both = np.concatenate([ends, rows / lengths])
            if self.resting is not None:
                both[:, self.resting[i] :] = 0.0
            off = ends @ accelerations[i] - values
            residual = np.concatenate([off, missed[own] / lengths])
            accelerations[i] -= np.linalg.lstsq(both, residual)[0]
        return dataclasses.replace(self, accelerations=accelerations)

    def lasting(self, duration: float) -> Timed:
        """Return the motion scaled to another final time [s], with its free waypoints."""
        factor = duration / self.duration
        passing = self.passing.lasting(duration, self.duration)
        return dataclasses.replace(
            self,
            step=factor * self.step,
            accelerations=self.accelerations / factor**2,
            passing=passing,
            rows=(),
            reference=None,
        )

    def refined(self, scenario: Scenario) -> Timed:
        """Return the same motion on a grid with a multiple of its steps.

        Args:
            scenario: the scenario on such a grid.
        """
        ratio = (scenario.grid.knots - 1) // self.accelerations.shape[1]
        accelerations = np.repeat(self.accelerations, ratio, axis=1)
        passing = dataclasses.replace(self.passing, least=self.passing.least / ratio)
        return Timed(scenario, self.step / ratio, accelerations, passing)

    def linearised(self) -> list[Constraint]:
        """Return the constraints that row generation adds, linearised around the motion."""
        reference = self.reference or Plan.from_motion(self.problem.scenario, self.motion)
        constraints = [
            *(each for each in self.problem.boxes if each.quantity == "position"),
            *self.problem.requirements,
            *self.problem.avoidance(reference, coupled),
        ]
        if self.nearer is None:
            return constraints
        number, by = self.nearer
        return [
            dataclasses.replace(each, required=each.required - by)
            if isinstance(each, KeepOutOfObstacle) and each.number == number
            else each
            for each in constraints
        ]

    def after(self, found: FreeTime, rows: Sequence[HalfSpaces]) -> Timed:
        """Return the solution of a program around this motion, with its own final time."""
        root, passing = float(np.sqrt(found.factor)), self.passing
        times = np.where(passing.given, passing.times, (passing.times + found.changes) * root)
        passing = dataclasses.replace(passing, times=times, least=passing.least * root)
        later = [dataclasses.replace(each, times=each.times * root) for each in rows]
        accelerations = found.accelerations / found.factor
        step = self.step * root
        rests = self.resting
        return Timed(
            self.scenario, step, accelerations, passing, later, resting=rests, short=found.missed
        )


def latest(scenario: Scenario, passing: Passing) -> float:
    """Return a lower bound on the final time, from times of waypoints and requirements [s].

    Args:
        scenario: the scenario.
        passing: its waypoints.
    """
    before_end = [each.active[1] for each in scenario.requirements if each.active]
    ends = [*passing.ends, *(end - scenario.grid.start for end in before_end)]
    after = _AFTER / (scenario.grid.knots - 1)  # as a part of the final time
    return max([0.0, *map(float, ends)]) / (1.0 - after)
