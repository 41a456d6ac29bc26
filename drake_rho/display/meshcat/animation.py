"""Animation in Drake's Meshcat: the vehicles' motion through the scene, and the replanning."""

from __future__ import annotations

import dataclasses

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams

from drake_rho.display.common.drawable import Drawn, Prediction, drawn
from drake_rho.display.meshcat.obstacles import add_obstacles
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.ports import address_of, on_free_port
from drake_rho.display.meshcat.requirements import add_requirements
from drake_rho.display.meshcat.scene import (
    Scene,
    add_conflicts,
    add_ends,
    add_light_goals,
    add_straight_lines,
    add_surroundings,
    set_camera,
)
from drake_rho.display.meshcat.trails import (
    add_light_trails,
    add_measured,
    add_predictions,
    add_trails,
)
from drake_rho.display.meshcat.tree import ROOT, Tree
from drake_rho.display.meshcat.tubes_and_wind import add_disturbed
from drake_rho.display.meshcat.vehicles import Vehicles, add_vehicles
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario
from drake_rho.system.drake_log import keep_to_news

_OBJECTS_PER_VEHICLE = 4
"""Moving objects per vehicle of a simulation: vehicle, ghost, ball of the tube, wind arrow."""
_MAX_TRAILS = 100
"""Largest number of vehicles with trails by default: more would hide the vehicles."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """Data of a scene: motions, geometry, playback, vehicles."""

    shown: Drawn
    """motion to draw"""
    scene: Scene
    """extent of the scene and sizes of marks"""
    playback: Playback
    """mapping of flight time to playback time"""
    vehicles: Vehicles
    """appearance of the vehicles"""
    conflicts: InfeasibleError | None = None
    """error whose vehicles and obstacles are marked, if any"""

    @classmethod
    def of(
        cls,
        flown: Flown | Scenario,
        rate: float | None = None,
        conflicts: InfeasibleError | None = None,
        heading: Heading | None = None,
    ) -> Stage:
        """Prepare the display of `flown` at `rate` seconds of flight per second; see `animate`.

        Raises:
            ValueError: `rate` is not positive, or the heading is invalid.
        """
        if rate is not None and not (np.isfinite(rate) and rate > 0.0):
            raise ValueError(f"rate: got {rate}, expected a positive number")
        shown = drawn(flown)
        scene = Scene.of(shown)
        disturbed = shown.simulation is not None and not scene.light
        playback = Playback.of(shown, rate, _OBJECTS_PER_VEHICLE if disturbed else 1)
        vehicles = Vehicles.of(scene, shown, playback, heading)
        return cls(shown, scene, playback, vehicles, conflicts)

    @property
    def windows(self) -> tuple[Prediction, ...]:
        """Predictions of windows that are drawn; none in a light scene."""
        return () if self.scene.light else self.shown.windows

    @property
    def simulation(self) -> Simulation | None:
        """Simulation whose ghosts, tubes and wind are drawn, if any; none in a light scene."""
        return None if self.scene.light else self.shown.simulation

    @property
    def few_enough_for_trails(self) -> bool:
        """Whether trails are drawn by default."""
        return len(self.shown.positions) <= _MAX_TRAILS and self.shown.kind != "scenario"


@checked
def animate(
    flown: Flown | Scenario,
    *,
    conflicts: InfeasibleError | None = None,
    meshcat: Meshcat | None = None,
    host: str = "localhost",
    port: int | None = None,
    rate: float | None = None,
    trails: bool | None = None,
    heading: Heading | None = None,
) -> Meshcat:
    """Show a plan, flight, simulation or scenario in the browser, with Meshcat's time slider.

    Obstacles are translucent, and fainter until they become known; moving obstacles move. Trails
    grow as the vehicles fly. Starts are small balls and goals larger ones. For a `Flight`, the
    whole prediction of the window in force is drawn as a thin line, and measured positions
    (`Flight.measured`) as a dark one. Colours are those of the
    figures.

    A requirement of positions relative to another vehicle, or to a moving point, is a line between
    the two, which reddens as the margin shrinks. Sets required of single vehicles are faint and
    green. Both are visible while the requirement is active.

    A vehicle is drawn as an aircraft or a quadrotor, according to `Vehicle.airframe` or its limits.
    It is enlarged to be visible, but not into an obstacle, or past the midpoint to another vehicle
    if a separation is required. A faint ball around it shows its radius, which is its required
    distance from obstacles.

    The result is the scene alone; `viewer_page` adds names, numbers and controls.

    For a `Simulation` the vehicles follow their true motion. A ghost of each vehicle shows the
    position in the plan in force, inside a ball with the current radius of the error tube: while
    the disturbance stays within the scenario's bounds, the vehicle is in that ball. An arrow shows
    the wind on the vehicle.

    A `Scenario` is shown before it is planned: vehicles move along straight lines from their starts
    through their waypoints to their goals.

    More than 24 vehicles make a light scene with few objects: goals are small, trails thin, and
    starts, predictions, ghosts and the wind are omitted.

    Args:
        flown: plan, flight, simulation or scenario to show.
        conflicts: error of an infeasible scenario, whose vehicles and obstacles in conflict are
            marked in red.
        meshcat: Meshcat to draw in, emptied first; a new server if not given.
        host: network interface of a new server; "*" for all interfaces.
        port: first port to try for a new server; 7000 if not given.
        rate: seconds of flight per second of playback; if not given, 1 for flights of up to a
            minute, and for longer ones a rate that limits the playback to a minute.
        trails: whether to draw trails; if not given, for up to a hundred vehicles.
        heading: headings to which vehicles are turned, as for `rho.export`. If not given, they fly
            nose first, or as a simulation with headings was flown.

    Returns:
        The Meshcat; `web_url()` is its address, `StaticHtml()` returns it as a single page.

    Raises:
        ValueError: `rate` is not positive, or the heading is invalid.
        OSError: no port is free.
    """
    stage = Stage.of(flown, rate, conflicts, heading)
    meshcat = start_meshcat(host, port) if meshcat is None else meshcat
    draw(meshcat, stage, trails=stage.few_enough_for_trails if trails is None else trails)
    return meshcat


def draw(meshcat: Meshcat, stage: Stage, *, trails: bool) -> None:
    """Empty a Meshcat, then draw and record a stage in it."""
    plan, scene, scenario = stage.shown, stage.scene, stage.shown.scenario
    meshcat.Delete(ROOT)
    meshcat.DeleteRecording()
    meshcat.StartRecording(
        frames_per_second=stage.playback.frames_per_second,
        set_visualizations_while_recording=False,
    )
    tree = Tree(meshcat, stage.playback)
    set_camera(meshcat, scene)
    add_surroundings(tree, scene, scenario)
    add_obstacles(tree, scene, plan, stage.conflicts)
    add_requirements(tree, scene, plan)
    if plan.kind == "scenario":
        add_straight_lines(tree, plan)
    if stage.conflicts is not None:
        add_conflicts(tree, scene, scenario, stage.conflicts)
    add_vehicles(tree, scene, plan, stage.vehicles)
    if scene.light:
        add_light_goals(tree, scene, scenario)
        if trails:
            add_light_trails(tree, plan)
    else:
        add_ends(tree, scene, scenario)
        if trails:
            add_trails(tree, scene, plan)
        add_measured(tree, plan)
    add_predictions(tree, stage.windows)
    if stage.simulation is not None:
        add_disturbed(tree, scene, plan, stage.simulation, stage.vehicles)
    meshcat.StopRecording()
    meshcat.PublishRecording()


def start_meshcat(host: str = "localhost", port: int | None = None) -> Meshcat:
    """Start a new Meshcat server on `port`, or on the next free one.

    Args:
        host: network interface; "*" for all interfaces.
        port: first port to try, at least 1024; 7000 if not given.

    Raises:
        OSError: no port is free, or the interface does not exist.
        ValueError: the port is out of range.
    """
    address = address_of(host)
    keep_to_news()

    def start(number: int) -> Meshcat | None:
        try:
            return Meshcat(MeshcatParams(host=address, port=number, show_stats_plot=False))
        except RuntimeError:  # port in use
            return None

    return on_free_port(start, host, port)
