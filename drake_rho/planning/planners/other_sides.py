"""Search for cheaper plans that pass obstacles on other sides.

Sequential convex programming stays on the sides of its first reference. Here every obstacle that a
converged plan touches is passed on other sides too, by the motion of least effort through a point
there, in closed form. A detour that costs less than the plan becomes a reference for a new plan.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from drake_rho.motion.costs import costs_of
from drake_rho.motion.dynamics import Motion, response
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.progress import Progress, tell, within
from drake_rho.planning.constraints.keep_out import EvaluationPoints, side_of
from drake_rho.planning.constraints.obstacles import KeepOutOfShape
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import FloatArray, IntArray

_WORTH = 0.02
"""Fraction of a vehicle's cost that a detour must save to be tried: plans near it cost more, since
they keep clear of the obstacle for longer than an instant."""

_BETTER = 1e-3
"""Fraction of a vehicle's cost that a plan must save to replace the one before."""

_TRIES = 8
"""Largest number of detours that are tried for one vehicle."""

_TURNS = np.radians([90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0])
"""Other sides of an obstacle: rotations about the direction of flight from the plan's side."""

_TOUCHING = 0.02
"""Clearance up to which a plan touches an obstacle, as a fraction of the obstacle's size."""

_SAMPLES = 4
"""Instants of a step at which clearances are compared."""

_ROUGHLY, _ROUGH_STEPS = 1e-2, 10
"""Relative fall of the cost, and number of linearisations, after which plans are compared."""

Iterate = Callable[..., Plan]
"""Function that iterates a subproblem from a plan until the cost converges."""


@dataclasses.dataclass(frozen=True, eq=False)
class Detour:
    """Motion of least effort that passes one obstacle on a given side, at a given instant."""

    vehicle: int
    """index of the vehicle"""
    cost: float
    """sum of its squared accelerations [m²/s⁴]"""
    accelerations: FloatArray
    """its accelerations [m/s²], shape (1, K-1, 3)"""


def has_other_sides(problem: Problem) -> bool:
    """Return whether to search other sides of obstacles: for independent vehicles before a flight.

    Windows of a flight under way stay on the sides of the previous plan.
    """
    scenario = problem.scenario
    alone = scenario.separation is None and not problem.has_links
    return bool(scenario.avoided) and alone and not scenario.under_way


def on_cheaper_sides(
    problem: Problem,
    plan: Plan,
    tolerance: float,
    *,
    most: int,
    backend: Backend,
    progress: Progress | None = None,
) -> Plan:
    """Return a plan in which vehicles pass obstacles on other sides where this costs less.

    Args:
        problem: to be solved, of vehicles that are independent of each other.
        plan: a converged plan.
        tolerance: relative fall of the cost at which a plan has converged.
        most: the largest number of linearisations of one plan.
        backend: the solver of the programs.
        progress: called with a short text on the current activity.
    """
    iterated = partial(sequential_convex, tolerance=tolerance, most=most)
    accelerations, spent = np.array(plan.accelerations), Statistics()
    references = None if plan.reference is None else np.array(plan.reference.accelerations)
    for vehicle in sorted({each.vehicle for each in _detours(problem, plan)}):
        alone = problem if len(problem) == 1 else _of_vehicle(problem, vehicle)
        own = Plan.from_accelerations(alone.scenario, accelerations[[vehicle]])
        task = within(progress, problem.scenario.names[vehicle])
        search = _OtherSides(Subproblem(alone, backend=backend.here()), own, iterated, task)
        best = search.best()
        spent += search.spent
        accelerations[vehicle] = best.accelerations[0]
        if references is not None and best.reference is not None:
            references[vehicle] = best.reference.accelerations[0]
        if spent.cut:
            break
    ended = plan.statistics.with_work(spent)
    if np.any(accelerations != plan.accelerations):
        plan = _with(plan, accelerations, references)
    return plan.with_statistics(ended)


def _of_vehicle(problem: Problem, vehicle: int) -> Problem:
    """Return the problem of one vehicle alone."""
    return dataclasses.replace(problem, scenario=problem.scenario.of_vehicles([vehicle]))


def _with(plan: Plan, accelerations: FloatArray, references: FloatArray | None) -> Plan:
    """Return a plan with other accelerations and another reference."""
    other = Plan.from_accelerations(plan.scenario, accelerations)
    if references is None:
        return other
    return other.found_around(Plan.from_accelerations(plan.scenario, references))


class _OtherSides:
    """Search for a cheaper plan of one vehicle on other sides of the obstacles it touches.

    Args:
        subproblem: of the vehicle alone.
        plan: a converged plan.
        iterated: iterates a plan until its cost has converged.
        progress: called with a short text on the current activity.

    Attributes:
        spent: statistics of all detours that were tried.
    """

    def __init__(
        self, subproblem: Subproblem, plan: Plan, iterated: Iterate, progress: Progress | None
    ) -> None:
        self._subproblem, self._best = subproblem, plan
        self._iterated, self._progress = iterated, progress
        self.spent = Statistics()

    def best(self) -> Plan:
        """Return the cheapest plan found; detours of a cheaper plan are tried too."""
        cheaper: Plan | None = self._best
        while cheaper is not None:
            self._best = cheaper
            cheaper = self._cheaper()
        return self._best

    def _cheaper(self) -> Plan | None:
        """Return the first cheaper plan along detours, from the cheapest detour on."""
        for detour in _detours(self._subproblem.problem, self._best):
            if self.spent.detours == _TRIES:
                break
            self.spent += Statistics(detours=1)
            tell(self._progress, f"trying another side of obstacles ({self.spent.detours})")
            try:
                found = self._around(detour)
            except (InfeasibleError, SolverError) as error:
                self.spent += error.statistics
            except OutOfTimeError:
                self.spent += Statistics(cut=True)
                break
            else:
                self.spent += found.statistics
                total = self._subproblem.problem.total_cost
                if total(found) < (1.0 - _BETTER) * total(self._best):
                    return found
        return None

    def _around(self, detour: Detour) -> Plan:
        """Return a plan near a detour, iterated to convergence if it may be the best one.

        Raises:
            InfeasibleError: the linearisation around the detour has no solution.
            OutOfTimeError: time is up.
            SolverError: the solvers fail numerically.
        """
        subproblem = self._subproblem.restarted()
        reference = Plan.from_accelerations(self._best.scenario, detour.accelerations)
        plan = subproblem.solve_around(reference)
        plan = sequential_convex(subproblem, plan, _ROUGHLY, most=_ROUGH_STEPS)
        total = subproblem.problem.total_cost
        return self._iterated(subproblem, plan) if total(plan) < total(self._best) else plan


