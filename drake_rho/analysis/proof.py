"""What a certificate's file holds: the scenario, the branches and their multipliers, as numbers.

`check_certificate` reads it. Multipliers are those of a Lagrangian in SI units whose rows have
length one in accelerations times the roots of their vehicles' weights.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from drake_rho.analysis.check_certificate import FORMAT, CheckedBound, digest_of, proved_by
from drake_rho.analysis.nodes import Node, Split
from drake_rho.analysis.terms import QUANTITIES
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.limits import Limits
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
    State,
    Vehicle,
    Waypoint,
)
from drake_rho.system.files import atomic_write

Proved = tuple[IntArray, dict[str, Any]]
"""Group of vehicles, and the tree of branches that bounds its cost."""


class Proof:
    """Tree of branches of a group of vehicles, which grows as nodes are split.

    Args:
        root: node of all motions.

    Attributes:
        content: the tree as a certificate's file has it.
    """

    def __init__(self, root: Node) -> None:
        self.content = of_node(root)
        self._of = WeakKeyDictionary({root: self.content})

    def split(self, node: Node, result: Split) -> None:
        """Replace a node by its parts."""
        content, where = self._of.pop(node), result.where
        content.clear()
        if where is None:  # the same motions with a better bound
            (better,) = result.parts
            content.update(of_node(better))
            self._of[better] = content
            return
        parts = [of_node(part) for part in result.parts]
        self._of.update(zip(result.parts, parts, strict=True))
        at = [where.vehicle, where.partner, where.obstacle, result.time]
        content.update(at=at, scales=result.scales.tolist(), parts=parts)
        regions = [part.branch[where] for part in result.parts]
        if where not in node.branch and not regions[0].is_beside_box:
            content["cones"] = [each.edges.tolist() for each in regions]
        if where.part > 0:
            content["part"] = where.part


def of_node(node: Node) -> dict[str, Any]:
    """Return a node's terms and multipliers."""
    curved, rows, kept = node.curved, node.affine, node.affine.kept
    weights, multipliers = node.unit**2 * node.weights, node.unit * node.multipliers
    of_curved = [
        *(curved.obstacles, curved.vehicles, curved.partners, curved.times),
        *(curved.centers, curved.scales, curved.radii, weights),
    ]
    names = np.array(QUANTITIES)[rows.quantities]
    of_rows = [names, rows.vehicles, rows.partners, rows.times, rows.normals, rows.bounds]
    return {
        "curved": _table(each[weights > 0.0] for each in of_curved),
        "rows": _table(each[~kept & (multipliers > 0.0)] for each in [*of_rows, multipliers]),
        "sides": multipliers[kept].tolist(),
    }


def _table(columns: Any) -> list[list[Any]]:
    return [list(row) for row in zip(*(each.tolist() for each in columns), strict=True)]


def written(path: Path, scenario: Scenario, proofs: Sequence[Proved]) -> CheckedBound:
    """Write a certificate, once it has been checked, and return the bound that it proves.

    Raises:
        OSError: the file cannot be written.
        ValueError: the scenario has what certificate files do not hold.
    """
    groups = [{"vehicles": group.tolist(), "tree": tree} for group, tree in proofs]
    text = json.dumps({"scenario": of_scenario(scenario), "groups": groups})
    content = json.loads(text)  # as it will be read
    try:
        proved = proved_by(content)
    except ValueError as error:
        raise ValueError(f"certificate: its files do not hold what it rests on: {error}") from None
    stored = {"format": FORMAT, "digest": digest_of(content), "content": content}
    data = gzip.compress(json.dumps(stored).encode(), mtime=0)
    with atomic_write(path) as file:
        file.write(data)
    return proved


def of_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the part of a scenario that bounds are computed from.

    Raises:
        ValueError: the cost is not that of accelerations alone, or is that of a tightened problem.
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
        "between_knots": scenario.between_knots,
        "separation": None if separation is None else separation.shape.semi_axes.tolist(),
        "vehicles": [_of_vehicle(each, scenario) for each in scenario.vehicles],
        "obstacles": {
            str(number): _of_obstacle(each, number, scenario) for number, each in scenario.avoided
        },
    }


def _of_vehicle(vehicle: Vehicle, scenario: Scenario) -> dict[str, Any]:
    start, goal, grid = vehicle.start, vehicle.goal, scenario.grid
    if not isinstance(goal, State):
        raise ValueError(f"certificate: got a goal of {vehicle.name} that is not a state")
    given = [["position", grid.duration, goal.position.tolist()]]
    if goal.velocity is not None:
        given.append(["velocity", grid.duration, goal.velocity.tolist()])
    near = [value for each in vehicle.waypoints for value in _of_waypoint(each, vehicle, grid)]
    velocity = np.zeros(3) if start.velocity is None else start.velocity
    return {
        "name": vehicle.name,
        "weight": vehicle.weight,
        "radius": vehicle.radius,
        "start": [start.position.tolist(), velocity.tolist()],
        "given": given,
        "near": near,
        "limits": _of_limits(scenario.limits_of(vehicle)),
    }


def _of_waypoint(waypoint: Waypoint, vehicle: Vehicle, grid: Grid) -> list[list[Any]]:
    """Return the position and the velocity that a waypoint gives.

    Raises:
        ValueError: its time is free, its velocity is in a set, or the vehicle dwells there.
    """
    velocity = waypoint.velocity
    is_vector = velocity is None or isinstance(velocity, np.ndarray)
    if waypoint.time is None or waypoint.dwell > 0.0 or not is_vector:
        expected = "its files hold waypoints with times, without dwells or sets of velocities"
        raise ValueError(f"certificate: got a waypoint of {vehicle.name}, {expected}")
    time = float(grid.since_start(waypoint.time))
    found = [["position", time, waypoint.position.tolist(), waypoint.within]]
    if velocity is not None:
        found.append(["velocity", time, np.asarray(velocity).tolist(), 0.0])
    return found


def _of_limits(limits: Limits) -> dict[str, Any]:
    boxes = {
        "position": limits.position,
        "velocity": limits.velocity,
        "acceleration": limits.acceleration,
    }
    held: dict[str, Any] = {
        name: [box.lower.tolist(), box.upper.tolist()]
        for name, box in boxes.items()
        if box is not None
    }
    largest = {"velocity": limits.max_speed, "acceleration": limits.max_acceleration}
    held |= {f"largest {name}": most for name, most in largest.items() if most is not None}
    return held


def _of_obstacle(obstacle: Obstacle, number: int, scenario: Scenario) -> dict[str, Any]:
    """Return an obstacle, at rest or on a track.

    Raises:
        ValueError: it is of another shape, or its error grows.
    """
    shape, kind = obstacle.shape, type(obstacle.shape).__name__
    if obstacle.velocity_error > 0.0:
        kind = "one with an error that grows"
    held: dict[str, Any] = {"kind": kind}
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
    if len(held) == 1 or held["kind"] != type(shape).__name__:
        expected = "spheres, ellipsoids, boxes, cylinders, capsules and polytopes"
        name = scenario.obstacle_name(number)
        raise ValueError(f"certificate: got {name} ({kind}), its files hold {expected}")
    track = obstacle.track
    times = np.zeros(1) if track is None else track.times
    return {
        "shape": held,
        "margin": obstacle.deviation + obstacle.position_error,
        "times": times.tolist(),
        "positions": obstacle.centers(times).tolist(),
        "goes_on": track is not None and track.after == "goes_on",
        "active": obstacle.active and list(obstacle.active),
    }
