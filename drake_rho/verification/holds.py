"""Fast verification of a plan, for every window of a receding horizon.

The verdict equals that of `verify`, with the information available when the plan begins. Quick
sufficient conditions decide most plans in a tenth of the time: quantities at the knots, bounds
between them, and the greatest error radii in each step. Other constraints are verified in full.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import combinations

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.motion.tube import Maximum
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.limits import GRAVITY
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.verification.averages import averaged
from drake_rho.verification.boxes import check_boxes
from drake_rho.verification.check import PRECISION, Check, Column
from drake_rho.verification.closest_pairs import ellipsoid_distance
from drake_rho.verification.continuous_time import AnyLower, least_over_time
from drake_rho.verification.kinds import refuse_unknown
from drake_rho.verification.maps import encounters
from drake_rho.verification.norms import check_norms
from drake_rho.verification.obstacles import check_obstacle, relative_to
from drake_rho.verification.requirements import check_requirements
from drake_rho.verification.rest import check_rest
from drake_rho.verification.separation import check_separation
from drake_rho.verification.states import check_planned
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import ErrorRadii, Tubes
from drake_rho.verification.waypoints import check_waypoints

_ALL_PAIRS = 100
"""Largest number of vehicles for which the quick condition visits every pair."""


def first_violation(plan: Plan, obstacles: Iterable[int] | None = None) -> Check | None:
    """Return the worst violation of the first violated constraint; None if the plan is feasible.

    Args:
        plan: plan to verify with its error tube and the obstacles known when it begins.
        obstacles: numbers of obstacles; if given, only these are verified.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # values that overflow become NaN or inf
        refuse_unknown(plan.scenario)
        check = _PlanCheck.of(plan)
        smooth = plan.scenario.smoothing is not None  # quick conditions are those of steps
        for is_kept, columns in check.kinds(obstacles):
            if smooth or not is_kept():
                for column in columns():
                    if not column.holds:
                        return _worst(column, plan.scenario)
    return None


def _worst(column: Column, scenario: Scenario) -> Check:
    """Return the violated check with the largest excess."""
    names = [vehicle.name for vehicle in scenario.vehicles]
    checks = [each for each in column.checks(names) if each is not None and not each.holds]
    return max(checks, key=lambda each: np.nan_to_num(each.excess, nan=np.inf))


Kind = tuple[Callable[[], bool], Callable[[], Iterator[Column]]]
"""Quick sufficient condition of a kind of constraints, and the full check for when it fails."""


