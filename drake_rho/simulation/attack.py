"""Wind that minimises a plan's clearance from its constraints, and a flight in that wind.

At a time t the error of a vehicle is anywhere in a ball of radius ρ(t), and distances from convex
shapes change by no more than a vehicle moves. So in any wind the clearance is at least the plan's
less ρ(t), or less 2 ρ(t) between two vehicles. The worst wind in the direction of the nearest
surface attains this bound, as long as the same surface stays nearest during the displacement.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.bounds import Bounds
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray, read_only
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.closed_loop import adopted, fly_plan
from drake_rho.simulation.small_steps import in_small_steps
from drake_rho.simulation.winds import WindOverTime
from drake_rho.simulation.worst_case import WorstCase, worst_case
from drake_rho.verification.boxes import check_position_box
from drake_rho.verification.check import PRECISION, Column
from drake_rho.verification.obstacles import check_obstacle
from drake_rho.verification.requirements import check_positions
from drake_rho.verification.separation import check_separation
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import Tubes


@dataclasses.dataclass(frozen=True, eq=False)
class AimedWind(WindOverTime):
    """Worst case with a separate direction for each vehicle."""

    worst: WorstCase
    """the worst case along x"""
    directions: FloatArray
    """unit vectors, or 0 for a vehicle without wind, shape (N, 3)"""

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """Return the wind at times on the scenario's clock [s], in m/s², shape (M, N, 3)."""
        return np.asarray(self.worst.over(times, vehicles)[..., :1] * self.directions)

    @property
    def switching_times(self) -> FloatArray:
        """Times at which the wind changes, on the scenario's clock [s], shape (S,)."""
        return self.worst.switching_times

    @property
    def position_errors(self) -> FloatArray:
        """Errors of the estimated positions at every sample [m], shape (J, N, 3)."""
        return np.asarray(self.worst.position_errors[:, None, :1] * self.directions)

    @property
    def velocity_errors(self) -> FloatArray:
        """Errors of the estimated velocities at every sample [m/s], shape (J, N, 3)."""
        return np.asarray(self.worst.velocity_errors[:, None, :1] * self.directions)

    @property
    def lost(self) -> BoolArray:
        """Whether the measurements of every sample are lost, shape (J,)."""
        return self.worst.lost


@dataclasses.dataclass(frozen=True, eq=False)
class Attack(metaclass=Described):
    """Effect of the worst wind on a plan."""

    constraint: str
    """constraint with the least clearance: an obstacle, the separation, or the position box"""
    vehicles: tuple[str, ...]
    """names of the one or two vehicles with this clearance"""
    time: float
    """time of the least clearance on the scenario's clock [s]"""
    planned: float
    """clearance of the plan at this time, beyond the required distance [m]"""
    bound: float
    """lower bound of the clearance at all times, in every wind, with all estimation errors [m];
    negative if they can violate the constraint"""
    clearance: float
    """clearance of the flight at this time [m]"""
    wind: AimedWind
    """worst wind, with its estimation errors"""
    simulation: Simulation
    """flight in this wind"""

    def __repr__(self) -> str:
        """Return a text like '<Attack: v1 keeps 0.01 m of 0.2 m, obstacle 1 at 6.4 s>'."""
        who, verb = " and ".join(self.vehicles), "keep" if len(self.vehicles) > 1 else "keeps"
        clearance = f"{self.clearance:.3g} m of {self.planned:.3g} m"
        where = f"{self.constraint} at {clock_time(self.time, 4)}"
        return f"<Attack: {who} {verb} {clearance} beyond the required distance, {where}>"


@dataclasses.dataclass(frozen=True, eq=False)
class _Clearance:
    """Clearance of one vehicle, or of two, from one constraint."""

    name: str
    vehicles: tuple[int, ...]
    clearance: Callable[[FloatArray, FloatArray], FloatArray]
    """function of positions (V, T, 3) [m] and times (T,) [s] to clearances (T,) [m]"""
    inward: Callable[[FloatArray, FloatArray], FloatArray]
    """function of a position (V, 1, 3) and a time (1,) to the unit vectors (V, 3) along which the
    vehicles' clearance falls fastest"""


@checked
def attack(scenario: Scenario, plan: Plan) -> Attack:
    """Find the wind that minimises a plan's clearance, and fly the plan in it.

    The plan is tracked by the scenario's feedback from its start to its end, without replanning.

    Args:
        scenario: scenario with the strength of the wind, the feedback and the constraints.
        plan: plan for the same vehicles and grid; it need not have been made for a disturbance.

    Returns:
        The attack on the constraint with the least clearance, over all obstacles (including those
        that are not known yet), pairs and sides of position boxes. Clearances are taken at all
        times, or at the knots if the scenario requires no more.

    Raises:
        ValueError: the scenario has no disturbance, is a window of a flight under way, or has no
            obstacles, separation, position box or required set of positions; or the plan is for
            other vehicles or another grid.

    Examples:
        >>> scenario = rho.load_scenario("courier")
        >>> rho.attack(scenario, rho.plan(scenario)).clearance > 0.0
        True
    """
    disturbance = scenario.disturbance
    if disturbance is None or disturbance.tracking is not None:
        expected = "one with the strength of the wind, in a scenario that is not under way"
        raise ValueError(f"scenario.disturbance: got {disturbance}, expected {expected}")
    plan = in_small_steps(adopted(scenario, plan))
    scenario = plan.scenario
    tightest = _tightest_of_all(scenario, plan)
    if tightest is None:
        expected = "obstacles, a separation, position boxes or sets of positions"
        raise ValueError(f"scenario: got nothing to keep clear of, expected {expected}")
    time, own = tightest.time, tightest.own
    who, now = list(own.vehicles), np.array([time])
    at = plan.motion().at("position", now - scenario.grid.start)[who]
    directions = np.zeros((len(scenario.vehicles), 3))
    directions[who] = own.inward(at, now)
    wind = AimedWind(worst_case(scenario, [1, 0, 0], time), read_only(directions))
    simulation = fly_plan(scenario, plan, wind=wind)
    m = int(np.argmin(np.abs(simulation.times - time)))
    flown = own.clearance(simulation.positions[m, who][:, None], now)
    names = tuple(scenario.vehicles[i].name for i in who)
    planned = float(own.clearance(at, now)[0])
    return Attack(own.name, names, time, planned, tightest.bound, float(flown[0]), wind, simulation)


