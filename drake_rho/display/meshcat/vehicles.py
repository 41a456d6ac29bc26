"""Vehicles in Meshcat: their appearance, drawn sizes and motion.

In the scene tree, /flight/vehicles/<name> is the vehicle's pose, and /flight/radii/<name> a faint
ball of its radius. A `/` in a name becomes %2F (`names.as_path`), so that no vehicle is a child of
another.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from pydrake.geometry import Meshcat, Rgba
from pydrake.geometry import Sphere as Ball

from drake_rho.display.common.clearances import free_radii
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_path
from drake_rho.display.meshcat.airframes import airframes, body
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.poses import lifts, record_poses, vehicle_poses
from drake_rho.display.meshcat.scene import ROOT, Scene, coloured
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Airframe, Vehicle

_INSIDE = 0.97
"""Fraction of the free radius that a body fills: it may be smaller between two frames."""
_MIN_SCALE = 1e-3
"""Least scale of a body; Meshcat cannot show a size of zero."""


@dataclasses.dataclass(frozen=True, eq=False)
class Vehicles:
    """Appearance of the vehicles of a scene."""

    kinds: list[Airframe]
    """airframe of each vehicle"""
    true: FloatArray
    """true radii, of the balls that contain the vehicles [m], shape (N,); 0 for point masses"""
    radii: FloatArray
    """drawn radii, of the balls that contain the meshes [m], shape (N,)"""
    scales: FloatArray
    """factors, at most 1, on the drawn radii at the times of the playback, shape (N, M)"""
    with_ball: list[bool]
    """whether a faint ball of the vehicle's radius is drawn around each"""

    @classmethod
    def of(cls, scene: Scene, shown: Drawn, playback: Playback) -> Vehicles:
        """Choose sizes at which vehicles are visible and touch neither obstacles nor each other.

        The radius of a body is the larger of the vehicle's radius and `Scene.seen`. It is scaled
        down when an obstacle or, if a separation is required, the midpoint to another vehicle is
        nearer, but never below the vehicle's own radius.
        """
        true = true_radii(shown)
        radii = np.maximum(true, scene.seen)
        fitting = np.maximum(_INSIDE * free_radii(shown, playback.times), true[:, None])
        scales = np.clip(fitting / radii[:, None], _MIN_SCALE, 1.0)
        with_ball = [each.radius > 0.0 and not scene.light for each in shown.scenario.vehicles]
        return cls(airframes(shown), true, radii, scales, with_ball)

    @property
    def note(self) -> str | None:
        """Note on the drawn size of the vehicles; None if it is their true size."""
        if np.all(self.radii <= self.true):
            return None
        near = "; smaller, and circled, near obstacles and each other" if self.shrink else ""
        if not np.all(self.true > 0.0):
            return f"vehicles are point masses, drawn enlarged{near}"
        times = float((self.radii / self.true).max())
        return f"vehicles are drawn {times:.2g} times their true size{near}"

    @property
    def shrink(self) -> bool:
        """Whether any vehicle is ever scaled down."""
        return bool(np.any(self.scales < 1.0))


def true_radii(shown: Drawn) -> FloatArray:
    """Return radii of balls around the vehicles that touch nothing if all constraints hold [m]."""
    scenario = shown.scenario
    radii: FloatArray = scenario.fleet.radii
    if (apart := scenario.separation) is None:
        return radii
    half = 0.5 * apart.distance * min(1.0, apart.downwash)
    return np.where(radii > 0.0, np.minimum(radii, half), half)


def add_vehicles(meshcat: Meshcat, scene: Scene, shown: Drawn, vehicles: Vehicles) -> None:
    """Add the bodies to the scene and, unless it is light, faint balls of the vehicles' radii."""
    looks = zip(vehicles.kinds, vehicles.radii.tolist(), vehicles.with_ball, strict=True)
    for (vehicle, colour), (kind, radius, with_ball) in zip(
        coloured(shown.scenario), looks, strict=True
    ):
        mesh = body(kind, radius, light=scene.light)
        meshcat.SetTriangleMesh(_path("vehicles", vehicle), *mesh, rgba=colour)
        if with_ball:
            path, faint = _path("radii", vehicle), Rgba(colour.r(), colour.g(), colour.b(), 0.15)
            meshcat.SetObject(path, Ball(vehicle.radius), faint)
            meshcat.SetProperty(f"{path}/<object>", "material.depthWrite", False)


def record_vehicles(meshcat: Meshcat, shown: Drawn, vehicles: Vehicles, playback: Playback) -> None:
    """Record the vehicles' poses and scales."""
    motion = shown.motion()
    places, velocities = (motion.at(each, playback.times) for each in ("position", "velocity"))
    flown = motion.with_accelerations(motion.accelerations) if shown.jumps else motion
    up = lifts(flown, playback.times, shown.scenario.grid.step)
    poses = vehicle_poses(vehicles.kinds, places, velocities, up)
    for vehicle, each, scales, with_ball in zip(
        shown.scenario.vehicles, poses, vehicles.scales, vehicles.with_ball, strict=True
    ):
        path = _path("vehicles", vehicle)
        record_poses(meshcat, path, each, playback)
        if np.any(scales < 1.0):
            record_scale(meshcat, path, scales, playback)
        if with_ball:
            record_poses(meshcat, _path("radii", vehicle), each, playback)


def record_scale(meshcat: Meshcat, path: str, sizes: FloatArray, playback: Playback) -> None:
    """Record the scales of an object, shape (M,), at the times of a playback."""
    meshcat.SetProperty(path, "scale", [sizes[0]] * 3)
    for time, size in zip(playback.times, sizes, strict=True):
        meshcat.SetProperty(path, "scale", [size] * 3, playback.time_at(time))


def _path(kind: str, vehicle: Vehicle) -> str:
    return f"{ROOT}/{kind}/{as_path(vehicle.name)}"
