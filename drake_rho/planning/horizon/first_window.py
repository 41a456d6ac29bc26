"""First window of a flight, which also finds the times of free waypoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from drake_rho.motion.flight import Window
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.horizon.free_final_time import arrival_steps, arriving
from drake_rho.planning.horizon.interfaces import Planner
from drake_rho.planning.horizon.waypoints_ahead import free_of, timed_as, until
from drake_rho.planning.horizon.windows import WindowPlanner
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True)
class FirstWindow:
    """Planner of the first window of a flight."""

    windows: WindowPlanner
    """planner of windows with given times"""
    times: Planner
    """planner that finds the times of free waypoints, for a given final time"""
    measured: Callable[[Scenario], Scenario]
    """function that returns a scenario from the measured states, itself if these are its starts"""
    free_final_time: bool
    """whether the arrival may be before the last knot"""

    def of(self, scenario: Scenario) -> Window:
        """Return the first window of a scenario.

        With a free final time, times of waypoints are found again for an arrival one step earlier,
        until no plan is found.

        Raises:
            InfeasibleError: the scenario has no plan from its own starts.
            OutOfTimeError: time was up before there was one.
            SolverError: the solvers fail numerically.
        """
        steps = scenario.grid.knots - 1
        if not any(map(any, free_of(scenario))):
            return self._window(scenario, scenario, steps)
        best = self._with_times(scenario, steps)
        while self.free_final_time and not best.infeasible:
            fewer = arrival_steps(best.plan) - 1
            if fewer < 1:
                break
            try:
                again = self._with_times(scenario, fewer)
            except (InfeasibleError, SolverError, OutOfTimeError, ScenarioError, MemoryError) as e:
                return best.after(getattr(e, "statistics", Statistics()))
            if again.infeasible:
                return best.after(again.statistics)
            best = again.after(best.statistics)
        return best

    def _with_times(self, scenario: Scenario, steps: int) -> Window:
        """Return a window with waypoint times found for an arrival after some steps."""
        grid = dataclasses.replace(scenario.grid, knots=steps + 1)
        short = until(scenario, grid, scenario.vehicles) if grid != scenario.grid else scenario
        found = self.times(short, reference=None, solver=self.windows.solver)
        timed = timed_as(scenario, found.scenario)
        return self._window(scenario, timed, steps).after(found.statistics)

    def _window(self, given: Scenario, timed: Scenario, steps: int) -> Window:
        """Return a window that arrives after some steps, or fewer if the final time is free."""
        windows = self.windows
        if self.free_final_time:
            windows = arriving(windows, free_of(given), steps)
        return windows.first(timed, self.measured(timed))
