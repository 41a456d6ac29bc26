"""Limits on norms: each is a convex set that contains a quantity of every vehicle."""

from __future__ import annotations

import abc
import dataclasses
from typing import Literal

import numpy as np

from drake_rho.scenario.convex_sets import Balls, Cones, ConvexSets, tolerances_of
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.limits import GRAVITY
from drake_rho.scenario.parts import UNITS, Quantity

Norm = Literal["max_speed", "max_acceleration", "max_thrust", "max_tilt", "max_jerk"]
"""The fields of `Limits` that limit a norm."""


@dataclasses.dataclass(frozen=True)
class Kind(abc.ABC):
    """Measure that one field of `Limits` bounds, and the sets of allowed values."""

    what: str
    """name of the measure: speed, acceleration, jerk, thrust or tilt"""
    measure: str
    """name of the measure in "a ... of at most" in error messages"""
    quantity: Quantity
    """quantity whose values lie in the set"""
    origin: FloatArray
    """centre or apex of the set, in the quantity's unit, shape (3,)"""

    @property
    def name(self) -> str:
        """Name of the constraint in messages, such as 'maximum speed'."""
        return f"maximum {self.what}"

    @property
    @abc.abstractmethod
    def unit(self) -> str:
        """Unit of the measure and of its limit."""

    @property
    def largest(self) -> float:
        """Least upper bound of limits, in the unit of the measure."""
        return np.inf

    @abc.abstractmethod
    def measured(self, values: FloatArray) -> FloatArray:
        """Return the limited measure of values (..., 3), in the limit's unit, shape (...)."""

    @abc.abstractmethod
    def inner_radii(self, most: FloatArray) -> FloatArray:
        """Return the radii of the largest balls in the sets, in the quantity's unit, shape (N,).

        Args:
            most: limit of each vehicle, infinite where it has none, shape (N,).
        """

    @abc.abstractmethod
    def sets(self, most: FloatArray, scale: FloatArray) -> ConvexSets:
        """Return the sets of all vehicles.

        Args:
            most: limit of each vehicle, infinite where it has none, shape (N,).
            scale: characteristic magnitude of the quantity in each motion, in its unit, shape (N,).
        """


@dataclasses.dataclass(frozen=True)
class Length(Kind):
    """Measure norm(value - origin)."""

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        return UNITS[self.quantity]

    def measured(self, values: FloatArray) -> FloatArray:
        """Return the distances from the origin, in the quantity's unit."""
        x = values - self.origin
        lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", x, x))
        return lengths

    def inner_radii(self, most: FloatArray) -> FloatArray:
        """Return the radii of the balls themselves."""
        return most

    def sets(self, most: FloatArray, scale: FloatArray) -> Balls:
        """Return balls of the radii `most`."""
        centers = np.tile(self.origin, (len(most), 1))
        return Balls(centers, tolerances_of(most, centers, scale), most)


@dataclasses.dataclass(frozen=True)
class Inclination(Kind):
    """Angle between value - origin and the upward vertical, below a right angle."""

    @property
    def unit(self) -> str:
        """Unit of angles."""
        return "rad"

    @property
    def largest(self) -> float:
        """A right angle, beyond which the set is not convex."""
        return np.pi / 2.0

    def measured(self, values: FloatArray) -> FloatArray:
        """Return the angles to the upward vertical [rad], from 0 to pi."""
        x = values - self.origin
        angles: FloatArray = np.arctan2(np.hypot(x[..., 0], x[..., 1]), x[..., 2])
        return angles

    def inner_radii(self, most: FloatArray) -> FloatArray:
        """Return infinite radii: a cone contains balls of any size."""
        return np.full(len(most), np.inf)

    def sets(self, most: FloatArray, scale: FloatArray) -> Cones:
        """Return upright cones; angles of pi stand for no limit.

        For its tolerance, the width of a cone is that at the thrust of hovering.
        """
        apexes = np.tile(self.origin, (len(most), 1))
        angles = np.minimum(most, np.pi)
        widths = float(np.linalg.norm(self.origin)) * np.tan(angles)
        return Cones(apexes, tolerances_of(widths, apexes, scale), angles)


_FREE_FALL = np.array([0.0, 0.0, -GRAVITY])
"""Acceleration without thrust [m/s²]."""

NORMS: dict[Norm, Kind] = {
    "max_speed": Length("speed", "norm", "velocity", np.zeros(3)),
    "max_acceleration": Length("acceleration", "norm", "acceleration", np.zeros(3)),
    "max_thrust": Length("thrust", "thrust", "acceleration", _FREE_FALL),
    "max_tilt": Inclination("tilt", "tilt", "acceleration", _FREE_FALL),
    "max_jerk": Length("jerk", "norm", "jerk", np.zeros(3)),
}
"""Limits on norms, by their field."""


@dataclasses.dataclass(frozen=True, eq=False)
class NormLimit:
    """Limit on a norm of a quantity, for every vehicle."""

    field: Norm
    """the field of `Limits`"""
    kind: Kind
    """limited measure"""
    limits: FloatArray
    """limit of each vehicle, infinite where it has none, shape (N,)"""
    sets: ConvexSets
    """sets of allowed values"""

    def check(self, where: str, values: FloatArray) -> None:
        """Check that `values`, shape (N, 3), satisfy the limit; NaN is not checked.

        Args:
            where: field of a vehicle that holds the values, such as `"start.velocity"`.
            values: one of each vehicle, in the quantity's unit.

        Raises:
            ScenarioError: a value violates the limit.
        """
        distances = self.sets.signed_distance(np.arange(len(values)), values)
        outside = distances > self.sets.tolerances
        if np.any(outside):
            i = int(np.argmax(outside))
            found = float(self.kind.measured(values[i]))
            expected = f"a {self.kind.measure} of at most {self.limits[i]:g}, not {found:.7g}"
            raise ScenarioError(f"vehicles[{i}].{where}", values[i].tolist(), expected)
