"""Linear constraints on the motion of a vehicle: boxes (4), (6), (7), and (8) made linear by (15).

All of them have one form, normal · quantity(time) >= bound.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from drake_rho.motion.clearance import closest_approach, turning_points
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Box, Quantity, Scenario, Sphere, Vehicle

WORST = 0.01
"""Part of the verifier's tolerance beyond which a constraint is broken and its rows are added."""

BoolArray = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class HalfSpaces:
    """Rows normal · quantity(time) >= bound, all of one constraint of one vehicle."""

    name: str
    """what the constraint is called in messages"""
    quantity: Quantity
    """what is bounded"""
    times: FloatArray
    """when [s], shape (R,)"""
    normals: FloatArray
    """in which direction, unit vectors, shape (R, 3)"""
    bounds: FloatArray
    """least value along the normal, in the quantity's unit, shape (R,)"""
    tolerances: FloatArray
    """how far below the bound still counts as held, in the quantity's unit, shape (R,)"""
    sides: int = 1
    """rows at each time, one after the other: 6 for a box"""
    within: Sphere | None = None
    """a sphere outside which the rows ask for nothing; None if they always hold"""

    def margins(self, motion: Motion) -> FloatArray:
        """How far above its bound each row is, in the quantity's unit, shape (R,)."""
        values = motion.at(self.quantity, self.times)
        margins: FloatArray = np.einsum("ri,ri->r", self.normals, values) - self.bounds
        if self.within is None:
            return margins
        outside = np.linalg.norm(values - self.within.center, axis=1) - self.within.radius
        held: FloatArray = np.maximum(margins, outside)
        return held

    def everywhere(self) -> HalfSpaces:
        """The same rows, asked for wherever the vehicle is."""
        return dataclasses.replace(self, within=None)

    def near(self, rows: BoolArray, reach: int) -> BoolArray:
        """The mask `rows` and those of the same side up to `reach` times before or after them."""
        count = np.zeros((len(rows) // self.sides + 2 * reach + 1, self.sides), dtype=int)
        count[reach + 1 : len(count) - reach] = rows.reshape(-1, self.sides)
        count = count.cumsum(axis=0)
        count[len(count) - reach :] = count[len(count) - reach - 1]
        return (count[2 * reach + 1 :] > count[: len(count) - 2 * reach - 1]).reshape(-1)

    def with_rows(self, other: HalfSpaces) -> HalfSpaces:
        """These rows and then those of `other`, of the same constraint."""
        return dataclasses.replace(
            self,
            times=np.concatenate([self.times, other.times]),
            normals=np.concatenate([self.normals, other.normals]),
            bounds=np.concatenate([self.bounds, other.bounds]),
            tolerances=np.concatenate([self.tolerances, other.tolerances]),
        )

    def select(self, rows: BoolArray) -> HalfSpaces:
        """Only the rows of the mask `rows`."""
        return dataclasses.replace(
            self,
            times=self.times[rows],
            normals=self.normals[rows],
            bounds=self.bounds[rows],
            tolerances=self.tolerances[rows],
        )


def box_sides(quantity: Quantity, box: Box, scale: float, times: FloatArray) -> HalfSpaces:
    """The six sides of a box (4), (6) or (7), each at every one of `times` [s].

    Args:
        quantity: what the box bounds.
        box: in the quantity's unit.
        scale: what is large for it, in its unit (`Scenario.scale`).
        times: since the first knot [s], shape (R,).
    """
    sides = np.concatenate([np.eye(3), -np.eye(3)])
    bounds = np.concatenate([box.lower, -box.upper])
    return HalfSpaces(
        f"{quantity} box",
        quantity,
        np.repeat(times, 6),
        np.tile(sides, (len(times), 1)),
        np.tile(bounds, len(times)),
        np.tile(box.tolerance(scale), 2 * len(times)),
        sides=6,
    )


def linearise(name: str, sphere: Sphere, reference: Motion, times: FloatArray) -> HalfSpaces:
    """(15): the sphere (8) replaced by its tangent planes that face a reference.

    With n = (q - p_m) / |q - p_m|, the row n · (p - q) + |q - p_m| >= R_m is the half-space
    n · p >= R_m + n · p_m. Every point it allows is outside the sphere. Where the reference is at
    the centre itself, n is undefined; it then points across the reference's way.

    Args:
        name: what the constraint is called in messages.
        sphere: the obstacle.
        reference: q, the motion of one vehicle.
        times: since the first knot [s], shape (R,).
    """
    offsets = reference.at("position", times) - sphere.center
    distances = np.linalg.norm(offsets, axis=1)
    at_centre = distances <= sphere.tolerance
    if np.any(at_centre):
        offsets[at_centre] = across(reference.positions[-1] - reference.positions[0])
        distances = np.linalg.norm(offsets, axis=1)
    n = offsets / distances[:, None]
    bounds = sphere.radius + n @ sphere.center
    tolerances = np.full(len(times), sphere.tolerance)
    return HalfSpaces(name, "position", times, n, bounds, tolerances)


def beside(name: str, sphere: Sphere, side: FloatArray, times: FloatArray) -> HalfSpaces:
    """A sphere that is to be passed on one side, wherever the vehicle would be inside it.

    Args:
        name: what the constraint is called in messages.
        sphere: the obstacle.
        side: from the centre towards that side, a unit vector, shape (3,).
        times: since the first knot [s], shape (R,).
    """
    return HalfSpaces(
        name,
        "position",
        times,
        np.tile(side, (len(times), 1)),
        np.full(len(times), sphere.radius + side @ sphere.center),
        np.full(len(times), sphere.tolerance),
        within=sphere,
    )


@dataclasses.dataclass(frozen=True)
class Constraints:
    """What a vehicle has to keep to beside its goal and its acceleration box."""

    rows: tuple[HalfSpaces, ...]
    """every row at the knots"""
    watches: tuple[Watch, ...] = ()
    """for what has to hold at every instant: each finds the rows that a motion breaks"""

    def __add__(self, other: Constraints) -> Constraints:
        """Both."""
        return Constraints(self.rows + other.rows, self.watches + other.watches)


Watch = Callable[[Motion], HalfSpaces]
"""The worst instants of a motion, as rows: those that it breaks are to be added to its program."""


def boxes_of(scenario: Scenario, vehicle: Vehicle) -> Constraints:
    """The boxes of position, velocity and jerk that a vehicle has to keep to.

    The first and the last knot are left out where the start and the goal decide. Between knots
    only positions need a watch: velocity is linear there, and jerk is of the knots.
    """
    limits = scenario.limits_of(vehicle)
    times, inner = scenario.grid.times, scenario.grid.times[1:-1]
    first = 1 if vehicle.start.acceleration is None else 0
    boxes: tuple[tuple[Quantity, Box | None, FloatArray], ...] = (
        ("position", limits.position, inner),
        ("velocity", limits.velocity, inner),
        ("jerk", limits.jerk, times[first:-1]),
    )
    rows = tuple(
        box_sides(quantity, box, scenario.scale(vehicle, quantity), when)
        for quantity, box, when in boxes
        if box is not None
    )
    if limits.position is None or not scenario.between_knots:
        return Constraints(rows)
    scale = scenario.scale(vehicle, "position")
    return Constraints(rows, (partial(_turns, limits.position, scale),))


def _turns(box: Box, scale: float, motion: Motion) -> HalfSpaces:
    """A watch: the sides of a position box where the motion turns round between knots."""
    times, positions = turning_points(motion)
    room = WORST * box.tolerance(scale)
    outside = (positions < box.lower - room) | (positions > box.upper + room)
    return box_sides("position", box, scale, np.unique(times[outside]))


def obstacles_as(
    scenario: Scenario, rows_for: Callable[[int, Sphere, FloatArray], HalfSpaces]
) -> Constraints:
    """The obstacles as half-spaces, at the knots between start and goal or at every instant.

    Args:
        scenario: with the obstacles.
        rows_for: makes the rows of an obstacle: (its index, the sphere, times) -> half-spaces.
    """
    spheres = list(enumerate(scenario.obstacles))
    rows = tuple(rows_for(index, sphere, scenario.grid.times[1:-1]) for index, sphere in spheres)
    if not scenario.between_knots:
        return Constraints(rows)
    watches = tuple(
        partial(_dips, sphere, partial(rows_for, index, sphere)) for index, sphere in spheres
    )
    return Constraints(rows, watches)


def _dips(
    sphere: Sphere, rows_for: Callable[[FloatArray], HalfSpaces], motion: Motion
) -> HalfSpaces:
    """A watch: the closest approaches of a motion that are inside a sphere."""
    approach = closest_approach(motion, sphere.center)
    inside = approach.distances < sphere.radius - WORST * sphere.tolerance
    return rows_for(np.unique(approach.times[inside]))


def across(direction: FloatArray) -> FloatArray:
    """A unit vector square to `direction`, shape (3,): the same one every time."""
    least = np.eye(3)[np.argmin(np.abs(direction))]
    across = np.cross(direction, least)
    length = float(np.linalg.norm(across))
    return across / length if length else np.array([0.0, 0.0, 1.0])