@dataclasses.dataclass(frozen=True, eq=False)
class _PlanCheck:
    """A plan's trajectory with upper bounds of the error radii in each step."""

    plan: Plan
    stepwise: PiecewiseTrajectory
    """motion with constant accelerations in steps"""
    trajectory: PiecewiseTrajectory
    """flown motion: after smoothing, if there is any"""
    radii: Maximum
    """greatest error radii in each step, arrays of shape (K-1,)"""

    @classmethod
    def of(cls, plan: Plan) -> _PlanCheck:
        scenario, grid = plan.scenario, plan.scenario.grid
        motion = Motion.from_starts(scenario.fleet, plan.accelerations, grid.step)
        stepwise = PiecewiseTrajectory.of(scenario, motion, Tubes.of(plan))
        nothing = np.zeros(grid.knots - 1)
        radii = Maximum(nothing, nothing, nothing, np.zeros(grid.knots))
        if scenario.disturbance is not None and scenario.smoothing is None:
            tube = tube_of(scenario)
            first = round((grid.start - tube.grid.start) / grid.step)
            radii = tube.over_steps(first, grid.knots - 1)
        return cls(plan, stepwise, averaged(stepwise), radii)

    def kinds(self, obstacles: Iterable[int] | None) -> Iterator[Kind]:
        """Yield all kinds of constraints, or only those of the given obstacles."""
        trajectory, scenario = self.trajectory, self.trajectory.scenario
        if obstacles is None:
            yield self._states_are_right, lambda: check_planned(self.plan, self.stepwise)
            yield self._boxes_are_kept, lambda: check_boxes(trajectory)
            yield self._norms_are_kept, lambda: check_norms(trajectory)
            yield (lambda: not scenario.fleet.waypoints), lambda: check_waypoints(trajectory)
            yield (lambda: not scenario.requirements), lambda: check_requirements(trajectory)
            yield self._all_keep_apart, lambda: check_separation(trajectory)
            yield (lambda: not scenario.hold_at_goal), lambda: check_rest(scenario)
            obstacles = [number for number, _ in scenario.known]
        for number in obstacles:
            yield from self._obstacle(number)

    def _obstacle(self, number: int) -> Iterator[Kind]:
        yield (
            lambda: self._obstacle_is_avoided(number),
            lambda: check_obstacle(self.trajectory, number),
        )

    def _states_are_right(self) -> bool:
        """Return whether the plan's states obey the dynamics and end at the goals."""
        plan, trajectory, fleet = self.plan, self.trajectory, self.trajectory.scenario.fleet
        pairs: tuple[tuple[Quantity, FloatArray, FloatArray, FloatArray], ...] = (
            ("position", plan.positions, trajectory.positions, fleet.goal_positions),
            ("velocity", plan.velocities, trajectory.velocities, fleet.goal_velocities),
        )
        for quantity, own, flown, goals in pairs:
            off = np.maximum(
                np.abs(own - flown).max(axis=(1, 2)), np.abs(flown[:, -1] - goals).max(axis=1)
            )
            if not (off <= TOLERANCE / np.sqrt(3.0) * fleet.scale(quantity)).all():
                return False
        return True

    def _boxes_are_kept(self) -> bool:
        bounds, trajectory = self.trajectory.scenario.fleet.bounds, self.trajectory
        p, v, a, h = (
            trajectory.positions,
            trajectory.velocities,
            trajectory.accelerations,
            trajectory.scenario.grid.step,
        )
        if bounds("position") is not None:
            low = high = p
            radii = self.radii.ends
            if trajectory.scenario.between_knots:
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
        if bounds("jerk") is None:
            return True
        limited = trajectory.jerks.limited
        return self._inside("jerk", limited, limited, np.zeros(limited.shape[1]))

    def _inside(
        self, quantity: Quantity, low: FloatArray, high: FloatArray, radii: FloatArray
    ) -> bool:
        """Return whether extremes (N, M, 3) are inside a box tightened by error radii (M,)."""
        box = self.trajectory.scenario.fleet.bounds(quantity)
        assert box is not None  # noqa: S101  # callers check this
        tightening = radii[:, None] - box.tolerances[:, None]
        lower, upper = box.lower[:, None] + tightening, box.upper[:, None] - tightening
        return bool(((low >= lower) & (high <= upper)).all())

    def _norms_are_kept(self) -> bool:
        limits, trajectory, radii = (
            self.trajectory.scenario.fleet.norms,
            self.trajectory,
            self.radii,
        )
        upright, limited = np.array([0.0, 0.0, GRAVITY]), trajectory.jerks.limited
        vectors = {
            "max_speed": (trajectory.velocities, np.maximum(*_beside(radii.velocity))),
            "max_acceleration": (trajectory.commands, radii.acceleration),
            "max_jerk": (limited, np.zeros(limited.shape[1])),
            "max_thrust": (trajectory.commands + upright, radii.acceleration),
        }
        if limits.keys() - vectors.keys():  # decided by the full check
            return False
        for norm, limit in limits.items():
            values, errors = vectors[norm]
            lengths = np.sqrt(np.einsum("nki,nki->nk", values, values)) + errors
            if not (lengths.max(axis=1) <= limit.limits + limit.sets.tolerances).all():
                return False
        return True

    def _obstacle_is_avoided(self, number: int) -> bool:
        scenario, fleet = self.trajectory.scenario, self.trajectory.scenario.fleet
        obstacle = scenario.bodies_in_flight[number - 1]
        shape, tolerances = obstacle.shape, fleet.obstacle_tolerances(obstacle.shape)
        required = (fleet.radii + obstacle.deviation - tolerances)[:, None]
        if not scenario.between_knots:
            x = self.trajectory.positions - obstacle.centers(self.trajectory.elapsed)
            errors = self.radii.ends + obstacle.uncertainty(self.trajectory.elapsed)
            apart = shape.local_distance(x) >= required + errors
            active = obstacle.is_active(self.trajectory.elapsed, scenario.grid.clock)
            return bool(apart[:, active].all())
        seen, radii = relative_to(self.trajectory, obstacle), self.radii.position
        if len(seen.trajectory.durations) > len(radii):  # cut at corners of its track
            steps = (
                np.searchsorted(scenario.grid.elapsed, seen.trajectory.elapsed, side="right") - 1
            )
            radii = radii[steps[:-1]]
        least = required + radii
        low = ~(seen.lowest_at_least(shape, least) >= least)
        owners, pieces = np.nonzero(low & seen.active_pieces)
        some, precision = seen.pieces.select(owners * len(radii) + pieces), PRECISION * tolerances
        asked, distance = (least + seen.grown)[owners, pieces], shape.local_distance
        if isinstance(shape, Map):
            met = encounters(shape, some, asked)
            some, distance = met.steps, met.distance
            owners, asked = owners[met.pieces], asked[met.pieces]
        return not _is_below(some, distance, asked, precision[owners]).any()

    def _all_keep_apart(self) -> bool:
        """Return whether all pairs keep their separation plus both vehicles' error radii.

        The distance is first bounded in the scaled space, where the separation is a ball. In steps
        that this leaves open, it is measured as `verify` does.
        """
        scenario, trajectory = self.trajectory.scenario, self.trajectory
        separation, count = scenario.separation, len(scenario.vehicles)
        if separation is None or count < 2:
            return True
        if count > _ALL_PAIRS:
            return False
        one, other = np.array(list(combinations(range(count), 2))).T
        states = trajectory.positions, trajectory.velocities, trajectory.accelerations
        relative = [each[one] - each[other] for each in states]
        scaled = [separation.scaled(each) for each in relative]
        distances = np.sqrt(np.einsum("nki,nki->nk", scaled[0], scaled[0]))
        required, scale = separation.distance - separation.tolerance, separation.shape.scales.max()
        if not scenario.between_knots:
            return bool((distances >= required + 2.0 * scale * self.radii.ends).all())
        errors, steps = 2.0 * self.radii.position, trajectory.steps_of(*scaled)
        lengths = steps.speeds.reshape(len(one), -1)
        lowest = (distances[:, :-1] + distances[:, 1:] - lengths) / 2.0
        pairs, k = np.nonzero(~(lowest >= required + scale * errors))
        which, precision = pairs * len(errors) + k, PRECISION * separation.tolerance
        least = (required + scale * errors)[k]
        close = _is_below(steps.select(which), _length, least, np.full(len(k), precision))
        if separation.is_round or scenario.disturbance is None:
            return not close.any()
        which, least = which[close], (required + errors)[k[close]]
        some, distance = (
            trajectory.steps_of(*relative).select(which),
            partial(ellipsoid_distance, separation),
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
    """Return whether a distance falls below its lower limit in each step, shape (M,)."""
    if len(least) == 0:
        return np.zeros(0, dtype=bool)
    owners = np.arange(len(least))[:, None]
    lower = AnyLower.unknown(least + precision)  # the search may miss as much as the precision
    none = ErrorRadii.constant(np.zeros(len(least)))
    found = least_over_time(steps, owners, distance, precision, lower, none)
    return np.asarray((found.steps >= 0) | np.isnan(found.values))


def _beside(steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the values of the steps before and after each knot."""
    return np.append(steps[:1], steps), np.append(steps, steps[-1:])
