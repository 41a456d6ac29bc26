"""One vehicle from rest to rest among spheres and boxes at rest: what an oracle and a peer read."""

from __future__ import annotations

import dataclasses

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray


@dataclasses.dataclass(frozen=True)
class Field:
    """A scenario of one vehicle with boxes of positions, velocities and accelerations."""

    start: FloatArray
    """[m], shape (3,)"""
    goal: FloatArray
    """[m], shape (3,)"""
    radius: float
    """of the vehicle [m]"""
    shapes: tuple[rho.Sphere | rho.Box, ...]
    """what it keeps its radius from"""
    room: rho.Box
    """of positions [m]"""
    velocity: rho.Box
    """[m/s]"""
    acceleration: rho.Box
    """[m/s²]"""
    duration: float
    """T [s]"""
    step: float
    """h [s]"""


def field_of(scenario: rho.Scenario) -> Field:
    """A scenario as a field.

    Raises:
        TypeError: it is none.
    """
    (vehicle,), limits = scenario.vehicles, scenario.limits
    room, velocity, acceleration = limits.position, limits.velocity, limits.acceleration
    if room is None or velocity is None or acceleration is None:
        raise TypeError("a limit is missing")
    shapes = tuple(each for each in scenario.obstacles if isinstance(each, rho.Sphere | rho.Box))
    if len(shapes) < len(scenario.obstacles):
        raise TypeError("an obstacle is neither a sphere nor a box at rest")
    return Field(
        vehicle.start.position,
        vehicle.goal.position,
        vehicle.radius,
        shapes,
        room,
        velocity,
        acceleration,
        scenario.grid.duration,
        scenario.grid.step,
    )
