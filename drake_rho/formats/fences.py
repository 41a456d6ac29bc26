"""Fences of missions as requirements (inclusion) and obstacles (exclusion), and back again.

A concave inclusion polygon is its convex hull without the pockets between hull and polygon, which
are no-fly zones. No-fly zones are cut into triangles that overlap by `OVERLAP`, as a vehicle
without a radius could fly between two that only touch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from drake_rho.formats.mission_items import Fence
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.frame import Frame
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.polygons import crosses_itself, triangulated, turn
from drake_rho.scenario.records import KeepIn, Scenario
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Polytope

OVERLAP = 0.01
"""Distance by which triangles of a zone overlap [m]; corners of the zone grow by it at most."""
_MOST_CORNERS = 200
"""Largest number of corners of a polygon, as every triangle is an obstacle."""
_FLAT = 1e-9
"""Area of a triangle, relative to the polygon's box, up to which it counts as none."""
_LEAST = 5e-4
"""Width of a triangle, as a part of its length or height, below which it is made wider by as much:
obstacles are no thinner than `THINNEST`."""
_BEYOND = 0.01
"""Distance by which pockets extend beyond the convex hull, as a part of its side."""
_SIMPLE = "a polygon whose sides do not cross"


@dataclasses.dataclass(frozen=True, eq=False)
class Zones:
    """Fences as parts of a scenario."""

    requirements: tuple[KeepIn, ...]
    """inclusion"""
    obstacles: tuple[Obstacle, ...]
    """exclusion"""


def zones_of(fences: tuple[Fence, ...], origin: Frame, heights: tuple[float, float]) -> Zones:
    """Return fences as requirements and obstacles.

    Args:
        fences: circles and polygons.
        origin: origin of the local positions.
        heights: least and greatest height of polygons [m], beyond which nobody flies.

    Raises:
        ScenarioError: a polygon has no area, crosses itself or has too many corners.
    """
    requirements, obstacles = list[KeepIn](), list[Obstacle]()
    for fence in fences:
        corners = _local(fence, origin)
        if fence.radius is not None:
            axis = Cylinder([*corners[0], 0.0], fence.radius)
            if fence.inclusion:
                requirements.append(KeepIn(axis, name=fence.name))
            else:
                obstacles.append(Obstacle(axis, name=fence.name))
            continue
        polygon = _anticlockwise(fence.name, corners)
        zones = [polygon]
        if fence.inclusion:
            hull = ConvexHull(polygon).vertices
            whole = _solid(fence.name, polygon[hull], heights)
            requirements.append(KeepIn(whole, name=fence.name))
            zones = list(_pockets(polygon, hull))
        for zone in zones:
            parts = _convex_parts(fence.name, zone, heights[1] - heights[0])
            solids = [_solid(fence.name, part, heights) for part in parts]
            obstacles += [Obstacle(each, name=fence.name) for each in solids]
    return Zones(tuple(requirements), tuple(obstacles))


def fences_of(
    scenario: Scenario, vehicle: str, origin: Frame, heights: tuple[float, float]
) -> tuple[Fence, ...]:
    """Return the fences that keep a vehicle in and out at all times and heights.

    These are upright, endless cylinders, and upright prisms that reach over the heights. No-fly
    zones in parts remain in parts.

    Args:
        scenario: scenario of the plan.
        vehicle: name of the vehicle.
        origin: origin of the local positions.
        heights: least and greatest height at which it flies [m].
    """
    inside = [
        each.set
        for each in scenario.requirements
        if (each.vehicles is None or vehicle in each.vehicles)
        and each.of == "position"
        and (each.relative_to, each.between, each.active, each.penalty) == (None,) * 4
    ]
    outside = [
        each.shape
        for each in scenario.bodies
        if each.is_steady and (each.active, each.penalty) == (None, None)
    ]
    found = list[Fence]()
    for inclusion, shapes in ((True, inside), (False, outside)):
        for shape in shapes:
            if isinstance(shape, Cylinder) and shape.axis == "z" and shape.height is None:
                corners, radius = shape.center[None, :2], float(shape.radius)
            elif isinstance(shape, Polytope) and (base := _base(shape, heights)) is not None:
                corners, radius = base, None
            else:
                continue
            level = np.column_stack([corners, np.zeros(len(corners))])
            found.append(Fence("", inclusion, origin.geodetic(level)[:, :2], radius))
    return tuple(found)


def _base(shape: Polytope, heights: tuple[float, float]) -> FloatArray | None:
    """Return the corners of an upright prism that reaches over heights, shape (M, 2), else None."""
    corners = shape.vertices
    lowest, highest = corners[:, 2].min(), corners[:, 2].max()
    top = corners[:, 2] == highest
    lower, upper = (np.unique(corners[each, :2], axis=0) for each in (~top, top))
    upright = np.array_equal(lower, upper) and (corners[~top, 2] == lowest).all()
    if not (upright and lowest <= heights[0] and heights[1] <= highest):
        return None
    return np.asarray(lower[ConvexHull(lower).vertices])


