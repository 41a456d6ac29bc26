"""Quick sufficient conditions that a plan holds: bounds on the values of the full checks.

They decide most plans in a tenth of the time: from quantities at the knots, bounds between them,
and the greatest error radii in each step. They are for plans without smoothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from itertools import combinations

import numpy as np

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.motion.tube import Maximum
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.norms import Length
from drake_rho.scenario.parts import Quantity
from drake_rho.verification.check import PRECISION
from drake_rho.verification.continuous_time import AnyLower, least_over_time
from drake_rho.verification.obstacles import encounters, relative_to
from drake_rho.verification.separation import ellipsoid_distance
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import ErrorRadii

_ALL_PAIRS = 100
"""Largest number of vehicles for which the quick condition visits every pair."""


@dataclasses.dataclass(frozen=True, eq=False)
class QuickBounds:
    """A plan's trajectory with upper bounds of the error radii in each step."""

    trajectory: PiecewiseTrajectory
    """trajectory to verify"""
    radii: Maximum
    """greatest error radii in each step, arrays of shape (K-1,)"""

    @classmethod
    def of(cls, trajectory: PiecewiseTrajectory) -> QuickBounds:
        """Return the bounds of a plan's trajectory; the radii are zero beside smoothing."""
        scenario, grid = trajectory.scenario, trajectory.scenario.grid
        nothing = np.zeros(grid.knots - 1)
        radii = Maximum(nothing, nothing, nothing, np.zeros(grid.knots))
        if scenario.disturbance is not None and not trajectory.is_smooth:
            tube = tube_of(scenario)
            first = round((grid.start - tube.grid.start) / grid.step)
            radii = tube.over_steps(first, grid.knots - 1)
        return cls(trajectory, radii)

    def boxes_hold(self) -> bool:
        """Return whether all quantities are certainly inside their boxes."""
        trajectory, radii, limited = self.trajectory, self.radii, self.trajectory.jerks.limited
        v, a = trajectory.velocities, trajectory.accelerations
        ends = v[:, :-1], v[:, 1:]
        return (
            self._positions_inside()
            and self._inside("velocity", np.minimum(*ends), np.maximum(*ends), radii.velocity)
            and self._inside("acceleration", a, a, radii.acceleration)
            and self._inside("jerk", limited, limited, np.zeros(limited.shape[1]))
        )

    def _positions_inside(self) -> bool:
        """Return whether positions are certainly inside their box, also where velocities turn."""
        trajectory = self.trajectory
        p, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
        if trajectory.scenario.fleet.bounds("position") is None:
            return True
        if not trajectory.scenario.between_knots:
            return self._inside("position", p, p, self.radii.ends)
        with np.errstate(divide="ignore"):
            s = np.nan_to_num(-v[:, :-1] / a, nan=0.0)
        s = np.clip(s, 0.0, trajectory.scenario.grid.step)
        turns = p[:, :-1] + s * (v[:, :-1] + s / 2.0 * a)
        low = np.minimum(np.minimum(p[:, :-1], p[:, 1:]), turns)
        high = np.maximum(np.maximum(p[:, :-1], p[:, 1:]), turns)
        return self._inside("position", low, high, self.radii.position)

    def _inside(
        self, quantity: Quantity, low: FloatArray, high: FloatArray, radii: FloatArray
    ) -> bool:
        """Return whether extremes (N, M, 3) are inside any box, tightened by error radii (M,)."""
        box = self.trajectory.scenario.fleet.bounds(quantity)
        if box is None:
            return True
        tightening = radii[:, None] - box.tolerances[:, None]
        lower, upper = box.lower[:, None] + tightening, box.upper[:, None] - tightening
        return bool(((low >= lower) & (high <= upper)).all())

    def norms_hold(self) -> bool:
        """Return whether all norms are certainly within their limits."""
        trajectory, radii, limited = self.trajectory, self.radii, self.trajectory.jerks.limited
        vectors = {
            "velocity": (trajectory.velocities, np.maximum(*_beside(radii.velocity))),
            "acceleration": (trajectory.commands, radii.acceleration),
            "jerk": (limited, np.zeros(limited.shape[1])),
        }
        for limit in trajectory.scenario.fleet.norms.values():
            if not isinstance(limit.kind, Length):  # decided by the full check
                return False
            values, errors = vectors[limit.kind.quantity]
            lengths = limit.kind.measured(values) + errors
            if not (lengths.max(axis=1) <= limit.limits + limit.sets.tolerances).all():
                return False
        return True

    def obstacle_is_avoided(self, number: int) -> bool:
        """Return whether all vehicles certainly avoid an obstacle, by its number from 1."""
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
        needed, distance = (least + seen.grown)[owners, pieces], shape.local_distance
        if isinstance(shape, Map):
            met = encounters(shape, some, needed)
            some, distance = met.steps, met.distance
            owners, needed = owners[met.pieces], needed[met.pieces]
        return not _is_below(some, distance, needed, precision[owners]).any()

    def all_keep_apart(self) -> bool:
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