def _detours(problem: Problem, plan: Plan) -> list[Detour]:
    """Return the detours of all vehicles that may lead to cheaper plans, the cheapest first."""
    motion, free = plan.motion(), problem.effort.motion
    least, costs = (_efforts(problem, each) for each in (free, motion))
    worth = (1.0 - _WORTH) * costs
    bent = np.flatnonzero(worth > least)
    if len(bent) == 0:
        return []
    found = [
        detour
        for each in problem.obstacles_around(motion)
        if isinstance(each, KeepOutOfShape)  # other sides of a map are not searched
        for detour in _beside(each, problem, motion, _touching(each, motion, bent), worth)
    ]
    return sorted(found, key=lambda each: each.cost)


def _efforts(problem: Problem, motion: Motion) -> FloatArray:
    """Return the cost of each vehicle without its weight [m²/s⁴], shape (N,)."""
    scenario = problem.scenario
    return np.asarray(costs_of(scenario, motion) / scenario.fleet.weights)


def _touching(obstacle: KeepOutOfShape, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
    """Return the instants of closest approach of the vehicles that touch an obstacle."""
    times = motion.step / _SAMPLES * np.arange(1, _SAMPLES * motion.accelerations.shape[1])
    times = times[obstacle.holds_at(times)]
    whose = np.repeat(vehicles, len(times))
    points = EvaluationPoints(whose, whose, np.tile(times, len(vehicles)))
    if len(points) == 0:
        return points
    clearances = obstacle.distances(motion, points) - obstacle.radius(points)
    clearances = clearances.reshape(len(vehicles), -1)
    nearest = len(times) * np.arange(len(vehicles)) + np.argmin(clearances, axis=1)
    return points.select(nearest[clearances.min(axis=1) <= _TOUCHING * obstacle.shape.size])


def _beside(
    obstacle: KeepOutOfShape,
    problem: Problem,
    motion: Motion,
    points: EvaluationPoints,
    worth: FloatArray,
) -> Iterator[Detour]:
    """Yield detours on other sides of an obstacle that cost less than a bound.

    Args:
        obstacle: the obstacle.
        problem: with the motion of least effort.
        motion: motion of a plan.
        points: instants at which vehicles touch the obstacle.
        worth: largest cost of a detour of each vehicle [m²/s⁴], shape (N,).
    """
    if len(points) == 0:
        return
    effort, grid, whose = problem.effort, problem.scenario.grid, points.vehicles
    sides = _sides(obstacle, motion, points)
    changes, responses = effort.changes, response("position", grid.step, grid.knots, points.times)
    rows = changes.projected(changes.whitened(responses, whose), whose)
    units = np.array([each.unit for each in changes.spaces])[changes.classes[whose], None]
    squares = np.vecdot(rows, rows)[:, None]
    far = obstacle.shape.local_support(sides.reshape(-1, 3)).reshape(sides.shape[:2])
    away = np.vecdot(sides, obstacle.offsets(effort.motion, points)[:, None])
    gaps = np.maximum(far + obstacle.radius(points)[:, None] - away, 0.0)
    least = _efforts(problem, effort.motion)[whose]
    costs = least[:, None] + units * gaps**2 / squares  # infinite along an endless cylinder
    for r, s in np.argwhere((gaps > 0.0) & (costs < worth[whose, None])).tolist():
        z = gaps[r, s] / squares[r] * rows[r, :, None] * sides[r, s]
        change = changes.accelerations(z[None], whose[r : r + 1])[0]
        free = effort.motion.accelerations[whose[r] : whose[r] + 1]
        yield Detour(int(whose[r]), float(costs[r, s]), free + change)


def _sides(obstacle: KeepOutOfShape, motion: Motion, points: EvaluationPoints) -> FloatArray:
    """Return unit vectors to other sides of an obstacle across the flight, shape (R, S, 3).

    For a vehicle at rest beside the obstacle, all of them point to the opposite side.
    """
    velocities = motion.each_at("velocity", points.vehicles, points.times)
    velocities = velocities - obstacle.obstacle.velocities(points.times)
    first = side_of(obstacle.shape.local_outward(obstacle.offsets(motion, points)), velocities)
    second = np.cross(velocities, first)
    lengths = np.linalg.norm(second, axis=1, keepdims=True)
    moving = lengths > 0.0
    second = np.where(moving, second / np.where(moving, lengths, 1.0), 0.0)[:, None]
    cosines = np.where(moving, np.cos(_TURNS), -1.0)[:, :, None]
    return np.asarray(cosines * first[:, None] + np.sin(_TURNS)[:, None] * second)
