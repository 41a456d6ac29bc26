"""Records of what was planned and flown: `Plan`, `Window`, `Flight`."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.tube import tube_of
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray, locked, unchecked
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario

if TYPE_CHECKING:
    from pydrake.trajectories import PiecewisePolynomial


def told(scenario: Scenario) -> str:
    """A scenario in a few words."""
    count = len(scenario.vehicles)
    vehicles = "1 vehicle" if count == 1 else f"{count} vehicles"
    return f"{scenario.name}: {vehicles}, {scenario.grid.knots} knots"


@dataclasses.dataclass(frozen=True, eq=False)
class Plan(metaclass=Described):
    """One trajectory for every vehicle of a scenario.

    Raises:
        ValueError: an array has another shape than the scenario asks for, or a value that is no
            finite number.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> plan.positions.shape
        (4, 50, 3)
        >>> plan.trajectory("UAV-1").value(24.5).ravel().round(1).tolist()  # Drake's, at any time
        [2789.0, 1535.6, 2126.7]
    """

    scenario: Scenario
    """what was asked"""
    positions: FloatArray
    """p[k] at the knots [m], shape (N, K, 3)"""
    velocities: FloatArray
    """v[k] at the knots [m/s], shape (N, K, 3)"""
    accelerations: FloatArray
    """a[k] from knot k to knot k+1 [m/s²], shape (N, K-1, 3)"""
    statistics: Statistics = dataclasses.field(default_factory=Statistics)
    """what it took"""
    reference: Plan | None = None
    """the motion around which obstacles were linearised to find it; None if there was none"""

    def __post_init__(self) -> None:
        vehicles, knots = len(self.scenario.vehicles), self.scenario.grid.knots
        # accelerations first: the others follow from them, and so would a number that is none
        shapes = {"accelerations": knots - 1, "positions": knots, "velocities": knots}
        for name, length in shapes.items():
            array = locked(getattr(self, name))
            if array.shape != (vehicles, length, 3):
                expected = (vehicles, length, 3)
                raise ValueError(f"{name}: got shape {array.shape}, expected {expected}")
            if not np.isfinite(array).all():
                vehicle, knot, axis = map(int, np.argwhere(~np.isfinite(array))[0])
                where = f"{self.scenario.vehicles[vehicle].name} at knot {knot} (from 0)"
                value = array[vehicle, knot, axis]
                raise ValueError(f"{name}: got {value} for {where}, expected finite numbers")
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        """As in '<Plan of paper: 4 vehicles, 50 knots, cost 16741.4 m²/s⁴>': arrays are many."""
        return f"<Plan of {told(self.scenario)}, cost {self.cost:.6g} m²/s⁴>"

    @classmethod
    @checked
    def from_accelerations(
        cls, scenario: Scenario, accelerations: FloatArray, statistics: Statistics | None = None
    ) -> Self:
        """The plan that flies `accelerations` [m/s²], shape (N, K-1, 3), from the starts."""
        with np.errstate(over="ignore", invalid="ignore"):  # the plan refuses what comes of it
            motion = Motion.from_starts(scenario.fleet, accelerations, scenario.grid.step)
        return cls.from_motion(scenario, motion, statistics)

    @classmethod
    def from_motion(
        cls, scenario: Scenario, motion: Motion, statistics: Statistics | None = None
    ) -> Self:
        """The plan that flies a motion of a scenario's vehicles, arrays of shape (N, ..., 3)."""
        p, v, a = motion.positions, motion.velocities, motion.accelerations
        return cls(scenario, p, v, a, statistics or Statistics())

    def with_statistics(self, statistics: Statistics) -> Plan:
        """This plan with another account of what it took."""
        return unchecked(self, statistics=statistics)

    def lasting(self, seconds: float) -> Plan:
        """Return this plan as one that took another wall time [s]."""
        return self.with_statistics(unchecked(self.statistics, seconds=seconds))

    def found_around(self, reference: Plan) -> Plan:
        """This plan with its reference, of which only the motion is kept."""
        motion = unchecked(reference, reference=None, statistics=Statistics())
        return unchecked(self, reference=motion)

    @property
    def times(self) -> FloatArray:
        """Time of every knot [s], shape (K,)."""
        return self.scenario.grid.times

    @property
    def cost(self) -> float:
        """The performance index f (13) [m²/s⁴]: the sum of squared accelerations."""
        return float(np.sum(self.accelerations**2))

    def states(self, knot: int) -> FloatArray:
        """Positions [m] and velocities [m/s] side by side at a knot from 0, shape (N, 6)."""
        return np.concatenate([self.positions[:, knot], self.velocities[:, knot]], axis=1)

    def only(self, vehicles: IntArray) -> Plan:
        """The plan of some of the vehicles, by their indices, as one of its own."""
        return Plan(
            self.scenario.of_vehicles(vehicles.tolist()),
            self.positions[vehicles],
            self.velocities[vehicles],
            self.accelerations[vehicles],
        )

    def motion(self) -> Motion:
        """The motion of all vehicles, to be asked at any time; arrays of shape (N, ..., 3)."""
        return Motion(
            self.scenario.grid.step,
            self.positions,
            self.velocities,
            self.accelerations,
            self.scenario.fleet.accelerations_before,
        )

    def motions(self) -> list[Motion]:
        """The motion of each vehicle alone."""
        whole = self.motion()
        return [
            Motion(whole.step, *each)
            for each in zip(
                whole.positions, whole.velocities, whole.accelerations, whole.before, strict=True
            )
        ]

    def trajectory(self, name: str) -> PiecewisePolynomial:
        """The path of the vehicle called `name`, exact at every time, as Drake's own type.

        Raises:
            ValueError: there is no such vehicle.
        """
        from pydrake.polynomial import Polynomial
        from pydrake.trajectories import PiecewisePolynomial

        vehicle = self.scenario.index_of(name)
        p, v, a = (
            self.positions[vehicle],
            self.velocities[vehicle],
            self.accelerations[vehicle],
        )
        coefficients = np.stack([p[:-1], v[:-1], a / 2], axis=-1)
        pieces = [np.array([[Polynomial(axis)] for axis in coefficients[k]]) for k in range(len(a))]
        return PiecewisePolynomial(pieces, self.times)

    def remainder(self, knot: int) -> Scenario:
        """The scenario that is left at `knot` (counted from 0): same goals, same arrival time.

        The start is the state of the plan there, with the acceleration flown until then.

        Raises:
            ValueError: `knot` is none at which a step begins.
        """
        if not 0 <= knot < self.scenario.grid.knots - 1:
            expected = f"0 to {self.scenario.grid.knots - 2}"
            raise ValueError(f"knot: got {knot}, expected {expected}")
        if knot == 0:
            return self.scenario
        return self.scenario.from_states(
            self.scenario.grid.from_knot(knot),
            self._kept("position", self.positions[:, knot]),
            self._kept("velocity", self.velocities[:, knot]),
            self._kept("acceleration", self.accelerations[:, knot - 1]),
            tube_of(self.scenario).tracking if self.scenario.disturbance else None,
        )

    def _kept(self, quantity: Quantity, values: FloatArray) -> FloatArray:
        """Values of all vehicles; rounding does not put them outside limits that they keep to.

        What is further outside, in a plan that breaks limits, stays where it is.
        """
        fleet = self.scenario.fleet
        if (bounds := fleet.bounds(quantity)) is not None:
            nearest = np.minimum(np.maximum(values, bounds.lower), bounds.upper)
            values = np.where(np.abs(values - nearest) <= bounds.tolerances, nearest, values)
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                excess = limit.sets.excess(np.arange(len(values)), values)
                held = excess <= limit.sets.tolerances
                values = np.where(held[:, None], limit.sets.nearest(values), values)
        return values

    def tail(self, knot: int) -> Plan:
        """What is left of the plan from `knot` (counted from 0) on, as a plan of its own."""
        return unchecked(
            self,
            scenario=self.remainder(knot),
            positions=self.positions[:, knot:],
            velocities=self.velocities[:, knot:],
            accelerations=self.accelerations[:, knot:],
            statistics=Statistics(),
            reference=None,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Window(metaclass=Described):
    """One prediction of a receding horizon: the whole rest of the flight, seen from one knot."""

    first_knot: int
    """where it starts, counted from 0"""
    plan: Plan
    """the whole prediction, up to the goal"""
    reference: Plan
    """the motion around which obstacles were linearised"""
    infeasible: str = ""
    """empty, or why the window had no plan of its own; `plan` is then the previous one's tail, or
    where that does not avoid what is known now, the plan that comes least too close"""
    learned: tuple[int, ...] = ()
    """numbers of the obstacles, from 1, that this window is the first to know of"""
    not_avoided: tuple[int, ...] = ()
    """numbers of the obstacles that its plan does not keep out of"""
    kept: bool = False
    """whether its plan is the previous one's rest, which still holds, in the tube that it had"""
    off_tube: tuple[str, ...] = ()
    """names of the vehicles that were further from the previous plan than its tube reaches and
    estimates err, so that they are disturbed more than the scenario says"""
    unseen: tuple[str, ...] = ()
    """names of the vehicles that were not seen when it was planned, and were predicted"""

    def __repr__(self) -> str:
        """As in '<Window from knot 6: a new plan, cost 12.5 m²/s⁴>'."""
        kind = "a new plan" if not self.infeasible else "what breaks least"
        kind = "the rest of the previous plan" if self.kept else kind
        return f"<Window from knot {self.first_knot + 1}: {kind}, cost {self.plan.cost:.6g} m²/s⁴>"

    @property
    def statistics(self) -> Statistics:
        """What it took, the reference included; `seconds` is the wall time of the whole window."""
        own = self.plan.statistics
        if self.reference is self.plan:
            return own
        return dataclasses.replace(self.reference.statistics + own, seconds=own.seconds)

    def lasting(self, seconds: float) -> Window:
        """Return this window as one that took another wall time [s], the reference included."""
        plan = self.plan.lasting(seconds)
        reference = plan if self.reference is self.plan else self.reference
        return unchecked(self, plan=plan, reference=reference)


@dataclasses.dataclass(frozen=True)
class Sighting:
    """When a flight learned of an obstacle, and what came of it."""

    obstacle: str
    """what it is called"""
    time: float
    """start of the first window that knew of it, on the scenario's clock [s]; without a window,
    when it became known"""
    avoided: bool
    """whether all windows from then on had a plan that keeps out of it"""
    planned_for: bool = True
    """whether there was such a window: what is known after the last one has begun is in no plan"""


@dataclasses.dataclass(frozen=True, eq=False)
class Flight(metaclass=Described):
    """What a receding horizon has flown."""

    plan: Plan
    """the whole flight as flown"""
    windows: tuple[Window, ...]
    """the predictions it was flown by, in their order"""

    def __repr__(self) -> str:
        """As in '<Flight of paper: 4 vehicles, 50 knots, 10 windows, cost 17027.2 m²/s⁴>'."""
        asked, windows = told(self.scenario), len(self.windows)
        return f"<Flight of {asked}, {windows} windows, cost {self.cost:.6g} m²/s⁴>"

    @property
    def scenario(self) -> Scenario:
        """What was asked."""
        return self.plan.scenario

    @property
    def cost(self) -> float:
        """The performance index (13) of what was flown [m²/s⁴]."""
        return self.plan.cost

    @property
    def sightings(self) -> tuple[Sighting, ...]:
        """The obstacles that became known under way, in the order of time."""
        missed = {number for window in self.windows for number in window.not_avoided}
        seen = [
            Sighting(
                self.scenario.obstacle_name(number),
                window.plan.scenario.grid.start,
                number not in missed,
            )
            for window in self.windows
            for number in window.learned
        ]
        return (*seen, *self._unplanned)

    @property
    def _unplanned(self) -> list[Sighting]:
        """The obstacles that became known after the last window began, in the order of time."""
        last = self.windows[-1].plan if self.windows else self.plan
        known = {number for number, _ in last.scenario.known}
        late = [
            (obstacle.known_from, self.scenario.obstacle_name(number))
            for number, obstacle in enumerate(self.scenario.bodies, start=1)
            if number not in known
        ]
        return [
            Sighting(name, time, avoided=False, planned_for=False) for time, name in sorted(late)
        ]

    @property
    def statistics(self) -> Statistics:
        """What all windows took together."""
        return self.plan.statistics

    def lasting(self, seconds: float) -> Flight:
        """Return this flight as one whose planning took another wall time [s]."""
        return dataclasses.replace(self, plan=self.plan.lasting(seconds))
