"""Verification after the end: checks of, and notes on, vehicles that hold at their goals for ever.

Vehicles whose goals are at rest stay there. So their motion after the end is one long piece of time
at rest, and every constraint is verified by the same functions as in the flight, with the largest
radii that the error tube has from the end on (`drake_rho.motion.rest_tube`). The piece ends when
nothing changes any more: tracks and intervals have ended, and obstacles that move on for ever are
far away.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import get_args

import numpy as np

from drake_rho.motion.rest_tube import RestTube, rest_tube
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.parts import Quantity, State
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.times import Clock
from drake_rho.scenario.tracks import Track
from drake_rho.verification.check import AT_ALL_TIMES, Column
from drake_rho.verification.checkers import checkers
from drake_rho.verification.jerks import Jerks
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import NO_ERRORS, ConstantTubes

_NAMED = 3
"""Largest number of vehicles that are named in notes."""


def check_rest(
    scenario: Scenario, ends: FloatArray | None = None, *, near_only: bool = False
) -> Iterator[Column]:
    """Yield the margins of holding at the goals for ever, if required: one check per unit.

    A check is of the most violated constraint or, if all hold, of the closest.

    Args:
        scenario: scenario of the flight.
        ends: positions at the last knot [m], where vehicles rest without an exact goal, (N, 3);
            such vehicles do not count if there is no flight yet.
        near_only: whether obstacles that surely stay away from the vehicles are left out. They
            cannot be violated, but could be the closest.
    """
    if not scenario.hold_at_goal:
        return
    rest, count = Rest.of(scenario, ends=ends), len(scenario.vehicles)
    columns = [] if rest is None else rest.near_columns() if near_only else rest.columns()
    for unit in dict.fromkeys(["m", *(each.unit for each in columns)]):
        yield _worst_of(unit, [each for each in columns if each.unit == unit], scenario, count)


def _worst_of(unit: str, columns: list[Column], scenario: Scenario, count: int) -> Column:
    """Return the worst checks of columns with one unit; an inactive column if there are none."""
    numbers = {name: np.zeros(count) for name in ("times", "values", "limits", "excess", "errors")}
    numbers["tolerances"] = np.ones(count)
    parts, concerned = [""] * count, np.zeros(count, dtype=bool)
    worst = np.full(count, -np.inf)
    for each in columns:
        excess = np.where(np.isnan(each.excess), np.inf, each.excess)
        violated = excess > each.tolerances
        tolerances = np.maximum(each.tolerances, np.finfo(np.float64).tiny)  # 0 of other vehicles
        badness = np.where(violated, excess / tolerances, np.minimum(excess, 0.0))
        worse = (badness > worst) & each.concerned
        worst[worse], concerned = badness[worse], concerned | worse
        for name, values in numbers.items():
            values[worse] = getattr(each, name)[worse]
        for vehicle in np.flatnonzero(worse).tolist():
            parts[vehicle] = _named(each, vehicle)
    return Column(
        kind="holding",
        constraint="hold at goal",
        parts=parts,
        times=numbers["times"],
        values=numbers["values"],
        limits=numbers["limits"],
        excess=numbers["excess"],
        tolerances=numbers["tolerances"],
        errors=numbers["errors"],
        unit=unit,
        concerned=concerned,
    )


def _named(column: Column, vehicle: int) -> str:
    """Return the constraint and part of a check, without its times."""
    return f"{column.constraint} {column.parts[vehicle].removesuffix(AT_ALL_TIMES)}".strip()


def notes_on_rest(scenario: Scenario, ends: FloatArray | None = None) -> tuple[str, ...]:
    """Return notes on vehicles that cannot hold at their goals for ever: until when, and why.

    Arguments are those of `check_rest`.
    """
    rest = Rest.of(scenario, ends=ends)
    if rest is None:
        return ()
    columns = rest.columns()
    failing = [
        vehicle
        for vehicle in range(len(rest.scenario.vehicles))
        if any(each.is_beyond(vehicle) for each in columns)
    ]
    notes = [_note(rest, columns, vehicle) for vehicle in failing[:_NAMED]]
    if len(failing) > _NAMED:
        notes.append(f"{len(failing) - _NAMED} more vehicles cannot hold at their goals for ever")
    return tuple(notes)


def _note(rest: Rest, columns: list[Column], vehicle: int) -> str:
    """Return a note on the time until which a vehicle can hold, and its first violation."""
    time = rest.until(vehicle)
    lasting = max(time - rest.begin, rest.shortest)
    then = zip(columns, rest.columns(lasting), strict=True)
    failing = [(now, each) for each, now in then if each.is_beyond(vehicle)]
    now, each = next((both for both in failing if both[0].is_beyond(vehicle, REACHED)), failing[0])
    name, at_once = rest.scenario.names[vehicle], time == rest.begin
    until = f"{name} can hold at its goal until {clock_time(time)} only"
    if at_once:
        until = f"{name} cannot hold at its goal"
    if not rest.is_bounded:
        return f"{until}, for {_named(now, vehicle)}: its errors go on growing"
    beyond = f"by up to {each.excess[vehicle]:.3g} {each.unit}"
    violated = "is violated" if at_once else "is violated later,"
    return f"{until}: {_named(now, vehicle)} {violated} {beyond}"


def _at_exact_goals(scenario: Scenario, places: FloatArray) -> Scenario:
    """Return a scenario with its tolerances and with goals at rest at places (N, 3) [m]."""
    vehicles = tuple(
        unchecked(each, goal=State(place))
        for each, place in zip(scenario.vehicles, places, strict=True)
    )
    return scenario.derived(vehicles=vehicles, fleet=scenario.fleet)


_AWAY = 1e3
"""Distance moved after which an obstacle is far away, as a multiple of its distance."""

_SHORT = 1e-12
"""Relative precision of times found by bisection."""

REACHED = 1e-6
"""Excess at which a limit counts as reached, for finding the time, as a part of the tolerance."""

_QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)

Check = Callable[[PiecewiseTrajectory], Iterable[Column]]
"""Function that verifies constraints of one kind, or one obstacle, on a trajectory."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rest:
    """Vehicles that hold at their goals from the end of a flight on."""

    scenario: Scenario
    """scenario of the flight, with the holding vehicles only, whose goals are exact"""
    places: FloatArray
    """positions at which they rest [m], shape (N, 3)"""
    begin: float
    """time from which they rest [s]"""
    tube: RestTube | None
    """their error tube from then on; None without a disturbance"""

    @classmethod
    def of(
        cls, scenario: Scenario, tube: ErrorTube | None = None, ends: FloatArray | None = None
    ) -> Rest | None:
        """Return the rest after a flight; None if nothing can be violated after it.

        Args:
            scenario: scenario of the flight.
            tube: error tube at its end, if it is not that of the scenario.
            ends: positions at the last knot [m], shape (N, 3), where vehicles rest without an exact
                goal; such vehicles do not count if there is no flight yet.
        """
        changes = any(not each.is_steady for each in scenario.bodies) or scenario.requirements
        given, held = scenario.fleet.fixed_positions, scenario.held
        if ends is None:
            held = tuple(each for each in held if given[each])
        if not held or (scenario.disturbance is None and not changes):
            return None
        places = scenario.fleet.goal_positions
        if not given.all():
            if ends is not None:
                places = np.where(given[:, None], places, ends)
            scenario = _at_exact_goals(scenario, places)
        end, errors = scenario.grid.end + scenario.lead, None
        if scenario.disturbance is not None:
            errors = rest_tube(tube or tube_of(scenario), end)
        if len(held) < len(scenario.vehicles):
            scenario, places = scenario.of_vehicles(held), places[list(held)]
        return cls(_without_what_is_over(scenario), places, end, errors)

    @property
    def is_bounded(self) -> bool:
        """Whether the errors stay bounded."""
        return self.tube is None or self.tube.is_bounded

    @property
    def settled(self) -> float:
        """Time since `begin` from which the radii are constant, or the end of their computation."""
        return 0.0 if self.tube is None else self.tube.end - self.begin

    def radii(self, lasting: float = np.inf) -> dict[Quantity, float]:
        """Return the largest error radii in a time since `begin` [s]; for ever if not given."""
        radii = dict.fromkeys(_QUANTITIES, 0.0)
        if self.tube is not None:
            errors: tuple[Quantity, ...] = ("position", "velocity", "acceleration")
            until = self.begin + lasting
            radii |= {quantity: self.tube.largest(quantity, until) for quantity in errors}
        return radii

    @cached_property
    def horizon(self) -> float:
        """Time after which nothing changes any more, since `begin` [s]."""
        corners = [each.corners for each in self.scenario.bodies_in_flight]
        corners += [each.corners for each in self._required]
        times = np.concatenate([np.zeros(1), *corners]) - self._elapsed
        horizon = max(self.scenario.grid.step, self.settled, float(times.max()))
        endless = self._endless(np.array([self._elapsed + horizon]))
        return max([horizon, *(horizon + _AWAY * away / speed for away, speed in endless)])

    @property
    def _required(self) -> list[KeepIn]:
        """Requirements on a clock that is 0 at the first knot."""
        return [each.since(self.scenario.grid) for each in self.scenario.required]

    def _endless(self, now: FloatArray) -> Iterator[tuple[float, float]]:
        """Yield the distance [m] and the speed [m/s] of every change that never ends.

        Args:
            now: time from which it goes on, since the first knot [s], shape (1,).
        """
        tracks, radius = list[tuple[Track, float]](), float(self.scenario.fleet.radii.max())
        for body in self.scenario.bodies_in_flight:
            if body.active is None and body.velocity_error > 0.0:  # it reaches every goal
                yield self._farthest(body.centers(now)), body.velocity_error
            if body.active is None and body.track is not None:
                extent = np.where(np.isfinite(body.shape.extent), body.shape.extent, 0.0)
                tracks.append((body.track, float(np.linalg.norm(extent)) + radius))
        for each in self._required:
            if each.active is None and each.track is not None:
                size = float(getattr(each.set, "size", 0.0))
                tracks.append((each.track, size if np.isfinite(size) else 0.0))
        for track, size in tracks:
            speed = float(np.linalg.norm(track.last_velocity))
            if track.after == "goes_on" and speed > 0.0:
                yield self._farthest(track.at(now)) + size + track.deviation, speed

    def _farthest(self, place: FloatArray) -> float:
        """Return the largest distance of a goal from a place (1, 3) [m]."""
        return float(np.linalg.norm(self.places - place, axis=1).max())

    @property
    def _clock(self) -> Clock:
        """Clock for comparing times after the end."""
        grid = self.scenario.grid
        return Clock.of(grid.step, grid.start, self.begin + self.horizon)

    @property
    def shortest(self) -> float:
        """Shortest time considered [s]: a vehicle that cannot hold for it cannot hold at all."""
        return self._clock.tick

    @property
    def _elapsed(self) -> float:
        """Time from the first knot to `begin` [s]."""
        return self.begin - self.scenario.grid.start

    @property
    def checks(self) -> list[Check]:
        """Functions that together verify all constraints of vehicles at rest."""
        return _checks_of(range(1, len(self.scenario.bodies) + 1))

    def columns(self, lasting: float = np.inf) -> list[Column]:
        """Return the checks of all constraints at all times.

        Args:
            lasting: time since `begin` until which vehicles hold [s]; for ever if not given.
        """
        return self._checked(self._trajectory(lasting))

    def near_columns(self) -> list[Column]:
        """Return the checks without those of obstacles that surely stay away."""
        return self._checked(self._trajectory(np.inf), self._near)

    @property
    def _near(self) -> list[int]:
        """Numbers of the obstacles that may come near, counted from 1."""
        required = self.scenario.fleet.radii + self.radii()["position"]
        return [
            number
            for number, body in enumerate(self.scenario.bodies_in_flight, start=1)
            if not body.stays_beyond(self.places, required, self._elapsed)
        ]

    def columns_without_errors(self) -> list[Column]:
        """Return the checks with radii of zero, whose margins do not depend on the disturbance."""
        tubes = ConstantTubes.with_radii(dict.fromkeys(_QUANTITIES, 0.0))
        return self._checked(dataclasses.replace(self._trajectory(np.inf), tubes=tubes))

    def _checked(
        self, rest: PiecewiseTrajectory, obstacles: Iterable[int] | None = None
    ) -> list[Column]:
        """Return the checks of some obstacles, by their numbers, or of all, and of all else."""
        checks = self.checks if obstacles is None else _checks_of(obstacles)
        return [each for check in checks for each in check(rest) if _counts(each)]

    def _trajectory(self, lasting: float) -> PiecewiseTrajectory:
        """Return the rest as one piece of time, with its largest radii."""
        duration, tubes = min(lasting, self.horizon), NO_ERRORS
        if self.tube is not None:
            tubes = ConstantTubes.with_radii(self.radii(duration))
        goals = self.places[:, None]
        still = np.zeros((len(goals), 2, 3))
        scenario = self.scenario.derived(
            grid=unchecked(
                self.scenario.grid, step=duration, knots=2, start=self.begin, clock=self._clock
            ),
            disturbance=None,
            smoothing=None,
            between_knots=True,
            fleet=self.scenario.fleet,  # with the flight's tolerances
        )
        return PiecewiseTrajectory.of_pieces(
            scenario,
            np.array([0.0, duration]),
            np.array([duration]),
            np.ones(2, dtype=bool),
            (np.repeat(goals, 2, axis=1), still, still[:, :1]),
            Jerks.at_rest(scenario),
            tubes=tubes,
        )

    def until(self, vehicle: int) -> float:
        """Return the time until which a vehicle satisfies every constraint [s], by bisection.

        A constraint that holds for a time holds for a shorter one too: there are fewer instants,
        and the radii are not larger.
        """
        held, lost = self.shortest, self.horizon
        if self._reached(vehicle, held, self.checks):
            return self.begin
        checks = self._reached(vehicle, lost, self.checks)
        worst = [each.times[vehicle] for each in self.columns() if each.is_beyond(vehicle)]
        middle = min(worst, default=self.begin + lost / 2.0) - self.begin
        middle = min(max(float(middle), self.settled), lost / 2.0)
        while lost - held > _SHORT * max(lost, self.scenario.grid.step):
            if earlier := self._reached(vehicle, middle, checks):
                lost, checks = middle, earlier  # other limits are reached later
            else:
                held = middle
            middle = (held + lost) / 2.0
        return self.begin + lost

    def _reached(self, vehicle: int, lasting: float, checks: Sequence[Check]) -> list[Check]:
        """Return checks whose limits a vehicle reaches within a time since `begin` [s]."""
        rest = self._trajectory(lasting)
        return [
            check
            for check in checks
            if any(each.is_beyond(vehicle, REACHED) for each in check(rest) if _counts(each))
        ]


