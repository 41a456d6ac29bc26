"""The scene in Meshcat: everything that stands still, at a size at which it is seen.

Everything is under /flight in the scene tree, in the scenario's own coordinates and metres.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from itertools import product

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba
from pydrake.geometry import Sphere as Ball
from pydrake.math import RigidTransform

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_path
from drake_rho.display.common.obstacle_snapshots import snapshots
from drake_rho.display.common.style import palette, vehicle_colours, view
from drake_rho.display.meshcat.meshes import box_edges, ground_grid, octahedron, scattered
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Box, Scenario, Vehicle

ROOT = "/flight"
MAX_DETAILED = 24
"""Most vehicles with ends, trails and predictions of their own; more make a light scene."""
_SEEN = 0.25
"""Least radius of a vehicle that is seen as what it is, in lengths at which things are drawn."""
_MAX_OUTLINE = 400
"""Most places of vehicles that a picture is made to hold."""
_BOX, _GROUND = Rgba(0.62, 0.64, 0.68), Rgba(0.8, 0.82, 0.85)
_LIGHT = [-6.0, 10.0, 8.0]
"""Where the light comes from, in three.js' axes (y is up)."""
_ASPECT = 1.4
"""Least width of a window over its height for which the whole scene is seen."""
_FIELD_OF_VIEW = 40.0
"""Of the camera, from top to bottom [deg]."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """Where everything is, and how large it has to be drawn to be seen."""

    lower: FloatArray
    """least coordinates of all that is shown [m], shape (3,)"""
    upper: FloatArray
    """greatest coordinates [m], shape (3,)"""
    vehicles: int
    """how many have to find room"""
    outline: FloatArray
    """places that a picture holds, of vehicles and corners around obstacles [m], shape (M, 3)"""

    @classmethod
    def of(cls, plan: Drawn) -> Scene:
        """The scene of a plan: its positions, obstacles, and the flyable boxes."""
        scenario = plan.scenario
        bounds = [(plan.positions.min(axis=(0, 1)), plan.positions.max(axis=(0, 1)))]
        bounds += [each.bounds for each in snapshots(plan, scenario.bodies)]
        ends = [each for each in bounds if np.all(np.isfinite(each))]
        flown = plan.positions.reshape(-1, 3)
        flown = flown[:: max(1, len(flown) // _MAX_OUTLINE)]
        outline = np.concatenate([flown, *(_corners(*each) for each in ends[1:])])
        bounds += [(box.lower, box.upper) for box in flyable_boxes(scenario)]
        lower = np.min([low for low, _ in bounds], axis=0)
        upper = np.max([high for _, high in bounds], axis=0)
        margin = 0.05 * float(np.max(upper - lower)) or 1.0
        return cls(lower - margin, upper + margin, len(scenario.vehicles), outline)

    @property
    def size(self) -> float:
        """Diagonal [m]."""
        return float(np.linalg.norm(self.upper - self.lower))

    @property
    def light(self) -> bool:
        """Whether there are so many vehicles that they are drawn without detail."""
        return self.vehicles > MAX_DETAILED

    @property
    def mark_length(self) -> float:
        """Length at which things are drawn [m]: large enough to be seen, small enough for all."""
        return float(self.size * 0.06 / max(1.0, self.vehicles / 4) ** 0.25)

    @property
    def seen(self) -> float:
        """Least radius of a vehicle that is drawn so that it can be seen [m]."""
        return _SEEN * self.mark_length

    @property
    def trail_radius(self) -> float:
        """Half the width of a trail [m]: thin beside the vehicle."""
        return 0.07 * self.seen


def _corners(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Corners of a box [m], shape (8, 3)."""
    return np.array(list(product(*np.array([lower, upper]).T)))


