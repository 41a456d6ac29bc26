"""Scenario in a certificate's file: what bounds are computed from, as numbers.

Limits, waypoints and requirements are all of one kind in a file: a quantity of vehicles stays in a
convex set, which may move, for an interval of time. Obstacles and the parts of maps are convex sets
to keep out of. All times are since the first knot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from drake_rho.analysis.terms import QUANTITIES
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.limits import Limits
from drake_rho.scenario.maps.parts import Boxes, Parts, Triangles
from drake_rho.scenario.norms import NORMS, Inclination, Kind
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Grid,
    Polytope,
    Scenario,
    Sphere,
    Vehicle,
)
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.sets import is_own
from drake_rho.scenario.shapes.posed import Posed
from drake_rho.scenario.shapes.unbounded import Cone, HalfSpace
from drake_rho.scenario.tracks import Track

_Held = dict[str, Any]


def of_scenario(scenario: Scenario, obstacles: Iterable[str] = ()) -> _Held:
    """Return the part of a scenario that bounds are computed from.

    Args:
        scenario: the scenario.
        obstacles: names in the file of obstacles and of parts of maps that a bound rests on.
            Without the other parts of its maps, a scenario has more plans, so the bound is one of
            theirs too.

    Raises:
        ValueError: the cost is not that of accelerations alone, or it has what files do not hold.
    """
    not_held = {
        "objective": not scenario.objective.is_effort,
        "disturbance": scenario.disturbance is not None,
        "smoothing": scenario.smoothing is not None,
        "penalties": bool(scenario.penalties),
    }
    if any(not_held.values()):
        fields = ", ".join(name for name, has in not_held.items() if has)
        raise ValueError(f"certificate: got a scenario with {fields}, which its files do not hold")
    separation, grid = scenario.separation, scenario.grid
    return {
        "name": scenario.name,
        "step": grid.step,
        "steps": grid.knots - 1,
        "tick": grid.clock.tick,
        "between_knots": scenario.between_knots,
        "separation": None if separation is None else separation.shape.semi_axes.tolist(),
        "vehicles": [_of_vehicle(each, grid) for each in scenario.vehicles],
        "kept": [*_kept(scenario)],
        "obstacles": _of_obstacles(scenario, {*obstacles}),
    }


def name_of(number: int, part: int) -> int | str:
    """Return the name of an obstacle in a file, or of a part of a map."""
    return number if part == 0 else f"{number}.{part}"


def _of_vehicle(vehicle: Vehicle, grid: Grid) -> _Held:
    """Return a vehicle's weight, radius, start, and goal as far as it is exact."""
    start, goal = vehicle.start, vehicle.goal
    velocity = np.zeros(3) if start.velocity is None else start.velocity
    reached = {"position": goal.position, "velocity": goal.velocity}
    exact = {name: each for name, each in reached.items() if isinstance(each, np.ndarray)}
    outside = [start.acceleration_outside, goal.acceleration_outside]
    if "velocity" not in exact:
        outside[1] = np.full(3, np.nan)  # it may arrive in motion
    return {
        "name": vehicle.name,
        "weight": vehicle.weight,
        "radius": vehicle.radius,
        "start": [start.position.tolist(), velocity.tolist()],
        "outside": [None if np.isnan(each).any() else each.tolist() for each in outside],
        "given": [[name, grid.duration, each.tolist()] for name, each in exact.items()],
    }


def _kept(scenario: Scenario) -> Iterator[_Held]:
    """Yield the convex sets that quantities stay in."""
    grid, names = scenario.grid, scenario.names
    for index, vehicle in enumerate(scenario.vehicles):
        for quantity, held, center in _of_limits(scenario.limits_of(vehicle)):
            yield _entry(quantity, [index], held, center)
        for each in vehicle.waypoints:
            assert each.time is not None  # noqa: S101  # plans have all times
            time = float(grid.since_start(each.time))
            ball = {"kind": "Sphere", "radius": each.within}
            yield _entry("position", [index], ball, each.position, active=[time, time])
    for number, requirement in enumerate(scenario.required, start=1):
        if requirement.interval(grid) is not None:
            yield _of_requirement(requirement.since(grid), number, names)


def _entry(
    quantity: str,
    vehicles: list[int],
    held: _Held,
    center: FloatArray,
    track: Track | None = None,
    **more: Any,
) -> _Held:
    """Return a convex set around a point, always required of single vehicles if not given."""
    always = {"partner": None, "active": None, "margin": 0.0}
    at = _places(track, lambda times: center + (0.0 if track is None else track.at(times)))
    return {"quantity": quantity, "vehicles": vehicles, "set": held, **always, **at, **more}


def _places(track: Track | None, at: Callable[[FloatArray], FloatArray]) -> _Held:
    """Return positions at the corners of a track, or one position without a track.

    Args:
        track: the track.
        at: function that returns positions at times, shape (T, 3).
    """
    times = np.zeros(1) if track is None else track.times
    return {
        "times": times.tolist(),
        "positions": np.broadcast_to(at(times), (len(times), 3)).tolist(),
        "goes_on": track is not None and track.after == "goes_on",
    }


def _of_limits(limits: Limits) -> Iterator[tuple[str, _Held, FloatArray]]:
    """Yield quantities, sets and their centres."""
    for quantity in QUANTITIES:
        if (box := getattr(limits, quantity)) is not None:
            yield quantity, _bounds(box), np.zeros(3)
    for norm, kind in NORMS.items():
        if (most := getattr(limits, norm)) is not None:
            yield kind.quantity, _of_norm(kind, most), kind.origin


