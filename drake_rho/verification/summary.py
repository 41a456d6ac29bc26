"""`Summary`: top speed, time and cost of a motion, for the first lines of a report."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np

from drake_rho.motion.costs import costs_by_term
from drake_rho.motion.flown import Flown
from drake_rho.motion.jumps import Jump, largest_jump
from drake_rho.motion.plan import Plan
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.verification.check import PRECISION
from drake_rho.verification.keep_in import Constrained
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import NO_ERRORS


@dataclasses.dataclass(frozen=True, kw_only=True)
class Summary(metaclass=Described):
    """Top speed, time and cost of a plan, a flight or a simulation."""

    top_speed: float
    """largest speed of all vehicles [m/s]"""
    fastest: str
    """name of the vehicle that reaches it"""
    fastest_at: float
    """time of the top speed on the scenario's clock [s]"""
    start: float
    """time at which the motion begins: the first knot unless smoothed [s]"""
    end: float
    """time at which the motion ends: the last knot unless smoothed [s]"""
    cost: float
    """cost of the plan [m²/s⁴], the performance index f (13) or that of the scenario's objective"""
    costs: Mapping[str, float]
    """cost by term of the objective [m²/s⁴], of those with a weight"""
    least_effort: float | None
    """least cost of all motions from the starts to the goals, without limits, obstacles and
    separation [m²/s⁴]: a lower bound on the cost of every plan; None with another objective"""
    minimised: Literal["cost", "time"] | None = "cost"
    """what the planner minimised, the cost or the final time; None for a simulation, whose motion
    the wind changes, and for a plan of least time that is held at its goals"""
    time_bound: float | None = None
    """time that every plan on as many knots takes at least [s]; None if it is not known"""
    cost_bound: float | None = None
    """largest cost of a flight with bounded costs, known from its first window [m²/s⁴]"""
    largest_jump: Jump | None = None
    """largest jump of a flight whose windows began at measured states; None if there is none"""

    @classmethod
    def of(cls, trajectory: PiecewiseTrajectory, flown: Flown) -> Summary:
        """Return the summary of a plan, flight or simulation with its trajectory.

        The top speed is that of the motion itself, without errors.
        """
        scenario = trajectory.scenario
        exact = dataclasses.replace(trajectory, tubes=NO_ERRORS)
        precision = PRECISION * TOLERANCE * scenario.fleet.scale("velocity")
        found = Constrained.by_all(exact, "velocity", _length, precision).greatest()
        vehicle = int(np.argmax(found.values))
        return cls(
            top_speed=float(found.values[vehicle]),
            fastest=scenario.vehicles[vehicle].name,
            fastest_at=float(scenario.grid.start + found.times[vehicle]),
            start=scenario.grid.start - scenario.lead,
            end=scenario.grid.end + scenario.lead,
            cost=flown.cost,
            costs=_by_term(scenario, flown.plan),
            least_effort=least_effort(scenario) if scenario.objective.is_effort else None,
            minimised=None if flown.simulation else flown.statistics.minimised,
            time_bound=flown.statistics.time_bound,
            cost_bound=flown.windows[0].cost_bound if flown.windows else None,
            largest_jump=None if flown.simulation else largest_jump(flown.plan),
        )


def _length(who: IntArray, x: FloatArray, times: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(x, axis=-1))


def _by_term(scenario: Scenario, plan: Plan) -> dict[str, float]:
    if scenario.objective.is_effort:
        return {"effort": plan.cost}
    every = costs_by_term(scenario, plan).items()
    return {term: float(costs.sum()) for term, costs in every}


def least_effort(scenario: Scenario) -> float:
    """Return the least cost of all motions from the starts to the goals [m²/s⁴].

    It is the least sum of squares among the solutions of the terminal equalities (12), linear
    equations of the accelerations of each axis. The planner's own closed form is not used.
    """
    fleet, grid = scenario.fleet, scenario.grid
    steps, h, duration = grid.knots - 1, grid.step, grid.duration
    remaining = duration - h * (np.arange(steps) + 0.5)  # from the middle of a step to the end
    # positions in units of h T and velocities in h, so that both rows are of similar size
    rows = np.array([remaining / duration, np.ones(steps)])
    drift = fleet.start_positions + duration * fleet.start_velocities
    changes = np.array(
        [
            (fleet.goal_positions - drift) / (h * duration),
            (fleet.goal_velocities - fleet.start_velocities) / h,
        ]
    )
    least, *_ = np.linalg.lstsq(rows, changes.reshape(2, -1), rcond=None)
    efforts = np.sum(least.reshape(steps, -1, 3) ** 2, axis=(0, 2))
    return float(fleet.weights @ efforts)