def _local(fence: Fence, origin: Frame) -> FloatArray:
    """Return the corners of a fence in local metres, shape (M, 2)."""
    if not np.all(np.abs(fence.corners) <= [90.0, 180.0]):  # also true for NaN
        expected = "latitudes within 90 degrees and longitudes within 180"
        raise ScenarioError(fence.name, fence.corners.tolist(), expected)
    latitudes, longitudes = fence.corners.T
    altitudes = np.full(len(fence.corners), origin.altitude)
    local = origin.local(latitudes, longitudes, altitudes)[:, :2]
    if np.abs(local).max() > 1e6:
        raise ScenarioError(fence.name, fence.corners.tolist(), "a fence within 1000 km of home")
    return local


def _solid(name: str, corners: FloatArray, heights: tuple[float, float]) -> Polytope:
    """Return a convex polygon between two heights.

    Raises:
        ScenarioError: it is too thin.
    """
    try:
        solid = Polytope(_extruded(corners, heights))
        solid.check_solid()
    except ScenarioError:
        got = Description("corners nearly on a line")
        expected = "a polygon that is no thinner than a ten-thousandth of its size"
        raise ScenarioError(name, got, expected) from None
    return solid


def _extruded(corners: FloatArray, tall: tuple[float, float]) -> FloatArray:
    """Return the corners of a polygon at both heights, shape (2 M, 3)."""
    return np.concatenate([np.column_stack([corners, np.full(len(corners), z)]) for z in tall])


def _anticlockwise(name: str, corners: FloatArray) -> FloatArray:
    """Return the corners of a simple polygon, anticlockwise, without repeated ones.

    Raises:
        ScenarioError: it has no area, crosses itself or has too many corners.
    """
    apart = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1) > OVERLAP
    corners = corners[apart]
    if not 3 <= len(corners) <= _MOST_CORNERS:
        expected = f"a polygon of 3 to {_MOST_CORNERS} different corners"
        count = max(len(corners), 1)
        got = "only one corner" if count == 1 else f"{count} corners"
        raise ScenarioError(name, Description(got), expected)
    try:
        ConvexHull(corners)
    except QhullError:
        raise ScenarioError(name, corners.tolist(), "a polygon with an area") from None
    if crosses_itself(corners):
        raise ScenarioError(name, corners.tolist(), _SIMPLE)
    area = turn(corners[0], corners, np.roll(corners, -1, axis=0)).sum()
    return corners if area > 0.0 else corners[::-1]


def _pockets(polygon: FloatArray, hull: IntArray) -> Iterator[FloatArray]:
    """Yield the polygons between a polygon and its convex hull, anticlockwise.

    They extend beyond the hull, so that a side with a slight dent leads to no flat one.
    """
    on_hull = np.sort(hull)
    for first, last in zip(on_hull, np.roll(on_hull, -1), strict=True):
        between = np.arange(first, last + 1 if last > first else last + 1 + len(polygon))
        if len(between) > 2:
            corners = polygon[between % len(polygon)][::-1]
            along = corners[0] - corners[-1]
            beyond = _BEYOND * np.array([along[1], -along[0]])
            yield np.concatenate([corners, [corners[-1] + 0.5 * along + beyond]])


def _convex_parts(name: str, polygon: FloatArray, height: float) -> list[FloatArray]:
    """Return a polygon as convex parts: itself, or overlapping triangles; thin ones are wider."""
    turns = turn(np.roll(polygon, 1, axis=0), polygon, np.roll(polygon, -1, axis=0))
    if np.all(turns >= 0.0):
        return [polygon]
    try:
        triangles = triangulated(polygon)
    except ValueError:
        raise ScenarioError(name, polygon.tolist(), _SIMPLE) from None
    flat = turn(*polygon[triangles].swapaxes(0, 1)) <= _FLAT * np.ptp(polygon, axis=0).prod()
    count, parts = len(polygon), list[FloatArray]()
    for triangle in triangles[~flat]:
        corners = [polygon[triangle]]
        longest = float(np.linalg.norm(np.ptp(corners[0], axis=0)))
        least = _LEAST * max(longest, height)
        thin = turn(*corners[0]) < least * longest
        for k in range(3):
            one, other = triangle[k], triangle[(k + 1) % 3]
            if thin or (one + 1) % count != other:  # a cut, not a side of the polygon
                along = polygon[other] - polygon[one]
                outward = np.array([along[1], -along[0]]) / np.linalg.norm(along)
                corners.append(polygon[[one, other]] + (least if thin else OVERLAP) * outward)
        parts.append(np.concatenate(corners))
    return parts