def _of_norm(kind: Kind, most: float) -> _Held:
    if isinstance(kind, Inclination):
        return {"kind": "Cone", "axis": [0.0, 0.0, 1.0], "half_angle": most}
    return {"kind": "Sphere", "radius": most}


def _bounds(box: Box) -> _Held:
    return {"kind": "Bounds", "lower": box.lower.tolist(), "upper": box.upper.tolist()}


def _of_requirement(requirement: KeepIn, number: int, names: Sequence[str]) -> _Held:
    """Return a requirement.

    Raises:
        ValueError: its set is a user's own, or velocities are relative to a track.
    """
    track, convex_set = requirement.track, requirement.set
    if is_own(convex_set) or (track is not None and requirement.of != "position"):
        what = "a velocity relative to a track" if track is not None else "a set of one's own"
        raise ValueError(
            f"certificate: got {requirement.called(number)} with {what}, which its files do not "
            "hold"
        )
    held, center = _of_set(convex_set)
    offset = np.zeros(3) if track is not None else requirement.offset(np.zeros(1))[0]
    return _entry(
        requirement.quantity,
        requirement.members(names).tolist(),
        held,
        center + offset,
        track,
        partner=requirement.partner(names),
        active=requirement.active and list(requirement.active),
        margin=requirement.deviation,
    )


def _of_set(convex_set: Any) -> tuple[_Held, FloatArray]:
    """Return a convex set of the package relative to a point, and the point."""
    if isinstance(convex_set, HalfSpace):
        normal, offset = convex_set.normal.tolist(), convex_set.offset
        return {"kind": "HalfSpace", "normal": normal, "offset": offset}, np.zeros(3)
    if isinstance(convex_set, Cone):
        axis, half_angle = convex_set.axis.tolist(), convex_set.half_angle
        return {"kind": "Cone", "axis": axis, "half_angle": half_angle}, convex_set.apex
    if isinstance(convex_set, Box):  # its centre may not exist
        return _bounds(convex_set), np.zeros(3)
    return _of_shape(convex_set), convex_set.center


def _of_obstacles(scenario: Scenario, names: set[str]) -> _Held:
    """Return all obstacles, but only those parts of maps that have one of some names."""
    held = dict[str, Any]()
    for number, obstacle in scenario.avoided:
        shape = obstacle.shape
        if not isinstance(shape, Parts):
            held[str(number)] = _of_obstacle(obstacle, _of_shape(shape), np.zeros(3))
            continue
        for name in sorted(names):
            whole, _, part = name.partition(".")
            if whole == str(number):
                held[name] = _of_obstacle(obstacle, *_of_part(shape, int(part or 0)))
    return held


def _of_obstacle(obstacle: Obstacle, shape: _Held, middle: FloatArray) -> _Held:
    """Return an obstacle, at rest or on a track, or a part around a point of it."""
    return {
        "shape": shape,
        "margin": obstacle.deviation + obstacle.position_error,
        "growth": [obstacle.velocity_error, obstacle.errors_from],
        "active": obstacle.active and list(obstacle.active),
        **_places(obstacle.track, lambda times: obstacle.centers(times) + middle),
    }


def _of_part(map_: Parts, part: int) -> tuple[_Held, FloatArray]:
    """Return a part of a map, and its middle relative to the map's centre."""
    if isinstance(map_, Triangles):
        middle = map_.corners[part].mean(axis=0)
        return {"kind": "Triangle", "vertices": (map_.corners[part] - middle).tolist()}, middle
    assert isinstance(map_, Boxes)  # noqa: S101  # there are no other parts
    held, rotation = {"kind": "Box", "half": map_.halves[part].tolist()}, map_.in_world(np.eye(3)).T
    if np.any(rotation != np.eye(3)):
        held = {"kind": "Posed", "rotation": rotation.tolist(), "shift": [0.0] * 3, "shape": held}
    return held, map_.in_world(map_.centers[part])


def _of_shape(shape: Any) -> _Held:
    """Return a convex shape relative to its centre.

    Raises:
        ValueError: it is of another kind.
    """
    held: _Held = {"kind": type(shape).__name__}
    if isinstance(shape, Sphere):
        held["radius"] = shape.radius
    elif isinstance(shape, Box):
        held["half"] = ((shape.upper - shape.lower) / 2.0).tolist()
    elif isinstance(shape, Ellipsoid):
        held["semi_axes"] = shape.semi_axes.tolist()
    elif isinstance(shape, Polytope):
        held["vertices"] = (shape.vertices - shape.center).tolist()
    elif isinstance(shape, Capsule):
        ends = np.array([shape.start, shape.end]) - shape.center
        held |= {"radius": shape.radius, "vertices": ends.tolist()}
    elif isinstance(shape, Cylinder):
        half = None if shape.height is None else shape.height / 2.0
        held |= {"radius": shape.radius, "half_height": half, "axis": "xyz".index(shape.axis)}
    elif isinstance(shape, Posed):
        shift = shape.center - shape.rotation @ shape.shape.center - shape.translation
        rotation, inner = shape.rotation.tolist(), _of_shape(shape.shape)
        held |= {"rotation": rotation, "shift": shift.tolist(), "shape": inner}
    else:
        kind = type(shape).__name__
        raise ValueError(f"certificate: got a {kind}, which its files do not hold")
    return held
