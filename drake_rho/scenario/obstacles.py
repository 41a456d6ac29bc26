"""Obstacles: shapes at rest or moving, known from the start or from a later time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Discriminator, Tag, model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    BoolArray,
    Finite,
    FloatArray,
    Margin,
    Name,
    Positive,
    Vector,
    read_only,
    record,
    record_kind,
    unchecked,
)
from drake_rho.scenario.maps.forms import KEYS, References
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.parts import Grid, State
from drake_rho.scenario.shapes.posed import KINDS, POSE, AnyConvex
from drake_rho.scenario.times import EXACT, Clock
from drake_rho.scenario.tracks import Track

if TYPE_CHECKING:
    from drake_rho.scenario.shapes.base import Solid

_KINDS = {
    "Obstacle": (
        "velocity",
        "track",
        "known_from",
        "name",
        "active",
        "position_error",
        "velocity_error",
        "seen_at",
    ),
    **KEYS,  # before poses, as references to maps have a rotation too
    "Mesh": ("triangles",),
    "Voxels": ("occupied",),
    "Posed": POSE,
    "At rest": ("shape",),
    **KINDS,
}
"""Keys that identify the record that a mapping describes. If keys of several records occur, the
first record in this order is taken. A shape at rest is an obstacle as well."""


def _kind(value: object) -> str:
    """Return the name of a record's type, or of the type that a mapping describes."""
    kind = record_kind(value, _KINDS, "Sphere")
    return "Obstacle" if kind == "At rest" else kind


_Shapes = AnyConvex | Annotated[Voxels, Tag("Voxels")] | Annotated[Mesh, Tag("Mesh")]

