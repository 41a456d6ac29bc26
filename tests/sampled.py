"""Clearances of plans sampled densely with formulas of the tests' own: nothing of the library."""

from __future__ import annotations

import numpy as np

import drake_rho as rho


def _signed_distance(x: np.ndarray, shape: object) -> np.ndarray:
    """Return signed distances of positions from the centre of a shape [m], shape (...)."""
    if isinstance(shape, rho.Sphere):
        return np.asarray(np.linalg.norm(x, axis=-1) - shape.radius)
    if isinstance(shape, rho.Ellipsoid):
        return _from_ellipsoid(x, np.asarray(shape.semi_axes))
    if isinstance(shape, rho.Cylinder):
        along = "xyz".index(shape.axis)
        across = np.linalg.norm(np.delete(x, along, axis=-1), axis=-1) - shape.radius
        half = np.inf if shape.height is None else shape.height / 2.0
        beyond = np.stack([across, np.abs(x[..., along]) - half], axis=-1)
    else:
        assert isinstance(shape, rho.Box)
        beyond = np.abs(x) - (shape.upper - shape.lower) / 2.0
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))


def _from_ellipsoid(x: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return distances from an ellipsoid; inside only their sign is right.

    The nearest point is y = A² x / (A² + t) for the t at which it is on the surface, by bisection.
    """
    low, high = np.zeros(x.shape[:-1]), np.linalg.norm(x * axes, axis=-1)
    for _ in range(80):
        t = (low + high) / 2.0
        outside = np.sum((axes * x / (axes**2 + t[..., None])) ** 2, axis=-1) > 1.0
        low, high = np.where(outside, t, low), np.where(outside, high, t)
    nearest = axes**2 * x / (axes**2 + low[..., None])
    depth = (np.linalg.norm(x / axes, axis=-1) - 1.0) * axes.min()
    return np.asarray(np.where(depth < 0.0, depth, np.linalg.norm(x - nearest, axis=-1)))


def _center(obstacle: rho.Obstacle, times: np.ndarray) -> np.ndarray:
    """Return the centres of an obstacle at times on the scenario's clock [m], shape (M, 3)."""
    shape, track = obstacle.shape, obstacle.track
    if track is not None:  # without a velocity after its last time
        return np.stack([np.interp(times, track.times, p) for p in track.positions.T], axis=-1)
    if isinstance(shape, rho.Box):
        center = (shape.lower + shape.upper) / 2.0
    else:
        center = np.asarray(getattr(shape, "center"))  # noqa: B009  # of spheres, cylinders, ...
    velocity = np.zeros(3) if obstacle.velocity is None else obstacle.velocity
    return np.asarray(center + times[:, None] * velocity)


def flown(plan: rho.Plan, elapsed: np.ndarray) -> np.ndarray:
    """Return positions at times since the first knot by (1) and (2) [m], shape (N, M, 3)."""
    scenario, h = plan.scenario, plan.scenario.grid.step
    p = np.array([each.start.position for each in scenario.vehicles])
    v = np.array([each.start.velocity for each in scenario.vehicles])
    states = []
    for a in np.moveaxis(plan.accelerations, 1, 0):
        states.append((p, v, a))
        p, v = p + h * v + h**2 / 2 * a, v + h * a
    k = np.minimum((elapsed / h).astype(int), len(states) - 1)
    at, speed, force = (np.array(each)[k] for each in zip(*states, strict=True))
    s = (elapsed - h * k)[:, None, None]
    return np.moveaxis(at + s * speed + s**2 / 2 * force, 1, 0)


def _uncertainty(obstacle: rho.Obstacle, times: np.ndarray) -> np.ndarray:
    """Return how far an obstacle may be from its centre at times [m], shape (M,)."""
    since = obstacle.known_from if obstacle.seen_at is None else obstacle.seen_at
    later = np.where(times > since, times - since, 0.0)
    return np.asarray(obstacle.position_error + obstacle.velocity_error * later)


def least_from_truths(plan: rho.Plan, rng: np.random.Generator, count: int = 1001) -> float:
    """Return the least clearance from an obstacle that moves anywhere it may be [m].

    It moves at random, with jumps, on the border of that space; and straight at each vehicle.
    """
    scenario, least = plan.scenario, np.inf
    times = np.linspace(scenario.grid.start, scenario.grid.end, count)
    x = flown(plan, times - scenario.grid.start)
    radii = np.array([[each.radius] for each in scenario.vehicles])
    for obstacle in scenario.bodies:
        first, last = obstacle.active or (-np.inf, np.inf)
        due = (times >= max(first, obstacle.known_from)) & (times <= last)
        far, center = _uncertainty(obstacle, times)[:, None], _center(obstacle, times)
        ways = [rng.standard_normal((count, 3)) for _ in range(20)]
        for way in [*ways, *(x - center)]:
            off = far * way / np.linalg.norm(way, axis=-1, keepdims=True)
            clear = _signed_distance(x - center - off, obstacle.shape) - radii
            least = min(least, float(np.min(clear[:, due], initial=np.inf)))
    return least


def least_clearances(plan: rho.Plan, count: int = 4001) -> np.ndarray:
    """Return the least clearance of any vehicle from each obstacle while active and known [m].

    From an uncertain obstacle, it is that from wherever it may be. Infinite for an obstacle that is
    not active, or not known while it is active, in the flight.
    """
    scenario, found = plan.scenario, []
    start, radii = scenario.grid.start, [each.radius for each in scenario.vehicles]
    for each in scenario.obstacles:
        obstacle = each if isinstance(each, rho.Obstacle) else rho.Obstacle(each)
        first, last = obstacle.active or (start, scenario.grid.end)
        first = max(first, start, obstacle.known_from if obstacle.known_from > 0.0 else start)
        last = min(last, scenario.grid.end)
        times = np.linspace(first, last, count) if first <= last else np.zeros(0)
        x = flown(plan, np.clip(times - start, 0.0, scenario.grid.duration))
        distances = _signed_distance(x - _center(obstacle, times), obstacle.shape)
        distances = distances - _uncertainty(obstacle, times)
        found.append(np.min(distances - np.array(radii)[:, None], initial=np.inf))
    return np.array(found)
