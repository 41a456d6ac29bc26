"""Violations of a motion that is no plan yet: too close to something, or out of limits."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.motion.close_pairs import NO_APPROACHES, CloseApproaches
from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.close_pairs import violating_pairs
from drake_rho.planning.constraints.obstacles import KeepOutOfObstacle
from drake_rho.planning.constraints.separation import NAME
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.problem import Problem
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import TOLERANCE, Scenario

_SMALL = 0.05
"""Part of a separation, or of an obstacle's least extent, by which vehicles may be too close and
rows are tried as hard ones."""

_TOLERATED = 0.99
"""Part of the verifier's tolerance up to which coming too close counts as none. Programs require
less, and solvers give about that: a motion that is held against them would not become another by
being linearised anew."""


@dataclasses.dataclass(frozen=True)
class Violations:
    """Violations of a motion; where it is too close, the worst instants of each step."""

    scenario: Scenario
    """of the motion"""
    pairs: CloseApproaches
    """vehicles that are too close to each other"""
    inside: dict[int, CloseApproaches]
    """by the number of an obstacle, vehicles that come too close to it, and by how much: distances
    from what is required, below zero"""
    inconsistent: IntArray
    """vehicles whose positions are not those that their accelerations lead to, shape (U,)"""
    beyond: IntArray
    """vehicles that violate limits of their own, or miss their goals, shape (B,)"""

    @property
    def none(self) -> bool:
        """Whether the motion violates nothing."""
        return len(self.pairs) == 0 and self.is_of_pairs_only

    @property
    def is_of_pairs_only(self) -> bool:
        """Whether everything holds but for the separation of pairs."""
        return not self.inside and len(self.inconsistent) + len(self.beyond) == 0

    @cached_property
    def vehicles(self) -> IntArray:
        """Vehicles that violate something, rising."""
        obstacles = [found.one for found in self.inside.values()]
        return np.unique(
            np.concatenate(
                [self.pairs.one, self.pairs.other, self.inconsistent, self.beyond, *obstacles]
            )
        )

    @property
    def _apart(self) -> float:
        separation = self.scenario.separation
        return 0.0 if separation is None else separation.distance

    @cached_property
    def worst(self) -> float:
        """Largest distance by which anything is too close [m], of pairs in their separation's."""
        inside = (-each.distances for each in self.inside.values())
        short = [self._apart - self.pairs.distances, *inside]
        return max((float(each.max()) for each in short if len(each) > 0), default=0.0)

    @property
    def is_small(self) -> bool:
        """Whether the motion is dynamically consistent, within limits, and nearly clear."""
        return len(self.inconsistent) + len(self.beyond) == 0 and self.is_nearly_clear

    @cached_property
    def is_nearly_clear(self) -> bool:
        """Whether what is too close is so by little."""
        if np.any(self.pairs.distances <= (1.0 - _SMALL) * self._apart):
            return False
        for number, found in self.inside.items():
            little = _SMALL * self.scenario.bodies[number - 1].shape.extent.min()
            if np.any(found.distances < -little):
                return False
        return True

    def error(self, spent: Statistics) -> InfeasibleError:
        """Return the error that names for each vehicle what it is too close to, and when most."""
        scenario = self.scenario
        names = [vehicle.name for vehicle in scenario.vehicles]
        reasons: dict[str, dict[str, str]] = {}
        touched: dict[str, set[int]] = {}

        def note(vehicle: int, what: str, time: float, number: int) -> None:
            at = clock_time(scenario.grid.start + time, 4)
            reasons.setdefault(names[vehicle], {}).setdefault(what, f"{what} at {at}")
            touched.setdefault(names[vehicle], set()).add(number)

        for one, other, time in _worst_first(self.pairs):
            note(one, f"{NAME} from {names[other]}", time, 0)
            note(other, f"{NAME} from {names[one]}", time, 0)
        for number, found in self.inside.items():
            for one, _, time in _worst_first(found):
                note(one, scenario.obstacle_name(number), time, number)
        return InfeasibleError(
            {name: tuple(each.values()) for name, each in reasons.items()},
            statistics=spent,
            scenario=scenario,
            obstacles={name: frozenset(numbers) for name, numbers in touched.items()},
        )


