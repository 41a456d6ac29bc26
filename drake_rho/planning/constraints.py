"""What vehicles have to keep to beside their goals, and the half-spaces that ask for it.

Every constraint says how far a motion is from breaking it at the knots, which half-spaces forbid
the breaches, and where between the knots it is broken.
"""

from __future__ import annotations

import abc
import dataclasses
import sys
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drake_rho.motion.clearance import dips, turning_points
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.fleet import Bounds
from drake_rho.scenario.parts import Quantity, Sphere
from drake_rho.scenario.records import Scenario

WORST = 0.01
"""Part of the verifier's tolerance beyond which a constraint is broken and its rows are added."""

_SIDES = np.concatenate([np.eye(3), -np.eye(3)])
"""Normals of a box's sides, pointing inwards."""


class Constraint(abc.ABC):
    """One constraint of every vehicle; S rows at each of T knots."""

    name: str
    """what it is called in messages"""
    times: FloatArray
    """knots at which it is asked [s], shape (T,)"""
    sides: int
    """S"""

    @abc.abstractmethod
    def margins(self, motion: Motion, vehicles: IntArray) -> FloatArray | None:
        """How far the motion of `vehicles` is above the bounds, in tolerances, shape (P, S, T).

        Returns None where it is plain that none is broken.
        """

    @abc.abstractmethod
    def rows(self, vehicles: IntArray, sides: IntArray, times: FloatArray) -> HalfSpaces:
        """Half-spaces of the given vehicles, sides and times, three arrays of shape (R,)."""

    def broken_between(self, motion: Motion, vehicles: IntArray) -> HalfSpaces | None:
        """Half-spaces at the worst instants between knots; None if it is not asked there."""
        return None

    def rows_of(self, vehicle: int) -> HalfSpaces:
        """Every row of one vehicle at the knots, side by side: S for the first knot, and so on."""
        knots, sides = len(self.times), np.tile(np.arange(self.sides), len(self.times))
        whose = np.full(knots * self.sides, vehicle)
        return self.rows(whose, sides, np.repeat(self.times, self.sides))


@dataclasses.dataclass(frozen=True)
class Listed(Constraint):
    """A constraint given by the list of its rows, neighbours in time one after the other."""

    every: HalfSpaces
    likely: BoolArray | None = None  # those that are in the programs from the start
    rounds: int = sys.maxsize  # in which rows are added; fewer for what is only on the way
    sides: int = 1

    @property
    def name(self) -> str:  # type: ignore[override]  # that of the rows
        """As the rows are called."""
        return self.every.name

    @property
    def times(self) -> FloatArray:  # type: ignore[override]  # those of the rows
        """Of every row."""
        return self.every.times

    def margins(self, motion: Motion, vehicles: IntArray) -> FloatArray | None:
        """Of the rows, which are of all vehicles, shape (R,)."""
        return self.every.margins(motion) / self.every.tolerances

    def rows(self, vehicles: IntArray, sides: IntArray, times: FloatArray) -> HalfSpaces:
        """The rows that there are."""
        return self.every

    def of_block(self, vehicles: IntArray) -> Listed:
        """Only the rows of neighbouring vehicles."""
        own = (self.every.vehicles >= vehicles[0]) & (self.every.vehicles <= vehicles[-1])
        if np.all(own):
            return self
        likely = None if self.likely is None else self.likely[own]
        return Listed(self.every.select(own), likely, self.rounds)

    def rows_of(self, vehicle: int) -> HalfSpaces:
        """Those of one vehicle."""
        return self.every.of(vehicle)


