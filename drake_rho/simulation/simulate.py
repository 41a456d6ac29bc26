"""`simulate`: closed-loop simulation of a receding horizon in wind, in Drake's simulator."""

from __future__ import annotations

from typing import Literal

import numpy as np

from drake_rho.motion.simulation import Simulation
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.horizon.windows import Planner
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario
from drake_rho.simulation import winds
from drake_rho.simulation.diagram import simulated
from drake_rho.simulation.winds import Wind


@checked
def simulate(
    scenario: Scenario,
    *,
    replan_every: int = 5,
    planner: Planner = plan_convex,
    fallback: Planner | None = best_plan,
    wind: Wind | None = None,
    plant: Literal["quadrotor"] | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Fly a scenario with a receding horizon and feedback in wind, in Drake's simulator.

    Args:
        scenario: scenario to fly; without a `disturbance` there is no feedback between windows.
        replan_every: number of steps flown of each window.
        planner: planner of a window.
        fallback: planner of a window for which `planner` finds no plan.
        wind: a wind of `rho.winds`, `rho.worst_case`, or a function of time [s], positions [m] and
            velocities [m/s], (N, 3) each, to accelerations [m/s²], (N, 3); none if not given.
        plant: point masses if not given; `"quadrotor"` for Drake's `QuadrotorPlant`, each with a
            controller of thrust and attitude.
        rng: source of random estimation errors; without it there are none, unless the wind brings
            its own.
        progress: called with a short text when a window begins, as 'window 3 of 10'.

    Returns:
        The true motion, with windows, winds and commands. Equal arguments and equally seeded
        generators give bit-equal motions.

    Raises:
        InfeasibleError: the first window has no plan.
        SolverError: the solvers fail numerically in the first window.
        ValueError: an argument is invalid.

    Examples:
        >>> scenario = rho.load_scenario("courier")
        >>> flown = rho.simulate(scenario, wind=rho.winds.constant(scenario, [0, 1, 0]))
        >>> rho.verify(flown).ok
        True
    """
    horizon = RecedingHorizon(
        scenario,
        replan_every=replan_every,
        planner=planner,
        fallback=fallback,
        progress=progress,
    )
    return simulated(horizon, winds.none() if wind is None else wind, plant, rng)
