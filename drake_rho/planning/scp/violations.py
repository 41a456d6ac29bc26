"""Violations of distances, limits and dynamics by motions, which need not be plans."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.motion.close_pairs import NO_APPROACHES, CloseApproaches
from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.close_pairs import violating_pairs
from drake_rho.planning.constraints.keep_out import KeepOutOfObstacle
from drake_rho.planning.constraints.separation import NAME
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.problem import Problem
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import TOLERANCE, Scenario

_SMALL = 0.05
"""Largest violation at which hard rows are tried, as a fraction of the separation or of an
obstacle's least extent."""

_TOLERATED = 0.99
"""Fraction of the verifier's tolerance up to which a distance counts as satisfied. Programs allow
less and solvers reach about that much, so a stricter test would reject motions that further
linearisation does not change."""


@dataclasses.dataclass(frozen=True)
class Violations:
    """Violations of a motion, with distances at the worst instants of each time step."""

    scenario: Scenario
    """scenario of the motion"""
    pairs: CloseApproaches
    """approaches of vehicles that are too close to each other"""
    inside: dict[int, CloseApproaches]
    """approaches of vehicles that are too close to an obstacle, by its number; their distances are
    measured from the required clearance and negative"""
    inconsistent: IntArray
    """vehicles with dynamically inconsistent positions, ascending, shape (U,)"""
    beyond: IntArray
    """vehicles that violate their own limits or miss their goals, ascending, shape (B,)"""

    @property
    def none(self) -> bool:
        """Whether the motion violates nothing."""
        return len(self.pairs) == 0 and self.is_of_pairs_only

    @property
    def is_of_pairs_only(self) -> bool:
        """Whether all constraints hold except perhaps the separation of pairs."""
        return not self.inside and len(self.inconsistent) + len(self.beyond) == 0

    @cached_property
    def vehicles(self) -> IntArray:
        """Indices of the vehicles that violate something, ascending."""
        obstacles = [found.one for found in self.inside.values()]
        return np.unique(
            np.concatenate(
                [self.pairs.one, self.pairs.other, self.inconsistent, self.beyond, *obstacles]
            )
        )

    @property
    def _separation(self) -> float:
        separation = self.scenario.separation
        return 0.0 if separation is None else separation.distance

    @cached_property
    def worst(self) -> float:
        """Largest violation of a distance [m]; for pairs in the norm of their separation."""
        inside = (-each.distances for each in self.inside.values())
        depths = [self._separation - self.pairs.distances, *inside]
        return max((float(each.max()) for each in depths if len(each) > 0), default=0.0)

    @property
    def is_small(self) -> bool:
        """Whether the motion is dynamically consistent and within limits, with small violations."""
        return len(self.inconsistent) + len(self.beyond) == 0 and self.is_nearly_clear

    @cached_property
    def is_nearly_clear(self) -> bool:
        """Whether all violations of distances are small."""
        if np.any(self.pairs.distances <= (1.0 - _SMALL) * self._separation):
            return False
        for number, found in self.inside.items():
            shape = self.scenario.bodies[number - 1].shape
            small = _SMALL * self.scenario.fleet.extent_to_evade(shape)
            if np.any(found.distances < -small):
                return False
        return True

    def error(self, spent: Statistics) -> InfeasibleError:
        """Return the error that names violated distances and their worst times by vehicle."""
        scenario = self.scenario
        names = [vehicle.name for vehicle in scenario.vehicles]
        reasons: dict[str, dict[str, str]] = {}
        obstacles: dict[str, set[int]] = {}

        def add(vehicle: int, name: str, time: float, number: int) -> None:
            at = clock_time(scenario.grid.start + time, 4)
            reasons.setdefault(names[vehicle], {}).setdefault(name, f"{name} at {at}")
            obstacles.setdefault(names[vehicle], set()).add(number)

        for one, other, time in _worst_first(self.pairs):
            add(one, f"{NAME} from {names[other]}", time, 0)
            add(other, f"{NAME} from {names[one]}", time, 0)
        for number, found in self.inside.items():
            for one, _, time in _worst_first(found):
                add(one, scenario.obstacle_name(number), time, number)
        return InfeasibleError(
            {name: tuple(each.values()) for name, each in reasons.items()},
            statistics=spent,
            scenario=scenario,
            obstacles={name: frozenset(numbers) for name, numbers in obstacles.items()},
        )