@dataclasses.dataclass(frozen=True)
class BoxConstraint(Constraint):
    """The box (4), (5), (6) or (7) of every vehicle."""

    quantity: Quantity
    bounds: Bounds
    times: FloatArray
    first: int  # index of the first of `times` among the values that the motion has
    between: bool = False  # whether asked between knots too; only positions can break it there
    sides: int = 6

    @property
    def name(self) -> str:  # type: ignore[override]  # derived here
        """As in 'position box'."""
        return f"{self.quantity} box"

    def margins(self, motion: Motion, vehicles: IntArray) -> FloatArray | None:
        """Each axis' lower bounds, then its upper ones."""
        values = self._values(motion)[:, self.first : self.first + len(self.times)]
        lower, upper = self.bounds.lower[vehicles], self.bounds.upper[vehicles]
        if not (np.any(values < lower[:, None]) or np.any(values > upper[:, None])):
            return None
        over = np.concatenate([values - lower[:, None], upper[:, None] - values], axis=2)
        over /= np.tile(self.bounds.tolerances[vehicles], 2)[:, None]
        if self.quantity == "jerk":  # the first acceleration may be free of a jerk limit
            over[np.isnan(motion.before[:, 0]), 0] = np.inf
        return np.moveaxis(over, 2, 1)

    def _values(self, motion: Motion) -> FloatArray:
        if self.quantity == "jerk":
            return motion.jerks()
        return {
            "position": motion.positions,
            "velocity": motion.velocities,
            "acceleration": motion.accelerations,
        }[self.quantity]

    def rows(self, vehicles: IntArray, sides: IntArray, times: FloatArray) -> HalfSpaces:
        """The sides asked for."""
        axes = sides % 3
        bounds = np.where(
            sides < 3, self.bounds.lower[vehicles, axes], -self.bounds.upper[vehicles, axes]
        )
        tolerances = self.bounds.tolerances[vehicles, axes]
        return HalfSpaces(
            self.name, self.quantity, vehicles, times, _SIDES[sides], bounds, tolerances
        )

    def broken_between(self, motion: Motion, vehicles: IntArray) -> HalfSpaces | None:
        """The sides of a position box where the motion turns round between knots."""
        if not self.between:
            return None
        times, positions = turning_points(motion)
        room = WORST * self.bounds.tolerances[vehicles][:, None]
        below = positions < self.bounds.lower[vehicles][:, None] - room
        above = positions > self.bounds.upper[vehicles][:, None] + room
        parts = []
        for broken, first in ((below, 0), (above, 3)):
            which, steps, axes = np.nonzero(broken)
            parts.append(self.rows(vehicles[which], axes + first, times[which, steps, axes]))
        return HalfSpaces.joined(parts)


@dataclasses.dataclass(frozen=True)
class Tangents(Constraint):
    """(15): an obstacle (8) replaced by its tangent planes that face a reference.

    With n = (q - p_m) / |q - p_m|, the row n · (p - q) + |q - p_m| >= R_m is the half-space
    n · p >= R_m + n · p_m. Every point it allows is outside the sphere. Where the reference is at
    the centre itself, n is undefined; it then points across the reference's way.
    """

    name: str
    sphere: Sphere
    reference: Motion  # q, of every vehicle
    times: FloatArray
    between: bool  # whether asked between knots too
    sides: int = 1

    @cached_property
    def _planes(self) -> tuple[FloatArray, FloatArray]:
        """Normals (N, T, 3) and bounds (N, T) at the knots."""
        offsets = self.reference.positions[:, 1:-1] - self.sphere.center
        n = _directions(self.sphere, offsets, self.reference)
        return n, self.sphere.radius + n @ self.sphere.center

    def margins(self, motion: Motion, vehicles: IntArray) -> FloatArray | None:
        """Distances from the tangent planes."""
        normals, bounds = self._planes
        if len(vehicles) < len(bounds):
            normals, bounds = normals[vehicles], bounds[vehicles]
        over = np.einsum("ptx,ptx->pt", normals, motion.positions[:, 1:-1]) - bounds
        over /= self.sphere.tolerance
        margins: FloatArray = over[:, None]
        return margins

    def rows(self, vehicles: IntArray, sides: IntArray, times: FloatArray) -> HalfSpaces:
        """The tangent planes at any times."""
        offsets = self.reference.each_at("position", vehicles, times) - self.sphere.center
        n = _directions(self.sphere, offsets, self.reference.of(vehicles))
        return _planes(self.name, self.sphere, vehicles, times, n)

    def broken_between(self, motion: Motion, vehicles: IntArray) -> HalfSpaces | None:
        """Tangent planes at the closest approaches that are inside the sphere."""
        return _at_dips(self, self.sphere, motion, vehicles) if self.between else None


