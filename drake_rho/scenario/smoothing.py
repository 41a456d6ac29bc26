"""`Smoothing`: moving averages with which a plan is flown, and checks of scenarios for them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field

from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    NOT_BOOLEAN,
    FloatArray,
    Positive,
    record,
    unchecked,
)
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.limits import GRAVITY
from drake_rho.scenario.parts import Grid, Quantity, State, Vehicle
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.times import Clock


@record
class Smoothing:
    """Moving averages, centred, that make the motion of a plan smooth.

    The acceleration of a plan is a step function. Averaged over a width once it is continuous,
    twice its jerk is too, three times its snap. A plan is at rest before its start and after its
    goal, so that its smooth motion begins `lead` before the first knot and ends as long after the
    last.

    Examples:
        >>> smoothing = rho.Smoothing(0.2, times=2)
        >>> smoothing.lead
        0.2
        >>> round(smoothing.margin(3.0), 6)  # in m, for accelerations up to 3 m/s²
        0.01
    """

    width: Positive
    """w, over which positions are averaged, at most the grid's step [s]"""
    times: Annotated[int, Field(ge=1, le=3), NOT_BOOLEAN] = 1
    """n, the number of averages, one after another: 1, 2 or 3"""

    @property
    def lead(self) -> float:
        """Time by which the smooth motion begins earlier and ends later than its plan [s]."""
        return self.times * self.width / 2.0

    def margin(self, acceleration: float) -> float:
        """Return `margins` of a single acceleration [m]."""
        return float(self.margins(np.float64(acceleration)))

    def margins(self, accelerations: FloatArray | np.float64) -> FloatArray:
        """Return the largest distance of the smooth motion from its plan at the same time [m].

        With the weights g of the averages, which are symmetric and have the variance n w²/12, the
        distance is that of ∫ g(s) (x(t - s) - x(t) + s v(t)) ds from 0, of which each factor is at
        most norm(a) s²/2. It is attained where the acceleration is constant.

        Args:
            accelerations: largest norms of the plan's accelerations within `lead` [m/s²].
        """
        return np.asarray(self.times * self.width**2 / 24.0 * accelerations)

    def for_grid(self, grid: Grid) -> Self:
        """Return the smoothing for another grid: its width is at most the step."""
        return unchecked(self, width=min(self.width, grid.step))


def largest_accelerations(fleet: Fleet) -> FloatArray:
    """Return the largest norms of accelerations that limits allow [m/s²], shape (N,).

    They are infinite where no limit bounds them. A thrust of at most f within the angle θ of the
    vertical is furthest from that of hovering at the rim of its cone, or where it is 0.
    """
    most: FloatArray = np.full(len(fleet.radii), np.inf)
    if (box := fleet.sides("acceleration")) is not None:
        most = np.linalg.norm(np.maximum(*np.abs(box)), axis=1)
    norms = fleet.largest_norms
    if "max_acceleration" in norms:
        most = np.minimum(most, norms["max_acceleration"])
    if "max_thrust" in norms:
        thrusts, angles = norms["max_thrust"], np.full(len(most), np.pi)
        if "max_tilt" in norms:
            angles = np.minimum(norms["max_tilt"], np.pi)
        level, up = thrusts * np.sin(angles), np.cos(angles)
        rim = np.hypot(level, np.where(np.isfinite(thrusts), thrusts * up - GRAVITY, np.inf))
        most = np.minimum(most, np.maximum(rim, GRAVITY))
    return most


def check_smoothing(
    smoothing: Smoothing,
    grid: Grid,
    vehicles: Sequence[Vehicle],
    between_knots: bool,
    tracking: Tracking | None,
) -> None:
    """Check that plans on a grid can be averaged, and extended by rest at both ends.

    Args:
        smoothing: the smoothing.
        grid: grid of the plans.
        vehicles: the vehicles.
        between_knots: whether constraints hold at every instant.
        tracking: of the scenario's disturbance, if any.

    Raises:
        ScenarioError: the width exceeds the step, constraints hold at knots only, or motions do not
            begin and end at rest.
    """
    if grid.clock.after(smoothing.width, grid.step):
        expected = f"at most the grid's step, {grid.step:g} s"
        raise ScenarioError("smoothing.width", smoothing.width, expected)
    if not between_knots:
        expected = "True beside smoothing: averages are taken of every instant"
        raise ScenarioError("between_knots", between_knots, expected)
    if tracking and grid.start - smoothing.lead - tracking.since > grid.step / 2.0:
        expected = (
            f"{grid.start - smoothing.lead:g} s beside smoothing, whose motions begin at rest"
        )
        raise ScenarioError("disturbance.tracking.since", tracking.since, expected)
    for index, each in enumerate(vehicles):
        if not isinstance(each.goal, State) or each.goal.velocity is None:
            expected = "a State at rest beside smoothing: plans are extended by rest at both ends"
            raise ScenarioError(f"vehicles[{index}].goal", each.goal, expected)
        given = {
            f"{end}.{quantity}": getattr(state, quantity)
            for end, state in (("start", each.start), ("goal", each.goal))
            for quantity in ("velocity", "acceleration")
        }
        for field, value in given.items():
            if value is not None and np.any(value):
                expected = "zero beside smoothing: plans are extended by rest at both ends"
                raise ScenarioError(f"vehicles[{index}].{field}", value.tolist(), expected)


