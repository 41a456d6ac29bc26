"""The swarm in Meshcat, Drake's own: the vehicles' way through the scene, and the replanning.

/flight/vehicles/<name> in the scene tree is the vehicle's pose, x along its velocity.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, MeshcatParams, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_rho.display.scene import (
    ROOT,
    Scene,
    add_ends,
    add_surroundings,
    coloured,
    set_camera,
)
from drake_rho.display.shapes import aircraft, nice_step, tube
from drake_rho.display.style import window_colours
from drake_rho.motion.plan import Flight, Plan, Window
from drake_rho.scenario.fields import FloatArray

_FRAMES = 32.0
"""Recorded poses a second."""
_LONGEST = 60.0
"""Longest playback [s]; a flight of up to this runs in real time."""
_MOST_PIECES = 1200
"""Most pieces of trail in a scene: each is an object of its own that appears when it is flown."""
_MOST_POSES = 100_000
"""Most recorded poses, of all vehicles together."""


def animate(
    flown: Plan | Flight,
    *,
    meshcat: Meshcat | None = None,
    host: str = "localhost",
    port: int | None = None,
    rate: float | None = None,
) -> Meshcat:
    """Show a plan or a flight in the browser, with Meshcat's time slider.

    Obstacles are translucent, trails grow as they are flown, starts are small balls and goals
    larger ones; with a `Flight`, each window's whole prediction is drawn as a thin line while it
    is the one that is flown. Colours are those of the figures.

    Args:
        flown: what to show.
        meshcat: where to show it, emptied first; a new server if not given.
        host: network interface of a new server; "*" is every one.
        port: of a new server, or the next free one; from 7000 if not given.
        rate: seconds of flight in a second of playback; if not given, 1 for flights of up to a
            minute and what makes longer ones a minute at most.

    Returns:
        The Meshcat; `web_url()` is its address, `StaticHtml()` the same as one page.

    Raises:
        ValueError: `rate` is not positive.
        OSError: no port is free.
    """
    if rate is not None and not (np.isfinite(rate) and rate > 0.0):
        raise ValueError(f"rate: got {rate}, expected a positive number")
    plan = flown.plan if isinstance(flown, Flight) else flown
    windows = flown.windows if isinstance(flown, Flight) else ()
    meshcat = start_meshcat(host, port) if meshcat is None else meshcat
    scene = Scene.of(plan)
    meshcat.Delete(ROOT)
    meshcat.DeleteRecording()
    set_camera(meshcat, scene)
    add_surroundings(meshcat, scene, plan.scenario)
    add_ends(meshcat, scene, plan.scenario)
    _add_vehicles(meshcat, scene, plan)
    pace = _Pace.of(plan, rate)
    meshcat.StartRecording(
        frames_per_second=pace.frames_per_second, set_visualizations_while_recording=False
    )
    _record_motion(meshcat, plan, pace)
    _record_trails(meshcat, scene, plan, pace)
    _record_predictions(meshcat, windows, pace)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return meshcat


def start_meshcat(host: str = "localhost", port: int | None = None) -> Meshcat:
    """A new Meshcat server on `port`, or on the next free one.

    Args:
        host: network interface; "*" is every one.
        port: first port to try, at least 1024; 7000 if not given.

    Raises:
        OSError: no port is free, or the interface is not there.
        ValueError: the port is out of range.
    """
    first = 7000 if port is None else port
    if not 1024 <= first <= 65535:
        raise ValueError(f"port: got {port}, expected 1024 to 65535")
    for number in range(first, min(first + 100, 65536)):
        try:
            return Meshcat(MeshcatParams(host=host, port=number, show_stats_plot=False))
        except RuntimeError:  # in use
            continue
    raise OSError(f"no free port from {first} on {host}")


@dataclasses.dataclass(frozen=True)
class _Pace:
    """How time in flight becomes time of playback."""

    rate: float
    frames_per_second: float
    times: FloatArray  # of the recorded poses, in flight [s]

    @classmethod
    def of(cls, plan: Plan, rate: float | None) -> _Pace:
        duration = plan.scenario.grid.duration
        if rate is None:
            rate = 1.0 if duration <= _LONGEST else nice_step(duration / _LONGEST)
        playback = duration / rate
        most = _MOST_POSES / len(plan.positions)
        frames_per_second = min(_FRAMES, max(4.0, most / playback))
        frames = int(np.ceil(playback * frames_per_second))
        times = np.minimum(np.arange(frames + 1) * rate / frames_per_second, duration)
        return cls(rate, frames_per_second, times)

    def playback(self, time: float) -> float:
        """When `time` [s] in flight is shown, since the beginning of the playback [s]."""
        return float(time) / self.rate


def _add_vehicles(meshcat: Meshcat, scene: Scene, plan: Plan) -> None:
    mesh = aircraft(scene.vehicle_length)
    for vehicle, colour in coloured(plan.scenario):
        meshcat.SetTriangleMesh(_vehicle_path(vehicle.name), *mesh, rgba=colour)


def _record_motion(meshcat: Meshcat, plan: Plan, pace: _Pace) -> None:
    motion = plan.motion()
    positions = motion.at("position", pace.times)
    headings = _headings(motion.at("velocity", pace.times))
    for index, vehicle in enumerate(plan.scenario.vehicles):
        path = _vehicle_path(vehicle.name)
        meshcat.SetTransform(path, _pose(positions[index, 0], headings[index, 0]))
        for time, position, heading in zip(
            pace.times, positions[index], headings[index], strict=True
        ):
            meshcat.SetTransform(path, _pose(position, heading), pace.playback(time))


def _record_trails(meshcat: Meshcat, scene: Scene, plan: Plan, pace: _Pace) -> None:
    """A tube for every few steps of every vehicle, to be seen from when it has been flown."""
    steps = plan.scenario.grid.knots - 1
    pieces = max(1, min(steps, _MOST_PIECES // len(plan.positions)))
    knots = np.unique(np.linspace(0, steps, pieces + 1).round().astype(int))
    radius = 0.05 * scene.vehicle_length
    for first, last in pairwise(knots):
        begin, end = plan.times[first], plan.times[last]
        paths = plan.motion().at("position", np.linspace(begin, end, 4 * (last - first) + 1))
        for (vehicle, colour), path in zip(coloured(plan.scenario), paths, strict=True):
            name = f"{ROOT}/trails/{vehicle.name}/{first}"
            meshcat.SetTriangleMesh(name, *tube(path, radius), rgba=colour)
            _show_between(meshcat, name, pace.playback((begin + end) / 2), None)


def _record_predictions(meshcat: Meshcat, windows: Sequence[Window], pace: _Pace) -> None:
    """Each window's whole prediction, while it is the one that is flown, as lines."""
    starts = [window.plan.scenario.grid.step * window.first_knot for window in windows]
    for number, (window, colour) in enumerate(
        zip(windows, window_colours(len(windows)), strict=True), start=1
    ):
        duration = window.plan.scenario.grid.duration
        times = np.linspace(0.0, duration, 4 * window.plan.scenario.grid.knots)
        paths = window.plan.motion().at("position", times)
        begins, ends = np.concatenate(paths[:, :-1]), np.concatenate(paths[:, 1:])
        name = f"{ROOT}/predictions/{number}"
        meshcat.SetLineSegments(
            name,
            np.asfortranarray(begins.T),
            np.asfortranarray(ends.T),
            rgba=Rgba(*to_rgb(colour)),
        )
        until = pace.playback(starts[number]) if number < len(windows) else None
        _show_between(meshcat, name, pace.playback(starts[number - 1]), until)


