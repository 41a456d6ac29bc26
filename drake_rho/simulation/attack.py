"""The wind that brings a plan's vehicles closest to what they keep clear of, and a flight in it.

At a time t the error of a vehicle is anywhere in a ball of radius ρ(t), and distances from convex
shapes change by no more than a vehicle moves. So no wind leaves less clearance than that of the
plan less ρ(t), or less 2 ρ(t) between two vehicles; and the wind that is worst in the direction of
the nearest surface leaves just that, as long as that surface stays the nearest on the way.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.tube import ErrorTube, error_tube
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, locked
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.closed_loop import adopted, fly_plan
from drake_rho.simulation.winds import WindOverTime
from drake_rho.simulation.worst_case import WorstCase, worst_case

_PER_STEP = 50
"""Times in a step of the grid at which clearances are looked at, before the least is refined."""


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
        return f"<Attack: {who} is left {left}, {self.constraint} at {self.time:.4g} s>"


@dataclasses.dataclass(frozen=True, eq=False)
class _Kept:
    """What one vehicle, or two, keep clear of."""

    name: str
    vehicles: tuple[int, ...]
    clearance: Callable[[FloatArray, FloatArray], FloatArray]
    """of positions (V, T, 3) [m] at times (T,) [s], shape (T,) [m]"""
    inward: Callable[[FloatArray, FloatArray], FloatArray]
    """unit vectors in which vehicles have least clearance, (V, 1, 3) and (1,) to (V, 3)"""
    speed: float = 0.0
    """greatest speed of what is kept clear of, if that is no vehicle [m/s]"""


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
    tube, motion, start = error_tube(scenario), plan.motion(), scenario.grid.start
    tightest = _tightest_of_all(scenario, motion, tube)
    if tightest is None:
        expected = "obstacles, a separation or position boxes, to come close to"
        raise ValueError(f"scenario: got nothing to keep clear of, expected {expected}")
    bound, time, kept = tightest
    who, now = list(kept.vehicles), np.array([time])
    at = motion.at("position", now - start)[who]
    directions = np.zeros((len(scenario.vehicles), 3))
    directions[who] = kept.inward(at, now)
    wind = AimedWind(worst_case(scenario, [1, 0, 0], time, tube=tube), locked(directions))
    simulation = fly_plan(scenario, plan, wind=wind)
    m = int(np.argmin(np.abs(simulation.times - time)))
    left = kept.clearance(simulation.positions[m, who][:, None], now)
    names = tuple(scenario.vehicles[i].name for i in who)
    planned = float(kept.clearance(at, now)[0])
    return Attack(kept.name, names, time, planned, bound, float(left[0]), wind, simulation)


def _tightest_of_all(
    scenario: Scenario, motion: Motion, tube: ErrorTube
) -> tuple[float, float, _Kept] | None:
    """What has the least clearance less radii, as `_tightest` says; None without constraints.

    Each is looked at closely only if its clearances at the knots leave room for less than is found.
    """
    grid = scenario.grid
    most = float(tube.position_over(grid.times[:-1], grid.times[1:]).max())

    def no_less(kept: _Kept) -> float:
        who = list(kept.vehicles)
        v = motion.velocities[who]
        speed = np.linalg.norm(v[0] - v[1] if len(who) == 2 else v[0], axis=1).max() + kept.speed
        at_knots = kept.clearance(motion.positions[who], grid.times).min()
        return float(at_knots - grid.step / 2.0 * speed - len(who) * most)

    found: tuple[float, float, _Kept] | None = None
    bounds = [(no_less(kept), kept) for kept in _all_kept(scenario)]
    for least, kept in sorted(bounds, key=lambda pair: pair[0]):
        if found is not None and least >= found[0]:
            break
        closer = _tightest(scenario, kept, motion, tube)
        found = closer if found is None or closer[0] < found[0] else found
    return found


def _tightest(
    scenario: Scenario, kept: _Kept, motion: Motion, tube: ErrorTube
) -> tuple[float, float, _Kept]:
    """The least clearance less radii [m], and its time on the clock [s]."""
    from scipy.optimize import minimize_scalar  # slow to load, so only where needed

    grid, who = scenario.grid, list(kept.vehicles)

    def left(times: FloatArray) -> FloatArray:
        positions = motion.at("position", times - grid.start)[who]
        return np.asarray(kept.clearance(positions, times) - len(who) * tube.position(times))

    if not scenario.between_knots:
        values = left(grid.times)
        return float(values.min()), float(grid.times[np.argmin(values)]), kept
    corners = [obstacle.corners for obstacle in scenario.bodies]
    times = np.linspace(grid.start, grid.end, _PER_STEP * (grid.knots - 1) + 1)
    times = np.union1d(times, np.concatenate([grid.times, *corners]))
    times = times[(times >= grid.start) & (times <= grid.end)]
    values = left(times)
    k = int(np.argmin(values))
    pieces = [(times[max(k - 1, 0)], times[k]), (times[k], times[min(k + 1, len(times) - 1)])]
    found = [(float(values[k]), float(times[k]))]
    for begin, end in pieces:  # in each the motion is smooth
        if end > begin:
            least = minimize_scalar(
                lambda time: float(left(np.array([time]))[0]),
                bounds=(begin, end),
                method="bounded",
                options={"xatol": 1e-6 * (end - begin)},
            )
            found.append((float(least.fun), float(least.x)))
    return *min(found), kept


def _all_kept(scenario: Scenario) -> Iterator[_Kept]:
    """Everything that vehicles keep clear of, vehicle by vehicle and pair by pair."""
    count = range(len(scenario.vehicles))
    for number in range(1, len(scenario.bodies) + 1):
        yield from (_from_obstacle(scenario, number, i) for i in count)
    if scenario.separation is not None:
        yield from (_from_each_other(scenario, *pair) for pair in combinations(count, 2))
    if (bounds := scenario.fleet.bounds("position")) is not None:
        for i in count:
            if np.any(np.isfinite([bounds.lower[i], bounds.upper[i]])):
                yield _within(bounds.lower[i], bounds.upper[i], i)


def _from_obstacle(scenario: Scenario, number: int, i: int) -> _Kept:
    obstacle = scenario.bodies[number - 1]
    margin = float(scenario.fleet.radii[i]) + obstacle.deviation
    moments = np.append(obstacle.corners, scenario.grid.start)
    speed = float(np.linalg.norm(obstacle.velocities(moments), axis=1).max())
    return _Kept(
        scenario.obstacle_name(number),
        (i,),
        lambda p, times: obstacle.distances(p[0], times) - margin,
        lambda p, times: -obstacle.shape.outward(p[0] - obstacle.centers(times)),
        speed,
    )


def _from_each_other(scenario: Scenario, i: int, j: int) -> _Kept:
    assert scenario.separation is not None  # noqa: S101  # asked before
    shape = scenario.separation.shape

    def inward(p: FloatArray, times: FloatArray) -> FloatArray:
        n = shape.outward(p[0] - p[1])
        return np.concatenate([-n, n])

    return _Kept("separation", (i, j), lambda p, _: shape.signed_distance(p[0] - p[1]), inward)


def _within(lower: FloatArray, upper: FloatArray, i: int) -> _Kept:
    sides = np.concatenate([np.eye(3), -np.eye(3)])  # outwards

    def rooms(p: FloatArray) -> FloatArray:
        return np.concatenate([upper - p[0], p[0] - lower], axis=1)

    return _Kept(
        "position box",
        (i,),
        lambda p, _: np.asarray(rooms(p).min(axis=1)),
        lambda p, _: sides[np.argmin(rooms(p), axis=1)],
    )