@dataclasses.dataclass(frozen=True, eq=False)
class _Tightest:
    """Least clearance less error radii."""

    bound: float
    """lower bound of the clearance less error radii [m]"""
    time: float
    """time of the least clearance on the scenario's clock [s]"""
    own: _Clearance
    """vehicles and constraint with the least clearance"""


def _tightest_of_all(scenario: Scenario, plan: Plan) -> _Tightest | None:
    """Return the verifier's least clearance less error radii; None if nothing has a clearance.

    The verifier misses smaller values by the fraction `PRECISION` of the tolerance at most.
    """
    trajectory = PiecewiseTrajectory.of(scenario, plan.motion(), Tubes.of(plan))
    found: _Tightest | None = None
    for column, clearance_of in _checks(trajectory):
        if column.is_at_all_times != scenario.between_knots:
            continue
        bounds = -column.excess - PRECISION * column.tolerances
        bounds = np.where(column.concerned, bounds, np.inf)
        i = int(np.argmin(bounds))
        if np.isfinite(bounds[i]) and (found is None or bounds[i] < found.bound):
            found = _Tightest(float(bounds[i]), float(column.times[i]), clearance_of(i))
    return found


def _checks(
    trajectory: PiecewiseTrajectory,
) -> Iterator[tuple[Column, Callable[[int], _Clearance]]]:
    """Yield the verifier's columns, each with a function from vehicle index to clearance.

    Those of soft limits are left out.
    """
    scenario = trajectory.scenario
    hard = (number for number, each in enumerate(scenario.bodies, start=1) if each.penalty is None)
    for number in hard:
        for column in check_obstacle(trajectory, number):
            yield column, partial(_from_obstacle, scenario, number)
    for column in check_separation(trajectory, far=np.inf):
        assert column.partners is not None  # noqa: S101  # a separation has them
        yield column, partial(_from_each_other, scenario, column.partners)
    if (bounds := scenario.fleet.bounds("position")) is not None:
        for column in check_position_box(trajectory):
            yield column, partial(_within, bounds)
    for number, each in enumerate(scenario.required, start=1):
        required = each.penalty is None and each.interval(scenario.grid) is not None
        if each.quantity == "position" and required:
            for column in check_positions(trajectory, number):
                yield column, partial(_in_set, scenario, number)


def _from_obstacle(scenario: Scenario, number: int, i: int) -> _Clearance:
    obstacle = scenario.bodies[number - 1]
    margin = float(scenario.fleet.radii[i]) + obstacle.deviation
    return _Clearance(
        scenario.obstacle_name(number),
        (i,),
        lambda p, times: obstacle.distances(p[0], times) - margin,
        lambda p, times: -obstacle.shape.local_outward(p[0] - obstacle.centers(times)),
    )


def _from_each_other(scenario: Scenario, partners: IntArray, i: int) -> _Clearance:
    assert scenario.separation is not None  # noqa: S101  # callers check this
    shape, (i, j) = scenario.separation.shape, sorted((i, int(partners[i])))

    def inward(p: FloatArray, times: FloatArray) -> FloatArray:
        n = shape.local_outward(p[0] - p[1])
        return np.concatenate([-n, n])

    return _Clearance("separation", (i, j), lambda p, _: shape.local_distance(p[0] - p[1]), inward)


def _in_set(scenario: Scenario, number: int, i: int) -> _Clearance:
    required = scenario.required[number - 1]
    partner = required.partner(scenario.names)
    vehicles = (i,) if partner is None else (i, partner)

    def relative(p: FloatArray, times: FloatArray) -> FloatArray:
        own = p[0] if partner is None else p[0] - p[1]
        return np.asarray(own - required.offset(times))

    def inward(p: FloatArray, times: FloatArray) -> FloatArray:
        n = np.asarray(required.set.outward(relative(p, times)))
        return n if partner is None else np.concatenate([n, -n])

    return _Clearance(
        required.called(number),
        vehicles,
        lambda p, times: -required.set.signed_distance(relative(p, times)) - required.deviation,
        inward,
    )


def _within(bounds: Bounds, i: int) -> _Clearance:
    lower, upper = bounds.lower[i], bounds.upper[i]
    sides = np.concatenate([np.eye(3), -np.eye(3)])  # outwards

    def distances(p: FloatArray) -> FloatArray:
        return np.concatenate([upper - p[0], p[0] - lower], axis=1)

    return _Clearance(
        "position box",
        (i,),
        lambda p, _: np.asarray(distances(p).min(axis=1)),
        lambda p, _: sides[np.argmin(distances(p), axis=1)],
    )
