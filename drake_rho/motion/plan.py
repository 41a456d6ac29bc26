"""Record of planned trajectories: `Plan`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import numpy.typing as npt

from drake_rho.motion.costs import costs_of
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.remainders import remainder
from drake_rho.motion.samples import Samples, times_of
from drake_rho.motion.scenario_tube import tracking_of
from drake_rho.motion.smooth import SmoothMotion, averaged
from drake_rho.motion.statistics import Statistics
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.consistency import check_goals_at_rest
from drake_rho.scenario.described import Described, ShownInNotebooks
from drake_rho.scenario.fields import FloatArray, IntArray, read_only, unchecked
from drake_rho.scenario.parts import MOST_KNOTS
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import TOLERANCE
from drake_rho.scenario.times import steps_lasting

if TYPE_CHECKING:
    from pydrake.trajectories import PiecewisePolynomial


def summary(scenario: Scenario) -> str:
    """Return a scenario's name and its numbers of vehicles and knots."""
    count = len(scenario.vehicles)
    vehicles = "1 vehicle" if count == 1 else f"{count} vehicles"
    return f"{scenario.name}: {vehicles}, {scenario.grid.knots} knots"


@dataclasses.dataclass(frozen=True, eq=False)
class Plan(ShownInNotebooks, metaclass=Described):
    """Trajectories of all vehicles of a scenario.

    Raises:
        ValueError: an array has a shape that does not match the scenario, or a value that is not
            finite.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> plan.positions.shape
        (4, 50, 3)
        >>> plan.trajectory("UAV-1").value(24.5).ravel().round(1).tolist()  # Drake's, at any time
        [2789.0, 1535.6, 2126.7]
    """

    scenario: Scenario
    """the planned scenario"""
    positions: FloatArray
    """p[k] at the knots [m], shape (N, K, 3)"""
    velocities: FloatArray
    """v[k] at the knots [m/s], shape (N, K, 3)"""
    accelerations: FloatArray
    """a[k] from knot k to knot k+1 [m/s²], shape (N, K-1, 3)"""
    statistics: Statistics = dataclasses.field(default_factory=Statistics)
    """statistics of planning"""
    reference: Plan | None = None
    """motion around which obstacles were linearised; None if there was none"""
    jumps: tuple[int, ...] = ()
    """knots, from 0, at which a flight's motion jumps to the measured states of a new window.
    Arrays have the states after a jump; those before it follow from the step that ends there. Empty
    for a planner's result"""

    def __post_init__(self) -> None:
        vehicles, knots = len(self.scenario.vehicles), self.scenario.grid.knots
        # accelerations are checked first: the others follow from them, and so does a NaN
        shapes = {"accelerations": knots - 1, "positions": knots, "velocities": knots}
        for name, length in shapes.items():
            array = read_only(getattr(self, name))
            if array.shape != (vehicles, length, 3):
                expected = (vehicles, length, 3)
                raise ValueError(f"{name}: got shape {array.shape}, expected {expected}")
            if not np.isfinite(array).all():
                vehicle, knot, axis = map(int, np.argwhere(~np.isfinite(array))[0])
                where = f"{self.scenario.vehicles[vehicle].name} at knot {knot} (from 0)"
                value = array[vehicle, knot, axis]
                raise ValueError(f"{name}: got {value} for {where}, expected finite numbers")
            object.__setattr__(self, name, array)
        ends = [-1, *self.jumps, knots - 1]
        if self.jumps and not all(a < b for a, b in pairwise(ends)):
            increasing = f"increasing knots from 0 to {knots - 2}"
            raise ValueError(f"jumps: got {self.jumps}, expected {increasing}")

    def __repr__(self) -> str:
        """Return '<Plan of paper: 4 vehicles, 50 knots, cost 16741.4 m²/s⁴>', without arrays."""
        return f"<Plan of {summary(self.scenario)}, cost {self.cost:.6g} m²/s⁴>"

    @classmethod
    @checked
    def from_accelerations(
        cls, scenario: Scenario, accelerations: FloatArray, statistics: Statistics | None = None
    ) -> Self:
        """Return the plan from the starts with `accelerations` [m/s²], shape (N, K-1, 3)."""
        with np.errstate(over="ignore", invalid="ignore"):  # the plan checks for finite values
            motion = Motion.from_starts(scenario.fleet, accelerations, scenario.grid.step)
        return cls.from_motion(scenario, motion, statistics)

    @classmethod
    def in_pieces(
        cls,
        scenario: Scenario,
        accelerations: FloatArray,
        begins: Mapping[int, FloatArray],
        statistics: Statistics | None = None,
    ) -> Self:
        """Return the plan whose motions restart at some knots, as flights from measured states.

        Args:
            scenario: the flown scenario.
            accelerations: in the steps [m/s²], shape (N, K-1, 3).
            begins: positions [m] and velocities [m/s], shape (N, 6), by knots counted from 0.
            statistics: of planning.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # the plan checks for finite values
            step = scenario.grid.step
            motion = Motion.in_pieces(scenario.fleet, accelerations, step, begins)
        return cls.from_motion(scenario, motion, statistics, tuple(sorted(begins)))

    @classmethod
    def from_motion(
        cls,
        scenario: Scenario,
        motion: Motion,
        statistics: Statistics | None = None,
        jumps: tuple[int, ...] = (),
    ) -> Self:
        """Return the plan with a motion of a scenario's vehicles, arrays of shape (N, ..., 3)."""
        p, v, a = motion.positions, motion.velocities, motion.accelerations
        return cls(scenario, p, v, a, statistics or Statistics(), jumps=jumps)

    def with_statistics(self, statistics: Statistics) -> Plan:
        """Return the plan with other statistics."""
        return unchecked(self, statistics=statistics)

    def lasting(self, seconds: float) -> Plan:
        """Return the plan with another wall time of planning [s]."""
        return unchecked(self, statistics=unchecked(self.statistics, seconds=seconds))

    def found_around(self, reference: Plan) -> Plan:
        """Return the plan with a reference, stored as its motion alone."""
        motion = unchecked(reference, reference=None, statistics=Statistics())
        return unchecked(self, reference=motion)

    @property
    def arrivals(self) -> FloatArray:
        """Times from which vehicles stay at their goals [s], shape (N,); NaN where one is missed.

        A vehicle that moves at its goal arrives at the last knot, and one without an exact position
        as its goal stays where it ends.
        """
        fleet, grid = self.scenario.fleet, self.scenario.grid
        goals = np.where(
            fleet.given_positions[:, None], fleet.goal_positions, self.positions[:, -1]
        )
        away = np.linalg.norm(self.positions - goals[:, None], axis=2)
        there = away <= TOLERANCE * fleet.lengths[:, None]
        stays = np.logical_and.accumulate(there[:, ::-1], axis=1)[:, ::-1]
        first = np.argmax(stays, axis=1)
        return np.where(stays[:, -1], grid.times[first], np.nan)

    @property
    def kind(self) -> Literal["plan"]:
        """Kind of the record."""
        return "plan"

    @property
    def plan(self) -> Plan:
        """The plan itself."""
        return self

    @property
    def windows(self) -> tuple[()]:
        """Windows of a receding horizon: none."""
        return ()

    @property
    def sightings(self) -> tuple[()]:
        """Obstacles that became known during the flight: none."""
        return ()

    @property
    def flight(self) -> None:
        """Flight in windows: none."""

    @property
    def simulation(self) -> None:
        """Simulation of the motion: none."""

    @property
    def times(self) -> FloatArray:
        """Times of the knots on the scenario's clock [s], shape (K,)."""
        return self.scenario.grid.times

    @property
    def cost(self) -> float:
        """Cost [m²/s⁴]: the sum of squared accelerations (13), or the scenario's `Objective`."""
        return float(costs_of(self.scenario, self).sum())

    @checked
    def at(self, times: npt.ArrayLike, vehicle: str | None = None) -> Samples:
        """Return positions, velocities and accelerations at times; they are exact at any time.

        With a smoothing they are those of the smooth motion, which begins before the first knot
        and ends after the last.

        Args:
            times: times on the scenario's clock [s], shape (T,), or a single one.
            vehicle: name of one vehicle; all vehicles if not given.

        Returns:
            A record with arrays of shape (N, T, 3), or (T, 3) for one vehicle. Accelerations are
            those of the step that begins at a knot, at the last knot of the step that ends there.
            At a jump all states are those after it.

        Raises:
            ValueError: a time is outside the flight, or there is no such vehicle.
        """
        index = None if vehicle is None else self.scenario.index_of(vehicle)
        samples = self.sampled(times_of(self.scenario.grid, times, self.scenario.lead))
        return samples if index is None else samples.of(index)

    def sampled(self, elapsed: FloatArray) -> Samples:
        """Return the states at times since the first knot [s]; at knots, the plan's own numbers.

        With a smoothing they are those of the smooth motion, at knots too.
        """
        names, start = self.scenario.names, self.scenario.grid.start
        return Samples(names, start + elapsed, *self.averaged().states(elapsed))

    def states(self, knot: int) -> FloatArray:
        """Return positions [m] and velocities [m/s] at a knot counted from 0, shape (N, 6)."""
        return np.concatenate([self.positions[:, knot], self.velocities[:, knot]], axis=1)

    def only(self, vehicles: IntArray) -> Plan:
        """Return the plan of some of the vehicles, given by their indices."""
        return Plan(
            self.scenario.of_vehicles(vehicles.tolist()),
            self.positions[vehicles],
            self.velocities[vehicles],
            self.accelerations[vehicles],
            jumps=self.jumps,
        )

    def motion(self) -> Motion:
        """Return the motion of all vehicles, with values at any time; arrays (N, ..., 3)."""
        return Motion(
            self.scenario.grid.step,
            self.positions,
            self.velocities,
            self.accelerations,
            self.scenario.fleet.accelerations_before,
            self.scenario.fleet.accelerations_after,
            self.scenario.fleet.flown,
        )

    def averaged(self) -> Motion | SmoothMotion:
        """Return the motion as it is flown: with a smoothing, the smooth motion."""
        return averaged(self.motion(), self.scenario.smoothing)

    def stepwise(self) -> Plan:
        """Return the plan without its smoothing."""
        return unchecked(self, scenario=self.scenario.derived(smoothing=None))

    def polynomials(self) -> Polynomials:
        """Return the motion as piecewise polynomials; with a smoothing, the smooth motion."""
        return self.averaged().polynomials()

    def trajectory(self, name: str) -> PiecewisePolynomial:
        """Return the trajectory of the vehicle called `name` as Drake's type, exact at all times.

        Its pieces are quadratic, and with a smoothing of n averages polynomials of degree n + 2.

        Raises:
            ValueError: there is no such vehicle.
        """
        vehicle = self.scenario.index_of(name)
        return self.polynomials().trajectory(vehicle, self.scenario.grid.start)

    @checked
    def holding(self, seconds: float) -> Plan:
        """Return the plan continued at rest: vehicles hold at their goals for a time after the end.

        Its grid is longer by the time, rounded up to whole steps. The feedback, if any, is that of
        this plan, so that the error tube continues unchanged.

        Args:
            seconds: time to hold [s], rounded up to whole steps.

        Raises:
            ValueError: the time is negative, infinite or NaN, or there would be too many knots.
            ScenarioError: a goal has a velocity, so that its vehicle moves on.

        Examples:
            >>> scenario = rho.load_scenario("courier")
            >>> longer = rho.plan(scenario).holding(60.0)
            >>> longer.scenario.grid.end, rho.verify(longer).ok
            (70.0, True)
        """
        scenario, grid = self.scenario, self.scenario.grid
        most = (MOST_KNOTS - grid.knots) * grid.step
        if not 0.0 <= seconds <= most:
            raise ValueError(f"seconds: got {seconds}, expected a time from 0 to {most:g} s")
        check_goals_at_rest(scenario.vehicles)
        steps = steps_lasting(seconds, grid.step)
        disturbance = scenario.disturbance
        disturbance = disturbance and unchecked(disturbance, tracking=tracking_of(scenario))
        longer = scenario.derived(
            grid=grid.from_knot(0, grid.knots - 1 + steps), disturbance=disturbance
        )
        still = np.zeros((len(scenario.vehicles), steps, 3))
        return Plan(
            longer,
            np.concatenate([self.positions, still + self.positions[:, -1:]], axis=1),
            np.concatenate([self.velocities, still], axis=1),
            np.concatenate([self.accelerations, still], axis=1),
            self.statistics.held(),
            jumps=self.jumps,
        )

    def tail(self, knot: int) -> Plan:
        """Return the remaining plan from `knot`, counted from 0, as a separate plan.

        Raises:
            ValueError: no step begins at `knot`.
        """
        return unchecked(
            self,
            scenario=remainder(self.scenario, self.motion(), knot),
            positions=self.positions[:, knot:],
            velocities=self.velocities[:, knot:],
            accelerations=self.accelerations[:, knot:],
            statistics=Statistics(),
            reference=None,
            jumps=tuple(each - knot for each in self.jumps if each > knot),
        )
