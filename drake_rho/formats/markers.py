"""Markers of obstacles and error tubes at times of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from drake_rho.formats.messages import Messages
from drake_rho.motion.flown import Flown
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Solid, unit_across
from drake_rho.scenario.shapes.capsules import Capsule
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.posed import Posed
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere

ENDLESS = 1000.0
"""Height with which endless cylinders are shown [m]."""
_GREY, _BLUE = (0.6, 0.63, 0.7, 0.5), (0.2, 0.45, 0.8, 0.25)
_NO_POINTS, _NO_PLACE = np.zeros((0, 3)), np.zeros(3)


class _Part(NamedTuple):
    """Part of a shape that one marker shows, in absolute coordinates."""

    kind: str
    """kind of the marker"""
    position: FloatArray
    """place of its origin [m], shape (3,)"""
    rotation: FloatArray
    """rotation matrix, shape (3, 3)"""
    scale: FloatArray
    """size along its axes [m], shape (3,)"""
    points: FloatArray = _NO_POINTS
    """points of a list relative to the origin [m], shape (P, 3)"""


class Obstacles:
    """Markers of a scenario's obstacles, sent again when they change."""

    def __init__(self, scenario: Scenario) -> None:
        self._start = scenario.grid.start
        self._shown = [_Shown(n, each) for n, each in enumerate(scenario.bodies, start=1)]

    def at(self, messages: Messages, elapsed: float, stamp: int) -> list[Any]:
        """Return the markers that have changed since the time before.

        Args:
            messages: that makes them.
            elapsed: time since the first knot [s].
            stamp: this time [ns].
        """
        time = np.array([self._start + elapsed])
        return [each for one in self._shown for each in one.at(messages, time, stamp)]


class _Shown:
    """Obstacle with the place at which its markers are."""

    def __init__(self, number: int, obstacle: Obstacle) -> None:
        self._name, self._obstacle = obstacle.called(number), obstacle
        self._parts, self._place = parts(obstacle.shape), np.full(3, np.nan)

    def at(self, messages: Messages, time: FloatArray, stamp: int) -> list[Any]:
        """Return its markers if it is elsewhere than before; it is nowhere while not active."""
        active = bool(self._obstacle.is_active(time)[0])
        place = self._obstacle.centers(time)[0] if active else np.full(3, np.nan)
        if np.array_equal(place, self._place, equal_nan=True):
            return []
        self._place = place
        moved = place - self._obstacle.shape.center if active else _NO_PLACE
        return [
            messages.marker(
                (self._name, number),
                part.kind if active else "DELETE",
                stamp,
                position=part.position + moved,
                turn=Rotation.from_matrix(part.rotation).as_quat(),
                scale=part.scale,
                colour=_GREY,
                points=part.points if active else _NO_POINTS,
            )
            for number, part in enumerate(self._parts)
        ]


class Tubes:
    """Markers of error tubes: balls around the planned positions, as large as the tube.

    Plans and simulations have tubes; a flight has one for each window, of which none is shown.
    """

    def __init__(self, flown: Flown, frames: Sequence[str]) -> None:
        self._flown, self._frames = flown, frames
        self._has_any = bool(flown.scenario.disturbance) and flown.kind != "flight"

    def at(self, messages: Messages, elapsed: float, stamp: int) -> list[Any]:
        """Return the markers at a time since the first knot [s]; none without a tube."""
        if not self._has_any:
            return []
        positions, radius = self._around(elapsed)
        return [
            messages.marker(
                (frame, 0),
                "SPHERE",
                stamp,
                position=position,
                turn=np.array([0.0, 0.0, 0.0, 1.0]),
                scale=np.full(3, 2.0 * radius),
                colour=_BLUE,
                points=_NO_POINTS,
            )
            for frame, position in zip(self._frames, positions, strict=True)
            if radius > 0.0
        ]

    def _around(self, elapsed: float) -> tuple[FloatArray, float]:
        """Return the centres of balls [m], shape (N, 3), and their radius [m]."""
        flown, time = self._flown, self._flown.scenario.grid.start + elapsed
        if simulation := flown.simulation:
            tube = simulation.tubes[int(simulation.in_force(time)[0])]
            return simulation.nominal("position", time)[0], float(tube.position(time))
        positions = flown.sampled(np.array([elapsed])).positions[:, 0]
        return positions, float(tube_of(flown.scenario).position(time))


@singledispatch
def parts(solid: Solid) -> list[_Part]:
    """Return the parts that show a shape or a map."""
    raise NotImplementedError(f"shape: got a {type(solid).__name__}, expected a shape or a map")


@parts.register
def _(solid: Sphere) -> list[_Part]:
    return [_Part("SPHERE", solid.center, np.eye(3), np.full(3, 2.0 * solid.radius))]


@parts.register
def _(solid: Ellipsoid) -> list[_Part]:
    return [_Part("SPHERE", solid.center, np.eye(3), 2.0 * solid.semi_axes)]


@parts.register
def _(solid: Box) -> list[_Part]:
    return [_Part("CUBE", solid.center, np.eye(3), 2.0 * solid.extent)]


@parts.register
def _(solid: Cylinder) -> list[_Part]:
    along = np.eye(3)["xyz".index(solid.axis)]
    return [_cylinder(solid.center, along, solid.radius, solid.height or ENDLESS)]


@parts.register
def _(solid: Capsule) -> list[_Part]:
    height = float(2.0 * np.linalg.norm(solid.half))
    balls = [each for end in (solid.start, solid.end) for each in parts(Sphere(end, solid.radius))]
    if height == 0.0:
        return balls[:1]
    return [_cylinder(solid.center, 2.0 * solid.half / height, solid.radius, height), *balls]


@parts.register
def _(solid: Polytope) -> list[_Part]:
    corners = solid.vertices[ConvexHull(solid.vertices).simplices].reshape(-1, 3)
    return [_Part("TRIANGLE_LIST", solid.center, np.eye(3), np.ones(3), corners - solid.center)]


@parts.register
def _(solid: Posed) -> list[_Part]:
    return [
        part._replace(
            position=solid.rotation @ part.position + solid.translation,
            rotation=solid.rotation @ part.rotation,
        )
        for part in parts(solid.shape)
    ]


@parts.register
def _(solid: Mesh) -> list[_Part]:
    corners = solid.corners.reshape(-1, 3) - solid.center
    return [_Part("TRIANGLE_LIST", solid.center, np.eye(3), np.ones(3), corners)]


@parts.register
def _(solid: Voxels) -> list[_Part]:
    cells = np.asarray(solid.resolution * (solid.occupied + 0.5), dtype=np.float64)
    rotation = np.eye(3) if solid.rotation is None else solid.rotation
    return [_Part("CUBE_LIST", solid.origin, rotation, np.full(3, solid.resolution), cells)]


def _cylinder(center: FloatArray, along: FloatArray, radius: float, height: float) -> _Part:
    """Return a cylinder, whose marker is along z, in another direction."""
    across = unit_across(along)
    rotation = np.stack([across, np.cross(along, across), along], axis=1)
    return _Part("CYLINDER", center, rotation, np.array([2.0 * radius, 2.0 * radius, height]))
