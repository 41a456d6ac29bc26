"""`Objective`: the terms of the cost that plans minimise, and the reference that they follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import Field, PlainSerializer, PlainValidator, TypeAdapter, model_validator

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    NOT_BOOLEAN,
    FloatArray,
    Points,
    read_only,
    record,
    unchecked,
)
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.parts import Grid, Vehicle
from drake_rho.scenario.tracks import Track

Weight = Annotated[
    float,
    Field(ge=0.0, le=LARGEST, allow_inf_nan=False, exclude_if=lambda weight: weight == 0.0),
    NOT_BOOLEAN,
]
"""Weight of a term of the cost, which files omit if it is 0."""


@runtime_checkable
class _Planned(Protocol):
    """Motion of all vehicles at the knots of a grid, as a plan."""

    @property
    def positions(self) -> FloatArray:
        """Positions at the knots [m], shape (N, K, 3)."""
        ...

    @property
    def times(self) -> FloatArray:
        """Times of the knots [s], shape (K,)."""
        ...


def _reference(value: object) -> Any:
    """Return tracks, or positions at the knots (N, K, 3), which a scenario makes tracks of."""
    if value is None:
        return None
    if isinstance(value, Track | Mapping):
        return (_track(value),)
    if isinstance(value, _Planned):
        return tuple(Track(value.times, positions) for positions in np.asarray(value.positions))
    if isinstance(value, list | tuple) and any(isinstance(each, Track | Mapping) for each in value):
        return tuple(_track(each, f"[{number}]") for number, each in enumerate(value))
    try:
        array = read_only(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        array = read_only(np.nan)
    if array.ndim != 3 or array.shape[2] != 3 or not np.all(np.abs(array) <= LARGEST):
        got = value if array.ndim == 0 else Description(f"an array of shape {array.shape}")
        expected = "a track, one track a vehicle, a plan, or finite positions of shape (N, K, 3)"
        raise ScenarioError("", got, expected)
    return array


def _track(value: object, where: str = "") -> Track:
    if isinstance(value, Track):
        return value
    if not isinstance(value, Mapping):
        raise ScenarioError(where, value, "a track")
    try:
        return Track(**{str(key): each for key, each in value.items()})
    except ScenarioError as error:
        inner = error.field.removeprefix("track").removeprefix(".")
        raise ScenarioError(f"{where}.{inner}".strip("."), error.value, error.expected) from None


_TRACKS = TypeAdapter(tuple[Track, ...])


def _written(value: Any) -> Any:
    """Return a reference in plain numbers, for files."""
    if value is None or isinstance(value, np.ndarray):
        return None if value is None else value.tolist()
    return _TRACKS.dump_python(value, mode="json", exclude_none=True)


Reference = Annotated[
    Any,
    PlainValidator(_reference, json_schema_input_type=Track | list[Track] | list[Points] | None),
    PlainSerializer(_written),
]
"""Tracks: one of all vehicles, or one of each; or positions at the knots (N, K, 3)."""


class Weights(NamedTuple):
    """Weights of the terms of a cost, in the order of `Objective`'s fields."""

    effort: float
    jerk: float
    snap: float
    position: float
    velocity: float
    terminal_position: float
    terminal_velocity: float


