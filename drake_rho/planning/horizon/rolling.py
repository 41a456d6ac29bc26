"""Windows of a horizon that rolls: each plans the same time ahead, and ends at rest.

A window is drawn towards a point on the shortest path to its goal, at the price of
`Objective.terminal_position`, and ends at rest where it may stay. So the plan in force, continued
at rest, is valid for the next window, whatever the goals are. Once a goal is within reach, the
arrival is a waypoint whose time stays.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Self

import numpy as np

from drake_rho.motion.flight import Window
from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tracking_of
from drake_rho.planning.horizon.arrivals import FEWEST, Orders, reaches
from drake_rho.planning.horizon.continued_plans import (
    as_measured,
    continued_at_rest,
    lasting_until,
)
from drake_rho.planning.horizon.places_of_rest import (
    avoided_until,
    ending_at_rest,
    largest_radius,
    within_window,
)
from drake_rho.planning.horizon.situation import Situation, WindowStart
from drake_rho.planning.horizon.told_goals import is_at, places_of_goals
from drake_rho.planning.horizon.windows import WindowPlanner
from drake_rho.planning.path_search.guidance import Aim, Guide, Surroundings
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST, FloatArray, unchecked
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.parts import MOST_KNOTS, Grid, State, Vehicle, Waypoint
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.scenario.times import steps_lasting

_PRICE = 100.0
"""Default price of a distance from the goal, in efforts of covering it from rest to rest within the
horizon."""


class RollingHorizon:
    """Horizon that rolls with the flight.

    Args:
        steps: number of steps of a window.
        rest_for: time after a window's end for which vehicles have to be able to stay there, as
            long as the errors of obstacles grow [s].
    """

    @classmethod
    def of(cls, scenario: Scenario, horizon: float, rest_for: float, replan_every: int) -> Self:
        """Return the horizon of a scenario's flight.

        Args:
            scenario: to be flown.
            horizon: time that every window plans ahead [s], rounded up to whole steps.
            rest_for: as above.
            replan_every: number of steps flown of each window.

        Raises:
            ValueError: a time is not positive, or too long.
            ScenarioError: the scenario has what a rolling horizon does not plan for.
        """
        step, fewest = scenario.grid.step, max(FEWEST, replan_every)
        longest = (MOST_KNOTS - 1) * step
        if not 0.0 < horizon <= longest or steps_lasting(horizon, step) < fewest:
            expected = f"a time from {fewest * step:g} to {longest:g} s, at least {fewest} steps"
            raise ValueError(f"horizon: got {horizon!r}, expected {expected}")
        if not 0.0 < rest_for <= LARGEST:
            raise ValueError(f"rest_for: got {rest_for!r}, expected a time above 0 in s")
        _check(scenario)
        return cls(steps_lasting(horizon, scenario.grid.step), rest_for)

    def __init__(self, steps: int, rest_for: float) -> None:
        self._steps, self._rest_for = steps, rest_for
        self._guides = dict[str, Guide]()

    def endless(self, scenario: Scenario) -> Scenario:
        """Return the scenario of a flight without an end, with the scales and gains of a window."""
        grid = scenario.grid.from_knot(0, MOST_KNOTS - 1)
        window = scenario.derived(grid=grid.from_knot(0, self._steps))
        shortest = float(reaches(window, window.grid.duration).min())
        fleet = window.fleet.reaching(shortest if np.isfinite(shortest) else 0.0)
        disturbance = scenario.disturbance
        if disturbance is not None and disturbance.tracking is None:
            disturbance = unchecked(disturbance, tracking=tracking_of(window))
        return scenario.derived(grid=grid, fleet=fleet, disturbance=disturbance)

    def until(self, scenario: Scenario, knot: int) -> Scenario:
        """Return the scenario of a flight that ends with a window from a knot."""
        grid = scenario.grid.from_knot(0, knot + self._steps)
        return scenario.derived(grid=grid, fleet=scenario.fleet)

    def begun(self, situation: Situation) -> Situation:
        """Return the situation of a flight without an end, in which a scenario was told."""
        flight = self.endless(situation.scenario)
        known = dataclasses.replace(situation.known, flight=flight, endless=True)
        return dataclasses.replace(situation, known=known)

    def remaining(self, situation: Situation, knot: int) -> Plan:
        """Return the rest of the plan in force from a knot, as far as a window plans.

        Raises:
            ValueError: there is no window yet.
        """
        if situation.last is None:
            raise ValueError("windows: got none, expected at least one planned window")
        last = self._continued(situation.last, knot)
        return last.plan.tail(knot - last.first_knot)

    def ended(self, situation: Situation, knot: int | None = None) -> Situation:
        """Return the situation of a flight that ends at a knot, by default with its last window.

        Vehicles that are not at rest at their goals then have none.
        """
        flight, last = situation.scenario, situation.last
        if last is None:
            return situation
        if knot is None:
            knot = last.first_knot + last.plan.scenario.grid.knots - 1
        grid, plan = flight.grid.from_knot(0, knot), lasting_until(last, knot).plan
        margin, scale = largest_radius(last.plan.scenario), flight.fleet.scale("position")
        states = plan.states(knot - last.first_knot)
        still = ~np.any(np.abs(states[:, 3:]) > TOLERANCE * scale[:, None], axis=1)
        vehicles = tuple(
            each
            if rests and is_at(each.goal, state[:3], margin, TOLERANCE * own)
            else unchecked(each, goal=Goal(None, np.zeros(3) if rests else None))
            for each, state, rests, own in zip(flight.vehicles, states, still, scale, strict=True)
        )
        whole = flight.derived(grid=grid, vehicles=vehicles)
        return dataclasses.replace(situation, known=situation.known.with_flight(whole))

    def first(
        self, windows: WindowPlanner, flight: Scenario, measured: Callable[[Scenario], Scenario]
    ) -> Window:
        """Return the first window of a flight.

        Args:
            windows: planner of windows.
            flight: scenario of the flight.
            measured: function that returns a scenario from the measured states.

        Raises:
            InfeasibleError: vehicles have no plan that ends at rest.
            SolverError: the solvers fail numerically.
        """
        grid = flight.grid.from_knot(0, self._steps)
        scenario = flight.derived(grid=grid, fleet=flight.fleet)
        orders = self._orders(scenario, flight, None)
        window = ending_at_rest(windows).first(orders.scenario, measured(orders.scenario))
        return self._noted(window, orders, np.inf)

    def next(
        self, windows: WindowPlanner, situation: Situation, knot: int, states: FloatArray
    ) -> tuple[Window, WindowStart]:
        """Return a window after the first, and its start.

        Args:
            windows: planner of windows.
            situation: of the flight.
            knot: at which the window begins, counted from 0.
            states: measured positions [m] and velocities [m/s], shape (N, 6), as for
                `Situation.at`.
        """
        if situation.last is None:
            raise ValueError("windows: got none, expected at least one planned window")
        grid, last = situation.last.plan.scenario.grid, self._continued(situation.last, knot)
        start = dataclasses.replace(situation, last=last).at(knot, states)
        required = within_window(start.remaining.scenario.requirements, grid)
        kept = start.remaining.scenario.derived(requirements=required, hold_at_goal=True)
        end = kept.grid.end if last.rest_until is None else max(last.rest_until, kept.grid.end)
        remaining = unchecked(start.remaining, scenario=avoided_until(kept, end))
        orders = self._orders(start.scenario, situation.scenario, remaining)
        reference = unchecked(as_measured(remaining, start.scenario), scenario=orders.scenario)
        start = dataclasses.replace(
            start, scenario=orders.scenario, remaining=remaining, own_reference=reference
        )
        windows = ending_at_rest(windows)
        window = windows.next(start)
        for arriving in () if window.infeasible else orders.arriving(window.plan):
            again = windows.next(dataclasses.replace(start, scenario=arriving))
            if not again.infeasible:
                window = again.after(window.statistics)
                break
        return self._noted(window, orders, end), start

    def _continued(self, last: Window, knot: int) -> Window:
        """Return the last window, its plan continued at rest as far as the next one plans."""
        steps = knot + self._steps - last.first_knot
        stop = last.contingency and continued_at_rest(last.contingency, steps)
        return unchecked(last, plan=continued_at_rest(last.plan, steps), contingency=stop)

    def _noted(self, window: Window, orders: Orders, before: float) -> Window:
        """Return a window with the time until which vehicles can stay, and goals without a path.

        Args:
            window: that was planned.
            orders: of the window.
            before: time until which they can stay where the plan in force ends [s].
        """
        lost = tuple(
            name
            for name, aim in zip(orders.scenario.names, orders.aims, strict=True)
            if not aim.reachable
        )
        grows = any(body.velocity_error > 0.0 for _, body in orders.scenario.avoided)
        last = before if window.kept else orders.scenario.grid.end + self._rest_for
        return dataclasses.replace(window, rest_until=last if grows else None, unreachable=lost)

    def _orders(self, scenario: Scenario, flight: Scenario, remaining: Plan | None) -> Orders:
        """Return the orders of a window.

        Args:
            scenario: of the window, with any goals.
            flight: scenario of the flight, with the goals as told.
            remaining: rest of the plan in force; None before there is one.
        """
        aims = self._aims(scenario, flight, remaining)
        before = flight.vehicles if remaining is None else remaining.scenario.vehicles
        vehicles = tuple(
            _aiming(vehicle, aim, own.waypoints if remaining else ())
            for vehicle, aim, own in zip(scenario.vehicles, aims, before, strict=True)
        )
        objective, grid = scenario.objective, Grid(scenario.grid.step, self._steps + 1)
        if objective.terminal_position == 0.0:
            price = _PRICE * 12.0 / (grid.step * grid.duration**3)
            objective = unchecked(objective, terminal_position=price)
        ordered = scenario.derived(
            vehicles=vehicles,
            requirements=within_window(flight.requirements, scenario.grid),
            objective=objective,
            hold_at_goal=True,
            fleet=scenario.fleet.aimed(vehicles),
            under_way=scenario.under_way,
        )
        return Orders(avoided_until(ordered, ordered.grid.end + self._rest_for), aims)

    def _aims(
        self, scenario: Scenario, flight: Scenario, remaining: Plan | None
    ) -> tuple[Aim, ...]:
        """Return the points to which vehicles are drawn, as seen from the end of their plan.

        Arguments are those of `_orders`.
        """
        fleet, still = scenario.fleet, [each for each in scenario.avoided if each[1].is_steady]
        bodies = tuple(body for _, body in still)
        told = tuple(scenario.bodies[number - 1] for number, _ in still)
        margin = largest_radius(scenario)
        farthest = reaches(scenario, self._steps * scenario.grid.step)
        lower, upper = np.full((2, *fleet.start_positions.shape), [[[-np.inf]], [[np.inf]]])
        if (box := fleet.sides("position")) is not None:
            lower, upper = box
        begins, goals = fleet.start_positions, places_of_goals(scenario, flight, remaining)
        ends = begins if remaining is None else remaining.positions[:, -1]
        aims = list[Aim]()
        for i, (name, end) in enumerate(zip(scenario.names, ends, strict=True)):
            guide = self._guides.setdefault(name, Guide())
            radius = float(fleet.radii[i]) + margin
            around = Surroundings(bodies, told, radius, lower[i], upper[i])
            left = max(float(farthest[i] - np.linalg.norm(end - begins[i])), 0.0)
            aims.append(guide.aim(around, end, goals[i], left))
        return tuple(aims)


def _check(scenario: Scenario) -> None:
    """Check that a rolling horizon can plan for a scenario.

    Raises:
        ScenarioError: it has waypoints, goals in motion, a smoothing, or gains of a feedback with
            which errors grow without bound.
    """
    for i, vehicle in enumerate(scenario.vehicles):
        where = f"vehicles[{i}]"
        if vehicle.waypoints:
            expected = "none with a horizon: the next goal can be told in flight"
            got = Description(f"{len(vehicle.waypoints)} of {vehicle.name}")
            raise ScenarioError(f"{where}.waypoints", got, expected)
        if isinstance(vehicle.goal.velocity, np.ndarray) and vehicle.goal.velocity.any():
            expected = "0 with a horizon, whose windows end at rest"
            raise ScenarioError(f"{where}.goal.velocity", vehicle.goal.velocity.tolist(), expected)
    if scenario.smoothing:
        expected = "none with a horizon: smooth windows have to end at given places"
        raise ScenarioError("smoothing", Description("one"), expected)
    if scenario.disturbance is not None and not np.isfinite(largest_radius(scenario)):
        expected = "gains with which errors stay bounded, so that vehicles can stay at rest"
        raise ScenarioError("disturbance", Description("a feedback with none"), expected)


def _aiming(vehicle: Vehicle, aim: Aim, before: tuple[Waypoint, ...]) -> Vehicle:
    """Return a vehicle that is drawn towards a point, and keeps its arrival there."""
    kept = (each for each in before if aim.is_goal and np.array_equal(each.position, aim.point))
    return unchecked(vehicle, goal=State(aim.point), waypoints=tuple(kept))
