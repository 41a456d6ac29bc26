"""Lower bound on the least time of one vehicle, by branch and bound.

Motions are split into sets, and the least time of a convex relaxation bounds that of each set
(`planning/programs/time_relaxation.py`). A set has an interval of final times, a cone beyond the
surface of an obstacle at some instants (`analysis/outside.py`), and an interval of the normalised
time of each waypoint, in which the vehicle passes it. The set with the least bound is split where
its relaxed motion violates the scenario most.
"""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Callable, Iterator
from functools import cached_property, partial
from itertools import count, pairwise

import numpy as np

from drake_rho.analysis.outside import Forbidden, Region, forbidden_by
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.errors import SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.time_relaxation import (
    PRECISION,
    Passage,
    Place,
    Relaxed,
    TimeRelaxations,
)
from drake_rho.planning.scp.least_time import ROUGH
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.smoothing import largest_accelerations
from drake_rho.scenario.waypoints import in_order

_LOOSE = 1e-3
"""Looseness of a relaxation above which its interval of final times is halved."""

_SHORT = 1e-5
"""Width, as a part of a final time, to which intervals of final and waypoint times are halved."""

_DEEP = 1e-4
"""Penetration that is ignored, as a part of the least of an obstacle's size and distance."""

_HALVINGS = 20
"""Number of halvings that find the first part of a final time at which a place is in reach."""

_SAMPLES = 33
"""Number of instants of an interval at which a motion is compared with a waypoint."""

_Key = tuple[int, int, int]
"""Index of an obstacle, number of its part, and index of an instant."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Set:
    """Set of motions of one vehicle."""

    shortest: float
    """least final time [s]"""
    longest: float
    """largest final time [s]"""
    regions: dict[_Key, Region]
    """regions beyond obstacles"""
    windows: FloatArray
    """first and last part of the final time at which waypoints are passed, shape (W, 2)"""
    relaxed: Relaxed | None = None
    """solution of its relaxation, or of a larger set's"""


