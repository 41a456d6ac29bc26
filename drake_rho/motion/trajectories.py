"""Record of trajectories that any planner may have made: `Trajectories`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from drake_rho.motion.flight import Sighting, Window
from drake_rho.motion.plan import Plan
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.samples import Samples
from drake_rho.motion.statistics import Statistics
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.errors import shortened
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import Clock

_LONGEST_TICK = 1e-3
"""Largest unit of times: files of shows count milliseconds [s]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectories(metaclass=Described):
    """Trajectories of vehicles, of any planner: polynomials in pieces of time, or samples.

    `rho.load_trajectories` reads them, `Trajectories.of` and `Trajectories.of_samples` take them
    from a program, and `rho.verify(trajectories, scenario)` verifies them at every instant.

    With a scenario (`for_scenario`, or one given to `rho.load_trajectories`) they are drawn and
    exported like plans: `rho.paths_figure(trajectories)`.

    Raises:
        ValueError: there is no vehicle, a time or a coefficient is not a finite number, times do
            not increase, the bound on the acceleration is not a positive number, the tick is not
            from 0 to 1 ms, the vehicles are not those of the scenario, or a motion is outside its
            time.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("courier"))
        >>> name = plan.scenario.names[0]
        >>> found = rho.Trajectories.of({name: plan.trajectory(name)})
        >>> rho.verify(found, plan.scenario).ok
        True
    """

    motions: Mapping[str, Polynomials]
    """motion of each vehicle, by its name; its times are on the scenario's clock"""
    max_acceleration: float | None = None
    """bound on the norm of the acceleration between samples [m/s²], which are joined by straight
    lines; None if the polynomials are the motion itself"""
    judged_for: Scenario | None = None
    """scenario whose vehicles they move, for figures, scenes and exports; None if it is unknown"""
    tick: float = 0.0
    """unit in which their file counts times [s]: they may end later than their scenario by this
    rounding, and are then verified to their own end; 0 if times are exact"""

    def __post_init__(self) -> None:
        if not self.motions:
            raise ValueError("motions: got none, expected one of each vehicle")
        for name, each in self.motions.items():
            _check(name, each)
        most = self.max_acceleration
        if most is not None and not 0.0 < most <= LARGEST:
            raise ValueError(f"max_acceleration: got {most}, expected a positive number")
        if not 0.0 <= self.tick <= _LONGEST_TICK:
            raise ValueError(f"tick: got {self.tick}, expected 0 to {_LONGEST_TICK:g} s")
        motions, own = dict(self.motions), self.judged_for
        if own is not None:
            motions = dict(zip(own.names, self.by_vehicle(own), strict=True))
        object.__setattr__(self, "motions", MappingProxyType(motions))

    @classmethod
    @checked
    def of(cls, trajectories: Mapping[str, Any]) -> Self:
        """Return trajectories of Drake's type `PiecewisePolynomial`.

        Args:
            trajectories: positions of each vehicle [m], a `PiecewisePolynomial` of shape (3, 1), by
                the vehicle's name.

        Raises:
            ValueError: a trajectory is of another type or shape, or is empty.
        """
        for name, each in trajectories.items():
            if not hasattr(each, "getPolynomial"):
                expected = "expected a PiecewisePolynomial of Drake"
                raise ValueError(f"{name}: got an object of type {type(each).__name__}, {expected}")
            shape = (each.rows(), each.cols()) if each.get_number_of_segments() else (0, 0)
            if shape != (3, 1):
                raise ValueError(f"{name}: got shape {shape}, expected positions of shape (3, 1)")
        return cls({name: Polynomials.of_trajectory(each) for name, each in trajectories.items()})

    @classmethod
    @checked
    def of_samples(cls, samples: Mapping[str, npt.ArrayLike], *, max_acceleration: float) -> Self:
        """Return trajectories through position samples with a bound on accelerations.

        Args:
            samples: rows of time [s], x, y and z [m] of each vehicle, shape (M, 4), by its name.
            max_acceleration: bound on the norm of the acceleration between samples [m/s²].

        Raises:
            ValueError: fewer than two samples, times that do not increase, a value that is not a
                finite number, or a bound that is not positive.
        """
        tables = {name: np.array(each, dtype=np.float64) for name, each in samples.items()}
        return cls({name: sampled(name, each) for name, each in tables.items()}, max_acceleration)

    def __repr__(self) -> str:
        """Return a text such as '<Trajectories of 4 vehicles from 0 to 10 s, 120 pieces>'."""
        count, pieces = len(self.motions), sum(len(e.instants) - 1 for e in self.motions.values())
        vehicles = "1 vehicle" if count == 1 else f"{count} vehicles"
        kind = "pieces" if self.max_acceleration is None else "samples"
        return (
            f"<Trajectories of {vehicles} from {self.start:g} to {self.end:g} s, {pieces} {kind}>"
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles."""
        return tuple(self.motions)

    @property
    def kind(self) -> Literal["trajectories"]:
        """Kind of the record."""
        return "trajectories"

    @property
    def scenario(self) -> Scenario:
        """Their scenario.

        Raises:
            ValueError: it is unknown.
        """
        if self.judged_for is None:
            expected = "expected those of a known one: trajectories.for_scenario(scenario)"
            raise ValueError(f"trajectories: got some without a scenario, {expected}")
        return self.judged_for

    @cached_property
    def plan(self) -> Plan:
        """Plan with their states at the knots."""
        return self.as_plan(self.scenario)

    @property
    def cost(self) -> float:
        """Performance index of the mean accelerations of the steps."""
        return self.plan.cost

    @property
    def statistics(self) -> Statistics:
        """Statistics of planning, which are unknown."""
        return self.plan.statistics

    @property
    def windows(self) -> tuple[Window, ...]:
        """Windows: none."""
        return ()

    @property
    def sightings(self) -> tuple[Sighting, ...]:
        """Obstacles that became known in flight: none."""
        return ()

    @property
    def flight(self) -> None:
        """Flight: none."""

    @property
    def simulation(self) -> None:
        """Simulation: none."""

    @property
    def start(self) -> float:
        """Time at which the first vehicle begins [s]."""
        return float(min(each.instants[0] for each in self.motions.values()))

    @property
    def end(self) -> float:
        """Time at which the last vehicle ends [s]."""
        return float(max(each.instants[-1] for each in self.motions.values()))

    @checked
    def delayed(self, seconds: float) -> Trajectories:
        """Return the trajectories that begin later by a time [s], or earlier if it is negative."""
        motions = {name: each.delayed(seconds) for name, each in self.motions.items()}
        return dataclasses.replace(self, motions=motions)

    @checked
    def for_scenario(self, scenario: Scenario) -> Trajectories:
        """Return the trajectories with a scenario, in the order of its vehicles.

        Raises:
            ValueError: the vehicles are not those of the scenario, or a motion is outside its time.
        """
        return dataclasses.replace(self, judged_for=scenario)

    @checked
    def at(self, times: npt.ArrayLike, vehicle: str | None = None) -> Samples:
        """Return positions, velocities and accelerations at times; those after a joint at a joint.

        Between samples they are those of the straight lines. A vehicle is at rest before its motion
        begins and after its end.

        Args:
            times: times [s], shape (T,), or a single one.
            vehicle: name of one vehicle; all vehicles if not given.

        Returns:
            A record with arrays of shape (N, T, 3), or (T, 3) for one vehicle.

        Raises:
            ValueError: a time is outside the trajectories, or there is no such vehicle.
        """
        instants = np.atleast_1d(np.asarray(times, dtype=np.float64))
        clock = Clock.of(self.end - self.start, self.start, self.end)
        inside = clock.within(instants, (self.start, self.end))
        if instants.ndim > 1 or not inside.all():
            expected = f"expected times from {self.start:.12g} to {self.end:.12g} s, shape (T,)"
            raise ValueError(f"times: got {np.array2string(instants, threshold=3)}, {expected}")
        if vehicle is not None and vehicle not in self.motions:
            raise ValueError(f"vehicle: got {vehicle!r}, expected one of {', '.join(self.names)}")
        samples = self._states(instants)
        return samples if vehicle is None else samples.of(self.names.index(vehicle))

    def sampled(self, elapsed: FloatArray) -> Samples:
        """Return the states at times since the first knot of the scenario [s]."""
        return self._states(self.scenario.grid.start + elapsed)

    def _states(self, times: FloatArray) -> Samples:
        """Return the states of all vehicles at times [s]."""
        states = [each.states(times) for each in self.motions.values()]
        return Samples(self.names, times, *map(np.concatenate, zip(*states, strict=True)))

    def by_vehicle(self, scenario: Scenario) -> list[Polynomials]:
        """Return the motions in the order of a scenario's vehicles.

        Raises:
            ValueError: the vehicles are not those of the scenario, or a motion is outside its time.
        """
        names, grid = scenario.names, scenario.grid
        if set(names) != set(self.motions):
            other = next(iter(sorted(set(names) ^ set(self.motions))))
            one, two = (scenario.name, "the trajectories")[:: 1 if other in names else -1]
            raise ValueError(f"vehicles: {other} is in {one}, but not in {two}")
        span = grid.start - scenario.lead, grid.end + scenario.lead
        latest = span[0], span[1] + self.tick
        if not grid.clock.within(np.array([self.start, self.end]), latest).all():
            got = f"got trajectories from {self.start:.12g} to {self.end:.12g} s"
            expected = f"times of {scenario.name}, {span[0]:.12g} to {span[1]:.12g} s"
            raise ValueError(f"{got}, expected {expected}, or a scenario that lasts as long")
        return [self.motions[name] for name in names]

    @checked
    def as_plan(self, scenario: Scenario) -> Plan:
        """Return the plan with the states of the trajectories at the knots of a scenario.

        Between knots it is near the trajectories: for figures and scenes, and as a reference of
        `rho.plan`. Its accelerations are the mean ones of the steps.

        Args:
            scenario: scenario of the same vehicles; its smoothing, if any, is left out.

        Raises:
            ValueError: the vehicles are not those of the scenario, or a motion is outside its time.
        """
        at_knots = self.for_scenario(scenario)._states(scenario.grid.times)
        p, v = at_knots.positions, at_knots.velocities
        a = np.diff(v, axis=1) / scenario.grid.step
        plain = scenario.derived(smoothing=None)
        return Plan(plain, p, v, a, Statistics(minimised=None))


def sampled(name: str, table: FloatArray) -> Polynomials:
    """Return the motion of one vehicle along straight lines between samples.

    Args:
        name: name of the vehicle, for errors.
        table: rows of time [s], x, y and z [m], shape (M, 4).

    Raises:
        ValueError: there are fewer than two samples, or times do not increase.
    """
    name = shortened(name)
    if table.ndim != 2 or table.shape[1] != 4 or len(table) < 2:
        raise ValueError(f"{name}: got shape {table.shape}, expected (M, 4) with two or more rows")
    _check_times(name, table[:, 0])
    with np.errstate(over="ignore", invalid="ignore"):  # such numbers are refused by `_check`
        return Polynomials.through(table[:, 0], table[:, 1:])


def _check(name: str, motion: Polynomials) -> None:
    """Check the motion of one vehicle.

    Raises:
        ValueError: its shape is wrong, times do not increase, or a number is not finite.
    """
    name = shortened(name)
    _check_times(name, motion.instants)
    shape, expected = motion.coefficients.shape, (1, len(motion.instants) - 1, 3)
    if shape[:3] != expected:
        raise ValueError(f"{name}: got coefficients of shape {shape}, expected {expected} powers")
    if not np.all(np.abs(motion.coefficients) <= LARGEST):  # also true for NaN
        piece = int(np.argwhere(~(np.abs(motion.coefficients) <= LARGEST))[0][1])
        found = f"{name}: got numbers beyond {LARGEST:g} in piece {piece + 1}"
        raise ValueError(f"{found}, expected those of a flight")


def _check_times(name: str, times: FloatArray) -> None:
    """Check that there are two or more times [s], finite and increasing.

    Raises:
        ValueError: they are not.
    """
    if len(times) < 2:
        raise ValueError(f"{name}: got {len(times)} times, expected at least two")
    clock = Clock.of(0.0, *times[[0, -1]])
    wrong = ~(np.abs(times) <= LARGEST)
    wrong[1:] |= ~clock.after(times[1:], times[:-1])
    if wrong.any():
        number = int(np.argmax(wrong))
        expected = "expected finite times that increase"
        raise ValueError(f"{name}: got the time {times[number]:.12g} s at {number + 1}, {expected}")
