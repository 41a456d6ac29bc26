"""Goals that are no exact states: sets of positions or velocities, or none at all."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import Discriminator, Tag, model_serializer

from drake_rho.scenario.fields import FloatArray, Vector, read_only, record, record_kind
from drake_rho.scenario.sets import SET_KEYS, AnySet, ConvexSet, is_own, set_text

STATE_KEYS = ("position", "velocity", "acceleration")
"""Keys of a state in a file, of which a goal has the first two."""


def _value_kind(value: object) -> str:
    """Return the tag of a goal's position or velocity."""
    if value is None:
        return "None"
    is_set = isinstance(value, Mapping | ConvexSet)
    return "AnySet" if is_set else "Vector"


if TYPE_CHECKING:  # goals are mostly exact: code that reads them should not have to check
    Aimed = Any
    FreeOrVector = Any
else:
    Aimed = Annotated[
        Annotated[Vector, Tag("Vector")]
        | Annotated[AnySet, Tag("AnySet")]
        | Annotated[None, Tag("None")],
        Discriminator(_value_kind),
    ]
    """Value, convex set of values, or None for any value."""
    FreeOrVector = Vector | None
    """Value, or None for any value."""


def with_absent(self: Any, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
    """Return the fields of a record for a file, with None where a goal's value is free.

    Absent fields are not written, but None is not the default of these two.
    """
    content = handler(self)
    for name in STATE_KEYS[:2]:
        if getattr(self, name) is None:
            content[name] = None
    return content


@record
class Goal:
    """Goal in a convex set of positions, of velocities, or of both, at the last knot.

    Examples:
        >>> pad = rho.Goal(rho.Box([8, -1, 0], [10, 1, 0]))  # somewhere on it, at rest
        >>> rho.Goal(None).velocity.tolist()  # anywhere, at rest
        [0.0, 0.0, 0.0]
        >>> print(rho.Goal([9, 0, 1], velocity=rho.Sphere([2, 0, 0], 0.5)))
        [9.0, 0.0, 1.0] m at a velocity in sphere of radius 0.5 m at [2.0, 0.0, 0.0]
    """

    position: Aimed
    """convex set of positions, one of the package's or any object with the functions of
    `ConvexSet`; or a position [m]; or None for any"""
    velocity: Aimed = dataclasses.field(default_factory=lambda: read_only(np.zeros(3)))
    """velocity [m/s], a convex set of velocities, or None for any; at rest if not given"""

    if TYPE_CHECKING:

        def __init__(
            self,
            position: npt.ArrayLike | ConvexSet | None,
            velocity: npt.ArrayLike | ConvexSet | None = ...,
        ) -> None: ...

    _with_absent = model_serializer(mode="wrap")(with_absent)

    @property
    def is_at_rest(self) -> bool:
        """Whether the velocity is zero."""
        return isinstance(self.velocity, np.ndarray) and not self.velocity.any()

    @property
    def acceleration_outside(self) -> FloatArray:
        """Acceleration after the goal [m/s²], shape (3,): zero at rest, else unknown, so NaN."""
        return np.zeros(3) if self.is_at_rest else np.full(3, np.nan)

    def __str__(self) -> str:
        """Return a description, such as 'anywhere at any velocity'."""
        where = _text(self.position, "m", "anywhere", "a place ")
        if self.is_at_rest:
            return where
        return f"{where} at {_text(self.velocity, 'm/s', 'any velocity', 'a velocity ')}"


def _text(value: object, unit: str, free: str, within: str = "") -> str:
    if value is None:
        return free
    if isinstance(value, np.ndarray):
        return f"{value.tolist()} {unit}"
    return f"{within}in {set_text(value)}"


def goal_kind(value: object) -> str:
    """Return "State" for a goal with an exact position and velocity, else "Goal".

    A mapping without keys of a state is one of a set.
    """
    if isinstance(value, Mapping):
        if "acceleration" in value:
            return "State"
        parts = [value.get(name, ()) for name in STATE_KEYS[:2]]
        inexact = any(each is None or isinstance(each, Mapping) for each in parts)
        return "Goal" if inexact else "State"
    return "Goal" if isinstance(value, Goal) else "State"


def as_goal(value: object) -> object:
    """Return what a user gives as a goal as a state or a `Goal`, or as a mapping of one's fields.

    A set is a goal at rest there, and None is one anywhere with any velocity.
    """
    if value is None:
        return Goal(None, velocity=None)
    if isinstance(value, Mapping):
        kinds = {"State": STATE_KEYS, "AnySet": SET_KEYS}
        of_set = record_kind(value, kinds, "State") == "AnySet"
        return {"position": value} if of_set else value
    if isinstance(value, ConvexSet):
        return Goal(value)
    return value


def set_in(value: object) -> Any:
    """Return the convex set among a goal's values; None for an exact or a free value."""
    return None if isinstance(value, np.ndarray) else value


def is_storable(goal: object) -> bool:
    """Return whether a file can hold a goal: it has no set of a user's own."""
    values = (set_in(getattr(goal, name)) for name in STATE_KEYS[:2])
    return not any(each is not None and is_own(each) for each in values)
