"""Assignment of goals to vehicles with the least total effort."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.minimum_effort import TerminalState
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.goals import set_in
from drake_rho.scenario.nominal_goals import project
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import TOLERANCE

_DENSE = 2000
"""Largest fleet for which all pairs of a start and a goal are compared by default."""

_NEAREST = 16
"""Number of goals nearest to each start, and starts nearest to each goal, in the first round."""

_ALIKE = 1e-12
"""Relative difference below which two total costs count as equal."""


@checked
def assign_goals(scenario: Scenario, *, exact: bool | None = None) -> Scenario:
    """Exchange the goals of a scenario's vehicles so that the total cost (13) is least.

    The cost of a vehicle and a goal, which is a position and a velocity, is that of the motion of
    least effort between the two, in closed form; of a goal that is a set, to its nearest point.
    Obstacles, limits, waypoints and separation are ignored: with any of them another assignment may
    have the better plan. Names, limits, radii and waypoints stay with the vehicles. No vehicle is
    assigned a goal that is too close to an obstacle for its radius.

    Args:
        scenario: to take vehicles and goals from.
        exact: whether all N² pairs of a start and a goal are compared. Otherwise only pairs near
            each other are, twice as many in each round until the total cost no longer falls: ten
            thousand vehicles take about ten seconds. By default all pairs are compared for up to
            2000 vehicles.

    Returns:
        The scenario with the assigned goals.

    Raises:
        ScenarioError: a vehicle's own position or velocity box does not contain its assigned goal,
            or the grid has a single step, which does not take the vehicles to the goals.

    Examples:
        >>> scenario = rho.random_transitions(8, np.random.default_rng(1))
        >>> rho.plan(rho.assign_goals(scenario)).cost < rho.plan(scenario).cost
        True
    """
    goals = [vehicle.goal for vehicle in scenario.vehicles]
    vehicles = tuple(
        dataclasses.replace(vehicle, goal=goals[index])
        for vehicle, index in zip(scenario.vehicles, assignment(scenario, exact=exact), strict=True)
    )
    return dataclasses.replace(scenario, vehicles=vehicles)


def assignment(scenario: Scenario, *, exact: bool | None = None) -> list[int]:
    """Return the index of each vehicle's new goal in the order of the vehicles.

    Raises:
        ScenarioError: the grid has a single step, which does not take the vehicles to the goals.
    """
    if exact is None:
        exact = len(scenario.vehicles) <= _DENSE
    fleet = scenario.fleet
    exact = exact or not (fleet.given_positions.all() and fleet.given_velocities.all())
    efforts = _Efforts.of(scenario)
    try:
        chosen = _of_all(efforts) if exact else _of_nearest(efforts)
    except ValueError:  # too many of the pairs are infinite
        expected = "more knots: a single step does not take the vehicles to the goals"
        raise ScenarioError("grid.knots", scenario.grid.knots, expected) from None
    return [int(each) for each in chosen]


@dataclasses.dataclass(frozen=True)
class _Efforts:
    """Least costs from starts to goals [m²/s⁴].

    The minimum-norm accelerations that meet (12) are combinations of orthonormal rows, so the cost
    is the sum of squares of their coefficients. The coefficients are linear in goal less start.
    Each start and each goal is therefore represented by a point, and the cost of a pair is the
    squared distance of its points.
    """

    starts: FloatArray
    """points of the starts, shape (N, 6), or (N, 3) for a single step"""
    goals: FloatArray
    """points of the goals, shape (N, 6), or (N, 3) for a single step"""
    start_rests: FloatArray
    """positions of vehicles after a single step [m], shape (N, 3)"""
    goal_rests: FloatArray
    """required positions after a single step [m], shape (N, 3)"""
    tolerance: float
    """largest difference of these positions [m]"""
    radii: FloatArray
    """radii of the vehicles [m], shape (N,)"""
    weights: FloatArray
    """weights of the vehicles in the cost, shape (N,)"""
    clearances: FloatArray
    """distance of every goal from the nearest obstacle [m], shape (N,)"""
    pairs: FloatArray | None = None
    """squared distances of all pairs, shape (N, N), if some goals are sets or free; None if points
    stand for all goals"""

    @classmethod
    def of(cls, scenario: Scenario) -> _Efforts:
        """Return the costs of a scenario's starts and goals."""
        fleet, terminal, T = scenario.fleet, TerminalState(scenario.grid), scenario.grid.duration
        starts, start_rests = terminal.values(
            fleet.start_velocities, fleet.start_positions + T * fleet.start_velocities
        )
        goals, goal_rests = terminal.values(fleet.goal_velocities, fleet.goal_positions)
        count = len(starts)
        exact = fleet.given_positions.all() and fleet.given_velocities.all()
        return cls(
            starts.reshape(count, -1),
            goals.reshape(count, -1),
            start_rests,
            goal_rests,
            TOLERANCE * float(fleet.lengths.max()),
            fleet.radii,
            fleet.weights,
            _clearances(scenario),
            None if exact else np.stack([_to_goal(scenario, j) for j in range(count)], axis=1),
        )

    def between(self, starts: IntArray, goals: IntArray) -> FloatArray:
        """Return the costs of pairs of indices that broadcast; infinite if there is no motion."""
        if self.pairs is not None:
            efforts = self.weights[starts] * self.pairs[starts, goals]
            return np.where(self.radii[starts] > self.clearances[goals], np.inf, efforts)
        apart = self.starts[starts] - self.goals[goals]
        efforts = self.weights[starts] * np.einsum("...c,...c->...", apart, apart)
        missed = np.abs(self.start_rests[starts] - self.goal_rests[goals]).max(axis=-1)
        impossible = (missed > self.tolerance) | (self.radii[starts] > self.clearances[goals])
        return np.where(impossible, np.inf, efforts)