def violations_of(
    problem: Problem, plan: Plan, before: tuple[Plan, Violations] | None = None
) -> Violations:
    """Return what a plan violates, or a reference that is dynamically inconsistent.

    Args:
        problem: to be solved.
        plan: of the same vehicles.
        before: another plan and its violations; vehicles that fly the same are not looked at again.
    """
    scenario, motion = problem.scenario, plan.motion()
    between, apart, margins = scenario.between_knots, scenario.separation, problem.margins
    obstacles = problem.obstacles_around(motion)
    approaches = [(each.obstacle_number, _too_deep(each, motion)) for each in obstacles]
    inside = {n: found for n, found in approaches if n is not None and len(found) > 0}
    moved = None if before is None else _moved(before[0].motion(), motion)
    pairs = NO_APPROACHES
    if apart is not None:
        finer = motion.subdivided(margins.pieces)
        pairs = violating_pairs(apart, finer, margins.inner, between=between, of=moved)
        pairs = pairs.select(pairs.distances < apart.distance - _TOLERATED * apart.tolerance)
    looked = np.arange(len(scenario.vehicles)) if moved is None else moved
    inconsistent = _inconsistent(scenario, motion, looked)
    beyond = _beyond(problem, motion, looked)
    if before is not None and moved is not None:
        old = before[1]
        pairs = pairs.union(
            old.pairs.select(~np.isin(old.pairs.one, moved) & ~np.isin(old.pairs.other, moved))
        )
        inconsistent = np.union1d(inconsistent, np.setdiff1d(old.inconsistent, moved))
        beyond = np.union1d(beyond, np.setdiff1d(old.beyond, moved))
    return Violations(scenario, pairs, inside, inconsistent, beyond)


def _too_deep(obstacle: KeepOutOfObstacle, motion: Motion) -> CloseApproaches:
    """Return where a motion comes too close to an obstacle by more than is tolerated."""
    found = obstacle.approaches(motion)
    return found.select(found.distances < -_TOLERATED * obstacle.tolerances[found.one])


def _moved(before: Motion, after: Motion) -> IntArray:
    """Return the vehicles that fly something else, or whose positions differ."""
    same = np.all(before.accelerations == after.accelerations, axis=(1, 2))
    same &= np.all(before.positions == after.positions, axis=(1, 2))
    return np.flatnonzero(~same)


def _inconsistent(scenario: Scenario, motion: Motion, vehicles: IntArray) -> IntArray:
    """Return the vehicles whose positions are not those that their accelerations lead to."""
    fleet = scenario.fleet
    start = fleet.start_positions[vehicles], fleet.start_velocities[vehicles]
    positions, _ = roll_out(*start, motion.accelerations[vehicles], motion.step)
    missed = np.abs(positions - motion.positions[vehicles]).max(axis=(1, 2), initial=0.0)
    found: IntArray = vehicles[missed > TOLERANCE * fleet.lengths[vehicles]]
    return found


def _beyond(problem: Problem, motion: Motion, vehicles: IntArray) -> IntArray:
    """Return the vehicles that violate limits, miss waypoints, or miss their goals."""
    fleet = problem.scenario.fleet
    missed = np.abs(motion.positions[:, -1] - fleet.goal_positions).max(axis=1)
    late = np.abs(motion.velocities[:, -1] - fleet.goal_velocities).max(axis=1)
    off = (missed > TOLERANCE * fleet.lengths) | (late > TOLERANCE * fleet.scale("velocity"))
    found = [vehicles[off[vehicles]]]
    for constraint in problem.convex:
        for between in (False, True)[: 1 + (constraint.searches > 0)]:
            rows = constraint.violated_rows(motion, vehicles, between=between)
            found.append(rows.vehicles[rows.margins(motion) < -rows.tolerances])
    return np.unique(np.concatenate(found))


def _worst_first(found: CloseApproaches) -> list[tuple[int, int, float]]:
    """Return the vehicles and times of approaches, those of least distance first."""
    order = np.argsort(found.distances, kind="stable")
    worst = found.select(order)
    return list(zip(worst.one.tolist(), worst.other.tolist(), worst.times.tolist(), strict=True))