class TimeBound:
    """Lower bound on the least time of one vehicle, improved step by step.

    Args:
        scenario: the scenario with one vehicle.
        duration: largest final time [s].

    Attributes:
        relaxations: number of relaxations that were solved.
        left_out: obstacles and waypoints that the bound does not count.
    """

    def __init__(self, scenario: Scenario, duration: float) -> None:
        self.relaxations, self.left_out = 0, set[str]()
        self._waypoints = [each for _, each in in_order(scenario.vehicles[0])]
        vehicle = dataclasses.replace(scenario.vehicles[0], waypoints=())
        grid = dataclasses.replace(scenario.grid, step=duration / (scenario.grid.knots - 1))
        bare = scenario.derived(requirements=(), disturbance=None, smoothing=None)
        self._scenario = bare.derived(hold_at_goal=None).ending_with(grid, [vehicle])
        self._free = self._scenario.without_obstacles()
        self._obstacles = self._scenario.avoided
        steps = (grid.knots - 1) * (2 if scenario.between_knots else 1)
        self._parts = np.arange(1, steps) / steps
        self._forbidden = dict[tuple[int, int], Forbidden]()
        self._half_spaces = dict[tuple[int, int, bytes], tuple[FloatArray, FloatArray]]()
        self._programs = dict[float, TimeRelaxations]()
        self._open = list[tuple[float, int, _Set]]()
        self._numbers, self._final = count(), duration
        windows = np.tile([0.0, 1.0], (len(self._waypoints), 1))
        self._add(_Set(0.0, duration, {}, windows))

    @property
    def bound(self) -> float:
        """Lower bound on the vehicle's final time, at most the largest one [s]."""
        return (1.0 - PRECISION) * min(self._open[0][0] if self._open else np.inf, self._final)

    def improve(self) -> bool:
        """Split the set with the least bound; return whether the bound may rise any further."""
        if not self._open or self._open[0][0] >= self._final:
            return False
        bound, number, one = self._open[0]
        parts = list(self._split(one))
        if not parts:  # nothing tells its relaxed motion from one of the scenario
            self._final = bound
            return False
        heapq.heappop(self._open)
        try:
            for each in parts:
                self._add(each)
        except BaseException:
            heapq.heappush(self._open, (bound, number, one))
            raise
        return True

    def _add(self, one: _Set) -> None:
        """Add a set of motions, unless its relaxation is infeasible."""
        check_time()
        if (windows := self._in_reach(one)) is None:
            return
        one = dataclasses.replace(one, windows=windows)
        self.relaxations += 1
        beyond = [self._beyond(one, key, region) for key, region in one.regions.items()]
        passages = [self._passage(one, number) for number in range(len(self._waypoints))]
        bound = one.shortest
        try:
            relaxed = self._relaxations(one.longest).least(one.shortest, beyond, passages)
        except SolverError:  # smaller sets may have programs that are easier to solve
            if one.relaxed is None:
                self._final = 0.0
                return
        else:
            if relaxed is None:
                return
            one, bound = dataclasses.replace(one, relaxed=relaxed), max(bound, relaxed.duration)
        heapq.heappush(self._open, (bound, next(self._numbers), one))

    def _relaxations(self, longest: float) -> TimeRelaxations:
        """Return the relaxations of motions up to a final time [s]."""
        if longest not in self._programs:
            grid = self._free.grid
            grid = dataclasses.replace(grid, step=longest / (grid.knots - 1))
            problem = Problem.of(self._free.ending_with(grid))
            self._programs[longest] = TimeRelaxations(problem, ROUGH)
        return self._programs[longest]

    def _split(self, one: _Set) -> Iterator[_Set]:
        """Yield parts of a set of motions; none if nothing is left to split."""
        relaxed = one.relaxed
        if relaxed is None:
            return
        depth, key = self._deepest(one, relaxed)
        missed, waypoint = self._most_missed(one, relaxed)
        one = dataclasses.replace(
            one, shortest=max(one.shortest, (1.0 - PRECISION) * relaxed.duration)
        )
        region = None if key is None else one.regions.get(key)
        is_flat = region is not None and not region.halves()  # only other times make it less deep
        in_time = relaxed.looseness > _LOOSE or (key is not None and key[2] < 0) or is_flat
        if in_time and one.longest - one.shortest > _SHORT * one.longest:
            middle = (one.shortest + one.longest) / 2.0
            yield dataclasses.replace(one, longest=middle)
            yield dataclasses.replace(one, shortest=middle)
        elif missed > (0.0 if is_flat else depth):
            yield from _with_halved_window(one, waypoint)
        elif key is not None and key[2] >= 0:
            forbidden = self._forbidden[key[:2]]
            for each in forbidden.regions if region is None else region.halves():
                yield dataclasses.replace(one, regions={**one.regions, key: each})

    def _deepest(self, one: _Set, relaxed: Relaxed) -> tuple[float, _Key | None]:
        """Return the deepest penetration of an obstacle by a relaxed motion [m], and its key.

        The index of the instant is -1 if the obstacle is active in a part of the interval only.
        """
        motion, deepest, key = relaxed.motion, 0.0, None
        times = relaxed.duration * self._parts
        at = motion.each_at("position", np.zeros(len(times), dtype=int), times)
        for index, (number, obstacle) in enumerate(self._obstacles):
            shape, required = obstacle.shape, self._required(obstacle)
            x = at - obstacle.centers(times)
            depths = required - shape.local_distance(x)
            always, sometimes = self._present(one, obstacle)
            depths[~(always | sometimes)] = 0.0
            k = int(np.argmax(depths))
            if depths[k] <= max(deepest, _DEEP * min(required or np.inf, shape.size)):
                continue
            part = int(shape.nearest(x[k])) if isinstance(shape, Parts) else 0
            if (index, part) not in self._forbidden:
                self._forbidden[index, part] = forbidden_by(shape, part, required)
            if not self._forbidden[index, part].has_middle:
                self.left_out.add(self._scenario.obstacle_name(number))
                continue
            deepest, key = float(depths[k]), (index, part, k if always[k] else -1)
        return deepest, key

    def _required(self, obstacle: Obstacle) -> float:
        """Return the distance required from an obstacle at all times [m]."""
        radius = float(self._scenario.fleet.radii[0])
        return radius + obstacle.deviation + obstacle.position_error

    def _present(self, one: _Set, obstacle: Obstacle) -> tuple[BoolArray, BoolArray]:
        """Return the instants at which an obstacle is active and moves straight.

        Returns:
            Masks of the instants at which this holds for all final times, and for some.
        """
        first, last = self._parts * one.shortest, self._parts * one.longest
        corners, active = obstacle.corners, (obstacle.is_active(first), obstacle.is_active(last))
        before = np.searchsorted(corners, first, side="right")
        straight = before == np.searchsorted(corners, last, side="left")
        always = active[0] & active[1] & straight
        return always, ~always & (active[0] | active[1] | ~straight)

    def _beyond(self, one: _Set, key: _Key, region: Region) -> Place:
        """Return the polyhedron that contains the outside of an obstacle in a region."""
        index, part, k = key
        content = region.edges.tobytes() + region.signs.tobytes()
        forbidden, known = self._forbidden[index, part], (index, part, content)
        if known not in self._half_spaces:
            (self._half_spaces[known],) = forbidden.half_spaces([region])
        times = self._parts[k] * np.array([one.shortest, one.longest])
        first, last = self._obstacles[index][1].centers(times)
        velocity = (last - first) / (times[1] - times[0]) if np.any(last != first) else np.zeros(3)
        return Place(
            float(self._parts[k]), last + forbidden.middle, velocity, *self._half_spaces[known]
        )

    def _in_reach(self, one: _Set) -> FloatArray | None:
        """Return windows without times at which waypoints are out of reach; None if one is empty.

        From each place to the next a vehicle flies at least the distance between them.
        """
        windows, longest = one.windows.copy(), one.longest
        for w in range(len(windows)):
            earliest = windows[w - 1, 0] if w > 0 else 0.0
            reached = partial(self.farthest, longest, earliest)
            windows[w, 0] = max(windows[w, 0], _first_part(reached, self._ways[w], earliest))
        for w in reversed(range(len(windows))):
            latest = windows[w + 1, 1] if w + 1 < len(windows) else 1.0
            # backwards in time, in parts that are left
            reached = partial(self._distance_before, longest, latest)
            left = _first_part(reached, self._ways[w + 1], 1.0 - latest)
            windows[w, 1] = min(windows[w, 1], 1.0 - left)
        return windows if np.all(windows[:, 0] <= windows[:, 1]) else None

    def _distance_before(self, longest: float, last: float, left: float) -> float:
        """Return the upper bound on the distance flown from 1 - `left` to `last` [m]."""
        return self.farthest(longest, min(1.0 - left, last), last)

    @cached_property
    def _ways(self) -> FloatArray:
        """Least distances from start to goal between consecutive waypoints [m], shape (W + 1,)."""
        fleet = self._free.fleet
        at = (each.position for each in self._waypoints)
        places = [fleet.start_positions[0], *at, fleet.goal_positions[0]]
        to_goal = 0.0 if fleet.given_positions[0] else np.inf  # its distance from a nominal one
        within = np.array([0.0, *(each.within for each in self._waypoints), to_goal])
        ways = np.linalg.norm(np.diff(places, axis=0), axis=1)
        return np.asarray(np.maximum(ways - within[:-1] - within[1:], 0.0))

    def _passage(self, one: _Set, number: int) -> Passage:
        """Return the ball of a waypoint, through which the vehicle passes in its window."""
        waypoint, window = self._waypoints[number], one.windows[number]
        first, last = window.tolist()
        middle, flown = (first + last) / 2.0, partial(self.farthest, one.longest)
        half = max(flown(first, middle), flown(middle, last))
        if not np.isfinite(half):
            self.left_out.add(f"waypoint {number + 1}")
        return Passage(window, waypoint.position, waypoint.within, flown(first, last), half)

    def farthest(self, longest: float, first: float, last: float) -> float:
        """Return an upper bound on the distance flown between two parts of a final time [m].

        The speed is bounded by accelerating from the start, and by braking to the goal, at the
        largest acceleration. The bound is the integral of the smallest of these speeds.
        """
        start, goal, most, acceleration = self._speeds
        begin, end = longest * first, longest * max(first, last)
        if not np.isfinite(acceleration):
            return (end - begin) * most if end > begin else 0.0
        corners = (
            (longest + (goal - start) / acceleration) / 2.0,
            (most - start) / acceleration,
            longest - (most - goal) / acceleration if np.isfinite(most) else np.inf,
        )
        times = sorted((begin, end, *(min(max(each, begin), end) for each in corners)))
        speeds = [
            min(start + acceleration * t, goal + acceleration * (longest - t), most) for t in times
        ]
        steps = zip(pairwise(times), pairwise(speeds), strict=True)
        return sum((after - before) * sum(both) / 2.0 for (before, after), both in steps)

    @cached_property
    def _speeds(self) -> tuple[float, float, float, float]:
        """Speeds at start and goal (infinite if not given), largest speed and acceleration."""
        fleet, most = self._free.fleet, np.inf
        start = float(np.linalg.norm(fleet.start_velocities[0]))
        goal = np.inf
        if fleet.given_velocities[0]:
            goal = float(np.linalg.norm(fleet.goal_velocities[0]))
        if (box := fleet.bounds("velocity")) is not None:
            most = float(np.linalg.norm(np.maximum(-box.lower[0], box.upper[0])))
        if "max_speed" in fleet.norms:
            most = min(most, float(fleet.norms["max_speed"].limits[0]))
        fastest = max(most, start, goal if np.isfinite(goal) else 0.0)
        return start, goal, fastest, float(largest_accelerations(fleet)[0])

    def _most_missed(self, one: _Set, relaxed: Relaxed) -> tuple[float, int]:
        """Return the largest distance from a waypoint in its window [m], and its index."""
        missed, which = 0.0, -1
        for number, (waypoint, window) in enumerate(zip(self._waypoints, one.windows, strict=True)):
            times = relaxed.duration * np.linspace(float(window[0]), float(window[1]), _SAMPLES)
            at = relaxed.motion.each_at("position", np.zeros(_SAMPLES, dtype=int), times)
            away = _distance_from_path(at - waypoint.position) - waypoint.within
            half = self._passage(one, number).half
            is_wide = np.ptp(window) > _SHORT and np.isfinite(half)
            if is_wide and away > max(missed, _DEEP * (half + waypoint.within)):
                missed, which = away, number
        return missed, which


