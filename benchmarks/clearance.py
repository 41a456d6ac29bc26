"""Distances from spheres, boxes and endless cylinders, independent of the package's."""

from __future__ import annotations

import numpy as np

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray


def distances(shape: object, positions: FloatArray) -> FloatArray:
    """Return the distance of positions from a shape at its given place [m].

    Args:
        shape: a sphere, a box or an endless cylinder.
        positions: [m], shape (..., 3).

    Returns:
        Negative inside, shape (...).

    Raises:
        TypeError: the shape is of another kind.
    """
    if isinstance(shape, rho.Sphere):
        far = np.linalg.norm(positions - shape.center, axis=-1)
        return np.asarray(far - shape.radius)
    if isinstance(shape, rho.Box):
        beyond = np.maximum(shape.lower - positions, positions - shape.upper)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))
    if isinstance(shape, rho.Cylinder) and shape.height is None:
        across = np.delete(positions - shape.center, "xyz".index(shape.axis), axis=-1)
        return np.asarray(np.linalg.norm(across, axis=-1) - shape.radius)
    raise TypeError(f"shape: got {shape}, expected a sphere, a box or an endless cylinder")


def nearest(shape: rho.Sphere | rho.Box, positions: FloatArray) -> FloatArray:
    """Return the points of a sphere or box nearest to positions outside [m], shape (..., 3)."""
    if isinstance(shape, rho.Box):
        return np.clip(positions, shape.lower, shape.upper)
    away = positions - shape.center
    lengths = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    return np.asarray(shape.center + shape.radius * away / lengths)


def clearance(scenario: rho.Scenario, times: FloatArray, positions: FloatArray) -> float:
    """Return the least distance of any vehicle from any obstacle beyond the required one [m].

    The required distance is the radius and the deviation of a track. Infinite without obstacles.

    Args:
        scenario: obstacles and radii.
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
    """Return the displacement of an obstacle from its given place [m], shape (S, 3)."""
    if obstacle.track is not None:
        track = obstacle.track
        axes = [np.interp(times, track.times, axis) for axis in track.positions.T]
        return np.stack(axes, axis=1) - obstacle.shape.center
    if obstacle.velocity is not None:
        return times[:, None] * obstacle.velocity
    return np.zeros((len(times), 3))