@dataclasses.dataclass(frozen=True)
class Beside(Constraint):
    """A sphere that is to be passed on one side, wherever a vehicle would be inside it."""

    name: str
    sphere: Sphere
    side: FloatArray  # from the centre towards that side, a unit vector, shape (3,)
    times: FloatArray
    between: bool
    sides: int = 1

    def margins(self, motion: Motion, vehicles: IntArray) -> FloatArray | None:
        """Distances from the tangent plane on that side, or from the sphere if these are larger."""
        offsets = motion.positions[:, 1:-1] - self.sphere.center
        beyond = np.maximum(offsets @ self.side, np.linalg.norm(offsets, axis=-1))
        margins: FloatArray = ((beyond - self.sphere.radius) / self.sphere.tolerance)[:, None]
        return margins

    def rows(self, vehicles: IntArray, sides: IntArray, times: FloatArray) -> HalfSpaces:
        """The tangent plane on that side."""
        n = np.tile(self.side, (len(times), 1))
        return _planes(self.name, self.sphere, vehicles, times, n)

    def rows_of(self, vehicle: int) -> HalfSpaces:
        """None: where the plane is asked for depends on the motion."""
        return super().rows_of(vehicle).select(np.zeros(len(self.times), dtype=bool))

    def broken_between(self, motion: Motion, vehicles: IntArray) -> HalfSpaces | None:
        """The tangent plane at the closest approaches that are inside the sphere."""
        return _at_dips(self, self.sphere, motion, vehicles) if self.between else None


def boxes_of(scenario: Scenario) -> list[Constraint]:
    """The boxes that the vehicles have to keep to.

    The first and the last knot are left out where the start and the goal decide. Between knots
    only positions can break theirs: velocity is linear there, acceleration and jerk are of the
    knots.
    """
    times = scenario.grid.times
    asked: tuple[tuple[Quantity, FloatArray, int], ...] = (
        ("position", times[1:-1], 1),
        ("velocity", times[1:-1], 1),
        ("acceleration", times[:-1], 0),
        ("jerk", times[:-1], 0),
    )
    boxes: list[Constraint] = []
    for quantity, when, first in asked:
        bounds = scenario.fleet.bounds(quantity)
        if bounds is not None:
            between = scenario.between_knots and quantity == "position"
            boxes.append(BoxConstraint(quantity, bounds, when, first, between))
    return boxes


def tangents_of(scenario: Scenario, reference: Plan) -> list[Constraint]:
    """The obstacles linearised (15) around `reference`, a motion of the same vehicles."""
    motion, times = reference.motion(), scenario.grid.times[1:-1]
    return [
        Tangents(f"obstacle {number}", sphere, motion, times, scenario.between_knots)
        for number, sphere in enumerate(scenario.obstacles, start=1)
    ]


def sides_of(scenario: Scenario, sides: Sequence[FloatArray]) -> list[Constraint]:
    """The obstacles, each to be passed on one of `sides`, unit vectors of shape (3,)."""
    times = scenario.grid.times[1:-1]
    return [
        Beside(f"obstacle {number}", sphere, side, times, scenario.between_knots)
        for number, (sphere, side) in enumerate(
            zip(scenario.obstacles, sides, strict=True), start=1
        )
    ]


def across(direction: FloatArray) -> FloatArray:
    """A unit vector square to `direction`, shape (3,): the same one every time."""
    least = np.eye(3)[np.argmin(np.abs(direction))]
    across = np.cross(direction, least)
    length = float(np.linalg.norm(across))
    return across / length if length else np.array([0.0, 0.0, 1.0])


def _directions(sphere: Sphere, offsets: FloatArray, reference: Motion) -> FloatArray:
    """Unit vectors along `offsets` from a sphere's centre, whose first axis is the motions'."""
    distances = np.sqrt(np.einsum("...i,...i->...", offsets, offsets))
    at_centre = distances <= sphere.tolerance
    if np.any(at_centre):
        for index in np.argwhere(at_centre):
            way = reference.positions[index[0], -1] - reference.positions[index[0], 0]
            offsets[tuple(index)] = across(way)
            distances[tuple(index)] = 1.0
    directions: FloatArray = offsets / distances[..., None]
    return directions


def _planes(
    name: str, sphere: Sphere, vehicles: IntArray, times: FloatArray, n: FloatArray
) -> HalfSpaces:
    bounds = sphere.radius + n @ sphere.center
    tolerances = np.full(len(times), sphere.tolerance)
    return HalfSpaces(name, "position", vehicles, times, n, bounds, tolerances)


def _at_dips(
    constraint: Constraint, sphere: Sphere, motion: Motion, vehicles: IntArray
) -> HalfSpaces:
    """Rows where the motions come too close, once where two steps share the instant."""
    found = dips(motion, sphere.center, sphere.radius - WORST * sphere.tolerance)
    whose, times = vehicles[found.vehicles], found.times
    again = (np.diff(whose, prepend=-1) == 0) & (np.diff(times, prepend=-1.0) == 0.0)
    whose, times = whose[~again], times[~again]
    return constraint.rows(whose, np.zeros(len(whose), dtype=int), times)
