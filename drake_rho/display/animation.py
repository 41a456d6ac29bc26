"""The swarm in Meshcat, Drake's own: the vehicles' way through the scene, and the replanning.

/flight/vehicles/<name> in the scene tree is the vehicle's pose, x along its velocity; a `/` in
its name is %2F there (`names.as_path`), so that no vehicle lies under another.
"""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, Rgba
from pydrake.geometry import Sphere as Ball
from pydrake.math import RigidTransform

from drake_rho.display.bodies import add_obstacles, record_obstacles
from drake_rho.display.flown import Drawn, Flown, drawn, windows_of
from drake_rho.display.names import as_path
from drake_rho.display.pace import Pace
from drake_rho.display.scene import (
    ROOT,
    Scene,
    add_ends,
    add_light_goals,
    add_surroundings,
    coloured,
    set_camera,
)
from drake_rho.display.shapes import aircraft
from drake_rho.display.trails import record_light_trails, record_predictions, record_trails
from drake_rho.scenario.fields import FloatArray

_MOST_TRAILS = 100
"""Most vehicles whose trails are drawn without being asked for: more would hide the vehicles."""


def animate(
    flown: Flown,
    *,
    meshcat: Meshcat | None = None,
    host: str = "localhost",
    port: int | None = None,
    rate: float | None = None,
    trails: bool | None = None,
) -> Meshcat:
    """Show a plan or a flight in the browser, with Meshcat's time slider.

    Obstacles are translucent, and fainter until they are known; those that move do so. Trails grow
    as they are flown, starts are small balls and goals larger ones; with a `Flight`, each window's
    whole prediction is drawn as a thin line while it is the one that is flown. Colours are those of
    the figures. Where there is a separation, a vehicle is drawn within half of it around its
    position, so that what is apart does not touch, unless that would be too small to be seen in the
    scene. A faint ball around a vehicle is its radius, which it keeps from obstacles.

    More than 24 vehicles make a light scene, in which little but the vehicles is an object: goals
    are small, trails thin, and starts, names and predictions are left out.

    Args:
        flown: what to show.
        meshcat: where to show it, emptied first; a new server if not given.
        host: network interface of a new server; "*" is every one.
        port: of a new server, or the next free one; from 7000 if not given.
        rate: seconds of flight in a second of playback; if not given, 1 for flights of up to a
            minute and what makes longer ones a minute at most.
        trails: whether to draw them; if not given, for up to a hundred vehicles.

    Returns:
        The Meshcat; `web_url()` is its address, `StaticHtml()` the same as one page.

    Raises:
        ValueError: `rate` is not positive.
        OSError: no port is free.
    """
    if rate is not None and not (np.isfinite(rate) and rate > 0.0):
        raise ValueError(f"rate: got {rate}, expected a positive number")
    plan, windows = drawn(flown), windows_of(flown)
    meshcat = start_meshcat(host, port) if meshcat is None else meshcat
    scene = Scene.of(plan)
    meshcat.Delete(ROOT)
    meshcat.DeleteRecording()
    set_camera(meshcat, scene)
    add_surroundings(meshcat, scene, plan.scenario)
    add_obstacles(meshcat, scene, plan)
    if scene.light:
        add_light_goals(meshcat, scene, plan.scenario)
    else:
        add_ends(meshcat, scene, plan.scenario)
    _add_vehicles(meshcat, scene, plan)
    pace = Pace.of(plan, rate)
    meshcat.StartRecording(
        frames_per_second=pace.frames_per_second, set_visualizations_while_recording=False
    )
    _record_motion(meshcat, plan, pace)
    record_obstacles(meshcat, scene, plan, pace)
    if len(plan.positions) <= _MOST_TRAILS if trails is None else trails:
        (record_light_trails if scene.light else record_trails)(meshcat, scene, plan, pace)
    if not scene.light:
        record_predictions(meshcat, windows, pace)
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


def _add_vehicles(meshcat: Meshcat, scene: Scene, plan: Drawn) -> None:
    mesh = aircraft(scene.vehicle_length)
    for vehicle, colour in coloured(plan.scenario):
        path = _vehicle_path(vehicle.name)
        meshcat.SetTriangleMesh(path, *mesh, rgba=colour)
        if vehicle.radius > 0.0 and not scene.light:
            faint = Rgba(colour.r(), colour.g(), colour.b(), 0.15)
            meshcat.SetObject(f"{path}/radius", Ball(vehicle.radius), faint)


def _record_motion(meshcat: Meshcat, plan: Drawn, pace: Pace) -> None:
    motion = plan.motion()
    positions = motion.at("position", pace.times)
    headings = _headings(motion.at("velocity", pace.times))
    playback = [pace.playback(time) for time in pace.times]
    for vehicle, poses in zip(plan.scenario.vehicles, _poses(positions, headings), strict=True):
        path = _vehicle_path(vehicle.name)
        meshcat.SetTransform(path, RigidTransform(poses[0]))
        for time, pose in zip(playback, poses, strict=True):
            meshcat.SetTransform(path, RigidTransform(pose), time)


def _vehicle_path(name: str) -> str:
    return f"{ROOT}/vehicles/{as_path(name)}"


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


def _poses(positions: FloatArray, headings: FloatArray) -> FloatArray:
    """Nose along the heading, wings level: arrays of shape (N, M, 3) give (N, M, 3, 4)."""
    left = np.cross([0.0, 0.0, 1.0], headings)
    lengths = np.linalg.norm(left, axis=2, keepdims=True)
    steep = lengths <= 1e-6
    left = np.where(steep, [0.0, 1.0, 0.0], left / np.where(steep, 1.0, lengths))
    above = np.cross(headings, left)
    return np.stack([headings, left, above, positions], axis=3)