def _checks_of(obstacles: Iterable[int]) -> list[Check]:
    """Return functions that verify some obstacles, by their numbers, and all else at rest."""
    return [each.check for each in checkers(obstacles) if each.at_rest]


def _counts(column: Column) -> bool:
    """Return whether a column covers every instant of a hard constraint."""
    return not column.is_at_knots and column.penalties is None


def _without_what_is_over(scenario: Scenario) -> Scenario:
    """Return a scenario without the constraints that expire by its end.

    Intervals include their ends, where the radii of the flight count.
    """
    end = scenario.grid.end + scenario.lead
    over = (end - 2.0, end - 1.0)

    def is_over(active: tuple[float, float] | None) -> bool:
        return active is not None and not scenario.grid.clock.after(active[1], end)

    if scenario.required is not scenario.requirements:  # those at waypoints end with the flight
        whole = [each for each in scenario.requirements if each.between is None]
        vehicles = tuple(unchecked(each, waypoints=()) for each in scenario.vehicles)
        scenario = scenario.derived(
            vehicles=vehicles, requirements=tuple(whole), fleet=scenario.fleet
        )
    changed: dict[str, object] = {
        name: tuple(unchecked(each, active=over) if is_over(each.active) else each for each in of)
        for name, of in (("obstacles", scenario.bodies), ("requirements", scenario.requirements))
        if any(is_over(each.active) for each in of)
    }
    return scenario.derived(**changed, fleet=scenario.fleet) if changed else scenario
