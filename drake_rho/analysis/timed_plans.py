"""Plans from least-time motions, which meet every limit despite rounding."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.constraints.tightening import CANNOT_HOLD, missing_slack_at_rest
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.least_time import LeastTime
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.waypoints import AllWaypoints
from drake_rho.verification.verify import verify

_SLOWER = 0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4
"""Relative increases of a final time, tried until the motion meets every limit."""

_ROUNDS = 3
"""Number of programs that are solved to more digits. With a smoothing, waypoints are exact only in
the final time around which a program is linearised, since the width of averages is fixed."""


class TimedPlans:
    """Plans of one scenario with optimised final and waypoint times.

    Args:
        scenario: scenario to plan for.
        waypoints: its waypoints.
        progress: called with a description of the current step.
        steady: whether only the motion depends on time.

    Attributes:
        statistics: statistics of all programs.
    """

    def __init__(
        self,
        scenario: Scenario,
        waypoints: AllWaypoints,
        progress: Progress | None,
        *,
        steady: bool,
    ) -> None:
        self._given, self._waypoints = scenario, waypoints
        self._progress, self._steady = progress, steady
        self.statistics = Statistics()

    def scenario(self, grid: Grid, times: FloatArray) -> Scenario:
        """Return the scenario on a grid, with waypoints at times since the first knot [s], (W,)."""
        vehicles = self._waypoints.placed(self._given.vehicles, grid.start + times)
        return self._given.ending_with(grid, vehicles)

    def of(self, best: Timed) -> Plan:
        """Return a motion as a plan.

        If rounding errors exceed limits, the motion is slowed by a few of them. If that does not
        suffice, a program is solved to more digits, with slightly more time if necessary.

        Raises:
            InfeasibleError: vehicles cannot hold at their goals from this time on, as required.
            SolverError: the motion violates a constraint.
        """
        plan = self._met(best) or self._in_little_more_time(best)
        if conflicts := missing_slack_at_rest(plan.scenario):
            raise InfeasibleError(conflicts, scenario=plan.scenario, because=CANNOT_HOLD)
        return plan

    def _in_little_more_time(self, best: Timed) -> Plan:
        """Return a plan near a motion, with as little more time as necessary.

        Raises:
            SolverError: it violates a constraint.
        """
        least = LeastTime(Backend(), self._progress, steady=self._steady)
        exact = best
        try:
            for part in _SLOWER:
                slower = best.lasting((1.0 + part) * best.duration) if part > 0.0 else best
                for _ in range(1 + _ROUNDS if self._given.smoothing else 1):
                    if (found := least.near(slower)) is None:
                        break
                    exact = slower = found
                    if (plan := self._met(exact)) is not None:
                        return plan
                if self._steady and exact is not best:  # the final time was free already
                    break
        finally:
            self.statistics += least.statistics
        plan = self._plan(exact)
        if not (verify(plan).ok or missing_slack_at_rest(plan.scenario)):
            raise SolverError("the motion that the solvers found does not meet every constraint")
        return plan

    def _met(self, best: Timed) -> Plan | None:
        """Return a motion as a plan, slowed by a few rounding errors if necessary, or None."""
        for motion in (best, best.to_rounding()) if len(best.passing) > 0 else (best,):
            for slower in _SLOWER if self._steady else _SLOWER[:1]:
                plan = self._plan(motion.lasting((1.0 + slower) * motion.duration))
                if Subproblem(Problem.of(plan.scenario)).holds(plan):
                    return plan
        return None

    def _plan(self, timed: Timed) -> Plan:
        """Return the plan of a motion, with goals reached to rounding.

        Raises:
            SolverError: a place is passed at a time at which the scenario does not allow it.
        """
        try:
            problem = Problem.of(self.scenario(timed.grid, timed.passing.times))
        except ScenarioError as error:  # the times are those found, not the user's
            raise SolverError(f"the motion found is at a place that is taken: {error}") from None
        every = np.arange(len(problem))
        accelerations = problem.effort.goals.met_by(timed.accelerations, every)
        return Plan.from_accelerations(problem.scenario, accelerations)
