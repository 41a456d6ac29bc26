"""Whether a plan holds, for those who ask in every window of a receding horizon.

The verdict is `verify`'s, on everything that is known when the plan begins. Quick sufficient
conditions settle most plans in a tenth of the time: quantities at the knots, bounds between them,
and the greatest radii of errors in each step. What these leave open is judged as `verify` does it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import combinations

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.motion.tube import Greatest, tube_of
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.parts import GRAVITY, Quantity
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.verification.boxes import check_boxes
from drake_rho.verification.closest_pairs import from_ellipsoid
from drake_rho.verification.continuous_time import AnyLower, least_over_time
from drake_rho.verification.course import Course
from drake_rho.verification.kinds import refuse_unknown
from drake_rho.verification.norms import check_norms
from drake_rho.verification.obstacles import check_obstacle, seen_from
from drake_rho.verification.report import PRECISION, Check, Column
from drake_rho.verification.separation import check_separation
from drake_rho.verification.states import check_planned
from drake_rho.verification.steps import Steps
from drake_rho.verification.tubes import Tubes
from drake_rho.verification.waypoints import check_waypoints

_ALL_PAIRS = 100
"""Vehicles up to which every pair is looked at."""


def first_violation(plan: Plan, obstacles: Iterable[int] | None = None) -> Check | None:
    """Return the worst that a plan breaks of the first constraint that it breaks; None if it holds.

    Args:
        plan: what is judged by what is known when it begins, with all of its tube.
        obstacles: numbers of the only constraints that are looked at, if given.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is told as no number
        refuse_unknown(plan.scenario)
        judged = _Judged.of(plan)
        for is_kept, columns in judged.kinds(obstacles):
            if not is_kept():
                for column in columns():
                    if not column.holds:
                        return _worst(column, plan.scenario)
    return None


def _worst(column: Column, scenario: Scenario) -> Check:
    """Return the check of a column that is furthest from being held."""
    names = [vehicle.name for vehicle in scenario.vehicles]
    checks = [each for each in column.checks(names) if each is not None and not each.holds]
    return max(checks, key=lambda each: np.nan_to_num(each.excess, nan=np.inf))


