"""Plans of the other vehicles, as far as one vehicle has heard of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.onboard.message import Message, MessageError
from drake_rho.planning.onboard.shared_plan import SharedPlan
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.objective import Objective
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid, Separation, State
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere
from drake_rho.verification.holds import first_violation
from drake_rho.verification.quick_bounds import QuickBounds
from drake_rho.verification.trajectory import PiecewiseTrajectory

_SMALLEST = 1e-3
"""Least semi-axis of the ellipsoid around another vehicle, in separations."""


_ANYWHERE = Goal(None)
"""Goal of a vehicle whose plan may end anywhere."""


@dataclasses.dataclass(frozen=True)
class Heard:
    """What was heard of another vehicle last."""

    message: Message
    """its newest message"""
    time: float
    """time at which it was heard last [s]"""


class Others:
    """The other vehicles of a scenario and what they may fly, for one vehicle.

    Until they are heard, they stay at their starts.

    Args:
        scenario: of all vehicles, on the grid of one window.
        name: of the vehicle to which they are others.
        clock_error: largest difference of two vehicles' clocks [s].
        forgets_after: time after which a vehicle that was not heard is out of the radius of
            communication [s]; infinite without one.
        error: largest distance of a vehicle from its start [m].
    """

    def __init__(
        self,
        scenario: Scenario,
        name: str,
        clock_error: float,
        forgets_after: float,
        error: float,
    ) -> None:
        self._name, self._clock_error, self._forgets_after = name, clock_error, forgets_after
        self._scenario, self._heard = _with_limits_only(scenario), dict[str, Heard]()
        names = enumerate(scenario.names)
        self._alone = {each: self._scenario.of_vehicles([index]) for index, each in names}
        grid = scenario.grid
        for each in scenario.vehicles:
            if each.name != name:
                rest = SharedPlan.at_rest(each.start.position, grid.start, grid.step, error)
                self._heard[each.name] = Heard(Message(each.name, -1, rest), grid.start)

    def hear(self, data: bytes, time: float) -> None:
        """Take in a message; one that is not newer only tells that its sender is near.

        Args:
            data: the message.
            time: at which it was heard [s].

        Raises:
            MessageError: it is not one, or a plan in it does not hold. Nothing has changed then.
        """
        message = Message.decoded(data)
        sender, heard = message.sender, self._heard.get(message.sender)
        if heard is None:
            own = "this vehicle's own name" if sender == self._name else "not in the scenario"
            raise MessageError(sender, f"the sender is {own}")
        if message.number > heard.message.number:
            known = {_key(each) for each in heard.message.plans}
            for each in message.plans:
                self._check(sender, each, time, is_known=_key(each) in known)
        elif heard.message.number >= 0:
            message = heard.message
        self._heard[sender] = Heard(message, max(time, heard.time))

    def _check(self, sender: str, plan: SharedPlan, time: float, *, is_known: bool) -> None:
        """Check that a plan may have been announced until now, ends at rest and keeps its limits.

        Raises:
            MessageError: it may not, or does not.
        """
        if not plan.announced <= time + self._clock_error:
            ahead = plan.announced - time
            raise MessageError(sender, f"a plan is from the future, {ahead:.3g} s ahead")
        if plan.start > plan.announced:
            raise MessageError(sender, "a plan begins after its announcement, not before")
        if is_known:
            return
        reason = self.violation(sender, plan)
        if reason is not None:
            raise MessageError(sender, f"a plan violates {reason}")

    def violation(self, sender: str, plan: SharedPlan) -> str | None:
        """Return what a plan violates of rest at its end and its vehicle's limits; None if nothing.

        Args:
            sender: name of the vehicle.
            plan: its plan.
        """
        fleet, index = self._scenario.fleet, self._scenario.index_of(sender)
        p, v = plan.knots
        if float(np.linalg.norm(v[-1])) > TOLERANCE * float(fleet.scale("velocity")[index]):
            return "rest at its end"
        start, alone = State(p[0], v[0]), self._alone[sender]
        vehicle = unchecked(alone.vehicles[0], start=start, goal=_ANYWHERE)
        grid = Grid(plan.step, len(p), 0.0)
        own = Fleet(grid, (vehicle,), alone.limits, reaches=float(fleet.lengths[index]))
        scenario = alone.derived(vehicles=(vehicle,), grid=grid, fleet=own)
        if _surely_within_limits(scenario, plan.accelerations):
            return None
        found = first_violation(Plan.from_accelerations(scenario, plan.accelerations[None]))
        return None if found is None else f"{found.what} by {found.excess:.3g} {found.unit}"

    def near(self, time: float) -> list[tuple[str, Message]]:
        """Return the others that matter, by name: those heard within the radius, or any."""
        return [
            (name, each.message)
            for name, each in self._heard.items()
            if time - each.time <= self._forgets_after
        ]


def _surely_within_limits(scenario: Scenario, accelerations: FloatArray) -> bool:
    """Return whether quick bounds show that a single vehicle keeps its limits.

    There is nothing else in the scenario that it could violate.

    Args:
        scenario: of the vehicle.
        accelerations: in the steps [m/s²], shape (M, 3).
    """
    motion = Motion.from_starts(scenario.fleet, accelerations[None], scenario.grid.step)
    with np.errstate(over="ignore", invalid="ignore"):  # values that overflow are not within
        bounds = QuickBounds.of(PiecewiseTrajectory.of(scenario, motion))
        return bounds.boxes_hold() and bounds.norms_hold()


def _with_limits_only(scenario: Scenario) -> Scenario:
    """Return a scenario that requires nothing but the limits of its vehicles."""
    nothing: dict[str, object] = {"obstacles": (), "requirements": (), "objective": Objective()}
    return scenario.derived(separation=None, disturbance=None, **nothing)


def _key(plan: SharedPlan) -> tuple[object, ...]:
    numbers = plan.announced, plan.start, plan.step, plan.radius
    return (*numbers, plan.state.tobytes(), plan.accelerations.tobytes())


def obstacle_around(separation: Separation, radius: float) -> Obstacle:
    """Return the space around another vehicle that one with a radius keeps clear of, at rest.

    The obstacle, enlarged by the radius r, contains the separation's ellipsoid: with a for its
    semi-axes, the support functions obey |a n| <= |(a - r) n| + r |n|.

    Args:
        separation: that vehicles have to keep.
        radius: of the vehicle that avoids the other [m].
    """
    least = _SMALLEST * separation.distance
    semi_axes: FloatArray = np.maximum(separation.shape.semi_axes - radius, least)
    center, round_one = np.zeros(3), separation.is_round
    return Obstacle(Sphere(center, semi_axes[0]) if round_one else Ellipsoid(center, semi_axes))


def obstacle_of(
    name: str, plan: SharedPlan, around: Obstacle, begin: float, error: float
) -> Obstacle:
    """Return another vehicle as an obstacle.

    Args:
        name: of the obstacle.
        plan: of the other vehicle.
        around: as `obstacle_around` returns it.
        begin: time from which on it matters [s].
        error: largest distance of the other vehicle from its plan [m].
    """
    track = plan.track(begin)
    shape = unchecked(around.shape, center=track.positions[0])
    return unchecked(around, shape=shape, track=track, name=name, position_error=error)
