"""How time in flight becomes time of playback."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.meshcat.meshes import nice_step
from drake_rho.scenario.fields import FloatArray

_FRAMES = 32.0
"""Recorded poses a second."""
_LONGEST = 60.0
"""Longest playback [s]; a flight of up to this runs in real time."""
_MAX_POSES = 50_000
"""Most recorded poses, of all vehicles and moving obstacles together."""


@dataclasses.dataclass(frozen=True)
class Playback:
    """How time in flight becomes time of playback."""

    rate: float
    frames_per_second: float
    times: FloatArray  # of the recorded poses, since the first knot [s]

    @classmethod
    def of(cls, plan: Drawn, rate: float | None, objects_per_vehicle: int = 1) -> Playback:
        """The pace of a plan at `rate` seconds of flight a second; see `animate`.

        So many objects of each vehicle move.
        """
        duration = plan.scenario.grid.duration
        if rate is None:
            rate = 1.0 if duration <= _LONGEST else nice_step(duration / _LONGEST)
        playback = duration / rate
        moving = sum(obstacle.moves for obstacle in plan.scenario.bodies)
        most = _MAX_POSES / (objects_per_vehicle * len(plan.positions) + moving)
        frames_per_second = min(_FRAMES, max(4.0, most / playback))
        frames = int(np.ceil(playback * frames_per_second))
        times = np.minimum(np.arange(frames + 1) * rate / frames_per_second, duration)
        return cls(rate, frames_per_second, times)

    def time_at(self, time: float) -> float:
        """When an instant, in seconds since the first knot, is shown [s of playback]."""
        return float(time) / self.rate