def _show_between(meshcat: Meshcat, path: str, begin: float, end: float | None) -> None:
    """Record that the object is seen from `begin` to `end` [s of playback] only."""
    if begin > 0.0:
        meshcat.SetProperty(path, "visible", False, 0.0)
    meshcat.SetProperty(path, "visible", True, begin)
    if end is not None:
        meshcat.SetProperty(path, "visible", False, end)


def _vehicle_path(name: str) -> str:
    return f"{ROOT}/vehicles/{name}"


def _headings(velocities: FloatArray) -> FloatArray:
    """Directions of flight, shape (N, M, 3): the last one kept where a vehicle stands still."""
    speeds = np.linalg.norm(velocities, axis=2)
    still = speeds <= 1e-3 * speeds.max(axis=1, keepdims=True)
    latest = np.where(still, -1, np.arange(speeds.shape[1]))
    latest = np.maximum.accumulate(latest, axis=1)
    earliest = np.argmin(still, axis=1)  # for a vehicle that has not moved yet
    latest = np.where(latest < 0, earliest[:, None], latest)
    headings = np.take_along_axis(velocities, latest[:, :, None], axis=1)
    lengths = np.linalg.norm(headings, axis=2, keepdims=True)
    return np.where(lengths > 0, headings / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0, 0.0])


def _pose(position: FloatArray, heading: FloatArray) -> RigidTransform:
    """Nose along `heading`, wings level."""
    left = np.cross([0.0, 0.0, 1.0], heading)
    length = np.linalg.norm(left)
    left = left / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])
    above = np.cross(heading, left)
    return RigidTransform(RotationMatrix(np.column_stack([heading, left, above])), position)
