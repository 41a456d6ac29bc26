"""Mapping of flight time to playback time."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.map_faces import has_map
from drake_rho.display.common.requirements import required_positions
from drake_rho.display.meshcat.meshes import nice_step
from drake_rho.scenario.fields import FloatArray

_FRAMES = 32.0
"""Recorded poses per second of playback."""
_LONGEST = 60.0
"""Longest default playback [s]; flights of up to this duration run in real time."""
_MAX_POSES, _MAX_POSES_IN_MAPS = 50_000, 6_500
"""Largest number of recorded poses of all moving objects together. It is smaller in a scene with a
map, to limit the page's size; Meshcat interpolates between poses."""


@dataclasses.dataclass(frozen=True)
class Playback:
    """Mapping of flight time to playback time."""

    rate: float
    """seconds of flight per second of playback"""
    frames_per_second: float
    """recorded poses per second of playback"""
    times: FloatArray
    """times of the recorded poses since the first knot [s], shape (M,)"""

    @classmethod
    def of(cls, plan: Drawn, rate: float | None, objects_per_vehicle: int = 1) -> Playback:
        """Return the playback of a plan at `rate` seconds of flight per second; see `animate`.

        The number of moving objects, `objects_per_vehicle` times the vehicles, the moving obstacles
        and the links, limits the number of frames.
        """
        duration = plan.scenario.grid.duration
        if rate is None:
            rate = 1.0 if duration <= _LONGEST else nice_step(duration / _LONGEST)
        playback = duration / rate
        moving = sum(obstacle.moves for obstacle in plan.scenario.bodies)
        moving += sum(
            len(each.members) for each in required_positions(plan.scenario) if each.is_link
        )
        poses = _MAX_POSES_IN_MAPS if has_map(plan.scenario) else _MAX_POSES
        most = poses / (objects_per_vehicle * len(plan.positions) + moving)
        frames_per_second = min(_FRAMES, max(4.0, most / playback))
        frames = int(np.ceil(playback * frames_per_second))
        times = np.minimum(np.arange(frames + 1) * rate / frames_per_second, duration)
        return cls(rate, frames_per_second, times)

    def time_at(self, time: float) -> float:
        """Return the playback time of a time since the first knot [s]."""
        return float(time) / self.rate