AnyShape = Annotated[_Shapes | References, Discriminator(_kind)]
"""One of the shapes or maps, identified by its keys in a file."""


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
    position_error: Margin = 0.0
    """largest error of the given position, at the time it was seen [m]: vehicles keep clear of
    everywhere it may be"""
    velocity_error: Margin = 0.0
    """speed at which the position error may grow from then on [m/s]"""
    seen_at: Finite | None = None
    """time on the scenario's clock to which the errors refer [s]; `known_from` if not given"""
    penalty: Positive | None = None
    """cost of each metre of the largest depth inside, times the vehicle's weight [m/s⁴]; vehicles
    must stay outside if not given"""

    if TYPE_CHECKING:

        def __init__(
            self,
            shape: Solid,
            velocity: npt.ArrayLike | None = None,
            track: Track | None = None,
            known_from: float = 0.0,
            name: str | None = None,
            active: tuple[float, float] | None = None,
            position_error: float = 0.0,
            velocity_error: float = 0.0,
            seen_at: float | None = None,
            penalty: float | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _has_one_motion(self) -> Self:
        if self.velocity is not None and self.track is not None:
            expected = "no velocity beside a track, which already defines the motion"
            raise ScenarioError("velocity", self.velocity.tolist(), expected)
        if self.active is not None and not self.active[0] < self.active[1]:
            expected = "a first time and a later last one"
            raise ScenarioError("active", list(self.active), expected)
        if self.velocity_error > 0.0 and self.seen_at is None and self.known_from == 0.0:
            expected = "seen_at beside it, or known_from: the time from which on the error grows"
            raise ScenarioError("velocity_error", self.velocity_error, expected)
        try:
            self.shape.check_solid()
        except ScenarioError as error:
            raise error.inside("shape") from None
        return self

    def called(self, number: int) -> str:
        """Return how reports refer to the obstacle: by its number from 1, and its name if any."""
        return f"obstacle {number}" + (f" ({self.name})" if self.name else "")

    def prices(self, weights: FloatArray) -> FloatArray | None:
        """Return the price of a metre inside for vehicles of these weights [m/s⁴], shape (N,).

        Returns:
            Prices; None without a penalty.
        """
        return None if self.penalty is None else np.asarray(self.penalty * weights)

    @property
    def moves(self) -> bool:
        """True if the obstacle moves at any time."""
        if self.track is not None:
            return self.track.moves
        return self.velocity is not None and bool(np.any(self.velocity))

    @property
    def changes(self) -> bool:
        """True if it moves, or if the space that it may occupy grows."""
        return self.moves or self.velocity_error > 0.0

    @property
    def is_steady(self) -> bool:
        """Whether vehicles avoid the same space at all times."""
        return self.active is None and not self.changes

    @property
    def is_uncertain(self) -> bool:
        """Whether it may be elsewhere than at `centers`."""
        return self.position_error > 0.0 or self.velocity_error > 0.0

    def uncertainty(self, times: FloatArray) -> FloatArray:
        """Return its largest distance from `centers` at times on the scenario's clock [m].

        It is `position_error` until it was seen and grows by `velocity_error` from then on.
        """
        if self.velocity_error == 0.0:
            return self.position_error + np.zeros(times.shape)
        since = np.maximum(times - self.errors_from, 0.0)
        uncertainty: FloatArray = self.position_error + self.velocity_error * since
        return uncertainty

    @property
    def errors_from(self) -> float:
        """Time to which the errors refer, on the scenario's clock [s]."""
        return self.known_from if self.seen_at is None else self.seen_at

    def is_active(self, times: FloatArray, clock: Clock = EXACT) -> BoolArray:
        """Return whether it is avoided at times on the scenario's clock [s], of any shape.

        Args:
            times: on the scenario's clock [s].
            clock: by which they are compared.
        """
        if self.active is None:
            return np.ones(times.shape, dtype=bool)
        return clock.within(times, self.active)

    def is_always_active(self, grid: Grid) -> bool:
        """Return whether it is avoided all through a flight; its clock is 0 at the first knot."""
        if self.active is None:
            return True
        return bool(self.is_active(grid.elapsed[[0, -1]], grid.clock).all())

    @property
    def deviation(self) -> float:
        """Largest distance of the true centre from `centers` [m]."""
        return 0.0 if self.track is None else self.track.deviation

    @property
    def corners(self) -> FloatArray:
        """Times at which velocity or growth changes, or the active interval begins or ends [s].

        They are on the scenario's clock, in increasing order, shape (M,).
        """
        corners = np.zeros(0)
        if self.track is not None:
            corners = self.track.times[: -1 if self.track.after == "goes_on" else None]
        if self.velocity_error > 0.0:
            corners = np.union1d(corners, [self.errors_from])
        return corners if self.active is None else np.union1d(corners, self.active)

    @property
    def first_center(self) -> FloatArray:
        """Centre of the bounding box at time 0 of the obstacle's clock [m], shape (3,)."""
        center: FloatArray = self.centers(np.zeros(1))[0]
        return center

    def is_late(self, grid: Grid) -> bool:
        """Return whether it becomes known only after the first knot of a grid on its clock."""
        return bool(grid.clock.after(self.known_from, max(grid.start, 0.0)))

    def known_by(self, time: float) -> Self:
        """Return the obstacle, known from a time on the scenario's clock [s] at the latest."""
        seen_at = self.errors_from if self.velocity_error > 0.0 else self.seen_at
        return unchecked(self, known_from=min(self.known_from, time), seen_at=seen_at)

    def seen(self, position: npt.ArrayLike, velocity: npt.ArrayLike, time: float) -> Self:
        """Return the obstacle as seen again: it goes on from there, and its errors start anew.

        Args:
            position: of the centre of its bounding box at that time [m], shape (3,).
            velocity: from then on [m/s], shape (3,).
            time: at which it was seen, on the scenario's clock [s].

        Raises:
            ScenarioError: the position or the velocity is not a vector of numbers.
        """
        at = State(position, velocity)
        track = Track([time, time + 1.0], [at.position, at.position + at.velocity], after="goes_on")
        return unchecked(self, velocity=None, track=track, seen_at=time)

    def since(self, grid: Grid) -> Self:
        """Return the obstacle on a clock that is 0 at a grid's first knot.

        Times in a flight are sums that begin at its first knot. On a clock that is 0 there, these
        sums and a track's corner times are equal numbers (`Grid.since_start`); on a clock far from
        0 they would differ by its rounding.
        """
        time = grid.start
        track = self.track
        if track is not None:
            track = unchecked(track, times=read_only(track.times - time))
        elif self.velocity is not None:
            centers = self.centers(time + np.array([0.0, 1.0]))
            track = Track([0.0, 1.0], centers, after="goes_on")
        active = None if self.active is None else grid.interval_since_start(self.active)
        return unchecked(
            self,
            velocity=None,
            track=track,
            known_from=self.known_from - time,
            active=active,
            seen_at=None if self.seen_at is None else self.seen_at - time,
        )

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

    def gaps(self, lower: FloatArray, upper: FloatArray, begin: float) -> FloatArray:
        """Return lower bounds of the distances of boxes from its centre, from a time on [m], (N,).

        They are distances from the box around the rest of its track, and 0 if it moves on for ever.

        Args:
            lower: lower corners of the boxes [m], shape (N, 3).
            upper: upper corners, shape (N, 3).
            begin: the time, on the scenario's clock [s].
        """
        if self.track is None and self.velocity is None:
            low = high = self.shape.center
        elif self.track is None or self.track.after == "goes_on":
            return np.zeros(len(lower))
        else:
            first = max(int(np.searchsorted(self.track.times, begin, side="right")) - 1, 0)
            ahead = self.track.positions[first:]
            low, high = ahead.min(axis=0), ahead.max(axis=0)
        gaps = np.maximum(np.maximum(low - upper, lower - high), 0.0)
        return np.asarray(np.sqrt(np.vecdot(gaps, gaps)))

    def stays_beyond(self, places: FloatArray, distances: FloatArray, begin: float) -> bool:
        """Return whether it surely stays further away than distances, from a time on.

        The ball with the corners of its bounding box, enlarged by its errors, decides. Errors that
        grow and numbers that are no numbers are never sure.

        Args:
            places: places [m], shape (N, 3).
            distances: distance of each place [m], shape (N,).
            begin: the time, on the scenario's clock [s].
        """
        size = float(np.linalg.norm(self.shape.extent)) + self.deviation + self.position_error
        away = self.gaps(places, places, begin)
        return self.velocity_error == 0.0 and bool((away >= size + distances).all())

    def distances(
        self, positions: FloatArray, times: FloatArray, most: float = np.inf
    ) -> FloatArray:
        """Return signed distances from the space that it may occupy [m], shape (..., M).

        They are negative inside, and infinite at times at which the obstacle is not active.
        Distances above `most` may be any above it, which is faster near maps.

        Args:
            positions: [m], shape (..., M, 3).
            times: on the scenario's clock [s], shape (M,), or one for all positions.
            most: largest distance of interest [m].
        """
        x = positions - self.centers(times)
        if self.is_uncertain:
            errors = self.uncertainty(times)
            farthest = most + 2.0 * float(errors.max(initial=0.0))  # rounding cannot matter
            distances = self.shape.distance_up_to(x, farthest) - errors
        else:
            distances = self.shape.distance_up_to(x, most)
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
    if not isinstance(value, Mapping) or "shape" in value:
        return value
    if (kind := _kind(value)) in ("Obstacle", "Posed"):
        keys = ", ".join(str(key) for key in value if _kind({key: None}) == kind)
        raise ScenarioError(
            "", dict(value), f"the shape in a mapping of its own, shape, beside {keys}"
        )
    return value


AnyObstacle = Annotated[
    _Shapes | References | Annotated[Obstacle, Tag("Obstacle")],
    Discriminator(_kind),
    BeforeValidator(_has_shape),
]
"""Shape at rest that is known from the start, or `Obstacle`."""
