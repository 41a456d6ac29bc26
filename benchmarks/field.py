"""Input of an oracle and a peer: one vehicle from rest to rest among spheres and boxes at rest."""

from __future__ import annotations

import dataclasses

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray


@dataclasses.dataclass(frozen=True)
class Field:
    """Scenario of one vehicle with boxes of positions, velocities and accelerations."""

    start: FloatArray
    """start [m], shape (3,)"""
    goal: FloatArray
    """goal [m], shape (3,)"""
    radius: float
    """radius of the vehicle [m]"""
    shapes: tuple[rho.Sphere | rho.Box, ...]
    """obstacles from which it has to keep its radius"""
    room: rho.Box
    """box of positions [m]"""
    velocity: rho.Box
    """box of velocities [m/s]"""
    acceleration: rho.Box
    """box of accelerations [m/s²]"""
    duration: float
    """duration T [s]"""
    step: float
    """step h [s]"""


def field_of(scenario: rho.Scenario) -> Field:
    """Return a scenario as a field.

    Raises:
        TypeError: the scenario has other features.
    """
    (vehicle,), limits = scenario.vehicles, scenario.limits
    room, velocity, acceleration = limits.position, limits.velocity, limits.acceleration
    if room is None or velocity is None or acceleration is None:
        raise TypeError("limits: got None, expected boxes of position, velocity and acceleration")
    shapes = tuple(each for each in scenario.obstacles if isinstance(each, rho.Sphere | rho.Box))
    if len(shapes) < len(scenario.obstacles):
        raise TypeError("obstacles: got another kind, expected spheres and boxes at rest")
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
