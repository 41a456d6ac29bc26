"""Search for cheaper plans that end elsewhere in goals that are sets.

Sequential convex programming stays on the sides of obstacles on which its first plan arrives. Here
vehicles are planned to several points of their sets, and each such plan becomes the reference of a
new one, which may end anywhere in the sets.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np

from drake_rho.motion.costs import costs_of
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.problem import Problem
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.goals import set_in
from drake_rho.scenario.nominal_goals import nearest_in
from drake_rho.scenario.parts import State
from drake_rho.scenario.records import Scenario

_WORTH = 0.02
"""Fraction of the cost by which a plan has to cost more than without obstacles to be compared."""

_BETTER = 1e-9
"""Fraction of a vehicle's cost that a plan must save to replace the one before."""

_DIRECTIONS = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
"""Directions of points of a set from the end of a plan."""


def has_other_goals(problem: Problem) -> bool:
    """Return whether vehicles have sets as goals, in which they could end elsewhere.

    With a disturbance, plans to points of a set need not keep the margin from its boundary; with
    soft limits, costs alone do not compare plans.
    """
    scenario = problem.scenario
    if scenario.disturbance is not None or scenario.penalties:
        return False
    return any(each.quantity == "position" for each in scenario.goal_sets)


def on_cheaper_goals(
    problem: Problem,
    plan: Plan,
    to_points: Callable[[Scenario], Plan],
    iterated: Callable[[Plan], Plan],
) -> Plan:
    """Return a plan in which vehicles end elsewhere in their sets where this costs less.

    Args:
        problem: to be solved, of vehicles that are independent of each other.
        plan: a converged plan.
        to_points: plans a scenario with exact positions as goals.
        iterated: iterates a plan of the problem until its cost has converged.
    """
    scenario = problem.scenario
    with suppress(InfeasibleError, SolverError):
        free = plan_convex(scenario.without_obstacles())
        if plan.cost <= (1.0 + _WORTH) * free.cost:
            return plan
    accelerations, costs = np.array(plan.accelerations), costs_of(scenario, plan)
    spent = Statistics()
    for exact in _to_points(scenario, plan):
        try:
            first = to_points(exact)
            found = iterated(Plan.from_accelerations(scenario, first.accelerations))
        except (InfeasibleError, SolverError, ScenarioError) as error:
            spent += getattr(error, "statistics", Statistics())
            continue
        except OutOfTimeError:
            spent += Statistics(cut=True)
            break
        spent += first.statistics + found.statistics
        better = (own := costs_of(scenario, found)) < (1.0 - _BETTER) * costs
        accelerations[better], costs = found.accelerations[better], np.where(better, own, costs)
    ended = plan.statistics.with_work(spent)
    if np.any(accelerations != plan.accelerations):
        plan = Plan.from_accelerations(scenario, accelerations).found_around(plan)
    return plan.with_statistics(ended)


def _to_points(scenario: Scenario, plan: Plan) -> Iterator[Scenario]:
    """Yield scenarios with points of the sets as goals; some may be inside obstacles."""
    ends = plan.positions[:, -1]
    lengths = np.linalg.norm(ends - scenario.fleet.start_positions, axis=1) + 1e-3
    for direction in _DIRECTIONS:
        goals = [
            _moved(scenario, i, ends[i] + lengths[i] * direction)
            for i in range(len(scenario.vehicles))
        ]
        vehicles = tuple(
            dataclasses.replace(vehicle, goal=goal)
            for vehicle, goal in zip(scenario.vehicles, goals, strict=True)
        )
        with suppress(ScenarioError):
            yield dataclasses.replace(scenario, vehicles=vehicles)


def _moved(scenario: Scenario, vehicle: int, towards: FloatArray) -> object:
    """Return a vehicle's goal at the point of its set that is nearest to a position."""
    goal = scenario.vehicles[vehicle].goal
    if (wanted := set_in(goal.position)) is None:
        return goal
    point, _ = nearest_in(wanted, scenario.fleet.projection("position", vehicle), towards)
    if isinstance(goal.velocity, np.ndarray) or goal.velocity is None:
        return State(point, goal.velocity)
    return dataclasses.replace(goal, position=point)
