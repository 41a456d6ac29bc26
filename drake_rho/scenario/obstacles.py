"""Obstacles: shapes at rest or moving, known from the start or from a later time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Discriminator, Tag, model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    BoolArray,
    Finite,
    FloatArray,
    Margin,
    Name,
    Numbers,
    Points,
    Vector,
    locked,
    numbers_of,
    record,
    unchecked,
)
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere

if TYPE_CHECKING:
    from drake_rho.scenario.shapes.base import Shape

_KINDS = {
    "Obstacle": ("shape", "velocity", "track", "known_from", "name", "active"),
    "Polytope": ("vertices",),
    "Ellipsoid": ("semi_axes",),
    "Box": ("lower", "upper"),
    "Cylinder": ("height", "axis"),
    "Sphere": ("center", "radius"),
}
"""Keys that identify the record that a mapping describes. If keys of several records occur, the
first record in this order is taken."""

_BETWEEN = 8
"""Number of parts of each piece of a track at whose ends an estimated deviation is measured."""


def _kind(value: object) -> str:
    """Return the name of a record's type, or of the type that a mapping describes.

    Mistyped keys are matched to the closest known ones.
    """
    if not isinstance(value, Mapping):
        return type(value).__name__
    known = [key for keys in _KINDS.values() for key in keys]
    close = {match for key in value for match in get_close_matches(str(key), known, 1, 0.75)}
    return next((kind for kind, keys in _KINDS.items() if close.intersection(keys)), "Sphere")


AnyShape = Annotated[
    Annotated[Sphere, Tag("Sphere")]
    | Annotated[Box, Tag("Box")]
    | Annotated[Ellipsoid, Tag("Ellipsoid")]
    | Annotated[Cylinder, Tag("Cylinder")]
    | Annotated[Polytope, Tag("Polytope")],
    Discriminator(_kind),
]
"""One of the shapes, identified by its keys in a file."""


@record
class Track:
    """Piecewise linear motion, at rest before its first time and, by default, after its last.

    Examples:
        >>> circle = lambda t: np.array([np.cos(t), np.sin(t), 2.0])
        >>> track = rho.Track.sampled(circle, np.linspace(0.0, 6.0, 61), max_acceleration=1.0)
        >>> print(f"{track.deviation:.5f} m")
        0.00125 m
    """

    times: Numbers
    """times on the scenario's clock, increasing [s], shape (M,), M >= 1"""
    positions: Points
    """positions of the centre of the shape's bounding box [m], shape (M, 3)"""
    deviation: Margin = 0.0
    """largest distance of the true position from the polyline [m], added to required distances"""
    deviation_is_estimated: bool = False
    """true if the deviation is an estimate from samples rather than a bound"""
    after: Literal["rests", "goes_on"] | None = None
    """motion after the last time: at rest, or with the velocity of the last piece; if not given,
    at rest is assumed, which a report notes where the flight is longer"""

    if TYPE_CHECKING:

        def __init__(
            self,
            times: npt.ArrayLike,
            positions: npt.ArrayLike,
            deviation: float = 0.0,
            deviation_is_estimated: bool = False,
            after: Literal["rests", "goes_on"] | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if len(self.times) == 0 or not np.all(np.diff(self.times) > 0.0):
            expected = "at least one time, each after the one before"
            raise ScenarioError("times", self.times.tolist(), expected)
        if len(self.positions) != len(self.times):
            expected = f"one for each of the {len(self.times)} times, not {len(self.positions)}"
            raise ScenarioError("positions", self.positions.tolist(), expected)
        if self.after == "goes_on" and len(self.times) < 2:
            raise ScenarioError("after", self.after, "at least two times, which define its motion")
        return self

    @property
    def last_velocity(self) -> FloatArray:
        """Velocity of the last piece [m/s], shape (3,); zero if there is only one time."""
        if len(self.times) < 2:
            return np.zeros(3)
        moved, time = np.diff(self.positions[-2:], axis=0)[0], self.times[-1] - self.times[-2]
        return np.asarray(moved / time)

    @classmethod
    def sampled(
        cls,
        function: Callable[[float], npt.ArrayLike],
        times: npt.ArrayLike,
        max_acceleration: float | None = None,
    ) -> Self:
        """Return the track through samples of a function of time, straight between them.

        Args:
            function: returns the position [m], shape (3,), at a time on the scenario's clock [s].
            times: of the samples, increasing [s], shape (M,).
            max_acceleration: largest acceleration of the function [m/s²]. If given, the deviation
                is the bound max_acceleration Δt² / 8; otherwise it is estimated at seven instants
                between each two samples.

        Raises:
            ScenarioError: the times do not increase, or the function does not return positions.
        """
        track = cls._through(function, times)
        if max_acceleration is not None:
            if not 0.0 <= max_acceleration <= LARGEST:  # also true for NaN
                expected = f"a number of at least 0 and at most {LARGEST:g}"
                raise ScenarioError("track.max_acceleration", max_acceleration, expected)
            longest = float(np.max(np.diff(track.times), initial=0.0))
            return dataclasses.replace(track, deviation=max_acceleration * longest**2 / 8.0)
        parts = np.arange(1, _BETWEEN) / _BETWEEN
        between = (track.times[:-1, None] + parts * np.diff(track.times)[:, None]).reshape(-1)
        if len(between) == 0:
            return dataclasses.replace(track, deviation_is_estimated=True)
        true = cls._through(function, between).positions
        most = np.max(np.linalg.norm(true - track.at(between), axis=1), initial=0.0)
        return dataclasses.replace(track, deviation=float(most), deviation_is_estimated=True)

    @classmethod
    def _through(cls, function: Callable[[float], npt.ArrayLike], times: npt.ArrayLike) -> Self:
        """Return the track through a function's positions at some times."""
        try:
            at = numbers_of(times)
        except ScenarioError as error:
            raise error.inside("track.times") from None
        positions: Any = [function(float(time)) for time in at]
        return cls(at, positions)

    def at(self, times: FloatArray) -> FloatArray:
        """Return the positions at times on the scenario's clock [m], shape (M, 3)."""
        axes = [np.interp(times, self.times, axis) for axis in self.positions.T]
        positions = np.stack(axes, axis=-1)
        if self.after == "goes_on":
            positions += np.maximum(times - self.times[-1], 0.0)[..., None] * self.last_velocity
        return positions

    def velocities(self, times: FloatArray) -> FloatArray:
        """Return velocities at times [m/s], shape (M, 3); at a corner, that of the next piece."""
        piece = np.searchsorted(self.times, times, side="right")
        moving = np.diff(self.positions, axis=0) / np.diff(self.times)[:, None]
        rest = np.zeros((1, 3))
        last = self.last_velocity[None] if self.after == "goes_on" else rest
        velocities: FloatArray = np.concatenate([rest, moving, last])[piece]
        return velocities


@record
class Obstacle:
    """Obstacle to avoid, which may move and may become known only during the flight.

    Examples:
        >>> intruder = rho.Obstacle(rho.Sphere([0, 0, 2], 1.0), velocity=[1, 0, 0], known_from=2.0)
        >>> intruder.known_from
        2.0
    """

    shape: AnyShape
    """shape at time 0 of the scenario's clock; a track, if given, determines its position"""
    velocity: Vector | None = None
    """constant velocity at all times [m/s]; at rest if neither this nor a track is given"""
    track: Track | None = None
    """motion of the centre of its bounding box"""
    known_from: Finite = 0.0
    """time on the scenario's clock from which planners know the obstacle [s]: it is always there,
    but plans made earlier do not avoid it; 0 means that it is known from the start"""
    name: Name | None = None
    """name shown in figures and reports, beside its number"""
    active: tuple[Finite, Finite] | None = None
    """first and last time on the scenario's clock at which vehicles avoid it, both included [s], as
    for a temporary no-fly zone; always if not given"""

    if TYPE_CHECKING:

        def __init__(
            self,
            shape: Shape,
            velocity: npt.ArrayLike | None = None,
            track: Track | None = None,
            known_from: float = 0.0,
            name: str | None = None,
            active: tuple[float, float] | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _has_one_motion(self) -> Self:
        if self.velocity is not None and self.track is not None:
            expected = "no velocity beside a track, which already defines the motion"
            raise ScenarioError("velocity", self.velocity.tolist(), expected)
        if self.active is not None and not self.active[0] < self.active[1]:
            expected = "a first time and a later last one"
            raise ScenarioError("active", list(self.active), expected)
        try:
            self.shape.check_solid()
        except ScenarioError as error:
            raise error.inside("shape") from None
        return self

    @property
    def moves(self) -> bool:
        """True if the obstacle moves at any time."""
        if self.track is not None:
            return bool(np.any(np.diff(self.track.positions, axis=0)))
        return self.velocity is not None and bool(np.any(self.velocity))

    @property
    def is_steady(self) -> bool:
        """Whether it stands still and is avoided at all times."""
        return self.active is None and not self.moves

    def is_active(self, times: FloatArray, slack: float = 0.0) -> BoolArray:
        """Return whether it is avoided at times on the scenario's clock [s], of any shape.

        Args:
            times: on the scenario's clock [s].
            slack: time before and after the interval that counts as within it [s].
        """
        if self.active is None:
            return np.ones(times.shape, dtype=bool)
        first, last = self.active
        active: BoolArray = (times >= first - slack) & (times <= last + slack)
        return active

    @property
    def deviation(self) -> float:
        """Largest distance of the true centre from `centers` [m]."""
        return 0.0 if self.track is None else self.track.deviation

    @property
    def corners(self) -> FloatArray:
        """Times at which the velocity changes or the active interval begins or ends [s], (M,).

        They are on the scenario's clock, in increasing order.
        """
        corners = np.zeros(0)
        if self.track is not None:
            corners = self.track.times[: -1 if self.track.after == "goes_on" else None]
        return corners if self.active is None else np.union1d(corners, self.active)

    @property
    def first_center(self) -> FloatArray:
        """Centre of the bounding box at time 0 of the obstacle's clock [m], shape (3,)."""
        center: FloatArray = self.centers(np.zeros(1))[0]
        return center

    def since(self, time: float) -> Self:
        """Return the obstacle on a clock that is 0 at `time` [s] of the present one.

        Times in a flight are sums that begin at its first knot. On a clock that is 0 there, these
        sums and a track's corner times are equal numbers; on a clock far from 0 they would differ
        by its rounding.
        """
        track = self.track
        if track is not None:
            track = unchecked(track, times=locked(track.times - time))
        elif self.velocity is not None:
            centers = self.centers(time + np.array([0.0, 1.0]))
            track = Track([0.0, 1.0], centers, after="goes_on")
        active = self.active and (self.active[0] - time, self.active[1] - time)
        known_from = self.known_from - time
        return unchecked(self, velocity=None, track=track, known_from=known_from, active=active)

    def centers(self, times: FloatArray) -> FloatArray:
        """Return the centres of the bounding box at times on the scenario's clock [m], (M, 3)."""
        if self.track is not None:
            return self.track.at(times)
        if self.velocity is not None:
            centers: FloatArray = self.shape.center + times[..., None] * self.velocity
            return centers
        still: FloatArray = np.empty((*times.shape, 3))
        still[...] = self.shape.center
        return still

    def distances(self, positions: FloatArray, times: FloatArray) -> FloatArray:
        """Return signed distances from the surface [m], shape (..., M).

        They are negative inside, and infinite at times at which the obstacle is not active.

        Args:
            positions: [m], shape (..., M, 3).
            times: on the scenario's clock [s], shape (M,), or one for all positions.
        """
        distances = self.shape.signed_distance(positions - self.centers(times))
        if self.active is None:
            return distances
        return np.where(self.is_active(times), distances, np.inf)

    def velocities(self, times: FloatArray) -> FloatArray:
        """Return the velocities at times on the scenario's clock [m/s], shape (M, 3)."""
        if self.track is not None:
            return self.track.velocities(times)
        velocity = np.zeros(3) if self.velocity is None else self.velocity
        return np.broadcast_to(velocity, (*times.shape, 3))


def _has_shape(value: object) -> object:
    if isinstance(value, Mapping) and _kind(value) == "Obstacle" and "shape" not in value:
        keys = ", ".join(str(key) for key in value if _kind({key: None}) == "Obstacle")
        raise ScenarioError(
            "", dict(value), f"the shape in a mapping of its own, shape, beside {keys}"
        )
    return value


AnyObstacle = Annotated[
    Annotated[Sphere, Tag("Sphere")]
    | Annotated[Box, Tag("Box")]
    | Annotated[Ellipsoid, Tag("Ellipsoid")]
    | Annotated[Cylinder, Tag("Cylinder")]
    | Annotated[Polytope, Tag("Polytope")]
    | Annotated[Obstacle, Tag("Obstacle")],
    Discriminator(_kind),
    BeforeValidator(_has_shape),
]
"""Shape at rest that is known from the start, or `Obstacle`."""
