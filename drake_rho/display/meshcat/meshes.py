"""Triangle meshes and lines of the objects in a Meshcat scene, as plain arrays.

A mesh is a pair: vertices [m], shape (3, V), and faces, indices of vertices, shape (3, F), both in
the column-major order that Drake requires.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import FloatArray

IntArray = npt.NDArray[np.int32]
Mesh = tuple[FloatArray, IntArray]


def columns(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> Mesh:
    """Return the mesh of vertices and faces given as rows."""
    return (
        np.asfortranarray(np.asarray(vertices, dtype=np.float64).T),
        np.asfortranarray(np.asarray(faces, dtype=np.int32).T),
    )


def faceted(triangles: FloatArray) -> Mesh:
    """Return the mesh of triangles (T, 3, 3) that share no vertices: they are shaded flat."""
    return columns(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def segments(paths: Sequence[FloatArray] | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the starts and ends of the segments of several polylines [m], each of shape (3, S)."""
    begins = np.concatenate([path[:-1] for path in paths])
    ends = np.concatenate([path[1:] for path in paths])
    return np.asfortranarray(begins.T), np.asfortranarray(ends.T)


def arrow(length: float) -> Mesh:
    """Return an arrow of `length` [m] along +x from the origin, with a square cross-section."""
    shaft, neck, head = 0.03, 0.68, 0.09
    around = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    sections = ((0.0, shaft), (neck, shaft), (neck, head))
    rings = [(x, *(size * y)) for x, size in sections for y in around]
    vertices = np.array([*rings, (1.0, 0.0, 0.0)])
    faces = [(0, 2, 1), (0, 3, 2)]
    for ring, corner in product(range(2), range(4)):
        a, b = 4 * ring + corner, 4 * ring + (corner + 1) % 4
        faces += [(a, b, b + 4), (a, b + 4, a + 4)]
    faces += [(8 + corner, 8 + (corner + 1) % 4, 12) for corner in range(4)]
    return columns(length * vertices, faces)


def octahedron(radius: float) -> Mesh:
    """Return an octahedron around the origin, with corners at the distance `radius` [m]."""
    corners = radius * np.concatenate([np.eye(3), -np.eye(3)])
    faces = [  # every second face is a mirror image
        (x, y, z) if (x + y + z) % 2 == 1 else (x, z, y)
        for x, y, z in product((0, 3), (1, 4), (2, 5))
    ]
    return columns(corners, faces)


def scattered(mesh: Mesh, places: FloatArray) -> Mesh:
    """Return copies of a mesh at several positions [m], shape (M, 3), as one mesh."""
    vertices, faces = mesh
    count = vertices.shape[1]
    copies = (vertices.T + places[:, None]).reshape(-1, 3)
    shifted = (faces.T + count * np.arange(len(places))[:, None, None]).reshape(-1, 3)
    return columns(copies, shifted)


def tube(points: FloatArray, radius: float | FloatArray, sides: int = 3) -> Mesh:
    """Return a tube along a polyline, since WebGL draws all lines one pixel wide.

    Args:
        points: points along the line [m], shape (M, 3), M >= 2.
        radius: radius of the tube [m], a number or one for each point, shape (M,).
        sides: number of sides of the cross-section, three for a thin tube.
    """
    ahead = np.gradient(points, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-300)
    least = np.eye(3)[np.argmin(np.abs(ahead).max(axis=0))]
    side = np.cross(ahead, least)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-300)
    up = np.cross(side, ahead)
    radii = np.broadcast_to(radius, len(points))[:, None]
    corners = [
        points + radii * (np.cos(angle) * side + np.sin(angle) * up)
        for angle in 2 * np.pi / sides * np.arange(sides)
    ]
    vertices = np.stack(corners, axis=1).reshape(-1, 3)
    faces = []
    for ring, corner in product(range(len(points) - 1), range(sides)):
        a, b = sides * ring + corner, sides * ring + (corner + 1) % sides
        faces += [(a, b, a + sides), (b, b + sides, a + sides)]
    return columns(vertices, faces)


def ground_grid(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the lines of a square grid on the floor of a box [m], shape (G, 2, 3).

    They are spaced by 1, 2 or 5 times a power of ten.
    """
    spacing = nice_step(float(np.max(upper[:2] - lower[:2])) / 8)
    low, high = np.floor(lower / spacing) * spacing, np.ceil(upper / spacing) * spacing
    x, y = (np.arange(low[k], high[k] + spacing / 2, spacing) for k in (0, 1))
    lines = [[(each, low[1], lower[2]), (each, high[1], lower[2])] for each in x]
    lines += [[(low[0], each, lower[2]), (high[0], each, lower[2])] for each in y]
    return np.array(lines)


def nice_step(least: float) -> float:
    """Return the smallest of 1, 2 and 5 times a power of ten that is at least `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(
        next(power * factor for factor in (1, 2, 5, 10) if power * factor >= least * 0.999)
    )
