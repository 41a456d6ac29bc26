"""`Track`: piecewise linear motion of an obstacle."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    Boolean,
    FloatArray,
    Margin,
    Numbers,
    Points,
    numbers_of,
    record,
)
from drake_rho.scenario.times import EXACT, Clock

_BETWEEN = 8
"""Number of parts of each piece of a track at whose ends an estimated deviation is measured."""


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
    deviation_is_estimated: Boolean = False
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

    @cached_property
    def moves(self) -> bool:
        """Whether not all positions are the same."""
        return bool((self.positions != self.positions[0]).any())

    @property
    def last_velocity(self) -> FloatArray:
        """Velocity of the last piece [m/s], shape (3,); zero if there is only one time."""
        return np.asarray(self._slopes[-1])

    @cached_property
    def _slopes(self) -> FloatArray:
        """Velocities of the pieces [m/s], shape (M - 1, 3); zero if there is only one time."""
        if len(self.times) < 2:
            return np.zeros((1, 3))
        return np.asarray(np.diff(self.positions, axis=0) / np.diff(self.times)[:, None])

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
        first, last = self.times[0], self.times[-1]
        during = np.minimum(np.maximum(times, first), last)
        k = np.minimum(self.times.searchsorted(during, "right"), len(self._slopes)) - 1
        since = during - self.times[k]
        positions: FloatArray = self._slopes[k] * since[..., None] + self.positions[k]
        positions[during == last] = self.positions[-1]  # without rounding
        if self.after == "goes_on":
            positions += np.maximum(times - self.times[-1], 0.0)[..., None] * self.last_velocity
        return positions

    def velocities(
        self, times: FloatArray, *, before: bool = False, clock: Clock = EXACT
    ) -> FloatArray:
        """Return velocities at times [m/s], shape (M, 3); at a corner, that of the next piece.

        Args:
            times: on the scenario's clock [s], shape (M,).
            before: whether to return that of the piece before instead.
            clock: by which times are compared with those of corners.
        """
        piece_at = clock.last_before if before else clock.last_begun
        piece = piece_at(self.times, times) + 1
        moving, rest = self._slopes[: len(self.times) - 1], np.zeros((1, 3))
        last = self.last_velocity[None] if self.after == "goes_on" else rest
        velocities: FloatArray = np.concatenate([rest, moving, last])[piece]
        return velocities
