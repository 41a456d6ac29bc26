"""What a motion breaks, while a plan is still looked for: too close to something, out of limits."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.motion.clearance import NONE, CloseApproaches
from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.catalogue import convex_constraints
from drake_rho.planning.constraints.close_pairs import too_close
from drake_rho.planning.constraints.margins import finer_margins_of
from drake_rho.planning.constraints.obstacles import KeepOutOfObstacle, obstacles_of
from drake_rho.planning.constraints.separation import NAME
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import TOLERANCE, Scenario

_ALMOST = 0.05
"""Part of a separation, or of an obstacle's least extent, by which vehicles may be too close and
rows are tried as hard ones."""

_TOLERATED = 0.99
"""Part of the verifier's tolerance up to which coming too close counts as none. Programs ask for
less, and solvers give about that: a motion that is held against them would not become another by
being linearised anew."""


@dataclasses.dataclass(frozen=True)
class Breaches:
    """What a motion breaks; where it is too close, the worst instants of each step."""

    pairs: CloseApproaches
    """vehicles that are too close to each other"""
    inside: dict[int, CloseApproaches]
    """by the number of an obstacle, vehicles that come too close to it, and by how much: distances
    from what they keep, below zero"""
    unflyable: IntArray
    """vehicles whose positions are not those that their accelerations lead to, shape (U,)"""
    beyond: IntArray
    """vehicles that break limits of their own, or miss their goals, shape (B,)"""

    @property
    def is_of_pairs_only(self) -> bool:
        """Whether everything is kept but for the separation of pairs."""
        return not self.inside and len(self.unflyable) + len(self.beyond) == 0

    @cached_property
    def vehicles(self) -> IntArray:
        """The vehicles that have to be planned anew, rising."""
        obstacles = [found.one for found in self.inside.values()]
        return np.unique(
            np.concatenate(
                [self.pairs.one, self.pairs.other, self.unflyable, self.beyond, *obstacles]
            )
        )

    def worst(self, scenario: Scenario) -> float:
        """By how much anything is too close at most [m], pairs as the separation measures it."""
        apart = 0.0 if scenario.separation is None else scenario.separation.distance
        short = [apart - self.pairs.distances, *(-each.distances for each in self.inside.values())]
        return max((float(each.max()) for each in short if len(each) > 0), default=0.0)

    def is_almost_out(self, scenario: Scenario) -> bool:
        """Whether what is too close is so by little, and the motion can be flown."""
        if len(self.unflyable) + len(self.beyond) > 0:
            return False
        return self.is_almost_clear(scenario)

    def is_almost_clear(self, scenario: Scenario) -> bool:
        """Whether what is too close is so by little."""
        apart = 0.0 if scenario.separation is None else scenario.separation.distance
        if np.any(self.pairs.distances <= (1.0 - _ALMOST) * apart):
            return False
        for number, found in self.inside.items():
            room = _ALMOST * scenario.bodies[number - 1].shape.extent.min()
            if np.any(found.distances < -room):
                return False
        return True

    def error(self, scenario: Scenario, spent: Statistics) -> InfeasibleError:
        """The breaches as an error: for each vehicle what it is too close to, and when most."""
        names = [vehicle.name for vehicle in scenario.vehicles]
        told: dict[str, dict[str, str]] = {}
        touched: dict[str, set[int]] = {}

        def tell(vehicle: int, what: str, time: float, number: int) -> None:
            at = scenario.grid.start + time
            told.setdefault(names[vehicle], {}).setdefault(what, f"{what} at {clock_time(at, 4)}")
            touched.setdefault(names[vehicle], set()).add(number)

        for one, other, time in _worst_first(self.pairs):
            tell(one, f"{NAME} from {names[other]}", time, 0)
            tell(other, f"{NAME} from {names[one]}", time, 0)
        for number, found in self.inside.items():
            for one, _, time in _worst_first(found):
                tell(one, scenario.obstacle_name(number), time, number)
        return InfeasibleError(
            {name: tuple(reasons.values()) for name, reasons in told.items()},
            statistics=spent,
            scenario=scenario,
            obstacles={name: frozenset(numbers) for name, numbers in touched.items()},
        )


def breaches_of(
    scenario: Scenario, plan: Plan, before: tuple[Plan, Breaches] | None = None
) -> Breaches:
    """What a plan breaks, or a reference that cannot be flown.

    Args:
        scenario: what is asked.
        plan: of the same vehicles.
        before: another plan and what it breaks; vehicles that fly the same are not looked at again.
    """
    motion, between = plan.motion(), scenario.between_knots
    apart, margins = scenario.separation, finer_margins_of(scenario)
    obstacles = obstacles_of(scenario, motion)
    approaches = [(each.obstacle_number, _too_deep(each, motion)) for each in obstacles]
    inside = {n: found for n, found in approaches if n is not None and len(found) > 0}
    moved = None if before is None else _moved(before[0].motion(), motion)
    pairs = NONE
    if apart is not None:
        finer = motion.finer(scenario.margin_pieces)
        pairs = too_close(apart, finer, margins, between=between, of=moved)
        pairs = pairs.select(pairs.distances < apart.distance - _TOLERATED * apart.tolerance)
    everyone = np.arange(len(scenario.vehicles))
    looked = everyone if moved is None else moved
    unflyable, beyond = _unflyable(scenario, motion, looked), _beyond(scenario, motion, looked)
    if before is not None and moved is not None:
        old = before[1]
        pairs = pairs.and_also(
            old.pairs.select(~np.isin(old.pairs.one, moved) & ~np.isin(old.pairs.other, moved))
        )
        unflyable = np.union1d(unflyable, np.setdiff1d(old.unflyable, moved))
        beyond = np.union1d(beyond, np.setdiff1d(old.beyond, moved))
    return Breaches(pairs, inside, unflyable, beyond)


def _too_deep(obstacle: KeepOutOfObstacle, motion: Motion) -> CloseApproaches:
    """Return where a motion comes too close to an obstacle by more than is tolerated."""
    found = obstacle.approaches(motion)
    return found.select(found.distances < -_TOLERATED * obstacle.tolerances[found.one])


def _moved(before: Motion, after: Motion) -> IntArray:
    """Vehicles that fly something else, or are said to be elsewhere."""
    same = np.all(before.accelerations == after.accelerations, axis=(1, 2))
    same &= np.all(before.positions == after.positions, axis=(1, 2))
    return np.flatnonzero(~same)


def _unflyable(scenario: Scenario, motion: Motion, vehicles: IntArray) -> IntArray:
    """Those of some vehicles that do not get where the motion says that they are."""
    fleet = scenario.fleet
    start = fleet.start_positions[vehicles], fleet.start_velocities[vehicles]
    positions, _ = roll_out(*start, motion.accelerations[vehicles], motion.step)
    missed = np.abs(positions - motion.positions[vehicles]).max(axis=(1, 2), initial=0.0)
    found: IntArray = vehicles[missed > TOLERANCE * fleet.lengths[vehicles]]
    return found


def _beyond(scenario: Scenario, motion: Motion, vehicles: IntArray) -> IntArray:
    """Those of some vehicles that break limits, miss waypoints, or miss their goals."""
    fleet = scenario.fleet
    missed = np.abs(motion.positions[:, -1] - fleet.goal_positions).max(axis=1)
    late = np.abs(motion.velocities[:, -1] - fleet.goal_velocities).max(axis=1)
    off = (missed > TOLERANCE * fleet.lengths) | (late > TOLERANCE * fleet.scale("velocity"))
    found = [vehicles[off[vehicles]]]
    for constraint in convex_constraints(scenario):
        for between in (False, True)[: 1 + (constraint.searches > 0)]:
            rows = constraint.violated(motion, vehicles, between=between)
            found.append(rows.vehicles[rows.margins(motion) < -rows.tolerances])
    return np.unique(np.concatenate(found))


def _worst_first(found: CloseApproaches) -> list[tuple[int, int, float]]:
    order = np.argsort(found.distances, kind="stable")
    worst = found.select(order)
    return list(zip(worst.one.tolist(), worst.other.tolist(), worst.times.tolist(), strict=True))
