"""Distances from spheres and boxes, at rest or moving, written apart from the package's."""

from __future__ import annotations

import numpy as np

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray


def distances(shape: object, positions: FloatArray) -> FloatArray:
    """Distance of positions from a sphere or box where it is given, negative inside [m].

    Args:
        shape: what is to be kept out of.
        positions: [m], shape (..., 3).

    Returns:
        Shape (...).

    Raises:
        TypeError: the shape is another.
    """
    if isinstance(shape, rho.Sphere):
        far = np.linalg.norm(positions - shape.center, axis=-1)
        return np.asarray(far - shape.radius)
    if isinstance(shape, rho.Box):
        beyond = np.maximum(shape.lower - positions, positions - shape.upper)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))
    raise TypeError(f"no distance from {shape}")


def nearest(shape: rho.Sphere | rho.Box, positions: FloatArray) -> FloatArray:
    """The points of a sphere or box that are nearest to positions outside [m], shape (..., 3)."""
    if isinstance(shape, rho.Box):
        return np.clip(positions, shape.lower, shape.upper)
    away = positions - shape.center
    lengths = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    return np.asarray(shape.center + shape.radius * away / lengths)


def clearance(scenario: rho.Scenario, times: FloatArray, positions: FloatArray) -> float:
    """Least distance of any vehicle from any obstacle beyond what it is to keep [m].

    That is its radius, and how far an obstacle may be from its track. Infinite without obstacles.

    Args:
        scenario: what is asked.
        times: on the scenario's clock [s], shape (S,).
        positions: of the vehicles at these times [m], shape (S, N, 3).
    """
    radii = np.array([vehicle.radius for vehicle in scenario.vehicles])
    least = np.inf
    for obstacle in scenario.obstacles:
        shape, kept, moved = obstacle, radii, np.zeros((len(times), 3))
        if isinstance(obstacle, rho.Obstacle):
            shape, kept = obstacle.shape, radii + obstacle.deviation
            moved = displacement(obstacle, times)
        least = min(least, float(np.min(distances(shape, positions - moved[:, None]) - kept)))
    return least


def displacement(obstacle: rho.Obstacle, times: FloatArray) -> FloatArray:
    """How far an obstacle is from where its shape is given [m], shape (S, 3)."""
    if obstacle.track is not None:
        track = obstacle.track
        axes = [np.interp(times, track.times, axis) for axis in track.positions.T]
        return np.stack(axes, axis=1) - obstacle.shape.center
    if obstacle.velocity is not None:
        return times[:, None] * obstacle.velocity
    return np.zeros((len(times), 3))
