"""Windows with a free final time: arrival at the earliest knot that has a plan, and rest after it.

The step of the grid stays, and the number of steps until the arrival falls. A motion that arrives
early and rests is a motion on the whole grid, so flights, tubes, clocks and files need no other
form. A window that continues the previous plan arrives when that plan does, never later.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from drake_rho.motion.flight import Window
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.horizon.interfaces import Planner
from drake_rho.planning.horizon.situation import WindowStart
from drake_rho.planning.horizon.waypoints_ahead import Free, sooner, until, with_waypoints
from drake_rho.planning.horizon.windows import WindowPlanner
from drake_rho.planning.programs.backend import Solver
from drake_rho.scenario.consistency import check_goals_at_rest
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.objective import TERMINAL, check_without
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.system.bisection import least_count
from drake_rho.verification.holds import first_violation

_ROUNDING = 1e-6
"""Fraction of a step before a knot within which a waypoint counts as at the knot."""


def check_rest_at_goals(scenario: Scenario) -> None:
    """Check that vehicles rest at their goals.

    Raises:
        ScenarioError: a vehicle moves at its goal, or has an acceleration after it.
    """
    expected = "0 with a free final time: vehicles rest at their goals after the arrival"
    check_goals_at_rest(scenario.vehicles, expected)
    check_without(scenario.objective, TERMINAL, expected)


def arrival_steps(plan: Plan) -> int:
    """Return the number of steps after which no vehicle accelerates any more."""
    moving = np.flatnonzero(plan.accelerations.any(axis=(0, 2)))
    return int(moving[-1]) + 1 if len(moving) > 0 else 0


def arriving(
    windows: WindowPlanner, free: Free, before: int, *, or_later: bool = False
) -> WindowPlanner:
    """Return the planner of windows that arrive as early as possible.

    Args:
        windows: planner of windows with a given final time.
        free: flags of waypoints with free times.
        before: number of steps until the previous plan arrives; in the first window, the number
            that the times of waypoints are for.
        or_later: whether the arrival may be after that of the previous plan.
    """
    # times found between given ones stay, so that waypoints keep their order
    free = tuple(own if all(own) else (False,) * len(own) for own in free)
    planner = EarlyArrival(windows.planner, free, before, or_later)
    fallback = windows.fallback and dataclasses.replace(planner, at_latest=windows.fallback)
    return dataclasses.replace(windows, planner=planner, fallback=fallback, retimed=True)


def next_window(windows: WindowPlanner, start: WindowStart) -> Window:
    """Return a window that arrives no later than the previous plan, as long as that is valid.

    Vehicles that have arrived stay. If the previous plan is no longer valid, or goals or waypoints
    are others, the arrival may become later.

    Args:
        windows: planner of windows with a given final time.
        start: rest of the flight and of the plan in force.
    """
    if start.has_new_orders:
        steps = start.scenario.grid.knots - 1
        return arriving(windows, start.free, steps, or_later=True).next(start)
    remaining, spent = start.remaining, Statistics()
    before = arrival_steps(remaining)
    if before > 0:
        earlier = arriving(
            dataclasses.replace(windows, braking_after=None, brakes=False), start.free, before
        )
        window = earlier.next(start)
        if window.kept or not window.infeasible:
            return window
        spent = window.statistics
    elif windows.still_holds(start):
        return Window(start.knot, remaining, remaining, kept=True)
    later = arriving(windows, start.free, before, or_later=True)
    return later.next(start).after(spent)


@dataclasses.dataclass(frozen=True)
class EarlyArrival:
    """Planner of windows that arrive at the earliest knot for which another planner finds a plan.

    A motion that arrives at a knot and rests also arrives by every later knot, so the earliest knot
    is found by exponential search and bisection: 1, 2, 4, ... steps are saved at a time until there
    is no plan, and then the number of steps is bisected.
    """

    planner: Planner
    """planner of a window with a given final time"""
    free: Free
    """flags of waypoints with free times"""
    before: int
    """number of steps until the arrival of the previous plan, with its times of waypoints"""
    or_later: bool = False
    """whether the arrival may be after that of the previous plan"""
    at_latest: Planner | None = None
    """planner for the latest arrival, from which fewer steps are tried; `planner` if not given"""

    def __call__(
        self, scenario: Scenario, *, reference: Plan | None, solver: Solver | None
    ) -> Plan:
        """Return a plan for `scenario` in which vehicles rest at their goals after the arrival.

        Raises:
            InfeasibleError: there is no plan with the latest arrival.
            OutOfTimeError: time was up before there was one.
            SolverError: the solvers fail numerically.
        """
        steps = scenario.grid.knots - 1 if self.or_later else self.before
        avoids = scenario.avoided or scenario.separation is not None
        best = self._plan(self.at_latest or self.planner, scenario, steps, reference, solver)
        spent = best.statistics

        def arrives(fewer: int) -> bool:
            nonlocal best, spent
            references = (None, best) if avoids and reference is None else (reference,)
            found, more = self._plan_around(scenario, fewer, references, solver)
            best, spent = found or best, spent + more
            return found is not None

        with suppress(OutOfTimeError):
            least_count(arrives, self._passed(scenario), steps, gallop=True)
        return best.with_statistics(spent)

    def _plan_around(
        self,
        scenario: Scenario,
        steps: int,
        references: Iterable[Plan | None],
        solver: Solver | None,
    ) -> tuple[Plan | None, Statistics]:
        """Return the first plan around one of several references, or None, and statistics."""
        spent = Statistics()
        for each in references:
            try:
                plan = self._plan(self.planner, scenario, steps, each, solver)
            except (InfeasibleError, SolverError, ScenarioError, MemoryError) as error:
                spent += getattr(error, "statistics", Statistics())
            else:
                return plan, spent + plan.statistics
        return None, spent

    def _passed(self, scenario: Scenario) -> int:
        """Return the number of steps that begin before the last waypoint with a given time ends."""
        grid, last = scenario.grid, scenario.grid.start
        for own, vehicle in zip(self.free, scenario.vehicles, strict=True):
            for one, each in zip(own, vehicle.waypoints, strict=True):
                if not one and each.time is not None:
                    last = max(last, each.time + each.dwell)
        return int(grid.since_start(last) / grid.step + _ROUNDING)

    def _plan(
        self,
        planner: Planner,
        scenario: Scenario,
        steps: int,
        reference: Plan | None,
        solver: Solver | None,
    ) -> Plan:
        """Return a planner's plan with an arrival after a number of steps.

        Raises:
            InfeasibleError: there is none, or it violates a constraint after the arrival.
        """
        whole = scenario.grid.knots - 1
        if steps == self.before == whole:
            return planner(scenario, reference=reference, solver=solver)
        short = shortened(scenario, self.free, steps, steps / max(self.before, 1))
        if reference is not None:  # moved to measured states, it does not rest exactly
            reference = in_steps(reference, short, min(arrival_steps(reference), self.before))
        return rested(planner(short, reference=reference, solver=solver), scenario)


def shortened(scenario: Scenario, free: Free, steps: int, factor: float) -> Scenario:
    """Return the scenario of a window that ends after some of its steps.

    Args:
        scenario: scenario of the window.
        free: flags of waypoints with free times.
        steps: number of steps.
        factor: factor on these times since the first knot.

    Raises:
        InfeasibleError: a waypoint is not passed before the end.
    """
    grid = Grid(scenario.grid.step, steps + 1, scenario.grid.start)
    vehicles = tuple(
        sooner(vehicle, own, grid.start, factor)
        for vehicle, own in zip(scenario.vehicles, free, strict=True)
    )
    short = until(scenario, grid, vehicles)
    for one, other in zip(short.vehicles, vehicles, strict=True):
        if len(one.waypoints) < len(other.waypoints):
            late = {one.name: ("waypoints",)}
            raise InfeasibleError(late, scenario=scenario, because="passed after the arrival")
    return short


def in_steps(plan: Plan, short: Scenario, arrival: int) -> Plan:
    """Return a reference that arrives at the end of another scenario: a plan scaled in time.

    It passes the positions of the plan until its arrival, and may be dynamically inconsistent.

    Args:
        plan: motion that arrives, and may rest then.
        short: scenario of the same vehicles with the same step and start.
        arrival: number of steps after which it arrives.
    """
    steps = short.grid.knots - 1
    if arrival in (0, steps):
        positions, velocities = plan.positions[:, : steps + 1], plan.velocities[:, : steps + 1]
        return Plan(short, positions, velocities, plan.accelerations[:, :steps])
    factor, motion = arrival / steps, plan.motion()
    times = np.minimum(factor * short.grid.elapsed, arrival * short.grid.step)
    middles: FloatArray = (times[1:] + times[:-1]) / 2.0
    return Plan(
        short,
        motion.at("position", times),
        factor * motion.at("velocity", times),
        factor**2 * motion.at("acceleration", middles),
    )


def rested(plan: Plan, scenario: Scenario) -> Plan:
    """Return a plan as one of a longer scenario, in which vehicles rest at their goals afterwards.

    Args:
        plan: plan of a shortened scenario.
        scenario: scenario of the window.

    Raises:
        InfeasibleError: it violates a constraint of the whole scenario.
    """
    whole = with_waypoints(scenario, plan.scenario.vehicles)
    more = scenario.grid.knots - plan.scenario.grid.knots
    accelerations = np.pad(plan.accelerations, ((0, 0), (0, more), (0, 0)))
    found = Plan.from_accelerations(whole, accelerations, plan.statistics)
    if (violated := first_violation(found)) is None:
        return found
    raise InfeasibleError(
        {violated.vehicle: (violated.what,)},
        statistics=plan.statistics,
        scenario=scenario,
        because="the plan violates a constraint with this arrival",
    )
