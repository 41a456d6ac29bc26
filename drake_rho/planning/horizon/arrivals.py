"""Orders of windows that roll: points to which vehicles are drawn, and arrivals at goals."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.planning.path_search.guidance import Aim
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.parts import Vehicle, Waypoint
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.quadrics import Sphere
from drake_rho.scenario.smoothing import largest_accelerations

FEWEST = 4
"""Least number of steps of a window: an arrival one step before its end needs two."""

_NEAR = 0.03
"""Largest distance of a window's end from the goal, as a part of that of its start, at which the
goal counts as within reach."""

_EASE = 1.1
"""Factor on the time in which limits allow an arrival."""

_THERE = 1e-4
"""Distance from the goal at which a vehicle needs no arrival, in lengths of the motion."""

_WIDER = 1.0 + 1e-6
"""Factor on the radii of the error tube at an arrival, so that the tube fits."""


@dataclasses.dataclass(frozen=True, eq=False)
class Orders:
    """Orders of one window: a scenario with the points that vehicles aim at as goals."""

    scenario: Scenario
    """rest of the flight for as long as a window plans"""
    aims: tuple[Aim, ...]
    """points to which vehicles are drawn"""

    def arriving(self, plan: Plan) -> Iterator[Scenario]:
        """Yield scenarios with arrivals of vehicles whose goals a plan nearly reaches.

        First with arrivals as soon as vehicles can with some ease, then at the end of the window;
        none if there are no new arrivals.
        """
        begins, ends = plan.positions[:, 0], plan.positions[:, -1]
        scales, last = plan.scenario.fleet.lengths, self.scenario.grid.knots - 2
        soonest = dict[int, int]()
        for i, (vehicle, aim) in enumerate(zip(self.scenario.vehicles, self.aims, strict=True)):
            left, away = (float(np.linalg.norm(x[i] - aim.point)) for x in (ends, begins))
            under_way = away > _THERE * scales[i]
            if aim.is_goal and not vehicle.waypoints and under_way and left <= _NEAR * away:
                soonest[i] = min(_steps_to(self.scenario, i, away), last)
        if not soonest:
            return
        yield self._with_arrivals(soonest)
        if min(soonest.values()) < last:
            yield self._with_arrivals(dict.fromkeys(soonest, last))

    def _with_arrivals(self, knots: Mapping[int, int]) -> Scenario:
        """Return the scenario in which vehicles arrive at knots, by their indices."""
        vehicles = list(self.scenario.vehicles)
        for i, knot in knots.items():
            vehicles[i] = _arriving(vehicles[i], self.scenario, knot)
        fleet = self.scenario.fleet.aimed(vehicles)
        return self.scenario.derived(vehicles=tuple(vehicles), fleet=fleet)


def reaches(scenario: Scenario, duration: float) -> FloatArray:
    """Return the distances that vehicles cover with least effort within a time [m], (N,).

    From rest to rest in the time T, the effort is least with velocities that are quadratic in
    time: the greatest is 3/2 of the mean one, and the greatest acceleration 6/T² of the
    distance. A vehicle with the greatest velocity keeps it at first. Distances are infinite
    where no limit bounds them.
    """
    speeds, accelerations = _limits(scenario)
    farthest = np.minimum(accelerations * duration**2 / 6.0, speeds * duration / 1.5)
    return np.asarray(farthest)


def _limits(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Return the greatest speeds [m/s] and accelerations [m/s²], (N,); infinite without a limit."""
    fleet = scenario.fleet
    speeds = np.full(len(fleet.radii), np.inf)
    if (box := fleet.sides("velocity")) is not None:
        speeds = np.minimum(*np.abs(box)).min(axis=1)
    if "max_speed" in fleet.largest_norms:
        speeds = np.minimum(speeds, fleet.largest_norms["max_speed"])
    return speeds, largest_accelerations(fleet)


def _steps_to(scenario: Scenario, vehicle: int, away: float) -> int:
    """Return the number of steps in which a vehicle covers a distance [m] with least effort.

    The time is that of `reaches`, and of stopping first. Without limits, a vehicle
    takes as long as the window does.
    """
    speed, acceleration = (float(each[vehicle]) for each in _limits(scenario))
    if not np.isfinite(acceleration):
        return scenario.grid.knots
    flown = float(np.linalg.norm(scenario.fleet.start_velocities[vehicle]))
    least = max(np.sqrt(6.0 * away / acceleration), 1.5 * away / speed) + flown / acceleration
    return max(int(np.ceil(_EASE * least / scenario.grid.step)), FEWEST)


def _arriving(vehicle: Vehicle, scenario: Scenario, knot: int) -> Vehicle:
    """Return a vehicle that is at rest at its goal from a knot on, counted from 0.

    With a disturbance it is there within the error tube.
    """
    grid = scenario.grid
    time, goal = float(grid.start + grid.elapsed[knot]), vehicle.goal.position
    if scenario.disturbance is None:
        arrival = Waypoint(time, goal, velocity=np.zeros(3))
    else:
        tube = tube_of(scenario)
        away, speed = _WIDER * float(tube.position(time)), _WIDER * float(tube.velocity(time))
        arrival = Waypoint(time, goal, away, velocity=Sphere(np.zeros(3), speed))
    return unchecked(vehicle, waypoints=(arrival,))
