"""Limits on norms, each a convex set that a quantity of every vehicle keeps in."""

from __future__ import annotations

import abc
import dataclasses
from typing import Literal

import numpy as np

from drake_rho.scenario.convex_sets import Balls, ConvexSets, UprightCones, tolerances_of
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import GRAVITY, Quantity

Norm = Literal["max_speed", "max_acceleration", "max_thrust", "max_tilt", "max_jerk"]
"""The fields of `Limits` that limit a norm."""


@dataclasses.dataclass(frozen=True)
class Kind(abc.ABC):
    """What one field of `Limits` limits, and how."""

    what: str
    """what is limited, in a word: speed, acceleration, jerk, thrust, tilt"""
    told_as: str
    """what a value has of it, in messages of what is expected"""
    quantity: Quantity
    """whose values are in the set"""
    origin: FloatArray
    """center or apex of the set, in the quantity's unit, shape (3,)"""

    @property
    def name(self) -> str:
        """What the constraint is called in messages, as 'maximum speed'."""
        return f"maximum {self.what}"

    @abc.abstractmethod
    def measured(self, values: FloatArray) -> FloatArray:
        """What is limited of values (..., 3), in the limit's unit, shape (...)."""

    @abc.abstractmethod
    def sets(self, most: FloatArray, scale: FloatArray) -> ConvexSets:
        """The sets of all vehicles.

        Args:
            most: the limit of each vehicle, infinite where it has none, shape (N,).
            scale: what is large for the quantity in each motion, in its unit, shape (N,).
        """


@dataclasses.dataclass(frozen=True)
class Length(Kind):
    """norm(value - origin)."""

    def measured(self, values: FloatArray) -> FloatArray:
        """Distances from the origin, in the quantity's unit."""
        x = values - self.origin
        lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", x, x))
        return lengths

    def sets(self, most: FloatArray, scale: FloatArray) -> Balls:
        """Balls of the radii `most`."""
        centers = np.tile(self.origin, (len(most), 1))
        return Balls(centers, tolerances_of(most, centers, scale), most)


@dataclasses.dataclass(frozen=True)
class Inclination(Kind):
    """The angle of value - origin to the upright."""

    def measured(self, values: FloatArray) -> FloatArray:
        """Angles to the upright [rad], from 0 to pi."""
        x = values - self.origin
        angles: FloatArray = np.arctan2(np.hypot(x[..., 0], x[..., 1]), x[..., 2])
        return angles

    def sets(self, most: FloatArray, scale: FloatArray) -> UprightCones:
        """Cones; as wide as at the height of hovering, and as good as all space without a limit."""
        apexes = np.tile(self.origin, (len(most), 1))
        angles = np.minimum(most, np.pi)
        widths = float(np.linalg.norm(self.origin)) * np.tan(angles)
        return UprightCones(apexes, tolerances_of(widths, apexes, scale), angles)


_FREE_FALL = np.array([0.0, 0.0, -GRAVITY])
"""The acceleration without thrust [m/s²]."""

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
    """A limit on a norm of a quantity, of every vehicle."""

    field: Norm
    """the field of `Limits`"""
    kind: Kind
    """what is limited"""
    most: FloatArray
    """the limit of each vehicle, infinite where it has none, shape (N,)"""
    sets: ConvexSets
    """what is allowed"""

    def check(self, where: str, values: FloatArray) -> None:
        """See that `values`, shape (N, 3), are inside; what is no number is not judged.

        Raises:
            ScenarioError: one is outside; `where` names it within its vehicle.
        """
        outside = self.sets.excess(np.arange(len(values)), values) > self.sets.tolerances
        if np.any(outside):
            i = int(np.argmax(outside))
            found = float(self.kind.measured(values[i]))
            expected = f"a {self.kind.told_as} of at most {self.most[i]:g}, not {found:.7g}"
            raise ScenarioError(f"vehicles[{i}].{where}", values[i].tolist(), expected)
