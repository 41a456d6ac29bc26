"""Sensitivity of the least time to limits, by relaxing each limit slightly in turn."""

from __future__ import annotations

import numpy as np

from drake_rho.analysis.relaxations import Relaxation, relaxations_of
from drake_rho.analysis.sensitivity import LimitEffect, TimeSensitivity
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.errors import OutOfTimeError, SolverError
from drake_rho.planning.planners.related import is_steady
from drake_rho.planning.planners.waypoint_times import GAP
from drake_rho.planning.programs.free_times import Passing
from drake_rho.planning.scp.least_time import ROUGH, LeastTime
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.gates import Gates
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.waypoints import AllWaypoints

_STEP_BOUND = 0.02
"""Step bound on times in a program with a relaxed limit, as a part of the final time."""

_LONGER = 0.01
"""Relative fall of the final time above which a plan is not of least time."""

_EFFECT = 1e-5
"""Least effect that counts: the least time has converged to no more digits."""

_SHARE = 0.1
"""Part of a limit's effect that a vehicle has to contribute to be named."""


class SensitivityAnalysis:
    """Sensitivity of the least time of one plan to each of its limits.

    The program with a free final time around the plan is solved once with every limit as it is, and
    once with each limit slightly relaxed. At a local optimum the difference is the change of the
    least time to first order: the program's rows are tangents of curved limits and motions.

    Args:
        plan: plan in the least time.
        planned: scenario that was planned for; waypoints without a time there are free. All are
            free if not given.
        progress: called with a short description of the current step.

    Raises:
        ScenarioError: nothing bounds the time.
        SolverError: the solvers fail numerically.
        ValueError: the plan takes longer than plans near it.
    """

    def __init__(self, plan: Plan, planned: Scenario | None, progress: Progress | None) -> None:
        self._timed = timed_of(plan, planned)
        scenario, passing = self._timed.scenario, self._timed.passing
        steady = is_steady(scenario) and not passing.given.any()
        self._least, self._progress = LeastTime(ROUGH, progress, steady=steady), progress
        tell(progress, "looking for less time near the plan")
        least = self._duration(self._timed)
        if least is None:
            raise SolverError("the solvers found no motion near the plan")
        if least < (1.0 - _LONGER) * self._timed.duration:
            raise ValueError(
                f"plan: got one of {self._timed.duration:.6g} s, near which there is one of about "
                f"{least:.6g} s, expected a plan of least time (`plan_minimum_time`, `drake-rho "
                "fastest`)"
            )
        self._without = least

    def result(self) -> TimeSensitivity:
        """Return the sensitivities found within the time limit."""
        effects, cut = list[LimitEffect](), False
        scenario = self._timed.scenario
        try:
            for each in relaxations_of(self._timed):
                tell(self._progress, f"trying {each.limit}, {each.change}")
                less = self._less(each, each.vehicles)
                if less * each.size > 0.0 and less > _EFFECT:
                    who = self._needing(each, less)
                    names = tuple(scenario.names[i] for i in who)
                    effects.append(LimitEffect(each.limit, each.change, less, names))
        except OutOfTimeError:
            cut = True
        effects.sort(key=lambda each: -each.rounded)  # equal ones in the scenario's order
        return TimeSensitivity(scenario, self._timed.duration, tuple(effects), cut)

    def _needing(self, relaxation: Relaxation, less: float) -> IntArray:
        """Return the vehicles that contribute to a relaxation's effect."""
        who = relaxation.vehicles
        if len(who) == 1 or not relaxation.for_each:
            return who
        lost = np.array([less - self._less(relaxation, who[who != i]) for i in who])
        return who[lost > _SHARE * less]

    def _less(self, relaxation: Relaxation, vehicles: IntArray) -> float:
        """Return the relative fall of the final time per change of unit size."""
        found = self._duration(relaxation.relaxed(self._timed, vehicles))
        if found is None:
            return 0.0
        return (1.0 - found / self._without) / relaxation.size

    def _duration(self, timed: Timed) -> float | None:
        """Return the final time of the program around a motion [s]; None if there is none."""
        found = self._least.linearised(timed, _STEP_BOUND)
        return None if found is None else found.duration


def timed_of(plan: Plan, planned: Scenario | None) -> Timed:
    """Return the motion of a plan with the times of its waypoints.

    Args:
        plan: the plan.
        planned: scenario with the given waypoint times; all are free if not given.

    Raises:
        ValueError: the scenario has other vehicles or waypoints.
    """
    scenario, grid = plan.scenario, plan.scenario.grid
    waypoints = AllWaypoints.of(scenario.vehicles)
    given = np.zeros(len(waypoints), dtype=bool)
    if planned is not None:
        wanted = AllWaypoints.of(planned.vehicles)
        if planned.names != scenario.names or not np.array_equal(
            waypoints.positions, wanted.positions
        ):
            got = f"{planned.name} with other vehicles or waypoints"
            raise ValueError(f"planned: got {got}, expected the scenario of the plan")
        given = wanted.given
    passing = Passing(
        waypoints.vehicles,
        waypoints.times - grid.start,
        waypoints.positions,
        waypoints.within,
        given,
        GAP * grid.step,
        gates=Gates.of(scenario.requirements, scenario.vehicles),
    )
    free = scenario.without_waypoints()
    return Timed(free, grid.step, plan.accelerations, passing)