def set_camera(meshcat: Meshcat, scene: Scene) -> None:
    """Look at the whole scene from where the figures do."""
    centre = (scene.lower + scene.upper) / 2
    camera = Meshcat.PerspectiveCamera(
        fov=_FIELD_OF_VIEW, near=scene.size / 1e3, far=scene.size * 1e2
    )
    meshcat.SetCamera(camera)
    right, up, towards = view()
    corners = _corners(scene.lower, scene.upper) - centre
    half = np.tan(np.radians(_FIELD_OF_VIEW / 2))
    # From a distance d a corner is seen if its offset is within the half-angle of d less its depth.
    sideways = np.abs(corners @ right) / (_ASPECT * half) + corners @ towards
    upwards = np.abs(corners @ up) / half + corners @ towards
    distance = 1.05 * max(float(sideways.max()), float(upwards.max()))
    meshcat.SetCameraPose(centre + distance * towards, centre)


def add_surroundings(meshcat: Meshcat, scene: Scene, scenario: Scenario) -> None:
    """Light, flyable boxes, a ground grid; Meshcat's own grid and axes are of 1 m."""
    for name in ("/Grid", "/Axes"):
        meshcat.SetProperty(name, "visible", False)
    # Meshcat's lamps hang a metre or two from the origin; light from afar suits every scale.
    for lamp in ("PointLightNegativeX", "PointLightPositiveX"):
        meshcat.SetProperty(f"/Lights/{lamp}", "visible", False)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.4)
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 3.0)
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", _LIGHT)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.90, 0.93, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [1.0, 1.0, 1.0])
    for number, box in enumerate(flyable_boxes(scenario), start=1):
        path = f"{ROOT}/flyable/{number}"
        meshcat.SetLineSegments(path, *box_edges(box.lower, box.upper), rgba=_BOX)
    boxes = flyable_boxes(scenario)
    lower = np.min([box.lower for box in boxes], axis=0) if boxes else scene.lower
    upper = np.max([box.upper for box in boxes], axis=0) if boxes else scene.upper
    meshcat.SetLineSegments(f"{ROOT}/ground", *ground_grid(lower, upper), rgba=_GROUND)


def add_ends(meshcat: Meshcat, scene: Scene, scenario: Scenario) -> None:
    """Starts and goals in the vehicles' colours, as small and larger balls."""
    size = 2.0 * scene.seen
    shared = Counter(tuple(vehicle.goal.position) for vehicle in scenario.vehicles)
    for vehicle, colour in coloured(scenario):
        alone = shared[tuple(vehicle.goal.position)] == 1
        for kind, state, radius, shown in (
            ("starts", vehicle.start, 0.13, colour),
            ("goals", vehicle.goal, 0.25, colour if alone else Rgba(0.1, 0.1, 0.1)),
        ):
            path = f"{ROOT}/{kind}/{as_path(vehicle.name)}"
            meshcat.SetObject(path, Ball(radius * size), shown)
            meshcat.SetTransform(path, RigidTransform(state.position))


def add_light_goals(meshcat: Meshcat, scene: Scene, scenario: Scenario) -> None:
    """Goals as small octahedra in the vehicles' colours, those of one colour in one object."""
    mark = octahedron(0.24 * scene.seen)
    goals = np.array([vehicle.goal.position for vehicle in scenario.vehicles])
    colours = palette(len(goals))
    for number, colour in enumerate(colours, start=1):
        marks = scattered(mark, goals[number - 1 :: len(colours)])
        meshcat.SetTriangleMesh(f"{ROOT}/goals/{number}", *marks, rgba=Rgba(*to_rgb(colour)))


def flyable_boxes(scenario: Scenario) -> list[Box]:
    """The position boxes of all vehicles, each once."""
    boxes: list[Box] = []
    for vehicle in scenario.vehicles:
        box = scenario.limits_of(vehicle).position
        if box is not None and box not in boxes:
            boxes.append(box)
    return boxes


def coloured(scenario: Scenario) -> Iterator[tuple[Vehicle, Rgba]]:
    """The vehicles with the colours they have in the figures."""
    colours = vehicle_colours(len(scenario.vehicles))
    for vehicle, colour in zip(scenario.vehicles, colours, strict=True):
        yield vehicle, Rgba(*to_rgb(colour))
