"""Static objects of the scene in Meshcat, at visible sizes."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from itertools import product

import numpy as np
from pydrake.geometry import Meshcat, Rgba

from drake_rho.display.common.drawable import Drawn, goal_point
from drake_rho.display.common.hidden import best_from_above
from drake_rho.display.common.names import as_path
from drake_rho.display.common.obstacle_snapshots import snapshots
from drake_rho.display.common.set_surfaces import requirements_near
from drake_rho.display.common.shape_faces import surface
from drake_rho.display.common.style import (
    CONFLICT,
    STEEP_ELEVATION,
    VIEW_ELEVATION,
    palette,
    vehicle_colours,
    view,
)
from drake_rho.display.meshcat.meshes import ground_grid, octahedron, scattered
from drake_rho.display.meshcat.tree import Tree, rgba
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Box, Scenario, Vehicle

MAX_DETAILED = 24
"""Largest number of vehicles with starts, goals, trails and predictions as objects of their own.

More vehicles make a light scene.
"""
_SEEN = 0.25
"""Least radius at which a vehicle can be recognised, over `Scene.mark_length`."""
_MAX_OUTLINE = 400
"""Largest number of vehicle positions for fitting the camera."""
_BOX, _GROUND = Rgba(0.62, 0.64, 0.68), Rgba(0.8, 0.82, 0.85)
_LIGHT = [-6.0, 10.0, 8.0]
"""Position of the light, in the axes of three.js (y is up)."""
_ASPECT = 1.4
"""Least aspect ratio, width over height, of a window in which the whole scene is visible."""
_FIELD_OF_VIEW = 40.0
"""Vertical field of view of the camera [deg]."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """Extent of the scene, and visible sizes of marks."""

    lower: FloatArray
    """least coordinates of the scene [m], shape (3,)"""
    upper: FloatArray
    """greatest coordinates of the scene [m], shape (3,)"""
    vehicles: int
    """number of vehicles"""
    outline: FloatArray
    """points for fitting the camera: positions of vehicles and corners of the bounding boxes of
    obstacles and of requirements [m], shape (M, 3)"""
    elevation: float = VIEW_ELEVATION
    """angle of the viewpoint above the horizon [deg]"""

    @classmethod
    def of(cls, plan: Drawn) -> Scene:
        """Return the scene that contains a plan's positions, obstacles and position limits.

        Required sets of positions are included where they are near.
        """
        scenario = plan.scenario
        bounds = [(plan.positions.min(axis=(0, 1)), plan.positions.max(axis=(0, 1)))]
        shown = snapshots(plan, scenario.bodies)
        bounds += [each.bounds for each in shown]
        bounds += requirements_near(plan, bounds)
        ends = [each for each in bounds if np.all(np.isfinite(each))]
        flown = plan.positions.reshape(-1, 3)
        flown = flown[:: max(1, len(flown) // _MAX_OUTLINE)]
        elevation = STEEP_ELEVATION if best_from_above(flown, shown) else VIEW_ELEVATION
        outline = np.concatenate([flown, *(_corners(*each) for each in ends[1:])])
        bounds += [(box.lower, box.upper) for box in flyable_boxes(scenario)]
        lower = np.min([low for low, _ in bounds], axis=0)
        upper = np.max([high for _, high in bounds], axis=0)
        margin = 0.05 * float(np.max(upper - lower)) or 1.0
        return cls(lower - margin, upper + margin, len(scenario.vehicles), outline, elevation)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest coordinates of the scene [m], (3,) each."""
        return self.lower, self.upper

    @property
    def size(self) -> float:
        """Length of the diagonal [m]."""
        return float(np.linalg.norm(self.upper - self.lower))

    @property
    def light(self) -> bool:
        """Whether there are too many vehicles to draw them in detail."""
        return self.vehicles > MAX_DETAILED

    @property
    def mark_length(self) -> float:
        """Reference length of marks [m]: large enough to be seen, small enough not to overlap."""
        return float(self.size * 0.06 / max(1.0, self.vehicles / 4) ** 0.25)

    @property
    def seen(self) -> float:
        """Least radius at which a vehicle can be recognised [m]."""
        return _SEEN * self.mark_length

    @property
    def trail_radius(self) -> float:
        """Radius of a trail [m], thin in comparison with the vehicle."""
        return 0.07 * self.seen


