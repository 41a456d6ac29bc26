"""PX4 format: setpoints for the offboard mode, MAVLink's SET_POSITION_TARGET_LOCAL_NED, as a table.

A scenario's axes are taken as east, north and up; MAVLink's are north, east and down.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drake_rho.formats.format import RATE, Format, check_ahead, exported
from drake_rho.formats.milliseconds import milliseconds
from drake_rho.formats.record import Exported
from drake_rho.motion.flown import Flown, sample
from drake_rho.motion.headings import Heading, directions_of, headings
from drake_rho.motion.samples import Samples
from drake_rho.motion.tables import write_rows
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.files import atomic_write

COLUMNS = (
    *("vehicle", "time_boot_ms", "target_system", "target_component", "coordinate_frame"),
    *("type_mask", "x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"),
)
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Matrix from east-north-up to north-east-down vectors."""
_AUTOPILOT, _LOCAL_NED = 1, 1  # MAV_COMP_ID_AUTOPILOT1, MAV_FRAME_LOCAL_NED
_IGNORE_YAW_RATE = 2048
_EAST = np.pi / 2.0
"""Heading along the scenario's x axis, measured from north, clockwise seen from above [rad]."""
_SYSTEMS = 255
"""Largest number of vehicles that MAVLink can distinguish."""


class Px4(Format):
    """Table of all vehicles' setpoints, in the order of sending."""

    name = "px4"
    endings = (".csv",)
    content = "positions, velocities, accelerations and headings at a rate"
    any_motion = True
    heading = "any"

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write the rows ordered by time, then by vehicle.

        Raises:
            ValueError: there are more vehicles than MAVLink can distinguish, or a simulation was
                given.
        """
        check_ahead(flown, self.name)
        if (count := len(flown.scenario.vehicles)) > _SYSTEMS:
            expected = f"at most {_SYSTEMS} with {self.name}: MAVLink numbers no more systems"
            raise ValueError(f"vehicles: got {count}, expected {expected}")
        directions = directions_of(flown.scenario.names, heading)
        ticks = milliseconds(flown.scenario, rate or RATE)
        with atomic_write(path) as file:
            write_rows(file, [COLUMNS])
            elapsed = ticks / 1000.0 - flown.scenario.lead
            yaws = _EAST - headings(flown, elapsed, directions)
            write_rows(file, _rows(sample(flown, elapsed), ticks.tolist(), _wrapped(yaws)))
        return exported(flown, path, [path], f"{len(ticks)} setpoints of each vehicle")


def _wrapped(angles: FloatArray) -> FloatArray:
    """Return angles between -π, inclusive, and π [rad]; those between them are unchanged."""
    turns = np.floor((angles + np.pi) / (2.0 * np.pi))
    return np.asarray(angles - 2.0 * np.pi * turns)


def _rows(samples: Samples, ticks: list[int], yaws: FloatArray) -> Iterator[list[object]]:
    """Yield the rows of the table, without the header.

    Args:
        samples: states of N vehicles at M times.
        ticks: these times [ms].
        yaws: headings from north, clockwise [rad], shape (N, M).
    """
    vectors = samples.states.reshape(*samples.positions.shape[:2], 3, 3) @ NED.T
    numbers = (vectors + 0.0).reshape(*vectors.shape[:2], 9)  # adding 0 avoids negative zeros
    for m, tick in enumerate(ticks):
        for system, name in enumerate(samples.names, start=1):
            head = [name, tick, system, _AUTOPILOT, _LOCAL_NED, _IGNORE_YAW_RATE]
            yield [*head, *numbers[system - 1, m].tolist(), yaws[system - 1, m].item(), 0.0]