@record
class Objective:
    """Cost of a vehicle, a weighted sum of squares; by default its effort, the paper's (13).

    The cost of all vehicles is the sum of theirs by `Vehicle.weight`. A weight is 0 or above, and
    some term has to make the plan unique: effort, position or velocity always does.

    Examples:
        >>> start, goal = rho.State([0, 0, 1]), rho.State([4, 0, 1])
        >>> smooth = rho.Scenario(
        ...     "least jerk",
        ...     rho.Grid.lasting(4.0, step=0.1),
        ...     [rho.Vehicle("scout", start, goal)],
        ...     objective=rho.Objective(effort=0, jerk=1),
        ... )
        >>> print(f"{rho.plan(smooth).accelerations.max():.2f} m/s²")
        1.44 m/s²
    """

    effort: Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False), NOT_BOOLEAN] = 1.0
    """weight of squared accelerations norm(a)², summed over steps"""
    jerk: Weight = 0.0
    """weight of squared jerks norm(j)² with j as in (7), summed over knots [s²]; at a start or goal
    at rest the jerk from or to rest counts twice, as it lasts half a step: to the middle of it"""
    snap: Weight = 0.0
    """weight of squared changes of the jerk, norm((j[k+1] - j[k]) / h)², summed over steps [s⁴]"""
    position: Weight = 0.0
    """weight of squared distances from the reference, summed over the knots after the first
    [1/s⁴]"""
    velocity: Weight = 0.0
    """weight of squared differences from the reference's velocity, summed over the knots after the
    first [1/s²]"""
    reference: Reference = None
    """path to follow on the scenario's clock: a `Track` for all vehicles, one for each, a `Plan`,
    or positions at the knots [m], shape (N, K, 3); its velocities are central differences over
    steps. Needed if `position` or `velocity` has a weight"""
    terminal_position: Weight = 0.0
    """weight of the squared distance from the goal at the last knot [1/s⁴]; if it is above 0 the
    goal's position may be missed at this price"""
    terminal_velocity: Weight = 0.0
    """weight of the squared difference from the goal's velocity at the last knot [1/s²]; if it is
    above 0 the goal's velocity may be missed at this price"""

    if TYPE_CHECKING:

        def __init__(
            self,
            effort: float = 1.0,
            jerk: float = 0.0,
            snap: float = 0.0,
            position: float = 0.0,
            velocity: float = 0.0,
            reference: Track | Sequence[Track] | _Planned | npt.ArrayLike | None = None,
            terminal_position: float = 0.0,
            terminal_velocity: float = 0.0,
        ) -> None: ...

    @model_validator(mode="after")
    def _has_terms(self) -> Any:
        if not any(self.weights):
            raise ScenarioError("effort", self.effort, "a weight above 0 of it or another term")
        for term in ("position", "velocity"):
            if getattr(self, term) > 0.0 and self.reference is None:
                raise ScenarioError("reference", None, f"a path to follow, beside {term}")
        return self

    @cached_property
    def weights(self) -> Weights:
        """Weights of all terms."""
        return Weights(*(float(getattr(self, name)) for name in Weights._fields))

    @cached_property
    def is_effort(self) -> bool:
        """Whether the cost is the sum of squared accelerations (13), with the weight 1."""
        return self.weights == Weights(1.0, *(0.0,) * 6)

    @property
    def misses_goals(self) -> tuple[bool, bool]:
        """Whether goals' positions, and velocities, may be missed at a price."""
        return self.terminal_position > 0.0, self.terminal_velocity > 0.0

    def on_clock(self, grid: Grid) -> Objective:
        """Return the objective with positions at a grid's knots as tracks on the clock.

        Raises:
            ScenarioError: there is not one position for each knot.
        """
        if not isinstance(self.reference, np.ndarray):
            return self
        count, knots, _ = self.reference.shape
        if knots != grid.knots:
            expected = f"positions at the {grid.knots} knots, not {knots}"
            got = Description(f"an array of shape {self.reference.shape}")
            raise ScenarioError("objective.reference", got, expected)
        tracks = tuple(Track(grid.times, self.reference[i]) for i in range(count))
        return unchecked(self, reference=tracks)

    def of_vehicles(self, indices: Sequence[int], count: int) -> Objective:
        """Return the objective of some of `count` vehicles."""
        if self.reference is None or len(self.reference) == 1 or len(indices) == count:
            return self
        return unchecked(self, reference=tuple(self.reference[index] for index in indices))

    def reach(self, grid: Grid, starts: FloatArray) -> FloatArray:
        """Return how far a path that is followed leads from starts [m], shape (N,); 0 for none.

        Args:
            grid: knots of the flight.
            starts: start positions [m], shape (N, 3).
        """
        followed = self.reference is not None and (self.position > 0.0 or self.velocity > 0.0)
        if not followed or len(self.reference) not in (1, len(starts)):
            return np.zeros(len(starts))  # another number of paths is refused (`check_objective`)
        positions, _ = self.reference_at(grid)
        away: FloatArray = np.linalg.norm(positions - starts[:, None], axis=2).max(axis=1)
        return away

    def reference_at(self, grid: Grid) -> tuple[FloatArray, FloatArray]:
        """Return the reference's positions [m] and velocities [m/s] at the knots.

        Velocities are central differences, over one step at the first knot and the last.

        Returns:
            Arrays of shape (N, K, 3), or (1, K, 3) if all vehicles have the same reference.
        """
        positions = np.array([track.at(grid.times) for track in self.reference])
        return positions, np.gradient(positions, grid.step, axis=1)


