"""Lights of vehicles, from the colours of their waypoints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario, Vehicle

_WHITE, _OFF = (255, 255, 255), (0, 0, 0)


class Lights(NamedTuple):
    """Colours of one vehicle's light at some times, between which they change linearly."""

    times: FloatArray
    """times since the beginning of the flight [s], increasing, shape (M,)"""
    colours: FloatArray
    """red, green and blue, from 0 to 255, shape (M, 3)"""

    def at(self, times: FloatArray) -> FloatArray:
        """Return whole numbers of red, green and blue at times [s], shape (len(times), 3)."""
        parts = [np.interp(times, self.times, each) for each in self.colours.T]
        return np.asarray(np.rint(np.stack(parts, axis=1)))


def lights_of(scenario: Scenario) -> list[Lights]:
    """Return the lights of all vehicles.

    A light that is off at the beginning fades to the colour of the first waypoint that has one,
    keeps it while the vehicle dwells there, fades to the next, and is off again at the end. Where
    no waypoint of any vehicle has a colour, all lights are white.
    """
    if any(each.colour is not None for vehicle in scenario.vehicles for each in vehicle.waypoints):
        return [_faded(scenario, vehicle) for vehicle in scenario.vehicles]
    ends = np.array([0.0, scenario.grid.duration + 2.0 * scenario.lead])
    return [Lights(ends, np.array([_WHITE, _WHITE], dtype=np.float64))] * len(scenario.vehicles)


def _faded(scenario: Scenario, vehicle: Vehicle) -> Lights:
    """Return the light of a vehicle that fades between the colours of its waypoints."""
    begin, lasting = scenario.grid.start - scenario.lead, scenario.grid.duration + scenario.lead * 2
    timed = sorted(
        ((each.time - begin, each) for each in vehicle.waypoints if each.time is not None),
        key=lambda pair: pair[0],
    )
    times, colours = [0.0], [_OFF]
    for time, waypoint in timed:
        if waypoint.colour is not None:
            times += [time, time + waypoint.dwell]
            red, green, blue = bytes.fromhex(waypoint.colour[1:])
            colours += [(red, green, blue)] * 2
    return Lights(
        np.array([*times, max(lasting, times[-1])]),
        np.array([*colours, _OFF], dtype=np.float64),
    )
