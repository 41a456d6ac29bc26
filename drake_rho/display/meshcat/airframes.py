"""Meshes of aircraft and quadrotors, scaled to fit into a ball."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.shape_faces import fan
from drake_rho.display.meshcat.meshes import Mesh, faceted
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.limits import Limits
from drake_rho.scenario.parts import Airframe

FAST = 30.0
"""Least top speed of a vehicle drawn as an aircraft [m/s]; few quadrotors are as fast."""
_ROTORS = np.pi / 4.0 + np.pi / 2.0 * np.arange(4)
"""Angles of the rotors around a quadrotor [rad]."""
_CONE = [(1.4, 0.0), (0.35, 0.26), (0.35, 0.0)]
"""Stations of the cone that shows a quadrotor's heading, between its front rotors."""


def airframes(shown: Drawn) -> list[Airframe]:
    """Choose the airframe of each vehicle: the scenario's, or else one that suits its limits.

    A vehicle with limits on thrust or tilt is a quadrotor. Any other is an aircraft if its top
    speed is at least `FAST`: the largest speed allowed or, without a limit, the largest flown.
    """
    fastest = np.linalg.norm(shown.velocities, axis=2).max(axis=1)
    return [
        vehicle.airframe or _by_limits(shown.scenario.limits_of(vehicle), float(flown))
        for vehicle, flown in zip(shown.scenario.vehicles, fastest, strict=True)
    ]


def _by_limits(limits: Limits, flown: float) -> Airframe:
    if limits.max_thrust is not None or limits.max_tilt is not None:
        return "quadrotor"
    speeds = [] if limits.max_speed is None else [limits.max_speed]
    if (box := limits.velocity) is not None:
        speeds.append(float(np.linalg.norm(np.maximum(np.abs(box.lower), np.abs(box.upper)))))
    return "aircraft" if min(speeds, default=flown) >= FAST else "quadrotor"


def body(airframe: Airframe, radius: float, *, light: bool, pointed: bool = False) -> Mesh:
    """Return the mesh of a vehicle around the origin, nose along +x and left along +y.

    Args:
        airframe: kind of vehicle.
        radius: radius of the smallest ball around the origin that contains the mesh [m].
        light: whether to use the fewest triangles that still show the airframe.
        pointed: whether a quadrotor, which looks alike from four sides, has a cone for its nose.
    """
    triangles = _aircraft(4 if light else 8) if airframe == "aircraft" else _quadrotor(light)
    if pointed and airframe == "quadrotor":
        triangles = np.concatenate([triangles, _turned(_CONE, 4 if light else 8)])
    triangles *= radius / np.linalg.norm(triangles, axis=2).max()
    return faceted(triangles)


def _aircraft(sides: int) -> FloatArray:
    """Build a fuselage, swept wings, stabilisers and a fin from triangles, shape (T, 3, 3)."""
    stations = [(0.62, 0.0), (0.5, 0.05), (0.25, 0.075), (-0.25, 0.07), (-0.55, 0.025), (-0.56, 0)]
    wing = [(0.22, 0.05, -0.02), (-0.12, 0.6, 0.02), (-0.25, 0.6, 0.02), (-0.14, 0.05, -0.02)]
    stabiliser = [(-0.36, 0.02, 0.02), (-0.5, 0.24, 0.03), (-0.58, 0.24, 0.03), (-0.54, 0.02, 0.02)]
    fin = [(-0.3, 0, 0.05), (-0.5, 0, 0.25), (-0.6, 0, 0.25), (-0.55, 0, 0.02)]
    mirror = np.array([1.0, -1.0, 1.0])
    plates = [plate for each in (wing, stabiliser) for plate in (each, mirror * each)]
    return np.concatenate(
        [_turned(stations, sides), *(fan(np.array(plate)) for plate in [*plates, fin])]
    )


def _quadrotor(light: bool) -> FloatArray:
    """Build a hull with a nose, four arms and four rotors from triangles, shape (T, 3, 3)."""
    sides = 6 if light else 14
    middle = [(0.0, 0.2)] if light else [(0.12, 0.16), (-0.16, 0.16)]
    hull = _turned([(0.34, 0.0), *middle, (-0.24, 0.0)], 4 if light else 6)
    parts = [hull * [1.0, 1.0, 0.7]]
    angles = 2.0 * np.pi / sides * np.arange(sides)
    for rotor in _ROTORS:
        out = np.array([np.cos(rotor), np.sin(rotor), 0.0])
        sideways = np.array([-out[1], out[0], 0.0])
        for across in (sideways,) if light else (sideways, np.array([0.0, 0.0, 1.0])):
            parts.append(
                fan(
                    np.array(
                        [0.04 * across, out + 0.03 * across, out - 0.03 * across, -0.04 * across]
                    )
                )
            )
        ring = 0.42 * np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=1)
        parts.append(fan(ring + out + [0.0, 0.0, 0.08]))
    return np.concatenate(parts)


def _turned(stations: list[tuple[float, float]], sides: int) -> FloatArray:
    """Build a surface of revolution about the x axis from its x and radius at several stations."""
    angles = 2.0 * np.pi / sides * (np.arange(sides) + 0.5)
    around = np.stack([np.zeros(sides), np.cos(angles), np.sin(angles)], axis=1)
    found = []
    for (x, radius), (further, other) in pairwise(stations):
        near, far = radius * around + [x, 0, 0], other * around + [further, 0, 0]
        for corner in range(sides):
            after = (corner + 1) % sides
            if radius > 0.0:
                found.append([near[corner], far[corner], near[after]])
            if other > 0.0:
                found.append([near[after], far[corner], far[after]])
    return np.array(found)
