"""Scenes in other coordinates, on another clock, with vehicles in another order."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

import drake_rho as rho
from tests.requirements import Egg

Array = np.ndarray


@dataclasses.dataclass(frozen=True)
class Frame:
    """Frame of reference: p' = turn p + shift, t' = t + later, vehicle i' = vehicle order[i]."""

    turn: Array
    """signed permutation, shape (3, 3), that keeps the vertical"""
    shift: Array
    """shape (3,) [m]"""
    later: float
    """by which all times are later [s]"""
    reverse: bool
    """whether the order of the vehicles is reversed"""

    def place(self, x: Array) -> Array:
        """Return positions in the frame."""
        return np.asarray(x @ self.turn.T + self.shift)

    def turned(self, x: Array | None) -> Any:
        """Return vectors in the frame."""
        return None if x is None else np.asarray(x @ self.turn.T)


def quarter_turn(rng: np.random.Generator) -> Array:
    """Return a rotation about the vertical by a right angle, or more."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.matrix_power(turn, int(rng.integers(1, 4))))


def moved(scenario: rho.Scenario, frame: Frame) -> rho.Scenario:
    """Return a scenario in another frame."""
    vehicles = [_vehicle(each, frame) for each in scenario.vehicles]
    return dataclasses.replace(
        scenario,
        grid=dataclasses.replace(scenario.grid, start=scenario.grid.start + frame.later),
        vehicles=tuple(reversed(vehicles)) if frame.reverse else tuple(vehicles),
        limits=_limits(scenario.limits, frame),
        obstacles=tuple(_obstacle(each, frame) for each in scenario.bodies),
        requirements=tuple(_requirement(each, frame) for each in scenario.requirements),
    )


def _state(state: rho.State, frame: Frame) -> rho.State:
    return rho.State(
        frame.place(state.position), frame.turned(state.velocity), frame.turned(state.acceleration)
    )


def _vehicle(vehicle: rho.Vehicle, frame: Frame) -> rho.Vehicle:
    return dataclasses.replace(
        vehicle,
        start=_state(vehicle.start, frame),
        goal=_state(vehicle.goal, frame),
        waypoints=tuple(
            dataclasses.replace(
                each,
                time=None if each.time is None else each.time + frame.later,
                position=frame.place(each.position),
            )
            for each in vehicle.waypoints
        ),
    )


def _limits(limits: rho.Limits, frame: Frame) -> rho.Limits:
    free = dataclasses.replace(frame, shift=np.zeros(3))
    boxes = {
        of: _set(getattr(limits, of), frame if of == "position" else free)
        for of in ("position", "velocity", "acceleration", "jerk")
        if getattr(limits, of) is not None
    }
    return dataclasses.replace(limits, **boxes)


def _interval(active: tuple[float, float] | None, frame: Frame) -> tuple[float, float] | None:
    return active and (active[0] + frame.later, active[1] + frame.later)


def _track(track: rho.Track, frame: Frame) -> rho.Track:
    return dataclasses.replace(
        track, times=track.times + frame.later, positions=frame.place(track.positions)
    )


def _obstacle(body: rho.Obstacle, frame: Frame) -> rho.Obstacle:
    shape = _set(body.shape, frame)
    if body.velocity is not None:  # whose position is that at time 0 of the clock
        back = dataclasses.replace(
            frame, shift=frame.shift - frame.turn @ body.velocity * frame.later
        )
        shape = _set(body.shape, back)
    known_from = body.known_from + frame.later if body.known_from else 0.0
    return dataclasses.replace(
        body,
        shape=shape,
        velocity=frame.turned(body.velocity),
        track=None if body.track is None else _track(body.track, frame),
        known_from=known_from,
        active=_interval(body.active, frame),
        seen_at=None if body.seen_at is None else body.seen_at + frame.later,
    )


def _requirement(asked: rho.KeepIn, frame: Frame) -> rho.KeepIn:
    absolute = asked.of == "position" and asked.relative_to is None
    relative = asked.relative_to
    return dataclasses.replace(
        asked,
        set=_set(asked.set, frame if absolute else dataclasses.replace(frame, shift=np.zeros(3))),
        relative_to=_track(relative, frame) if isinstance(relative, rho.Track) else relative,
        active=_interval(asked.active, frame),
    )


def _set(each: Any, frame: Frame) -> Any:
    """Return a shape, a map or a convex set in another frame."""
    if isinstance(each, rho.Box):
        corners = np.sort(frame.place(np.stack([each.lower, each.upper])), axis=0)
        return rho.Box(*corners)
    if isinstance(each, rho.Sphere):
        return rho.Sphere(frame.place(each.center), each.radius)
    if isinstance(each, Egg):
        return Egg(frame.place(each.centre), each.radius)
    if isinstance(each, rho.Ellipsoid):
        return rho.Ellipsoid(frame.place(each.center), np.abs(frame.turn) @ each.semi_axes)
    if isinstance(each, rho.Cylinder):
        along = "xyz"[int(np.argmax(np.abs(frame.turn[:, "xyz".index(each.axis)])))]
        return rho.Cylinder(frame.place(each.center), each.radius, each.height, along)  # type: ignore[arg-type]
    if isinstance(each, rho.Capsule):
        return rho.Capsule(frame.place(each.start), frame.place(each.end), each.radius)
    if isinstance(each, rho.Polytope):
        return rho.Polytope(frame.place(each.vertices))
    if isinstance(each, rho.HalfSpace):
        normal = frame.turned(each.normal)
        return rho.HalfSpace(normal, each.offset + float(normal @ frame.shift))
    if isinstance(each, rho.Cone):
        return rho.Cone(frame.place(each.apex), frame.turned(each.axis), each.half_angle)
    if isinstance(each, rho.Voxels):
        turn = frame.turn if each.rotation is None else frame.turn @ each.rotation
        return rho.Voxels(each.occupied, each.resolution, frame.place(each.origin), turn)
    if isinstance(each, rho.Mesh):
        return rho.Mesh(frame.place(each.vertices), each.triangles)
    assert isinstance(each, rho.Posed)
    turn = frame.turn @ np.asarray(each.rotation if each.rotation is not None else np.eye(3))
    return rho.Posed(each.shape, turn, frame.place(each.translation))