def _corners(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the corners of a box [m], shape (8, 3)."""
    return np.array(list(product(*np.array([lower, upper]).T)))


def set_camera(meshcat: Meshcat, scene: Scene) -> None:
    """Show the whole scene, from the viewpoint of the figures or from higher up."""
    centre = (scene.lower + scene.upper) / 2
    camera = Meshcat.PerspectiveCamera(
        fov=_FIELD_OF_VIEW, near=scene.size / 1e3, far=scene.size * 1e2
    )
    meshcat.SetCamera(camera)
    right, up, to_viewer = view(scene.elevation)
    corners = _corners(scene.lower, scene.upper) - centre
    half = np.tan(np.radians(_FIELD_OF_VIEW / 2))
    # From a distance d a corner at a depth z towards the camera is visible if its offset is at most
    # (d - z) times the tangent of the half-angle.
    sideways = np.abs(corners @ right) / (_ASPECT * half) + corners @ to_viewer
    upwards = np.abs(corners @ up) / half + corners @ to_viewer
    distance = 1.05 * max(float(sideways.max()), float(upwards.max()))
    meshcat.SetCameraPose(centre + distance * to_viewer, centre)


def add_surroundings(tree: Tree, scene: Scene, scenario: Scenario) -> None:
    """Add light, flyable boxes and a ground grid, and hide Meshcat's own grid and axes of 1 m."""
    meshcat = tree.meshcat
    for name in ("/Grid", "/Axes"):
        meshcat.SetProperty(name, "visible", False)
    # Meshcat's lamps are a metre or two from the origin; distant light suits every scale.
    for lamp in ("PointLightNegativeX", "PointLightPositiveX"):
        meshcat.SetProperty(f"/Lights/{lamp}", "visible", False)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.4)
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 3.0)
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", _LIGHT)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.90, 0.93, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [1.0, 1.0, 1.0])
    boxes = flyable_boxes(scenario)
    for number, box in enumerate(boxes, start=1):
        tree.add_lines(f"flyable/{number}", surface(box).moved(box.center).edges, _BOX)
    lower = np.min([box.lower for box in boxes], axis=0) if boxes else scene.lower
    upper = np.max([box.upper for box in boxes], axis=0) if boxes else scene.upper
    tree.add_lines("ground", ground_grid(lower, upper), _GROUND)


def add_ends(tree: Tree, scene: Scene, scenario: Scenario) -> None:
    """Add starts (small balls), goals (large balls) and waypoints (octahedra), coloured."""
    size = 2.0 * scene.seen
    shared = Counter(tuple(goal) for each in scenario.vehicles for goal in goal_point(each))
    for vehicle, colour in coloured(scenario):
        name = as_path(vehicle.name)
        tree.add_ball(f"starts/{name}", 0.13 * size, colour)
        tree.place(f"starts/{name}", vehicle.start.position)
        for goal in goal_point(vehicle):
            unique = shared[tuple(goal)] == 1
            tree.add_ball(f"goals/{name}", 0.25 * size, colour if unique else Rgba(0.1, 0.1, 0.1))
            tree.place(f"goals/{name}", goal)
        if vehicle.waypoints:
            passed = np.array([waypoint.position for waypoint in vehicle.waypoints])
            tree.add_mesh(f"waypoints/{name}", scattered(octahedron(0.16 * size), passed), colour)


def add_straight_lines(tree: Tree, plan: Drawn) -> None:
    """Add the straight lines of a scenario, from starts through waypoints to goals."""
    for (vehicle, colour), positions in zip(coloured(plan.scenario), plan.positions, strict=True):
        tree.add_lines(f"lines/{as_path(vehicle.name)}", [positions], colour)


def add_conflicts(tree: Tree, scene: Scene, scenario: Scenario, error: InfeasibleError) -> None:
    """Mark starts and goals of the vehicles in conflict with translucent red balls."""
    for vehicle in scenario.vehicles:
        if vehicle.name in error.conflicts:
            ends = [("start", vehicle.start.position)]
            for kind, position in (*ends, *(("goal", each) for each in goal_point(vehicle))):
                path = f"conflicts/{as_path(vehicle.name)}/{kind}"
                tree.add_ball(path, 1.2 * scene.seen, rgba(CONFLICT, 0.35))
                tree.place(path, position)


def add_light_goals(tree: Tree, scene: Scene, scenario: Scenario) -> None:
    """Add goals as small octahedra in the vehicles' colours, one object per colour."""
    mark = octahedron(0.24 * scene.seen)
    goals = scenario.fleet.given_goals("position")
    colours = palette(len(goals))
    for number, colour in enumerate(colours, start=1):
        own = goals[number - 1 :: len(colours)]
        marks = scattered(mark, own[np.isfinite(own[:, 0])])
        tree.add_mesh(f"goals/{number}", marks, rgba(colour))


def flyable_boxes(scenario: Scenario) -> list[Box]:
    """Return the distinct position limits of all vehicles."""
    boxes: list[Box] = []
    for vehicle in scenario.vehicles:
        box = scenario.limits_of(vehicle).position
        if box is not None and box not in boxes:
            boxes.append(box)
    return boxes


def coloured(scenario: Scenario) -> Iterator[tuple[Vehicle, Rgba]]:
    """Yield the vehicles with their colours in the figures."""
    colours = vehicle_colours(len(scenario.vehicles))
    for vehicle, colour in zip(scenario.vehicles, colours, strict=True):
        yield vehicle, rgba(colour)
