"""The swarm in Meshcat, Drake's own: the vehicles' way through the scene, and the replanning.

/flight/vehicles/<name> in the scene tree is the vehicle's pose, x along its velocity; a `/` in
its name is %2F there (`names.as_path`), so that no vehicle lies under another.
"""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, Rgba
from pydrake.geometry import Sphere as Ball

from drake_rho.display.bodies import add_obstacles, record_obstacles
from drake_rho.display.disturbed import add_disturbed, record_disturbed
from drake_rho.display.flown import Drawn, Flown, drawn, windows_of
from drake_rho.display.names import as_path
from drake_rho.display.pace import Pace
from drake_rho.display.poses import headings, poses, record_poses
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
from drake_rho.motion.simulation import Simulation

_OF_EACH = 4
"""What moves of each vehicle of a simulation: itself, its ghost, its ball, its wind."""
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
    """Show a plan, a flight or a simulation in the browser, with Meshcat's time slider.

    Obstacles are translucent, and fainter until they are known; those that move do so. Trails grow
    as they are flown, starts are small balls and goals larger ones; with a `Flight`, each window's
    whole prediction is drawn as a thin line while it is the one that is flown. Colours are those of
    the figures. Where there is a separation, a vehicle is drawn within half of it around its
    position, so that what is apart does not touch, unless that would be too small to be seen in the
    scene. A faint ball around a vehicle is its radius, which it keeps from obstacles.

    With a `Simulation` the vehicles are where they truly were. A ghost of each is where the plan in
    force had it, in a ball of the radius that its tube has then: while the disturbance is as the
    scenario says, the vehicle is in it. An arrow is the wind on the vehicle; its key says how
    strong.

    More than 24 vehicles make a light scene, in which little but the vehicles is an object: goals
    are small, trails thin, and starts, names, predictions, ghosts and the wind are
    left out.

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
    disturbed = isinstance(flown, Simulation) and not scene.light
    pace = Pace.of(plan, rate, _OF_EACH if disturbed else 1)
    meshcat.StartRecording(
        frames_per_second=pace.frames_per_second, set_visualizations_while_recording=False
    )
    _record_motion(meshcat, plan, pace)
    record_obstacles(meshcat, scene, plan, pace)
    if len(plan.positions) <= _MOST_TRAILS if trails is None else trails:
        (record_light_trails if scene.light else record_trails)(meshcat, scene, plan, pace)
    if not scene.light:
        record_predictions(meshcat, windows, pace)
        if isinstance(flown, Simulation):
            add_disturbed(meshcat, scene, flown)
            record_disturbed(meshcat, flown, pace)
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
    ahead = headings(motion.at("velocity", pace.times))
    for vehicle, each in zip(plan.scenario.vehicles, poses(positions, ahead), strict=True):
        record_poses(meshcat, _vehicle_path(vehicle.name), each, pace)


def _vehicle_path(name: str) -> str:
    return f"{ROOT}/vehicles/{as_path(name)}"