def _to_goal(scenario: Scenario, number: int) -> FloatArray:
    """Return the least efforts of all vehicles to one goal, or to its nearest point, (N,).

    The effort to a position, or to a velocity, grows with the squared distance from that at which
    it is least. With sets of both, each is taken alone, and the result is a lower bound.
    """
    fleet, goal = scenario.fleet, scenario.vehicles[number].goal
    quantities: tuple[Quantity, Quantity] = ("position", "velocity")
    masks = fleet.given_positions, fleet.given_velocities
    points = fleet.goal_positions, fleet.goal_velocities
    given = {each: bool(mask[number]) for each, mask in zip(quantities, masks, strict=True)}
    aims = {each: point[[number]] for each, point in zip(quantities, points, strict=True)}
    efforts, motion = _least(scenario, given, aims)
    least = efforts
    for quantity in quantities:
        if (wanted := set_in(getattr(goal, quantity))) is not None:
            nearest = project(wanted, motion.values(quantity)[:, -1])
            own, _ = _least(scenario, given | {quantity: True}, aims | {quantity: nearest})
            least = np.maximum(least, own)
    return least


def _least(
    scenario: Scenario, given: Mapping[Quantity, bool], aims: Mapping[Quantity, FloatArray]
) -> tuple[FloatArray, Motion]:
    """Return the motions of least effort to given positions or velocities, and their efforts."""
    fleet, T = scenario.fleet, scenario.grid.duration
    terminal = TerminalState(scenario.grid, position=given["position"], velocity=given["velocity"])
    coasting = fleet.start_positions + T * fleet.start_velocities
    values, _ = terminal.values(
        aims["velocity"] - fleet.start_velocities, aims["position"] - coasting
    )
    accelerations = terminal.rows.T @ values
    motion = Motion.from_starts(fleet, accelerations, scenario.grid.step)
    return np.sum(accelerations**2, axis=(1, 2)), motion


def _of_all(efforts: _Efforts) -> IntArray:
    """Return the goal of each vehicle from the comparison of all pairs."""
    from scipy.optimize import linear_sum_assignment  # slow to load, so only where needed

    everyone = np.arange(len(efforts.starts))
    costs = np.stack([efforts.between(start, everyone) for start in everyone[:, None]])
    chosen: IntArray = linear_sum_assignment(costs)[1]
    return chosen


def _of_nearest(efforts: _Efforts) -> IntArray:
    """Return the goal of each vehicle from the comparison of pairs that are near each other."""
    count, nearest, last = len(efforts.starts), _NEAREST, np.inf
    while 2 * nearest < count:
        found = _matched(efforts, nearest)
        if found is not None:
            cost = float(efforts.between(np.arange(count), found).sum())
            if cost > last * (1.0 - _ALIKE):
                return found
            last = cost
        nearest *= 2
    return _of_all(efforts)


def _matched(efforts: _Efforts, nearest: int) -> IntArray | None:
    """Return the best assignment among nearest neighbours; None if they admit none.

    Args:
        efforts: costs of the pairs.
        nearest: number of goals nearest to each start, and of starts nearest to each goal.
    """
    from scipy.sparse import csr_array  # slow to load, so only where needed
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching
    from scipy.spatial import cKDTree

    count = len(efforts.starts)
    goals = cKDTree(efforts.goals).query(efforts.starts, nearest)[1].reshape(-1)
    starts = cKDTree(efforts.starts).query(efforts.goals, nearest)[1].reshape(-1)
    own = np.repeat(np.arange(count), nearest)
    pairs = np.unique(np.append(own * count + goals, starts * count + own))
    start, goal = np.divmod(pairs, count)
    costs = efforts.between(start, goal)
    start, goal, costs = (each[np.isfinite(costs)] for each in (start, goal, costs))
    costs = costs + max(float(costs.sum()) / count, 1.0)  # zeros would count as missing pairs
    try:
        graph = csr_array((costs, (start, goal)), shape=(count, count))
        _, chosen = min_weight_full_bipartite_matching(graph)
    except ValueError:  # no full matching exists
        return None
    matched: IntArray = chosen.astype(np.int64)
    return matched


def _clearances(scenario: Scenario) -> FloatArray:
    """Return the distance of every goal from the nearest obstacle at the end [m], shape (N,)."""
    least = np.full(len(scenario.vehicles), np.inf)
    goals, given = scenario.fleet.goal_positions, scenario.fleet.given_positions
    for obstacle in scenario.bodies_in_flight:
        free = obstacle.distances(goals, np.array([scenario.grid.duration]))
        free = free - obstacle.deviation + obstacle.shape.tolerance
        least = np.where(given, np.minimum(least, free), least)
    return least
