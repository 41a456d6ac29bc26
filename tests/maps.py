"""Small maps, and distances from them by brute force."""

import dataclasses

import numpy as np
import numpy.typing as npt

import drake_rho as rho

Array = npt.NDArray[np.float64]
Cells = npt.NDArray[np.int64]

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation by 90° about z."""


def cloud_of_cells(rng: np.random.Generator) -> Cells:
    """Return random different cells of a cube of 6 cells, shape (M, 3)."""
    return np.argwhere(rng.random((6, 6, 6)) < rng.uniform(0.05, 0.9))[: 1 + rng.integers(216)]


def grid_of(cells: Cells) -> npt.NDArray[np.bool_]:
    """Return the cube of 6 cells in which given ones are True, shape (6, 6, 6)."""
    grid = np.zeros((6, 6, 6), dtype=bool)
    grid[tuple(cells.T)] = True
    return grid


def box_distances(x: Array, lower: npt.ArrayLike, upper: npt.ArrayLike) -> Array:
    """Return distances of positions (Q, 3) from the nearest of boxes (B, 3), 0 inside."""
    gaps = np.maximum(np.asarray(lower) - x[:, None], x[:, None] - np.asarray(upper))
    distances: Array = np.linalg.norm(np.maximum(gaps, 0.0), axis=2).min(axis=1)
    return distances


def triangle_distances(x: Array, corners: Array) -> Array:
    """Return distances of positions (Q, 3) from the nearest of triangles (B, 3, 3).

    A point p = a + s (b - a) + t (c - a) of the triangle is nearest if s, t minimise the quadratic
    on the triangle s, t >= 0, s + t <= 1. It is solved without bounds, and on each edge.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    distances = []
    for one, other in ((a, b), (b, c), (c, a)):
        along = np.linspace(0.0, 1.0, 2)[:, None, None] * (other - one) + one
        lengths = np.maximum(np.sum((along[1] - along[0]) ** 2, axis=1), 1e-300)
        s = np.sum((x[:, None] - one) * (other - one), axis=2) / lengths
        foot = one + np.clip(s, 0.0, 1.0)[..., None] * (other - one)
        distances.append(np.linalg.norm(x[:, None] - foot, axis=2))
    M = np.stack([b - a, c - a], axis=2)
    weights = np.einsum("bij,qbj->qbi", np.linalg.pinv(M), x[:, None] - a)
    inside = np.all(weights >= 0.0, axis=2) & (weights.sum(axis=2) <= 1.0)
    foot = a + np.einsum("bij,qbj->qbi", M, weights)
    distances.append(np.where(inside, np.linalg.norm(x[:, None] - foot, axis=2), np.inf))
    least: Array = np.min(distances, axis=(0, 2))
    return least


def l_mesh() -> rho.Mesh:
    """Return a watertight L: arms of 0.5 m thickness along x and y, 4 m high, a notch between."""
    corners = np.array([[0.0, -1.0], [2.5, -1.0], [2.5, -0.5], [0.5, -0.5], [0.5, 2.5], [0.0, 2.5]])
    low = np.column_stack([corners, np.zeros(6)])
    vertices = np.concatenate([low, low + np.array([0.0, 0.0, 4.0])])
    bottom = np.array([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 5, 4]])
    sides = [[k, (k + 1) % 6, 6 + (k + 1) % 6] for k in range(6)]
    sides += [[k, 6 + (k + 1) % 6, 6 + k] for k in range(6)]
    return rho.Mesh(vertices, np.concatenate([bottom, 6 + bottom[:, ::-1], sides]))


def turned(voxels: rho.Voxels) -> rho.Voxels:
    """Return cells turned by 90° about the z axis of the world."""
    rotation = np.eye(3) if voxels.rotation is None else voxels.rotation
    return dataclasses.replace(voxels, rotation=QUARTER @ rotation, origin=QUARTER @ voxels.origin)


def wall_with_gap(resolution: float = 0.25) -> rho.Voxels:
    """Return a wall of 0.5 m across the way along x, 4 m wide and 3 m high, with a gap of 1 m."""
    count = round(1.0 / resolution)
    thick, wide, high = range(count // 2), range(-2 * count, 2 * count), range(3 * count)
    open_ = range(count // 2, count + count // 2)
    cells = [[x, y, z] for x in thick for y in wide for z in high if y not in open_]
    return rho.Voxels(cells, resolution, [-0.25, 0.0, 0.0])


def crossing(obstacles: list[object], **changes: object) -> rho.Scenario:
    """Return a flight of one vehicle of 0.2 m from x = -3 to x = 3 m in a room of 3 m height."""
    scenario = rho.Scenario(
        "crossing",
        rho.Grid.lasting(6.0, step=0.25),
        [rho.Vehicle("one", rho.State([-3, 0, 1.5]), rho.State([3, 0, 1.5]), radius=0.2)],
        limits=rho.Limits(
            position=rho.Box([-4, -2, 0.2], [4, 2, 2.8]), max_speed=4.0, max_acceleration=6.0
        ),
        obstacles=obstacles,  # type: ignore[arg-type]
    )
    return dataclasses.replace(scenario, **changes)  # type: ignore[arg-type]