def _first_part(reached: Callable[[float], float], way: float, first: float) -> float:
    """Return the earliest part of the final time at which a place may be reached.

    It is a little too early rather than too late; infinite if the place is out of reach.

    Args:
        reached: function that returns a bound on the distance flown up to a part [m].
        way: distance of the place [m].
        first: part of the final time at which the vehicle sets out.
    """
    if reached(1.0) < way:
        return np.inf
    low, high = first, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if reached(middle) < way else (low, middle)
    return low


def _with_halved_window(one: _Set, waypoint: int) -> Iterator[_Set]:
    """Yield the halves of a set of motions that pass a waypoint earlier and later."""
    first, last = one.windows[waypoint]
    middle = (first + last) / 2.0
    for half in ((first, middle), (middle, last)):
        windows = one.windows.copy()
        windows[waypoint] = half
        yield dataclasses.replace(one, windows=windows)


def _distance_from_path(corners: FloatArray) -> float:
    """Return the distance of the origin from a path that is straight between corners (M, 3)."""
    sides = np.diff(corners, axis=0)
    squares = np.vecdot(sides, sides)
    parts = -np.vecdot(corners[:-1], sides) / np.where(squares > 0.0, squares, 1.0)
    nearest = corners[:-1] + np.clip(parts, 0.0, 1.0)[:, None] * sides
    return float(np.linalg.norm(nearest, axis=1).min())
