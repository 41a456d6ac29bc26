"""Vehicles in Meshcat: what they look like, how large they are drawn, and where they are.

/flight/vehicles/<name> in the scene tree is the vehicle's pose; a `/` in its name is %2F there
(`names.as_path`), so that no vehicle lies under another; /flight/radii/<name> is a faint ball.
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
"""How much of the room that there is a body takes: between two frames there may be less."""
_MIN_SCALE = 1e-3
"""Least that a body is scaled by: nothing can be shown at a size of zero."""


@dataclasses.dataclass(frozen=True, eq=False)
class Vehicles:
    """How vehicles are drawn."""

    kinds: list[Airframe]
    """what each looks like"""
    true: FloatArray
    """radii of the balls that the vehicles fit into by their scenario [m], shape (N,); 0 of points
    """
    radii: FloatArray
    """of the balls that hold what is drawn of them [m], shape (N,)"""
    scales: FloatArray
    """by how much each is drawn smaller at the times of the playback, shape (N, M)"""
    ringed: list[bool]
    """around which there is a faint ball of the radius"""

    @classmethod
    def of(cls, scene: Scene, shown: Drawn, playback: Playback) -> Vehicles:
        """Large enough to be seen, and never reaching into what they keep clear of.

        So a body is as large as the vehicle, or as `Scene.seen` if that is larger; then it is drawn
        smaller whenever an obstacle, or half the way to another vehicle from which it keeps apart,
        is nearer, but never smaller than the vehicle is.
        """
        true = true_radii(shown)
        radii = np.maximum(true, scene.seen)
        room = np.maximum(_INSIDE * free_radii(shown, playback.times), true[:, None])
        scales = np.clip(room / radii[:, None], _MIN_SCALE, 1.0)
        ringed = [each.radius > 0.0 and not scene.light for each in shown.scenario.vehicles]
        return cls(airframes(shown), true, radii, scales, ringed)

    @property
    def note(self) -> str | None:
        """What has to be said of their size; nothing if they are drawn as large as they are."""
        if np.all(self.radii <= self.true):
            return None
        beside = (
            ", smaller, with a ring, where they would reach into something" if self.shrink else ""
        )
        if not np.all(self.true > 0.0):
            return f"vehicles are points, drawn to be seen{beside}"
        times = float((self.radii / self.true).max())
        return f"vehicles are drawn {times:.2g} times larger than life{beside}"

    @property
    def shrink(self) -> bool:
        """Whether one is ever drawn smaller than else."""
        return bool(np.any(self.scales < 1.0))


def true_radii(shown: Drawn) -> FloatArray:
    """Radii of balls that vehicles fit into without ever touching what they keep from [m]."""
    scenario = shown.scenario
    radii: FloatArray = scenario.fleet.radii
    if (apart := scenario.separation) is None:
        return radii
    half = 0.5 * apart.distance * min(1.0, apart.downwash)
    return np.where(radii > 0.0, np.minimum(radii, half), half)


def add_vehicles(meshcat: Meshcat, scene: Scene, shown: Drawn, vehicles: Vehicles) -> None:
    """Put the bodies into the scene, and around those of a few a faint ball of their radius."""
    looks = zip(vehicles.kinds, vehicles.radii.tolist(), vehicles.ringed, strict=True)
    for (vehicle, colour), (kind, radius, ringed) in zip(
        coloured(shown.scenario), looks, strict=True
    ):
        mesh = body(kind, radius, light=scene.light)
        meshcat.SetTriangleMesh(_path("vehicles", vehicle), *mesh, rgba=colour)
        if ringed:
            path, faint = _path("radii", vehicle), Rgba(colour.r(), colour.g(), colour.b(), 0.15)
            meshcat.SetObject(path, Ball(vehicle.radius), faint)
            meshcat.SetProperty(f"{path}/<object>", "material.depthWrite", False)


def record_vehicles(meshcat: Meshcat, shown: Drawn, vehicles: Vehicles, playback: Playback) -> None:
    """Record where they are, how they lean and how large they are drawn."""
    motion = shown.motion()
    places, velocities = (motion.at(each, playback.times) for each in ("position", "velocity"))
    up = lifts(motion, playback.times, shown.scenario.grid.step)
    poses = vehicle_poses(vehicles.kinds, places, velocities, up)
    for vehicle, each, scales, ringed in zip(
        shown.scenario.vehicles, poses, vehicles.scales, vehicles.ringed, strict=True
    ):
        path = _path("vehicles", vehicle)
        record_poses(meshcat, path, each, playback)
        if np.any(scales < 1.0):
            record_scale(meshcat, path, scales, playback)
        if ringed:
            record_poses(meshcat, _path("radii", vehicle), each, playback)


def record_scale(meshcat: Meshcat, path: str, sizes: FloatArray, playback: Playback) -> None:
    """Record that an object has sizes, shape (M,), at the times of a playback."""
    meshcat.SetProperty(path, "scale", [sizes[0]] * 3)
    for time, size in zip(playback.times, sizes, strict=True):
        meshcat.SetProperty(path, "scale", [size] * 3, playback.time_at(time))


def _path(kind: str, vehicle: Vehicle) -> str:
    return f"{ROOT}/{kind}/{as_path(vehicle.name)}"