TERMINAL = ("terminal_position", "terminal_velocity")
"""Terms that let goals be missed."""


def check_without(objective: Objective, terms: Sequence[str], expected: str) -> None:
    """Check that terms have no weight.

    Raises:
        ScenarioError: one of them has.
    """
    for term in terms:
        if (weight := getattr(objective, term)) > 0.0:
            raise ScenarioError(f"objective.{term}", weight, expected)


def check_only_effort(objective: Objective, why: str) -> None:
    """Check that the cost is the sum of squared accelerations (13).

    Raises:
        ScenarioError: it has other terms, or another weight.
    """
    check_without(objective, Weights._fields[1:], f"0 {why}")
    if objective.effort != 1.0:
        raise ScenarioError("objective.effort", objective.effort, f"1 {why}")


def check_objective(
    objective: Objective, vehicles: Sequence[Vehicle], fleet: Fleet, grid: Grid
) -> None:
    """Check that an objective fits the vehicles and the grid, and determines the motions.

    Raises:
        ScenarioError: the reference is for another number of vehicles or ends early, or several
            motions have the same cost.
    """
    if (reference := objective.reference) is not None:
        if len(reference) not in (1, len(vehicles)):
            got = Description(f"{len(reference)} paths")
            expected = f"one path for all vehicles, or {len(vehicles)}"
            raise ScenarioError("objective.reference", got, expected)
        for number, track in enumerate(reference):
            ends_early = track.after is None and grid.clock.before(track.times[-1], grid.end)
            if ends_early or grid.clock.after(track.times[0], grid.start):
                got = Description(f"from {track.times[0]:g} to {track.times[-1]:g} s")
                expected = f"a path from {grid.start:g} to {grid.end:g} s, or `after`"
                raise ScenarioError(f"objective.reference[{number}].times", got, expected)
    for term, missed in zip(("position", "velocity"), objective.misses_goals, strict=True):
        given = fleet.given_positions if term == "position" else fleet.given_velocities
        if missed and not given.all():
            which = int(np.argmin(given))
            expected = f"0: the goal of {vehicles[which].name} has no single {term} to miss"
            value = getattr(objective, f"terminal_{term}")
            raise ScenarioError(f"objective.terminal_{term}", value, expected)
    if any(_undetermined(objective, fleet)):
        which = int(np.argmax(_undetermined(objective, fleet)))
        expected = (
            f"a weight above 0: otherwise several motions of {vehicles[which].name} have the "
            "least cost"
        )
        raise ScenarioError("objective.effort", objective.effort, expected)


def _undetermined(objective: Objective, fleet: Fleet) -> FloatArray:
    """Return flags of vehicles of which several motions have the same cost, shape (N,).

    Jerks leave a constant acceleration free unless one is known at an end; snaps leave free an
    acceleration linear in time, less one number for each end where it is known. Each of a goal's
    position and velocity, exact or at a price, determines one number.
    """
    weights = objective.weights
    if weights.effort > 0.0 or weights.position > 0.0 or weights.velocity > 0.0:
        return np.zeros(len(fleet.radii), dtype=bool)
    ends = (fleet.accelerations_before, fleet.accelerations_after)
    known = sum(np.all(np.isfinite(each), axis=1).astype(int) for each in ends)
    if weights.jerk > 0.0:
        free = np.maximum(1 - known, 0)
    elif weights.snap > 0.0:
        free = np.maximum(2 - known, 0)
    else:
        free = np.full(len(fleet.radii), np.iinfo(int).max)
    numbers = fleet.fixed_positions.astype(int) + fleet.fixed_velocities
    numbers = numbers + sum(each > 0.0 for each in weights[5:])
    return np.asarray(free > numbers)
