"""Distances of vehicles from static and moving obstacles over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.minima import Minima, Minimum
from drake_rho.display.common.style import dense_times
from drake_rho.motion.nearest_vehicles import nearest_vehicles
from drake_rho.motion.obstacle_clearances import (
    closest,
    nearest_obstacles,
    required_distances,
)
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle


@dataclasses.dataclass(frozen=True, eq=False)
class Clearances:
    """Clearance of each vehicle from its nearest obstacle over time.

    A clearance is the distance from the obstacle, less its uncertainty, the vehicle's radius and
    the largest deviation of the obstacle from its track. The nearest obstacle is the one with the
    least clearance.
    """

    times: FloatArray
    """times since the first knot, ascending, closest approaches included [s], shape (N, M)"""
    clearances: FloatArray
    """clearances, negative where an obstacle is too close [m], shape (N, M)"""
    nearest: IntArray
    """index of the nearest obstacle, shape (N, M)"""

    @property
    def minima(self) -> Minima:
        """Least clearance of each vehicle."""
        vehicles, lowest = np.arange(len(self.times)), self._lowest
        return Minima(vehicles, self.times[vehicles, lowest], self.clearances[vehicles, lowest])

    @property
    def nearest_at_minima(self) -> IntArray:
        """Index of the nearest obstacle at each vehicle's least clearance, shape (N,)."""
        found: IntArray = self.nearest[np.arange(len(self.nearest)), self._lowest]
        return found

    @property
    def _lowest(self) -> IntArray:
        return np.asarray(np.argmin(self.clearances, axis=1))


def minima_from(plan: Drawn, obstacle: Obstacle) -> Minima:
    """Return each vehicle's least clearance from an obstacle over time, infinite if not active."""
    found = closest(plan, obstacle)
    clearances = found.distances - required_distances(plan.scenario, obstacle)
    return Minima(np.arange(len(clearances)), found.times, clearances)


def nearest(plan: Drawn, obstacle: Obstacle) -> Minimum:
    """Return the least clearance of any vehicle from an obstacle over time."""
    return minima_from(plan, obstacle).least


def least_clearances(plan: Drawn, obstacles: Sequence[Obstacle]) -> Clearances:
    """Return each vehicle's least clearance over time from one or more obstacles."""
    times = sample_times(plan, obstacles)
    least, numbers = nearest_obstacles(plan, obstacles, times)
    whole = np.tile(times, (len(least), 1))
    return _with_exact_minima(plan, obstacles, Clearances(whole, least, numbers))


def sample_times(plan: Drawn, obstacles: Sequence[Obstacle]) -> FloatArray:
    """Return `dense_times` and one time in each obstacle's active interval [s].

    An interval may be shorter than the time between samples.
    """
    grid = plan.scenario.grid
    intervals = [np.subtract(each.active, grid.start) for each in obstacles if each.active]
    inside = [np.clip(each, 0.0, grid.duration).mean() for each in intervals]
    times: FloatArray = np.union1d(dense_times(plan), np.array(inside, dtype=np.float64))
    return times


def free_radii(plan: Drawn, times: FloatArray) -> FloatArray:
    """Return the radii of the largest free balls around the vehicles.

    A free ball touches no obstacle. If the scenario requires a separation, it also reaches at most
    half-way to the nearest other vehicle.

    Args:
        plan: the motion of vehicles and obstacles.
        times: times since the first knot [s], shape (M,).

    Returns:
        Radii [m], shape (N, M); inf if nothing limits them, and not positive inside an obstacle.
    """
    clearances, _ = nearest_obstacles(plan, plan.scenario.bodies, times)
    room: FloatArray = clearances + plan.scenario.fleet.radii[:, None]
    if plan.scenario.separation is not None:
        away, _ = nearest_vehicles(plan.motion().at("position", times))
        room = np.minimum(room, away / 2.0)
    return room


def _with_exact_minima(
    plan: Drawn, obstacles: Sequence[Obstacle], sampled: Clearances
) -> Clearances:
    """Insert each vehicle's exact minimum, from its nearest obstacle, into sampled clearances."""
    which = sampled.nearest_at_minima
    times, least = np.zeros(len(which)), np.zeros(len(which))
    for index in np.unique(which):
        here, exact = which == index, minima_from(plan, obstacles[index])
        times[here], least[here] = exact.times[here], exact.values[here]
    order = np.argsort(np.append(sampled.times, times[:, None], axis=1), axis=1, kind="stable")

    def inserted(values: NDArray[Any], minima: NDArray[Any]) -> NDArray[Any]:
        return np.take_along_axis(np.append(values, minima[:, None], axis=1), order, axis=1)

    return Clearances(
        inserted(sampled.times, times),
        inserted(sampled.clearances, least),
        inserted(sampled.nearest, which),
    )
