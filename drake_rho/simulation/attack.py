"""The wind that brings a plan's vehicles closest to what they keep clear of, and a flight in it.

At a time t the error of a vehicle is anywhere in a ball of radius ρ(t), and distances from convex
shapes change by no more than a vehicle moves. So no wind leaves less clearance than that of the
plan less ρ(t), or less 2 ρ(t) between two vehicles; and the wind that is worst in the direction of
the nearest surface leaves just that, as long as that surface stays the nearest on the way.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray, locked
from drake_rho.scenario.fleet import Bounds
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.closed_loop import adopted, fly_plan
from drake_rho.simulation.winds import WindOverTime
from drake_rho.simulation.worst_case import WorstCase, worst_case
from drake_rho.verification.boxes import check_position_box
from drake_rho.verification.obstacles import check_obstacle
from drake_rho.verification.report import PRECISION, Column
from drake_rho.verification.separation import check_separation
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import Tubes


@dataclasses.dataclass(frozen=True, eq=False)
class AimedWind(WindOverTime):
    """A worst case that drives each vehicle in a direction of its own."""

    worst: WorstCase
    """the worst case along x"""
    directions: FloatArray
    """unit vectors, or 0 for a vehicle that is left alone, shape (N, 3)"""

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """The wind at times on the scenario's clock [s], in m/s², shape (M, N, 3)."""
        return np.asarray(self.worst.over(times, vehicles)[..., :1] * self.directions)

    @property
    def switching_times(self) -> FloatArray:
        """When it changes, on the scenario's clock [s], shape (S,)."""
        return self.worst.switching_times

    @property
    def position_errors(self) -> FloatArray:
        """Errors of the estimated positions at every sample [m], shape (J, N, 3)."""
        return np.asarray(self.worst.position_errors[:, None, :1] * self.directions)

    @property
    def velocity_errors(self) -> FloatArray:
        """Errors of the estimated velocities at every sample [m/s], shape (J, N, 3)."""
        return np.asarray(self.worst.velocity_errors[:, None, :1] * self.directions)


@dataclasses.dataclass(frozen=True, eq=False)
class Attack(metaclass=Described):
    """What the worst wind does to a plan."""

    constraint: str
    """what is come closest to: an obstacle, the separation, or the position box"""
    vehicles: tuple[str, ...]
    """whose clearance it is: one vehicle, or two"""
    time: float
    """when, on the scenario's clock [s]"""
    planned: float
    """clearance of the plan then, above what is to be kept [m]"""
    bound: float
    """the least that any wind and errors can leave at any time, negative if that breaks it [m]"""
    clearance: float
    """what was left of it in the flight at this time [m]"""
    wind: AimedWind
    """which wind, with the errors of the estimate that belong to it"""
    simulation: Simulation
    """the flight in it"""

    def __repr__(self) -> str:
        """As in '<Attack: v1 is left 0.01 m of 0.2 m beyond what is kept, obstacle 1 at 6.4 s>'."""
        who = " and ".join(self.vehicles)
        left = f"{self.clearance:.3g} m of {self.planned:.3g} m beyond what is kept"
        return f"<Attack: {who} is left {left}, {self.constraint} at {clock_time(self.time, 4)}>"


@dataclasses.dataclass(frozen=True, eq=False)
class _Kept:
    """What one vehicle, or two, keep clear of."""

    name: str
    vehicles: tuple[int, ...]
    clearance: Callable[[FloatArray, FloatArray], FloatArray]
    """of positions (V, T, 3) [m] at times (T,) [s], shape (T,) [m]"""
    inward: Callable[[FloatArray, FloatArray], FloatArray]
    """unit vectors in which vehicles have least clearance, (V, 1, 3) and (1,) to (V, 3)"""


