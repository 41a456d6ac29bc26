"""Straight legs: few places of a motion, so that lines between them stay near it."""

from __future__ import annotations

import dataclasses
from functools import partial
from itertools import pairwise

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Vehicle

TOLERANCE = 0.1
"""Largest distance of a motion from its legs [m]."""
_BETWEEN = 0.01
"""Largest distance of a motion from lines between its samples [m]."""
_AT_REST = 1e-6
"""Speed up to which a vehicle is at rest [m/s]: solvers and smoothing round zero."""
_SAMPLES = 64
"""Largest number of samples of a step."""


@dataclasses.dataclass(frozen=True, eq=False)
class Legs:
    """Straight legs of a vehicle: start, places in their order, goal."""

    times: FloatArray
    """times of the places on the scenario's clock [s], shape (M,)"""
    positions: FloatArray
    """places [m], shape (M, 3)"""
    dwells: FloatArray
    """times at rest [s], shape (M,)"""
    deviation: float
    """upper bound of the distance of the motion from the legs [m]"""
    from_rest: bool
    """whether the motion begins at rest"""
    to_rest: bool
    """whether it ends at rest"""

    @property
    def longest(self) -> float:
        """Length of the longest leg [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).max())


def legs_of(plan: Plan, *, timed: bool) -> list[Legs]:
    """Return straight legs of all vehicles, through all their waypoints.

    Args:
        plan: the plan.
        timed: whether distances are those of equal times, not of paths.
    """
    scenario = plan.scenario
    fastest = float(np.linalg.norm(plan.accelerations, axis=-1).max(initial=0.0))
    step = scenario.grid.step
    per_step = int(np.clip(np.ceil(step * np.sqrt(fastest / (8.0 * _BETWEEN))), 1, _SAMPLES))
    lead = scenario.lead
    count = round((scenario.grid.duration + 2.0 * lead) / step * per_step) + 1
    elapsed = np.linspace(-lead, scenario.grid.duration + lead, count)
    between = fastest * (elapsed[1] - elapsed[0]) ** 2 / 8.0
    return [
        _legs(plan, index, vehicle, elapsed, between, timed)
        for index, vehicle in enumerate(scenario.vehicles)
    ]


def _legs(
    plan: Plan, index: int, vehicle: Vehicle, elapsed: FloatArray, between: float, timed: bool
) -> Legs:
    """Return the legs of a vehicle; `between` bounds its distance from lines between samples."""
    grid = plan.scenario.grid
    passed = [each for each in vehicle.waypoints if each.time is not None]
    ends = [each.time + each.dwell for each in passed if each.time is not None and each.dwell]
    marks = grid.since_start([*(each.time or 0.0 for each in passed), *ends])
    times = np.union1d(elapsed, marks)
    positions = plan.sampled(times).positions[index]
    for each, mark in zip(passed, marks, strict=False):
        if each.within == 0.0 and plan.scenario.smoothing is None:
            positions[np.searchsorted(times, mark)] = each.position  # exactly
    fixed = np.unique([0, *np.searchsorted(times, marks), len(times) - 1])
    distances = partial(_at_times, times, positions) if timed else partial(_of_path, positions)
    chosen, deviation = [0], 0.0
    stack = [(int(first), int(last)) for first, last in pairwise(fixed)][::-1]
    while stack:  # the algorithm of Ramer, Douglas and Peucker
        first, last = stack.pop()
        apart = distances(first, last)
        worst = int(np.argmax(apart))
        if apart[worst] > TOLERANCE - between and last > first + 1:
            stack += [(first + worst, last), (first, first + worst)]
            continue
        deviation = max(deviation, float(apart[worst]))
        chosen.append(last)
    dwells = np.zeros(len(times))
    for each, mark in zip(passed, marks, strict=False):
        dwells[np.searchsorted(times, mark)] = each.dwell
    kept = _moving(positions, chosen) if not timed else chosen
    rests = np.linalg.norm(plan.velocities[index, [0, -1]], axis=-1) <= _AT_REST
    own = grid.start + times[kept], positions[kept], dwells[kept], deviation + between
    return Legs(*own, from_rest=bool(rests[0]), to_rest=bool(rests[1]))


def _moving(positions: FloatArray, chosen: list[int]) -> list[int]:
    """Return the chosen samples without those at the place before them."""
    kept = chosen[:1]
    for each in chosen[1:]:
        if np.linalg.norm(positions[each] - positions[kept[-1]]) > 1e-4:
            kept.append(each)
    return kept if len(kept) > 1 else chosen[:1] + chosen[-1:]


def _of_path(positions: FloatArray, first: int, last: int) -> FloatArray:
    """Return the distances of samples from the leg between two of them [m]."""
    x, leg = positions[first : last + 1] - positions[first], positions[last] - positions[first]
    along = np.clip(x @ leg / max(float(leg @ leg), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(x - along[:, None] * leg, axis=1))


def _at_times(times: FloatArray, positions: FloatArray, first: int, last: int) -> FloatArray:
    """Return the distances of samples from the leg between two of them at the same times [m]."""
    part = (times[first : last + 1] - times[first]) / max(times[last] - times[first], 1e-12)
    on_leg = positions[first] + part[:, None] * (positions[last] - positions[first])
    return np.asarray(np.linalg.norm(positions[first : last + 1] - on_leg, axis=1))
