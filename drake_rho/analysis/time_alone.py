"""Least time of each vehicle alone, subject to its limits and permanent requirements."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from drake_rho.analysis.infeasible_subset import infeasible_subset
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.planners.convex import linearised_once
from drake_rho.planning.planners.first_plan import first_plan
from drake_rho.planning.planners.related import is_steady, of_each_alone
from drake_rho.planning.planners.waypoint_times import GAP, in_least_time, passing_of
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.free_times import Passing
from drake_rho.planning.scp.least_time import CONVERGED, ROUGH, LeastTime
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.gates import Gates
from drake_rho.scenario.records import Grid, Scenario, State, Waypoint
from drake_rho.scenario.waypoints import AllWaypoints

_COARSE, _REFINED = 6, 1e-3
"""Steps of a leg in the coarse search for waypoint times, and the first step bound of the refined
search, as a part of the final time."""

_LONGER = 1.0, 1e3, 1e6
"""First guesses of the step, as multiples of the scenario's, tried in order."""

_LATER = 1.0, 2.0, 4.0, 8.0
"""First guesses of the final time, as multiples of the scenario's, if waypoints have times."""

_SLOWER = 1.0, 1.3, 1.7, 2.2, 3.0, 4.0
"""First guesses of the final time, as multiples of that without the velocities of gates."""

_AT_ONCE = 1e-6
"""Step of a vehicle that stays where it is, as a part of the scenario's."""

_ROUGHLY = 1e-3
"""Convergence tolerance of the coarse search on the final time."""


