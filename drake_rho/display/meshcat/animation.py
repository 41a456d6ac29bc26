"""The swarm in Meshcat, Drake's own: the vehicles' way through the scene, and the replanning."""

from __future__ import annotations

import dataclasses

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams

from drake_rho.display.common.drawable import Drawn, Flown, drawn, windows_of
from drake_rho.display.meshcat.obstacles import add_obstacles, record_obstacles
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.ports import address_of, on_free_port
from drake_rho.display.meshcat.scene import (
    ROOT,
    Scene,
    add_ends,
    add_light_goals,
    add_surroundings,
    set_camera,
)
from drake_rho.display.meshcat.trails import record_light_trails, record_predictions, record_trails
from drake_rho.display.meshcat.tubes_and_wind import add_disturbed, record_disturbed
from drake_rho.display.meshcat.vehicles import Vehicles, add_vehicles, record_vehicles
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.arguments import checked

_OBJECTS_PER_VEHICLE = 4
"""What moves of each vehicle of a simulation: itself, its ghost, its ball, its wind."""
_MAX_TRAILS = 100
"""Most vehicles whose trails are drawn without being asked for: more would hide the vehicles."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """What is shown, and how: everything that a scene is drawn from."""

    flown: Flown
    """what was planned or flown"""
    shown: Drawn
    """the motions that are drawn"""
    scene: Scene
    """where everything is"""
    playback: Playback
    """when it is played"""
    vehicles: Vehicles
    """how vehicles are drawn"""

    @classmethod
    def of(cls, flown: Flown, rate: float | None = None) -> Stage:
        """How something is shown at `rate` seconds of flight in a second; see `animate`.

        Raises:
            ValueError: `rate` is not positive.
        """
        if rate is not None and not (np.isfinite(rate) and rate > 0.0):
            raise ValueError(f"rate: got {rate}, expected a positive number")
        shown = drawn(flown)
        scene = Scene.of(shown)
        disturbed = isinstance(flown, Simulation) and not scene.light
        playback = Playback.of(shown, rate, _OBJECTS_PER_VEHICLE if disturbed else 1)
        return cls(flown, shown, scene, playback, Vehicles.of(scene, shown, playback))

    @property
    def few_enough_for_trails(self) -> bool:
        """Whether trails are drawn without being asked for."""
        return len(self.shown.positions) <= _MAX_TRAILS


@checked
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
    the figures. A vehicle is drawn as an aircraft or a quadrotor, as `Vehicle.airframe` or its
    limits say, and large enough to be seen, but smaller where it would reach into an obstacle, or
    past the middle between it and another vehicle from which it keeps apart. A faint ball around it
    is its radius, which it keeps from obstacles.

    This is the scene alone; `viewer_page` is the same with names, numbers and controls over it.

    With a `Simulation` the vehicles are where they truly were. A ghost of each is where the plan in
    force had it, in a ball of the radius that its tube has then: while the disturbance is as the
    scenario says, the vehicle is in it. An arrow is the wind on the vehicle.

    More than 24 vehicles make a light scene, in which little but the vehicles is an object: goals
    are small, trails thin, and starts, predictions, ghosts and the wind are left out.

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
    stage = Stage.of(flown, rate)
    meshcat = start_meshcat(host, port) if meshcat is None else meshcat
    draw(meshcat, stage, trails=stage.few_enough_for_trails if trails is None else trails)
    return meshcat


def draw(meshcat: Meshcat, stage: Stage, *, trails: bool) -> None:
    """Draw and record a stage in a Meshcat, which is emptied first."""
    plan, scene, vehicles, playback = stage.shown, stage.scene, stage.vehicles, stage.playback
    meshcat.Delete(ROOT)
    meshcat.DeleteRecording()
    set_camera(meshcat, scene)
    add_surroundings(meshcat, scene, plan.scenario)
    add_obstacles(meshcat, scene, plan)
    if scene.light:
        add_light_goals(meshcat, scene, plan.scenario)
    else:
        add_ends(meshcat, scene, plan.scenario)
    add_vehicles(meshcat, scene, plan, vehicles)
    meshcat.StartRecording(
        frames_per_second=playback.frames_per_second, set_visualizations_while_recording=False
    )
    record_vehicles(meshcat, plan, vehicles, playback)
    record_obstacles(meshcat, scene, plan, playback)
    if trails:
        (record_light_trails if scene.light else record_trails)(meshcat, scene, plan, playback)
    if not scene.light:
        record_predictions(meshcat, windows_of(stage.flown), playback)
        if isinstance(stage.flown, Simulation):
            add_disturbed(meshcat, scene, stage.flown, vehicles)
            record_disturbed(meshcat, stage.flown, vehicles, playback)
    meshcat.StopRecording()
    meshcat.PublishRecording()


def start_meshcat(host: str = "localhost", port: int | None = None) -> Meshcat:
    """A new Meshcat server on `port`, or on the next free one.

    Args:
        host: network interface; "*" is every one.
        port: first port to try, at least 1024; 7000 if not given.

    Raises:
        OSError: no port is free, or the interface is not there.
        ValueError: the port is out of range.
    """
    address = address_of(host)

    def start(number: int) -> Meshcat | None:
        try:
            return Meshcat(MeshcatParams(host=address, port=number, show_stats_plot=False))
        except RuntimeError:  # in use
            return None

    return on_free_port(start, host, port)