def check_limits_of_averages(fleet: Fleet, vehicles: Sequence[Vehicle], margin: float) -> None:
    """Check that limits of accelerations and jerks contain zero, and bound the averages' margin.

    Args:
        fleet: the vehicles as arrays.
        vehicles: the vehicles.
        margin: margin of positions; infinite if it is needed and limits do not bound it [m].

    Raises:
        ScenarioError: a limit does not contain zero, or the margin is infinite.
    """
    limits: tuple[Quantity, ...] = ("acceleration", "jerk")
    for limit in limits:
        if (box := fleet.bounds(limit)) is None:
            continue
        outside = np.flatnonzero(np.any((box.lower > 0.0) | (box.upper < 0.0), axis=1))
        if len(outside) > 0:
            field = _limit_of(vehicles, int(outside[0]), limit)
            expected = "a box that contains zero beside smoothing, whose motions begin at rest"
            raise ScenarioError(field, [box.lower[outside[0]], box.upper[outside[0]]], expected)
    if np.isinf(margin):
        vehicle = int(np.argmax(largest_accelerations(fleet)))
        expected = (
            "an acceleration box, max_acceleration or max_thrust beside smoothing: without one the "
            "smooth motion may be any distance from its plan"
        )
        raise ScenarioError(_limit_of(vehicles, vehicle, "max_acceleration"), None, expected)


def _limit_of(vehicles: Sequence[Vehicle], vehicle: int, limit: str) -> str:
    """Return the field of a limit: the vehicle's own if it has one, else the scenario's."""
    if getattr(vehicles[vehicle].limits, limit, None) is not None:
        return f"vehicles[{vehicle}].limits.{limit}"
    return f"limits.{limit}"


def check_requirements_of_averages(
    requirements: Sequence[KeepIn], fleet: Fleet, names: Sequence[str], grid: Grid, lead: float
) -> None:
    """Check that requirements hold for averages, also before the start and after the goal.

    Args:
        requirements: all requirements.
        fleet: the vehicles.
        names: names of the vehicles.
        grid: grid of the plans.
        lead: time by which averages begin earlier and end later [s].

    Raises:
        ScenarioError: a requirement is relative to a track, or does not contain a vehicle at rest.
    """
    count = len(names)
    for index, each in enumerate(requirements):
        where = f"requirements[{index}]"
        if each.track is not None:
            expected = "a vehicle or none beside smoothing: a track is not averaged"
            raise ScenarioError(f"{where}.relative_to", "a Track", expected)
        if each.quantity == "jerk":  # of averages of accelerations that do not change
            _check_at_rest(each, where, np.zeros((count, 3)), fleet, names)
        resting = each.longer(lead)
        for at, positions in (
            (grid.start, fleet.start_positions),
            (grid.end, fleet.goal_positions),
        ):
            if resting.active is None or _is_inside(at, resting.active, grid.clock):
                values = positions if each.quantity == "position" else np.zeros((count, 3))
                _check_at_rest(each, where, values, fleet, names)


def _is_inside(time: float, interval: tuple[float, float], clock: Clock) -> bool:
    """Return whether a time is strictly inside an interval."""
    return bool(clock.after(time, interval[0]) and clock.before(time, interval[1]))


def _check_at_rest(
    requirement: KeepIn, where: str, values: FloatArray, fleet: Fleet, names: Sequence[str]
) -> None:
    """Check that values at rest (N, 3) are in a requirement's set."""
    members = requirement.members(names)
    relative = requirement.relative(values, np.zeros(len(names)), names)
    outside = requirement.set.signed_distance(relative)
    if np.any(outside > requirement.tolerances(fleet, names)):
        expected = (
            "a set that contains the vehicles at rest, with which smoothing averages near the "
            f"start and the goal; {names[members[int(np.argmax(outside))]]} is outside"
        )
        raise ScenarioError(f"{where}.set", requirement.set, expected)