class TimesAlone:
    """Search for the least time of each vehicle alone.

    Args:
        scenario: the scenario, without waypoints.
        waypoints: the waypoints of all vehicles.
        gates: what else is required at these; None for nothing.
        backend: solver for the reason why there is no motion.
        progress: called with the final time after each iteration.

    Attributes:
        statistics: statistics of all programs.
        durations: least time of each vehicle [s], 0 if it is not known, shape (N,).
    """

    def __init__(
        self,
        scenario: Scenario,
        waypoints: AllWaypoints,
        gates: Gates | None,
        backend: Backend,
        progress: Progress | None,
    ) -> None:
        self._scenario, self._waypoints = scenario, waypoints
        self._gates, self._backend, self._progress = gates, backend, progress
        self.statistics = Statistics()
        self.durations = np.zeros(len(scenario.vehicles))

    @property
    def bound(self) -> float | None:
        """Lower bound on the final time of every plan [s]; None if it is not known.

        From rest to rest without waypoints the least time of one vehicle is that of a convex
        program. Obstacles, other vehicles and a disturbance leave fewer motions.
        """
        moving = not self._scenario.fleet.are_at_rest
        without = np.bincount(self._waypoints.vehicles, minlength=len(self.durations)) == 0
        if moving or not without.any():
            return None
        return float(self.durations[without].max()) or None

    def motion(self, *, reduce_effort: bool = False) -> Timed:
        """Return the least-time motion of each vehicle alone (`of_each_alone`).

        All are scaled to the final time of the slowest one. If waypoints have given times, the
        motion is a feasible one, not one of least time.

        Args:
            reduce_effort: whether the faster vehicles reduce their effort in this time.
        """
        tell(self._progress, "looking for the least time of each vehicle alone")
        free = of_each_alone(self._scenario)
        if self._waypoints.given.any():
            return self._with_given_times(free)
        passing = passing_of(self._waypoints, free, free.grid, self._gates)
        each = [self._one(free, passing, i) for i in range(len(free.vehicles))]
        self.durations = np.array([one.duration if one.converged else 0.0 for one in each])
        if not any(one.accelerations.any() for one in each):
            given = Description("goals at the starts, and no waypoints")
            raise ScenarioError("vehicles", given, "a motion, without which the least time is zero")
        slowest = max(each, key=lambda one: one.duration)
        scaled = [one.lasting(slowest.duration) for one in each]
        if reduce_effort:
            scaled = [
                one if one.duration == before.duration else self._of_less_effort(one)
                for one, before in zip(scaled, each, strict=True)
            ]
        accelerations = np.concatenate([one.accelerations for one in scaled])
        times = np.concatenate([one.passing.times for one in scaled])
        passing = dataclasses.replace(passing, times=times, least=GAP * slowest.step)
        converged = all(one.converged for one in each)
        return Timed(free, slowest.step, accelerations, passing, converged=converged)

    def _with_given_times(self, free: Scenario) -> Timed:
        """Return a motion within the limits through waypoints at given times, if one is found.

        Args:
            free: scenario without obstacles and other vehicles.
        """
        starts = list[Timed]()
        for longer in _LATER:
            grid = dataclasses.replace(free.grid, step=longer * free.grid.step)
            passing = passing_of(self._waypoints, free, grid, self._gates)
            accelerations = first_guess(free.ending_with(grid))
            starts.append(Timed(free, grid.step, accelerations, passing))
            if longer == _LATER[0] and not self._requires_slowness:
                LeastTime(ROUGH).check_bounded(starts[0])
            with suppress(SolverError):
                found, least = in_least_time(starts[-1], ROUGH, self._progress)
                if least <= found.duration:
                    return found
        return starts[0]

    @property
    def _requires_slowness(self) -> bool:
        """Whether a requirement of the scenario limits velocities, accelerations or jerks."""
        return any(each.quantity != "position" for each in self._scenario.requirements)

    def _one(self, free: Scenario, passing: Passing, number: int) -> Timed:
        """Return the least-time motion of one vehicle.

        Args:
            free: scenario without obstacles and other vehicles.
            passing: waypoints of all vehicles.
            number: index of the vehicle.
        """
        scenario, own = free.of_vehicles([number]), passing.vehicles == number
        for longer in _LONGER:
            grid = dataclasses.replace(scenario.grid, step=longer * scenario.grid.step)
            later = dataclasses.replace(passing.of(own), times=longer * passing.times[own])
            found = None
            with suppress(SolverError):
                found = self._from_guess(scenario.ending_with(grid), later)
            if found is not None:
                return found
        if passing.gates is not None:
            with suppress(InfeasibleError, SolverError):
                fast = self._one(free, dataclasses.replace(passing, gates=None), number)
                if (found := self._through_gates(fast, passing.of(own))) is not None:
                    return found
        if not is_steady(scenario):  # a start or a goal in motion
            with suppress(ScenarioError):  # where velocities or requirements do not allow rest
                found = self._one(at_rest(scenario), passing.of(own), 0)
                return dataclasses.replace(found, scenario=scenario, rows=(), converged=False)
        raise no_plan_alone(scenario, self._backend)

    def _from_guess(self, scenario: Scenario, passing: Passing) -> Timed | None:
        """Return the least-time motion of one vehicle from a guess; None if there is none.

        Args:
            scenario: scenario of the vehicle, with a guess of the step.
            passing: its waypoints.
        """
        least = LeastTime(ROUGH, self._progress, steady=passing.is_scale_free)
        grid, count = scenario.grid, len(passing)
        if Problem.of(scenario).effort.unreachable.any():
            return None
        accelerations = first_guess(scenario)
        if count == 0 and not accelerations.any():  # it stays where it is
            step = grid.step * _AT_ONCE
            return Timed(scenario, step, accelerations, passing, converged=True)
        ratio = coarsening(grid.knots - 1, 1 + count)
        coarse = Grid(grid.step * ratio, (grid.knots - 1) // ratio + 1, grid.start)
        rough = scenario.ending_with(coarse)
        start = Timed(rough, coarse.step, first_guess(rough), passing)
        found = least.around(start, _ROUGHLY if ratio > 1 else CONVERGED)
        if found is not None and ratio > 1:
            found = least.around(found.refined(scenario), reach=_REFINED)
        self.statistics += least.statistics
        return found

    def _through_gates(self, fast: Timed, passing: Passing) -> Timed | None:
        """Return the least-time motion of one vehicle from one that is slow enough for its gates.

        Args:
            fast: motion through its waypoints that need not have the velocities of gates.
            passing: the waypoints.
        """
        for longer in _SLOWER:
            times = longer * fast.passing.times
            slow = dataclasses.replace(
                fast,
                step=longer * fast.step,
                passing=dataclasses.replace(passing, times=times),
                rows=(),
            )
            with suppress(InfeasibleError, SolverError, ScenarioError):
                plan = linearised_once(_at_given_times(slow), None, self._backend)
                start = dataclasses.replace(slow, accelerations=plan.accelerations)
                least = LeastTime(ROUGH, self._progress, steady=passing.is_scale_free)
                found = least.around(start)
                self.statistics += least.statistics
                if found is not None:
                    return found
        return None

    def _of_less_effort(self, timed: Timed) -> Timed:
        """Return the motion of least effort in the same time."""
        least = LeastTime(ROUGH, self._progress, final_time=False)
        found = least.around(timed) or timed
        self.statistics += least.statistics
        return found


def _at_given_times(timed: Timed) -> Problem:
    """Return the convex problem of one vehicle with its waypoints at the times of a motion."""
    scenario, passing = timed.problem.scenario, timed.passing
    clock = scenario.grid.start + passing.times
    waypoints = tuple(
        Waypoint(float(time), position, float(within))
        for time, position, within in zip(clock, passing.positions, passing.within, strict=True)
    )
    (vehicle,) = scenario.vehicles
    return Problem.of(scenario.derived(vehicles=(unchecked(vehicle, waypoints=waypoints),)))


def first_guess(scenario: Scenario) -> FloatArray:
    """Return accelerations of least effort to the goals, or to nominal ones, (N, K-1, 3)."""
    fleet = scenario.fleet
    if fleet.given_positions.all():
        return Problem.of(scenario).effort.motion.accelerations
    vehicles = tuple(
        unchecked(each, goal=State(position, velocity if each.goal.velocity is not None else None))
        for each, position, velocity in zip(
            scenario.vehicles, fleet.goal_positions, fleet.goal_velocities, strict=True
        )
    )
    return Problem.of(scenario.derived(vehicles=vehicles)).effort.motion.accelerations


def at_rest(scenario: Scenario) -> Scenario:
    """Return a scenario with starts and goals at rest; its least time is a guess."""
    vehicles = tuple(
        dataclasses.replace(each, start=State(each.start.position), goal=State(goal))
        for each, goal in zip(scenario.vehicles, scenario.fleet.goal_positions, strict=True)
    )
    return dataclasses.replace(scenario, vehicles=vehicles)


def coarsening(steps: int, legs: int) -> int:
    """Return the coarsening factor of the grid for the first search for waypoint times.

    A coarse grid gives most of these times at a fraction of the cost.

    Args:
        steps: number of steps.
        legs: number of legs between start, waypoints and goal.
    """
    if legs == 1:
        return 1
    fitting = [each for each in range(1, steps + 1) if steps % each == 0]
    return max(each for each in fitting if each == 1 or steps >= _COARSE * legs * each)


def no_plan_alone(scenario: Scenario, backend: Backend) -> Exception:
    """Return the error for vehicles without a motion of any duration, even without obstacles."""
    grid = dataclasses.replace(scenario.grid, step=_LONGER[1] * scenario.grid.step)
    try:
        first_plan(Problem.of(scenario.ending_with(grid)), backend=backend)
    except InfeasibleError as error:
        return in_no_time([error], backend)
    except SolverError as error:
        return error
    conflicts = {each.name: ("waypoints in their order",) for each in scenario.vehicles}
    because = f"no motion on {scenario.grid.knots} knots passes these in any time; more knots may"
    return InfeasibleError(conflicts, because=because)  # the scenario has no waypoints here


def in_no_time(errors: Sequence[InfeasibleError], backend: Backend) -> InfeasibleError:
    """Return the error of a scenario without a plan for any final time.

    The first conflict that does not involve the goal is the most informative: the others may only
    show that the final time is too short.

    Args:
        errors: errors of the final times tried, the longest last.
        backend: solver that reduces the conflicts.
    """
    for error in errors:
        if error.scenario is None or error.because:
            return error
        duration, conflicts = error.scenario.grid.duration, error.conflicts
        with suppress(SolverError):
            conflicts = infeasible_subset(error, solver=backend.solver)
        if not any(name.startswith("goal") for each in conflicts.values() for name in each):
            break
    premise = f" {error.premise}" if error.premise else ""
    return InfeasibleError(
        conflicts,
        scenario=error.scenario,
        statistics=error.statistics,
        obstacles=error.obstacles,
        reference=error.reference,
        because=f"in no final time that was tried; in {duration:.4g} s these cannot be met "
        f"together{premise}",
    )
