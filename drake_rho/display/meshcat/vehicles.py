"""Vehicles in Meshcat: their appearance, drawn sizes and motion.

In the scene tree, /flight/vehicles/<name> is the vehicle's pose, and /flight/radii/<name> a faint
ball of its radius. A `/` in a name becomes %2F (`names.as_path`), so that no vehicle is a child of
another.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from pydrake.geometry import Rgba

from drake_rho.display.common.clearances import free_radii
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_path
from drake_rho.display.meshcat.airframes import airframes, body
from drake_rho.display.meshcat.meshes import Mesh
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.poses import lifts, vehicle_poses
from drake_rho.display.meshcat.scene import Scene, coloured
from drake_rho.display.meshcat.tree import Tree
from drake_rho.motion.headings import Heading
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Airframe

_INSIDE = 0.97
"""Fraction of the free radius that a body fills: it may be smaller between two frames."""
_BALL = 0.15
"""Opacity of balls of the vehicles' radii."""
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
    yaws: FloatArray | None = None
    """headings at these times [rad], shape (N, M); None to fly nose first"""

    @classmethod
    def of(
        cls, scene: Scene, shown: Drawn, playback: Playback, heading: Heading | None = None
    ) -> Vehicles:
        """Choose sizes at which vehicles are visible and touch neither obstacles nor each other.

        The radius of a body is the larger of the vehicle's radius and `Scene.seen`. It is scaled
        down when an obstacle or, if a separation is required, the midpoint to another vehicle is
        nearer, but never below the vehicle's own radius.
        """
        true = true_radii(shown)
        radii = np.maximum(true, scene.seen)
        fitting = np.maximum(_INSIDE * free_radii(shown, playback.times), true[:, None])
        scales = np.clip(fitting / radii[:, None], _MIN_SCALE, 1.0)
        yaws = shown.headings(playback.times, heading)
        return cls(airframes(shown), true, radii, scales, yaws)

    def body(self, vehicle: int, *, light: bool) -> Mesh:
        """Return the mesh of a vehicle, whose nose is plain to see if headings are shown."""
        kind, radius = self.kinds[vehicle], float(self.radii[vehicle])
        return body(kind, radius, light=light, pointed=self.yaws is not None)

    @property
    def note(self) -> str:
        """Note on the drawn size of the vehicles; empty if it is their true size."""
        if np.all(self.radii <= self.true):
            return ""
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
    if (separation := scenario.separation) is None:
        return radii
    half = 0.5 * separation.distance * min(1.0, separation.downwash)
    return np.where(radii > 0.0, np.minimum(radii, half), half)


def add_vehicles(tree: Tree, scene: Scene, shown: Drawn, vehicles: Vehicles) -> None:
    """Add the bodies and, unless the scene is light, faint balls of the vehicles' radii.

    Their poses and scales are recorded.
    """
    motion, times = shown.motion(), tree.playback.times
    places, velocities = (motion.at(each, times) for each in ("position", "velocity"))
    flown = motion.with_accelerations(motion.accelerations) if shown.jumps else motion
    up = lifts(flown, times, shown.scenario.grid.step)
    poses = vehicle_poses(vehicles.kinds, places, velocities, up, vehicles.yaws)
    for i, (vehicle, colour) in enumerate(coloured(shown.scenario)):
        path, ball = (f"{kind}/{as_path(vehicle.name)}" for kind in ("vehicles", "radii"))
        mesh = vehicles.body(i, light=scene.light)
        tree.add_mesh(path, mesh, colour)
        tree.move(path, poses[i])
        if np.any(vehicles.scales[i] < 1.0):
            tree.scale(path, uniform(vehicles.scales[i]))
        if vehicle.radius > 0.0 and not scene.light:
            tree.add_ball(ball, vehicle.radius, faint(colour, _BALL))
            tree.set_see_through(ball)
            tree.move(ball, poses[i])


def uniform(scales: FloatArray) -> FloatArray:
    """Return scales (M,) along all three axes, shape (M, 3)."""
    return np.repeat(scales[:, None], 3, axis=1)


def faint(colour: Rgba, opacity: float) -> Rgba:
    """Return a colour with an opacity."""
    return Rgba(colour.r(), colour.g(), colour.b(), opacity)
