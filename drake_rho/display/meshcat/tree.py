"""Scene tree of an animation in Meshcat: its objects, and their changes over time.

All objects are under /flight, in the scenario's own coordinates and metres. Meshcat records poses,
scales and visibility. All times are those of the flight, since its first knot.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba
from pydrake.geometry import Sphere as Ball
from pydrake.math import RigidTransform

from drake_rho.display.meshcat.meshes import Mesh, segments
from drake_rho.display.meshcat.playback import Playback
from drake_rho.scenario.fields import BoolArray, FloatArray

ROOT = "/flight"


def rgba(colour: str, alpha: float = 1.0) -> Rgba:
    """Return a colour of the figures with an opacity."""
    return Rgba(*to_rgb(colour), alpha)


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """Scene tree of a Meshcat that is recording; paths are below `ROOT`."""

    meshcat: Meshcat
    """Meshcat that records"""
    playback: Playback
    """mapping of flight time to playback time"""

    def add_mesh(self, path: str, mesh: Mesh, colour: Rgba) -> None:
        """Add a triangle mesh."""
        self.meshcat.SetTriangleMesh(f"{ROOT}/{path}", *mesh, rgba=colour)

    def add_lines(self, path: str, lines: Sequence[FloatArray] | FloatArray, colour: Rgba) -> None:
        """Add polylines [m], each of shape (M, 3), one pixel wide."""
        self.meshcat.SetLineSegments(f"{ROOT}/{path}", *segments(lines), rgba=colour)

    def add_ball(self, path: str, radius: float, colour: Rgba) -> None:
        """Add a ball around the origin with a radius [m]."""
        self.meshcat.SetObject(f"{ROOT}/{path}", Ball(radius), colour)

    def place(self, path: str, position: FloatArray) -> None:
        """Set the position of an object [m], shape (3,)."""
        self.meshcat.SetTransform(f"{ROOT}/{path}", RigidTransform(position))

    def set_see_through(self, path: str) -> None:
        """Keep a translucent object from hiding objects inside it or behind it."""
        self.meshcat.SetProperty(f"{ROOT}/{path}/<object>", "material.depthWrite", False)

    def show_between(self, path: str, begin: float, end: float = np.inf) -> None:
        """Record that an object is visible only from `begin` to `end` [s].

        Nothing is recorded after the flight: it would lengthen the playback.
        """
        last = float(self.playback.times[-1])
        if begin > 0.0 or end < 0.0:
            self._show(path, 0.0, visible=False)
        if begin <= last and end >= 0.0:
            self._show(path, max(0.0, begin), visible=True)
            if end < last:
                self._show(path, end, visible=False)

    def show_while(self, path: str, visible: BoolArray) -> None:
        """Record whether an object is visible at the times of the playback, shape (M,)."""
        for m in (0, *(np.flatnonzero(np.diff(visible)) + 1)):
            self._show(path, self.playback.times[m], visible=bool(visible[m]))

    def move(self, path: str, poses: FloatArray, at: BoolArray | slice = slice(None)) -> None:
        """Record the poses of an object at the times of the playback.

        Args:
            path: path of the object.
            poses: rotations, with positions [m] as last columns, shape (M, 3, 4).
            at: which of the poses are recorded.
        """
        self.meshcat.SetTransform(f"{ROOT}/{path}", RigidTransform(poses[0]))
        for time, pose in zip(self.playback.times[at], poses[at], strict=True):
            when = self.playback.time_at(time)
            self.meshcat.SetTransform(f"{ROOT}/{path}", RigidTransform(pose), when)

    def scale(self, path: str, sizes: FloatArray) -> None:
        """Record the scales of an object along its axes at the times of the playback, (M, 3)."""
        self.meshcat.SetProperty(f"{ROOT}/{path}", "scale", sizes[0].tolist())
        for time, size in zip(self.playback.times, sizes.tolist(), strict=True):
            at = self.playback.time_at(time)
            self.meshcat.SetProperty(f"{ROOT}/{path}", "scale", size, at)

    def _show(self, path: str, time: float, *, visible: bool) -> None:
        at = self.playback.time_at(time)
        self.meshcat.SetProperty(f"{ROOT}/{path}", "visible", visible, at)
