"""`Summary`: top speed, time and cost of a motion, for the first lines of a report."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np

from drake_rho.motion.costs import costs_by_term
from drake_rho.motion.deviations import Deviation, largest_deviation
from drake_rho.motion.flown import Planned
from drake_rho.motion.jumps import largest_jump
from drake_rho.motion.plan import Plan
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.goals import set_in
from drake_rho.scenario.nominal_goals import project
from drake_rho.scenario.parts import Vehicle
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
    largest_jump: Deviation | None = None
    """largest jump of a flight whose windows began at measured states; None if there is none"""
    largest_deviation: Deviation | None = None
    """largest deviation of measured positions from the planned motion; None without measurements"""

    @classmethod
    def of(cls, trajectory: PiecewiseTrajectory, flown: Planned) -> Summary:
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
            largest_deviation=largest_deviation(flown.flight),
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
    if not (fleet.given_positions.all() and fleet.given_velocities.all()):
        return _least_of_any(scenario, h * rows * [[duration], [1.0]])
    least, *_ = np.linalg.lstsq(rows, changes.reshape(2, -1), rcond=None)
    efforts = np.sum(least.reshape(steps, -1, 3) ** 2, axis=(0, 2))
    return float(fleet.weights @ efforts)


def _least_of_any(scenario: Scenario, rows: FloatArray) -> float:
    """Return the least effort of vehicles of which some have goals that are sets or free [m²/s⁴].

    Args:
        scenario: the scenario.
        rows: changes of the last position and velocity by accelerations, shape (2, K-1).
    """
    fleet = scenario.fleet
    drift = fleet.start_positions + scenario.grid.duration * fleet.start_velocities
    coasting = np.stack([drift, fleet.start_velocities], axis=1)
    changes = np.stack([fleet.goal_positions, fleet.goal_velocities], axis=1) - coasting
    given = np.stack([fleet.given_positions, fleet.given_velocities], axis=1)
    efforts = [
        _least_effort(rows, changes[i], coasting[i], given[i], vehicle)
        for i, vehicle in enumerate(scenario.vehicles)
    ]
    return float(fleet.weights @ efforts)


def _least_effort(
    rows: FloatArray, changes: FloatArray, coasting: FloatArray, given: BoolArray, vehicle: Vehicle
) -> float:
    """Return the least effort of a vehicle whose goal is a set or free [m²/s⁴].

    The effort grows with the squared distance of a position, or of a velocity, from that at which
    it is least, so that the best value of a set is the nearest one. With sets of both, each is
    taken alone, and the result is a lower bound.

    Args:
        rows: changes of the last position and velocity by accelerations, shape (2, K-1).
        changes: required changes of position [m] and velocity [m/s], shape (2, 3).
        coasting: last position and velocity without acceleration, shape (2, 3).
        given: whether each of them is required, shape (2,).
        vehicle: the vehicle.
    """
    least = np.linalg.pinv(rows[given]) @ changes[given]
    best = float(np.sum(least**2))
    efforts = [best]
    for which, wanted in enumerate((vehicle.goal.position, vehicle.goal.velocity)):
        if set_in(wanted) is not None:
            nearest = project(set_in(wanted), coasting[which] + rows[which] @ least)
            fixed, aims = given.copy(), changes.copy()
            fixed[which], aims[which] = True, nearest - coasting[which]
            efforts.append(float(np.sum((np.linalg.pinv(rows[fixed]) @ aims[fixed]) ** 2)))
    return max(efforts)