Kind = tuple[Callable[[], bool], Callable[[], Iterator[Column]]]
"""A quick sufficient test of a kind of constraints, and the full judgement for when it fails."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Judged:
    """A plan as it is judged, with upper bounds of the radii of errors in each step."""

    plan: Plan
    course: Course
    radii: Greatest
    """in each step, arrays of shape (K-1,)"""

    @classmethod
    def of(cls, plan: Plan) -> _Judged:
        scenario, grid = plan.scenario, plan.scenario.grid
        motion = Motion.from_starts(scenario.fleet, plan.accelerations, grid.step)
        course = Course.of(scenario, motion, Tubes.around(plan))
        nothing = np.zeros(grid.knots - 1)
        radii = Greatest(nothing, nothing, nothing, np.zeros(grid.knots))
        if scenario.disturbance is not None:
            tube = tube_of(scenario)
            first = round((grid.start - tube.grid.start) / grid.step)
            radii = tube.over_steps(first, grid.knots - 1)
        return cls(plan, course, radii)

    def kinds(self, obstacles: Iterable[int] | None) -> Iterator[Kind]:
        """Yield all kinds of constraints, or only those of some obstacles."""
        course, scenario = self.course, self.course.scenario
        if obstacles is None:
            yield self._states_are_right, lambda: check_planned(self.plan, course)
            jerks = self.plan.motion().jerks()
            yield (lambda: self._boxes_are_kept(jerks)), lambda: check_boxes(course, jerks)
            yield (lambda: self._norms_are_kept(jerks)), lambda: check_norms(course, jerks)
            yield (lambda: not scenario.fleet.waypoints), lambda: check_waypoints(course)
            yield self._all_keep_apart, lambda: check_separation(course)
            obstacles = [number for number, _ in scenario.known]
        for number in obstacles:
            yield from self._obstacle(number)

    def _obstacle(self, number: int) -> Iterator[Kind]:
        yield (
            lambda: self._obstacle_is_avoided(number),
            lambda: check_obstacle(self.course, number),
        )

    def _states_are_right(self) -> bool:
        """Return whether states are those that are flown, and the last ones the goals."""
        plan, course, fleet = self.plan, self.course, self.course.scenario.fleet
        pairs: tuple[tuple[Quantity, FloatArray, FloatArray, FloatArray], ...] = (
            ("position", plan.positions, course.positions, fleet.goal_positions),
            ("velocity", plan.velocities, course.velocities, fleet.goal_velocities),
        )
        for quantity, own, flown, goals in pairs:
            off = np.maximum(
                np.abs(own - flown).max(axis=(1, 2)), np.abs(flown[:, -1] - goals).max(axis=1)
            )
            if not (off <= TOLERANCE / np.sqrt(3.0) * fleet.scale(quantity)).all():
                return False
        return True

    def _boxes_are_kept(self, jerks: FloatArray) -> bool:
        bounds, course = self.course.scenario.fleet.bounds, self.course
        p, v, a, h = (
            course.positions,
            course.velocities,
            course.accelerations,
            course.scenario.grid.step,
        )
        if bounds("position") is not None:
            low = high = p
            radii = self.radii.ends
            if course.scenario.between_knots:
                with np.errstate(divide="ignore"):
                    s = np.clip(np.nan_to_num(-v[:, :-1] / a, nan=0.0), 0.0, h)
                turns = p[:, :-1] + s * (v[:, :-1] + s / 2.0 * a)
                low = np.minimum(np.minimum(p[:, :-1], p[:, 1:]), turns)
                high = np.maximum(np.maximum(p[:, :-1], p[:, 1:]), turns)
                radii = self.radii.position
            if not self._inside("position", low, high, radii):
                return False
        if bounds("velocity") is not None:
            low, high = np.minimum(v[:, :-1], v[:, 1:]), np.maximum(v[:, :-1], v[:, 1:])
            if not self._inside("velocity", low, high, self.radii.velocity):
                return False
        if bounds("acceleration") is not None and not self._inside(
            "acceleration", a, a, self.radii.acceleration
        ):
            return False
        return bounds("jerk") is None or self._inside(
            "jerk", jerks, jerks, np.zeros(jerks.shape[1])
        )

    def _inside(
        self, quantity: Quantity, low: FloatArray, high: FloatArray, radii: FloatArray
    ) -> bool:
        """Return whether extremes, shape (N, M, 3), are in a box by radii, shape (M,)."""
        box = self.course.scenario.fleet.bounds(quantity)
        assert box is not None  # noqa: S101  # asked before
        room = radii[:, None] - box.tolerances[:, None]
        kept = (low >= box.lower[:, None] + room) & (high <= box.upper[:, None] - room)
        return bool(kept.all())

    def _norms_are_kept(self, jerks: FloatArray) -> bool:
        limits, course, radii = self.course.scenario.fleet.norms, self.course, self.radii
        if "max_tilt" in limits:
            return False
        upright = np.array([0.0, 0.0, GRAVITY])
        vectors = {
            "max_speed": (course.velocities, np.maximum(*_beside(radii.velocity))),
            "max_acceleration": (course.commands, radii.acceleration),
            "max_jerk": (jerks, np.zeros(jerks.shape[1])),
            "max_thrust": (course.commands + upright, radii.acceleration),
        }
        for norm, limit in limits.items():
            values, errors = vectors[norm]
            lengths = np.sqrt(np.einsum("nki,nki->nk", values, values)) + errors
            if not (lengths.max(axis=1) <= limit.most + limit.sets.tolerances).all():
                return False
        return True

    def _obstacle_is_avoided(self, number: int) -> bool:
        scenario, fleet = self.course.scenario, self.course.scenario.fleet
        obstacle = scenario.bodies_in_flight[number - 1]
        shape, tolerances = obstacle.shape, fleet.obstacle_tolerances(obstacle.shape)
        kept = (fleet.radii + obstacle.deviation - tolerances)[:, None]
        if not scenario.between_knots:
            x = self.course.positions - obstacle.centers(self.course.elapsed)
            apart = shape.signed_distance(x) >= kept + self.radii.ends
            active = obstacle.is_active(self.course.elapsed, scenario.grid.rounding)
            return bool(apart[:, active].all())
        seen, radii = seen_from(self.course, obstacle), self.radii.position
        if len(seen.course.durations) > len(radii):  # cut at corners of its track
            steps = np.searchsorted(scenario.grid.elapsed, seen.course.elapsed, side="right") - 1
            radii = radii[steps[:-1]]
        least = kept + radii
        low = ~(seen.lowest_at_least(shape, least) >= least)
        owners, pieces = np.nonzero(low & seen.active_pieces)
        some, precision = seen.pieces.select(owners * len(radii) + pieces), PRECISION * tolerances
        asked = least[owners, pieces]
        return not _is_below(some, shape.signed_distance, asked, precision[owners]).any()

    def _all_keep_apart(self) -> bool:
        """Return whether pairs are apart, by what both errors take.

        First where their separation is a ball; in steps that leave it open, as it is measured.
        """
        scenario, course = self.course.scenario, self.course
        separation, count = scenario.separation, len(scenario.vehicles)
        if separation is None or count < 2:
            return True
        if count > _ALL_PAIRS:
            return False
        one, other = np.array(list(combinations(range(count), 2))).T
        states = course.positions, course.velocities, course.accelerations
        relative = [each[one] - each[other] for each in states]
        scaled = [separation.scaled(each) for each in relative]
        distances = np.sqrt(np.einsum("nki,nki->nk", scaled[0], scaled[0]))
        around, wide = separation.distance - separation.tolerance, separation.shape.scales.max()
        if not scenario.between_knots:
            return bool((distances >= around + 2.0 * wide * self.radii.ends).all())
        errors, steps = 2.0 * self.radii.position, course.steps_of(*scaled)
        ways = steps.speeds.reshape(len(one), -1)
        lowest = (distances[:, :-1] + distances[:, 1:] - ways) / 2.0
        pairs, k = np.nonzero(~(lowest >= around + wide * errors))
        which, precision = pairs * len(errors) + k, PRECISION * separation.tolerance
        least = (around + wide * errors)[k]
        close = _is_below(steps.select(which), _length, least, np.full(len(k), precision))
        if separation.is_round or scenario.disturbance is None:
            return not close.any()
        which, least = which[close], (around + errors)[k[close]]
        some, distance = (
            course.steps_of(*relative).select(which),
            partial(from_ellipsoid, separation),
        )
        return not _is_below(some, distance, least, np.full(len(least), precision)).any()


def _length(x: FloatArray) -> FloatArray:
    lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", x, x))
    return lengths


def _is_below(
    steps: Steps,
    distance: Callable[[FloatArray], FloatArray],
    least: FloatArray,
    precision: FloatArray,
) -> BoolArray:
    """Return in which of some steps a distance is ever below what it is to be, shape (M,)."""
    if len(least) == 0:
        return np.zeros(0, dtype=bool)
    owners = np.arange(len(least))[:, None]
    lower = AnyLower.unknown(least + precision)  # of which the search may miss the precision
    found = least_over_time(steps, owners, distance, precision, lower)
    return np.asarray((found.steps >= 0) | np.isnan(found.values))


def _beside(steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what is in the step before each knot, and in the one after it."""
    return np.append(steps[:1], steps), np.append(steps, steps[-1:])
