"""Slack of vehicles that hold at their goals after the end: a check before planning.

The radii of the error tube are the largest from the end on. The vehicles are at rest: distances
from objects at rest are constant, and the least distances from moving objects are searched for on
the straight pieces of their tracks.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from drake_rho.motion.rest_tube import rest_tube
from drake_rho.motion.tube import ErrorTube
from drake_rho.planning.constraints.slack import TighteningSlack
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.shapes.base import Shape, Solid

_WHERE = "held goal"
"""Place of the comparison, as in 'obstacle 1 (held goal 0.1 m inside, of 0.2)'."""

_FAR = 1e4
"""Distance over which an endless motion is considered, in multiples of its initial distance."""

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0

_SECTIONS = 90
"""Number of golden sections of a piece of time, which leave 1e-19 of it."""

_PRECISION = 1e-3
"""Precision of distances from maps that move, as a part of the smallest radius of a vehicle."""

_ROUNDS = 60
"""Largest number of halvings of a piece of time for this precision."""


def slacks_at_rest(scenario: Scenario, tube: ErrorTube | None) -> Iterator[TighteningSlack]:
    """Yield the slack of every constraint for vehicles that hold at their goals after the end.

    Args:
        scenario: the scenario.
        tube: error tube of plans at their end; None without a disturbance.
    """
    if not scenario.hold_at_goal:
        return
    rest = None if tube is None else rest_tube(tube, scenario.grid.end + scenario.lead)
    radii: dict[Quantity, FloatArray] = {
        quantity: np.array([0.0 if rest is None else rest.largest(quantity)])
        for quantity in ("position", "velocity", "acceleration")
    }
    radii["jerk"] = np.zeros(1)
    yield from _limits(scenario, radii)
    yield from _obstacles(scenario, radii["position"])
    yield from _pairs(scenario, radii["position"])
    yield from _requirements(scenario, radii)


def _limits(scenario: Scenario, radii: dict[Quantity, FloatArray]) -> Iterator[TighteningSlack]:
    """Yield the slack of boxes and norms of vehicles at rest."""
    fleet = scenario.fleet
    goals = fleet.goal_positions
    still = np.zeros_like(goals)
    for quantity, needed in radii.items():
        values = goals if quantity == "position" else still
        if (bounds := fleet.bounds(quantity)) is not None:
            available = np.minimum(values - bounds.lower, bounds.upper - values).min(axis=1)
            tolerances = bounds.tolerances.min(axis=1)
            name = f"{quantity} box"
            yield TighteningSlack(name, _WHERE, quantity, available, needed, tolerances)
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                available = -limit.sets.signed_distance(np.arange(len(values)), values)
                name, tolerances = limit.kind.name, limit.sets.tolerances
                yield TighteningSlack(name, _WHERE, quantity, available, needed, tolerances)


def _obstacles(scenario: Scenario, radius: FloatArray) -> Iterator[TighteningSlack]:
    """Yield the slack of obstacles after the end, at rest, moving or active for an interval."""
    fleet, end = scenario.fleet, scenario.grid.duration + scenario.lead
    for number, body in enumerate(scenario.bodies_in_flight, start=1):
        if body.active is not None and not scenario.grid.clock.after(body.active[1], end):
            continue
        precision = _PRECISION * float(fleet.radii.min())
        distances = _least_distances(body, fleet.goal_positions, end, precision)
        available = distances - fleet.radii - body.deviation
        tolerances = fleet.obstacle_tolerances(body.shape)
        name = scenario.obstacle_name(number)
        yield TighteningSlack(name, _WHERE, "position", available, radius, tolerances)


def _least_distances(
    body: Obstacle, points: FloatArray, begin: float, precision: float
) -> FloatArray:
    """Return the least distances of points (N, 3) from an obstacle's later positions [m], (N,).

    Distances from a moving map may be too small by `precision` [m].
    """
    if body.is_steady:
        return body.distances(points[:, None], np.zeros(1))[:, 0]
    least = np.full(len(points), np.inf)
    for first, last in _pieces(body, points, begin):
        ends = body.centers(np.array([first, last]))
        x, moved = points - ends[0], ends[0] - ends[1]
        if isinstance(body.shape, Shape):
            found = _least_of_convex(
                body.shape, x, moved, body.uncertainty(np.array([first, last]))
            )
        else:
            found = _least_of_map(body.shape, x, moved, precision)
            found = found - body.uncertainty(np.array([last]))
        least = np.minimum(least, found)
    return least


def _least_of_convex(
    shape: Shape, x: FloatArray, moved: FloatArray, errors: FloatArray
) -> FloatArray:
    """Return the least distances from a convex shape on segments, by golden sections, (N,).

    Args:
        shape: shape of the obstacle.
        x: beginnings of the segments relative to its centre [m], shape (N, 3).
        moved: their ends less their beginnings [m], shape (3,).
        errors: position errors of the obstacle at the beginning and at the end [m], shape (2,).
    """

    def at(s: FloatArray) -> FloatArray:
        off = errors[0] + s * (errors[1] - errors[0])
        return np.asarray(shape.local_distance(x + s[:, None] * moved) - off)

    low, high = np.zeros(len(x)), np.ones(len(x))
    least = np.minimum(at(low), at(high))
    for _ in range(_SECTIONS):
        width = _GOLDEN * (high - low)
        left, right = high - width, low + width
        first, second = at(left), at(right)
        least = np.minimum(least, np.minimum(first, second))
        later = first > second
        low, high = np.where(later, left, low), np.where(later, high, right)
    return least


def _least_of_map(shape: Solid, x: FloatArray, moved: FloatArray, precision: float) -> FloatArray:
    """Return lower bounds of the least distances from a map on segments, by branch and bound, (N,).

    A distance changes no faster than its point moves.

    Args:
        shape: shape of the obstacle.
        x: beginnings of the segments relative to its centre [m], shape (N, 3).
        moved: their ends less their beginnings [m], shape (3,).
        precision: amount by which the bounds may be too small [m].
    """
    length, who, low = float(np.linalg.norm(moved)), np.arange(len(x)), np.zeros(len(x))
    left, right = shape.local_distance(x), shape.local_distance(x + moved)
    least, width = np.minimum(left, right), 1.0
    for _ in range(_ROUNDS):
        open_ = (left + right - length * width) / 2.0 < least[who] - precision
        who, low, left, right = who[open_], low[open_], left[open_], right[open_]
        if len(who) == 0:
            break
        width /= 2.0
        middle = shape.local_distance(x[who] + (low + width)[:, None] * moved)
        np.minimum.at(least, who, middle)
        who, low = np.tile(who, 2), np.concatenate([low, low + width])
        left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
    return least - precision


def _pieces(body: Obstacle, points: FloatArray, begin: float) -> Iterator[tuple[float, float]]:
    """Yield intervals from `begin` on in which an obstacle is active and moves straight."""
    first, last = body.active or (begin, np.inf)
    first = max(first, begin)
    times = [each for each in body.corners.tolist() if first < each < last]
    latest = times[-1] if times else first
    if last == np.inf:
        size = np.where(np.isfinite(body.shape.extent), body.shape.extent, 0.0)
        last = latest + _until_far(body, points, latest, float(np.linalg.norm(size)))
    times = [first, *times, last]
    yield from pairwise(times)


def _until_far(moving: Obstacle, points: FloatArray, time: float, size: float) -> float:
    """Return the duration after which an obstacle that moves or grows is far away [s]."""
    at = moving.centers(np.array([time, time + 1.0]))
    speed = float(np.linalg.norm(at[1] - at[0]))
    away = float(np.linalg.norm(points - at[0], axis=1).max()) + size + moving.deviation
    speeds = [each for each in (speed, moving.velocity_error) if each > 0.0]
    return max([1.0, *(_FAR * away / each for each in speeds)])


def _pairs(scenario: Scenario, radius: FloatArray) -> Iterator[TighteningSlack]:
    """Yield half the distance from the closest other goal, beyond the separation."""
    from scipy.spatial import cKDTree  # slow to import, so deferred until needed

    separation, goals = scenario.separation, scenario.fleet.goal_positions
    if separation is None or len(goals) < 2:
        return
    scaled = separation.scaled(goals)
    scale = float(separation.shape.scales.max())
    widest = float(np.ptp(scaled, axis=0).max()) + separation.distance
    within = min(separation.distance + 2.0 * float(radius[0]) * scale, 2.0 * widest)
    near = cKDTree(scaled).query_pairs(within, output_type="ndarray")
    distances = separation.shape.local_distance(goals[near[:, 0]] - goals[near[:, 1]])
    available = np.full(len(goals), np.inf)
    for vehicles in near.T:
        np.minimum.at(available, vehicles, distances / 2.0)
    tolerances = np.array([separation.tolerance])
    yield TighteningSlack("separation", _WHERE, "position", available, radius, tolerances)


def _requirements(
    scenario: Scenario, radii: dict[Quantity, FloatArray]
) -> Iterator[TighteningSlack]:
    """Yield the slack of requirements after the end, half of it for each vehicle of a pair."""
    fleet, names = scenario.fleet, scenario.names
    end = scenario.grid.end + scenario.lead
    for number, asked in enumerate(scenario.requirements, start=1):
        if asked.active is not None and not scenario.grid.clock.after(asked.active[1], end):
            continue
        goals = fleet.goal_positions
        values = goals if asked.quantity == "position" else np.zeros_like(goals)
        if (partner := asked.partner(names)) is not None:
            values = values - values[partner]
        inside = np.full(len(values), np.inf)
        for offset in _offsets(asked, values, end):
            inside = np.minimum(inside, -np.asarray(asked.set.signed_distance(values - offset)))
        members, available = asked.members(names), np.full(len(values), np.inf)
        tolerances = np.zeros(len(values))
        share = 1.0 if partner is None else 2.0
        available[members] = (inside[members] - asked.deviation) / share
        tolerances[members] = asked.tolerances(fleet, names)
        name, needed = asked.called(number), radii[asked.quantity]
        yield TighteningSlack(name, _WHERE, asked.quantity, available, needed, tolerances)


def _offsets(asked: KeepIn, values: FloatArray, end: float) -> FloatArray:
    """Return offsets of a requirement from the end on that include the worst one, (M, 3).

    On a straight piece of the moving point's track, a convex distance is largest at an end.
    """
    first, last = asked.active or (end, np.inf)
    first, track = max(first, end), asked.track
    if track is None:
        return asked.offset(np.array([first]))
    latest = max(first, float(track.times[-1]))
    if last == np.inf:
        speed = float(np.linalg.norm(track.last_velocity)) if track.after == "goes_on" else 0.0
        at = asked.track.at(np.array([latest])) if asked.track is not None else np.zeros(3)
        size = float(getattr(asked.set, "size", 0.0))
        away = float(np.linalg.norm(values - at, axis=1).max()) + (size if np.isfinite(size) else 0)
        last = latest + (1.0 if speed == 0.0 else max(1.0, _FAR * away / speed))
    times = np.array([first, *(t for t in track.times.tolist() if first < t < last), last])
    if asked.of == "velocity":
        return asked.offset((times[:-1] + times[1:]) / 2.0)
    return asked.offset(times)