def violations_of(
    problem: Problem, plan: Plan, before: tuple[Plan, Violations] | None = None
) -> Violations:
    """Return the violations of a plan, or of a reference that may be dynamically inconsistent.

    Args:
        problem: the problem that the plan is for.
        plan: a motion of the problem's vehicles.
        before: another plan and its violations; vehicles with equal motions are not checked again.
    """
    scenario, motion = problem.scenario, plan.motion()
    between, required, margins = scenario.between_knots, scenario.separation, problem.margins
    obstacles = [each for each in problem.obstacles_around(motion) if not each.soft]
    approaches = [(each.number, _too_deep(each, motion)) for each in obstacles]
    inside = {number: found for number, found in approaches if len(found) > 0}
    changed = None if before is None else _changed(before[0].motion(), motion)
    pairs = NO_APPROACHES
    if required is not None:
        finer = motion.subdivided(margins.inner.pieces)
        pairs = violating_pairs(
            problem.pair_search,
            finer,
            margins.inner,
            between=between,
            of=changed,
            open_end=scenario.fleet.open_end,
        )
        least = required.distance - _TOLERATED * required.tolerance
        pairs = pairs.select(pairs.distances < least)
    checked = np.arange(len(scenario.vehicles)) if changed is None else changed
    inconsistent = _inconsistent(scenario, motion, checked)
    beyond = _beyond(problem, motion, checked)
    if before is not None and changed is not None:
        old = before[1]
        pairs = pairs.merged(
            old.pairs.select(~np.isin(old.pairs.one, changed) & ~np.isin(old.pairs.other, changed))
        )
        inconsistent = np.union1d(inconsistent, np.setdiff1d(old.inconsistent, changed))
        beyond = np.union1d(beyond, np.setdiff1d(old.beyond, changed))
    return Violations(scenario, pairs, inside, inconsistent, beyond)


def _too_deep(obstacle: KeepOutOfObstacle, motion: Motion) -> CloseApproaches:
    """Return the approaches to an obstacle that are too close by more than the tolerance."""
    found = obstacle.approaches(motion)
    return found.select(found.distances < -_TOLERATED * obstacle.tolerances[found.one])


def _changed(before: Motion, after: Motion) -> IntArray:
    """Return the vehicles whose accelerations or positions differ between two motions."""
    same = np.all(before.accelerations == after.accelerations, axis=(1, 2))
    same &= np.all(before.positions == after.positions, axis=(1, 2))
    return np.flatnonzero(~same)


def _inconsistent(scenario: Scenario, motion: Motion, vehicles: IntArray) -> IntArray:
    """Return the vehicles whose positions do not follow from their accelerations."""
    fleet = scenario.fleet
    start = fleet.start_positions[vehicles], fleet.start_velocities[vehicles]
    positions, _ = roll_out(*start, motion.accelerations[vehicles], motion.step)
    missed = np.abs(positions - motion.positions[vehicles]).max(axis=(1, 2), initial=0.0)
    found: IntArray = vehicles[missed > TOLERANCE * fleet.lengths[vehicles]]
    return found


def _beyond(problem: Problem, motion: Motion, vehicles: IntArray) -> IntArray:
    """Return the vehicles that violate limits, miss waypoints, or miss their goals."""
    fleet = problem.scenario.fleet
    missed = np.abs(fleet.missed("position", motion.positions[:, -1])).max(axis=1)
    speed = np.abs(fleet.missed("velocity", motion.velocities[:, -1])).max(axis=1)
    off = (missed > TOLERANCE * fleet.lengths) | (speed > TOLERANCE * fleet.scale("velocity"))
    found = [vehicles[off[vehicles]]]
    for constraint in (each for each in problem.convex if not each.soft):
        for between in (False, True)[: 1 + (constraint.searches > 0)]:
            rows = constraint.violated_rows(motion, vehicles, between=between)
            found.append(rows.vehicles[rows.margins(motion) < -rows.tolerances])
    return np.unique(np.concatenate(found))


def _worst_first(found: CloseApproaches) -> list[tuple[int, int, float]]:
    """Return the vehicles and times of approaches, in ascending order of distance."""
    order = np.argsort(found.distances, kind="stable")
    worst = found.select(order)
    return list(zip(worst.one.tolist(), worst.other.tolist(), worst.times.tolist(), strict=True))