@checked
def attack(scenario: Scenario, plan: Plan) -> Attack:
    """Look for the wind in which a plan keeps least clearance, and fly it in that wind.

    The plan is held by the scenario's feedback from its start to its end, without new windows.

    Args:
        scenario: how strong wind is, how vehicles are held, and what they keep clear of.
        plan: for the same vehicles and grid; it need not have been made for any disturbance.

    Returns:
        The constraint with the least clearance, over all obstacles (those included that are not
        known yet), pairs and sides of position boxes. At all times, or at the knots where the
        scenario asks for no more.

    Raises:
        ValueError: the scenario has no disturbance, is under way, or has nothing to keep clear of;
            or the plan is for other vehicles or another grid.

    Examples:
        >>> scenario = rho.load_scenario("courier")
        >>> rho.attack(scenario, rho.plan(scenario)).clearance > 0.0
        True
    """
    around = scenario.disturbance
    if around is None or around.tracking is not None:
        expected = "one that says how strong wind is, in a scenario that is not under way"
        raise ValueError(f"scenario.disturbance: got {around}, expected {expected}")
    plan = adopted(scenario, plan)
    tightest = _tightest_of_all(scenario, plan)
    if tightest is None:
        expected = "obstacles, a separation or position boxes, to come close to"
        raise ValueError(f"scenario: got nothing to keep clear of, expected {expected}")
    time, kept = tightest.time, tightest.kept
    who, now = list(kept.vehicles), np.array([time])
    at = plan.motion().at("position", now - scenario.grid.start)[who]
    directions = np.zeros((len(scenario.vehicles), 3))
    directions[who] = kept.inward(at, now)
    wind = AimedWind(worst_case(scenario, [1, 0, 0], time), locked(directions))
    simulation = fly_plan(scenario, plan, wind=wind)
    m = int(np.argmin(np.abs(simulation.times - time)))
    left = kept.clearance(simulation.positions[m, who][:, None], now)
    names = tuple(scenario.vehicles[i].name for i in who)
    planned = float(kept.clearance(at, now)[0])
    return Attack(kept.name, names, time, planned, tightest.bound, float(left[0]), wind, simulation)


@dataclasses.dataclass(frozen=True, eq=False)
class _Tightest:
    """Where there is least clearance less radii."""

    bound: float
    """no clearance less radius is below it [m]"""
    time: float
    """on the scenario's clock [s]"""
    kept: _Kept
    """what is come closest to"""


def _tightest_of_all(scenario: Scenario, plan: Plan) -> _Tightest | None:
    """Return what has the least clearance less radii, as the judge finds it; None without any.

    The judge misses no smaller one by more than the part `PRECISION` of the tolerance.
    """
    trajectory = PiecewiseTrajectory.of(scenario, plan.motion(), Tubes.of(plan))
    found: _Tightest | None = None
    for column, kept_by in _judged(trajectory):
        if column.always != scenario.between_knots:
            continue
        bounds = -np.asarray(column.excess) - PRECISION * column.tolerances
        i = int(np.argmin(bounds))
        if np.isfinite(bounds[i]) and (found is None or bounds[i] < found.bound):
            found = _Tightest(float(bounds[i]), float(column.times[i]), kept_by(i))
    return found


def _judged(trajectory: PiecewiseTrajectory) -> Iterator[tuple[Column, Callable[[int], _Kept]]]:
    """Yield the judge's columns, and what is kept clear of in the row of a vehicle."""
    scenario = trajectory.scenario
    for number in range(1, len(scenario.bodies) + 1):
        for column in check_obstacle(trajectory, number):
            yield column, partial(_from_obstacle, scenario, number)
    for column in check_separation(trajectory, far=np.inf):
        assert column.partners is not None  # noqa: S101  # of a separation there always are
        yield column, partial(_from_each_other, scenario, column.partners)
    if (bounds := scenario.fleet.bounds("position")) is not None:
        for column in check_position_box(trajectory):
            yield column, partial(_within, bounds)


def _from_obstacle(scenario: Scenario, number: int, i: int) -> _Kept:
    obstacle = scenario.bodies[number - 1]
    margin = float(scenario.fleet.radii[i]) + obstacle.deviation
    return _Kept(
        scenario.obstacle_name(number),
        (i,),
        lambda p, times: obstacle.distances(p[0], times) - margin,
        lambda p, times: -obstacle.shape.outward(p[0] - obstacle.centers(times)),
    )


def _from_each_other(scenario: Scenario, partners: IntArray, i: int) -> _Kept:
    assert scenario.separation is not None  # noqa: S101  # asked before
    shape, (i, j) = scenario.separation.shape, sorted((i, int(partners[i])))

    def inward(p: FloatArray, times: FloatArray) -> FloatArray:
        n = shape.outward(p[0] - p[1])
        return np.concatenate([-n, n])

    return _Kept("separation", (i, j), lambda p, _: shape.signed_distance(p[0] - p[1]), inward)


def _within(bounds: Bounds, i: int) -> _Kept:
    lower, upper = bounds.lower[i], bounds.upper[i]
    sides = np.concatenate([np.eye(3), -np.eye(3)])  # outwards

    def rooms(p: FloatArray) -> FloatArray:
        return np.concatenate([upper - p[0], p[0] - lower], axis=1)

    return _Kept(
        "position box",
        (i,),
        lambda p, _: np.asarray(rooms(p).min(axis=1)),
        lambda p, _: sides[np.argmin(rooms(p), axis=1)],
    )
