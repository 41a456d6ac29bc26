"""States measured in a flight: `Measurements`, and the log that collects them."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from drake_rho.motion.samples import COLUMNS
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import LARGEST, BoolArray, FloatArray, read_only
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import EXACT, Clock

_MEASURED = 7
"""Number of columns of a table of states without those of accelerations, and the vehicle's."""


@dataclasses.dataclass(frozen=True, eq=False)
class Measurements(metaclass=Described):
    """Measured states of all vehicles at times of any rate, NaN where a vehicle was not seen.

    Raises:
        ValueError: the times do not increase, an array has another shape, or a vehicle at a time
            has neither finite numbers nor NaN only; velocities without positions are refused.

    Examples:
        >>> positions = [[[0.0, 0.0, 1.0]], [[0.2, 0.0, 1.0]]]
        >>> unknown = np.full((2, 1, 3), np.nan)
        >>> rho.Measurements(["q1"], [0.0, 0.1], positions, unknown)
        <Measurements of q1 at 2 times, from 0 to 0.1 s>
    """

    names: tuple[str, ...]
    """names of the vehicles: all those of the flight, in the order of its scenario"""
    times: FloatArray
    """times on the scenario's clock, increasing [s], shape (M,)"""
    positions: FloatArray
    """measured positions [m], shape (M, N, 3); NaN where a vehicle was not seen"""
    velocities: FloatArray
    """measured velocities [m/s], shape (M, N, 3); NaN where they were not measured"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        for name in ("times", "positions", "velocities"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if self.times.ndim != 1:
            raise ValueError(f"times: got shape {self.times.shape}, expected (M,)")
        check_increasing(self.times, EXACT)
        shape = (len(self.times), len(self.names), 3)
        for name in ("positions", "velocities"):
            if (values := getattr(self, name)).shape != shape:
                raise ValueError(f"{name}: got shape {values.shape}, expected {shape}")
        expected = f"three numbers of at most {LARGEST:g}, or NaN only"
        self._check_all("positions", np.ones(shape[:2], dtype=bool), expected)
        self._check_all("velocities", self.seen, f"{expected}, as for a vehicle that was not seen")

    def _check_all(self, name: str, possible: BoolArray, expected: str) -> None:
        """Check that each vehicle has numbers, where these are possible, or NaN only."""
        values = getattr(self, name)
        right = (np.abs(values) <= LARGEST).all(axis=2) & possible | np.isnan(values).all(axis=2)
        if not right.all():
            m, i = np.argwhere(~right)[0]
            got = f"{values[m, i].tolist()} for {self.names[i]}"
            at = clock_time(float(self.times[m]))
            raise ValueError(f"{name}: got {got} at {at}, expected {expected}")

    def __repr__(self) -> str:
        """Return a text such as '<Measurements of 2 vehicles at 501 times, from 0 to 5 s>'."""
        vehicles = self.names[0] if len(self.names) == 1 else f"{len(self.names)} vehicles"
        count, times = len(self.times), ""
        if count > 0:
            first, last = (float(each) for each in self.times[[0, -1]])
            times = f", from {clock_number(first)} to {clock_time(last)}"
        return f"<Measurements of {vehicles} at {count} time{'s' if count != 1 else ''}{times}>"

    @property
    def seen(self) -> BoolArray:
        """Whether each vehicle was seen at each time, shape (M, N)."""
        return np.asarray(~np.isnan(self.positions[..., 0]))

    def of(self, vehicle: str) -> Measurements:
        """Return the measurements of one vehicle, without the times at which it was not seen.

        Args:
            vehicle: its name.

        Raises:
            ValueError: there is no such vehicle.
        """
        if vehicle not in self.names:
            raise ValueError(f"vehicle: got {vehicle!r}, expected one of {', '.join(self.names)}")
        i = self.names.index(vehicle)
        here = self.seen[:, i]
        p, v = (each[here, i : i + 1] for each in (self.positions, self.velocities))
        return Measurements((vehicle,), self.times[here], p, v)

    def columns(self) -> dict[str, list[str] | list[float]]:
        """Return a table with one row per vehicle and time at which it was seen, by column.

        The columns are those of `Samples.columns`, without accelerations; as there,
        `pandas.DataFrame(measured.columns())` is the same table.
        """
        every = [self.of(name) for name in self.names]
        states = [
            np.column_stack([each.times, each.positions[:, 0], each.velocities[:, 0]])
            for each in every
        ]
        named = [each.names[0] for each in every for _ in each.times]
        numbers = np.concatenate([np.empty((0, _MEASURED)), *states]).T.tolist()
        return dict(zip(COLUMNS, [named, *numbers], strict=False))

    def check_flight_of(self, scenario: Scenario) -> None:
        """Check that these may be measurements of a flight of a scenario.

        Raises:
            ValueError: the vehicles are others, or a time is before the flight.
        """
        if self.names != scenario.names:
            got, expected = (", ".join(each) for each in (self.names, scenario.names))
            raise ValueError(f"measured: got the vehicles {got}, expected {expected}")
        first = scenario.grid.start - scenario.lead
        early = scenario.grid.clock.before(self.times, first)
        if early.any():
            got = clock_time(float(self.times[np.argmax(early)]))
            expected = f"times of the flight, from {clock_time(first)} on"
            raise ValueError(f"times: got {got}, expected {expected}")


class MeasurementLog:
    """Log of the measurements of a flight, which grows at its end."""

    def __init__(self) -> None:
        self._parts: list[Measurements] = []

    def add(self, scenario: Scenario, time: npt.ArrayLike, states: npt.ArrayLike) -> None:
        """Add states measured at one or more times.

        Args:
            scenario: of the flight.
            time: on the scenario's clock [s], a single one or shape (M,).
            states: positions [m] and velocities [m/s], shape (N, 6) or (M, N, 6).

        Raises:
            ValueError: they are not later measurements of the flight.
        """
        times, array = np.array(time, dtype=np.float64), np.array(states, dtype=np.float64)
        shape = (*times.shape, len(scenario.vehicles), 6)
        if times.ndim > 1:
            raise ValueError(f"time: got shape {times.shape}, expected (M,) or a single time")
        if array.shape != shape:
            raise ValueError(f"states: got shape {array.shape}, expected {shape}")
        times, array = np.atleast_1d(times), array.reshape(-1, *shape[-2:])
        last = [part.times[-1:] for part in self._parts[-1:]]
        check_increasing(np.concatenate([*last, times]), scenario.grid.clock, "time")
        part = Measurements(scenario.names, times, array[..., :3], array[..., 3:])
        part.check_flight_of(scenario)
        if len(times) > 0:
            self._parts.append(part)

    @property
    def measurements(self) -> Measurements | None:
        """All measurements so far; None if there are none."""
        if not self._parts:
            return None
        names = ("times", "positions", "velocities")
        arrays = [np.concatenate([getattr(part, name) for part in self._parts]) for name in names]
        return Measurements(self._parts[0].names, *arrays)


def check_increasing(times: FloatArray, clock: Clock, name: str = "times") -> None:
    """Check that each time is finite and after the one before.

    Args:
        times: on the scenario's clock [s], shape (M,).
        clock: by which they are compared.
        name: of the argument, for the error.

    Raises:
        ValueError: a time is not.
    """
    wrong = ~(np.abs(times) <= LARGEST)  # true for NaN as well
    wrong[1:] |= ~clock.after(times[1:], times[:-1])
    if wrong.any():
        m = int(np.argmax(wrong))
        before = f"a time after {clock_time(float(times[m - 1]), 12)}" if m > 0 else "a finite time"
        raise ValueError(f"{name}: got {clock_time(float(times[m]), 12)}, expected {before}")
