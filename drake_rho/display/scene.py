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

from drake_rho.display.flown import Drawn
from drake_rho.display.names import as_path, brief
from drake_rho.display.shapes import box_edges, ground_grid, octahedron, scattered, words
from drake_rho.display.snapshots import snapshots
from drake_rho.display.style import palette, vehicle_colours, view
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Box, Scenario, Separation, Vehicle

ROOT = "/flight"
MOST_DETAILED = 24
"""Most vehicles with ends, trails and predictions of their own; more make a light scene."""
MOST_NAMES = 12
"""Most vehicles whose names are written beside their starts, and most names of obstacles."""
_LEAST_SEEN = 0.25
"""Least length of a vehicle, of that at which it is drawn if there is no separation."""
_LIGHT = [-3.0, 10.0, 8.0]
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
    separation: Separation | None
    """how far they keep apart"""
    radius: float = 0.0
    """the least of how far each keeps from obstacles [m]"""

    @classmethod
    def of(cls, plan: Drawn) -> Scene:
        """The scene of a plan: its positions, obstacles, and the flyable boxes."""
        scenario = plan.scenario
        bounds = [(plan.positions.min(axis=(0, 1)), plan.positions.max(axis=(0, 1)))]
        bounds += [each.bounds for each in snapshots(plan, scenario.bodies)]
        bounds += [(box.lower, box.upper) for box in flyable_boxes(scenario)]
        lower = np.min([low for low, _ in bounds], axis=0)
        upper = np.max([high for _, high in bounds], axis=0)
        margin = 0.05 * float(np.max(upper - lower)) or 1.0
        least = float(np.min(scenario.fleet.radii))
        count, apart = len(scenario.vehicles), scenario.separation
        return cls(lower - margin, upper + margin, count, apart, least)

    @property
    def size(self) -> float:
        """Diagonal [m]."""
        return float(np.linalg.norm(self.upper - self.lower))

    @property
    def light(self) -> bool:
        """Whether there are so many vehicles that they are drawn without detail."""
        return self.vehicles > MOST_DETAILED

    @property
    def mark_length(self) -> float:
        """Length at which things are drawn [m]: large enough to be seen, small enough for all."""
        return float(self.size * 0.06 / max(1.0, self.vehicles / 4) ** 0.25)

    @property
    def vehicle_length(self) -> float:
        """Length at which a vehicle is drawn [m].

        Where there is a separation, within the ellipsoid of half of it around the position, and
        within the radius if that is not zero, so that what is apart does not touch; but never too
        small to be seen.
        """
        within = 1.5 * self.radius if self.radius > 0.0 else np.inf
        if self.separation is not None:
            apart = self.separation.distance * min(1.0, self.separation.downwash)
            within = min(within, 0.75 * apart)
        return min(self.mark_length, max(within, _LEAST_SEEN * self.mark_length))

    @property
    def trail_radius(self) -> float:
        """Half the width of a trail [m]: thin beside the vehicle."""
        return min(0.05 * self.mark_length, 0.1 * self.vehicle_length)


def set_camera(meshcat: Meshcat, scene: Scene) -> None:
    """Look at the whole scene from where the figures do."""
    centre = (scene.lower + scene.upper) / 2
    camera = Meshcat.PerspectiveCamera(
        fov=_FIELD_OF_VIEW, near=scene.size / 1e3, far=scene.size * 1e2
    )
    meshcat.SetCamera(camera)
    right, up, towards = view()
    corners = np.array(list(product(*np.array([scene.lower, scene.upper]).T))) - centre
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
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.8)
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 1.5)
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", _LIGHT)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.90, 0.93, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [1.0, 1.0, 1.0])
    for number, box in enumerate(flyable_boxes(scenario), start=1):
        path = f"{ROOT}/flyable/{number}"
        meshcat.SetLineSegments(path, *box_edges(box.lower, box.upper), rgba=Rgba(0.3, 0.3, 0.3))
    boxes = flyable_boxes(scenario)
    lower = np.min([box.lower for box in boxes], axis=0) if boxes else scene.lower
    upper = np.max([box.upper for box in boxes], axis=0) if boxes else scene.upper
    meshcat.SetLineSegments(
        f"{ROOT}/ground", *ground_grid(lower, upper), rgba=Rgba(0.75, 0.75, 0.78)
    )


def add_ends(meshcat: Meshcat, scene: Scene, scenario: Scenario) -> None:
    """Starts and goals in the vehicles' colours, with their names if they are few."""
    size = scene.vehicle_length
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
        if len(scenario.vehicles) <= MOST_NAMES and vehicle.name.strip():
            right, up, _ = view()
            above = vehicle.start.position + 0.7 * scene.mark_length * up
            letters = words(brief(vehicle.name), 0.4 * scene.mark_length, above, right, up)
            path = f"{ROOT}/names/{as_path(vehicle.name)}"
            meshcat.SetTriangleMesh(path, *letters, rgba=colour)


def add_light_goals(meshcat: Meshcat, scene: Scene, scenario: Scenario) -> None:
    """Goals as small octahedra in the vehicles' colours, those of one colour in one object."""
    mark = octahedron(0.12 * scene.vehicle_length)
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
