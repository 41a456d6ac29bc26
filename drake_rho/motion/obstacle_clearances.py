"""Distances of vehicles from obstacles: at given times, and the least over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.penetration import deepest, pieces_near
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario

_SLACK = 1e-9
"""Tolerance above the least distance at the knots up to which pieces are searched, as a fraction
of the obstacle's size."""


_SAMPLES = 32
"""Samples in each step of a motion that enters a map."""


class Moving(Protocol):
    """Protocol of a motion of a scenario's vehicles; every `Plan` satisfies it."""

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        ...

    def motion(self) -> Motion:
        """Return the motion as a function of the time since the first knot."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class ClosestApproaches:
    """The closest approach of each vehicle to an obstacle."""

    times: FloatArray
    """times since the first knot [s], shape (N,)"""
    distances: FloatArray
    """distances from the surface, negative inside [m], shape (N,)"""


def distances(plan: Moving, obstacle: Obstacle, times: FloatArray) -> FloatArray:
    """Return the distances of all vehicles from the space an obstacle may occupy, negative inside.

    Args:
        plan: the vehicles' motion.
        obstacle: the obstacle, with its motion.
        times: since the first knot [s], shape (M,).

    Returns:
        Distances [m], shape (N, M).
    """
    positions = plan.motion().at("position", times)
    return obstacle.since(plan.scenario.grid).distances(positions, times)


def required_distances(scenario: Scenario, obstacle: Obstacle) -> FloatArray:
    """Return the distances required between vehicles and an obstacle's surface [m], shape (N,).

    They are the vehicles' radii plus the largest deviation of the obstacle from its track.
    """
    least: FloatArray = scenario.fleet.radii + obstacle.deviation
    return least


def clearances(
    scenario: Scenario, obstacle: Obstacle, positions: FloatArray, times: FloatArray
) -> FloatArray:
    """Return distances from an obstacle's surface less the required distances.

    Args:
        scenario: of the vehicles.
        obstacle: the obstacle, with its motion.
        positions: of the vehicles [m], shape (N, M, 3).
        times: on the scenario's clock [s], shape (M,).

    Returns:
        Clearances [m], shape (N, M), negative where a vehicle is too close.
    """
    return obstacle.distances(positions, times) - required_distances(scenario, obstacle)[:, None]


def closest(plan: Moving, obstacle: Obstacle) -> ClosestApproaches:
    """Find the closest approach of each vehicle to an obstacle, exact also between the knots."""
    motion, local = plan.motion(), obstacle.since(plan.scenario.grid)
    knots: FloatArray = np.float64(motion.step) * np.arange(motion.positions.shape[1])
    slack = _SLACK * obstacle.shape.size
    at_knots = distances(plan, obstacle, knots)
    below = at_knots.min(axis=1) + slack  # reached by at least one piece
    pieces = pieces_near(motion, local, np.maximum(below, slack))
    tolerances = np.full(len(pieces.owners), obstacle.shape.tolerance)
    which, times = deepest(obstacle.shape, pieces, below[pieces.owners], tolerances)
    owners = pieces.owners[which]
    found = local.distances(motion.each_at("position", owners, times), times)
    order = np.lexsort((found, owners))
    near, firsts = np.unique(owners[order], return_index=True)
    least = ClosestApproaches(np.zeros(len(below)), np.full(len(below), np.inf))  # if not active
    least.times[near], least.distances[near] = times[order[firsts]], found[order[firsts]]
    if isinstance(obstacle.shape, Map) and np.any(np.minimum(least.distances, below) <= slack):
        return _deeper(least, _deepest_sampled(plan, obstacle, knots))
    return least


def _deeper(one: ClosestApproaches, other: ClosestApproaches) -> ClosestApproaches:
    """Return the closer of two approaches of each vehicle."""
    closer = other.distances < one.distances
    times = np.where(closer, other.times, one.times)
    return ClosestApproaches(times, np.where(closer, other.distances, one.distances))


def _deepest_sampled(plan: Moving, obstacle: Obstacle, knots: FloatArray) -> ClosestApproaches:
    """Return the closest approaches to a map that a motion enters, among samples.

    The depth in a map is neither the depth in one of its parts nor a convex function of position.
    """
    parts = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False)
    times = np.append((knots[:-1, None] + parts * np.diff(knots)[:, None]).reshape(-1), knots[-1])
    found = distances(plan, obstacle, times)
    k = np.argmin(found, axis=1)
    return ClosestApproaches(times[k], found[np.arange(len(found)), k])


def nearest_obstacles(
    plan: Moving, obstacles: Sequence[Obstacle], times: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Find the obstacle nearest to each vehicle, and the clearance from it.

    Args:
        plan: the vehicles' motion.
        obstacles: the obstacles to avoid.
        times: since the first knot [s], shape (M,).

    Returns:
        `clearances` [m], inf without obstacles, and indices of the obstacles, both
        of shape (N, M).
    """
    positions, start = plan.motion().at("position", times), plan.scenario.grid.start
    least = np.full(positions.shape[:2], np.inf)
    numbers = np.zeros(least.shape, dtype=np.int64)
    for index, obstacle in enumerate(obstacles):
        clearance = clearances(plan.scenario, obstacle, positions, start + times)
        numbers[clearance < least] = index
        least = np.minimum(clearance, least)
    return least, numbers
