"""Point clouds in PCD, PLY, XYZ and NPY files, and the cells that hold their points."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.libraries import library, quiet
from drake_rho.scenario.maps.cells import unique
from drake_rho.scenario.maps.claims import check_pcd, check_ply
from drake_rho.scenario.maps.source import checked_file, named, unreadable
from drake_rho.system.arrays import read_header
from drake_rho.system.files import check_readable, opened, read_bytes

ENDINGS = (".pcd", ".ply", ".xyz", ".npy")
"""Endings of files of points."""

_EXPECTED = "a point cloud with coordinates x, y and z"

_LARGEST_CELL = 2**30
"""Largest index of a cell."""


def cells_of_points(points: Any, resolution: float) -> IntArray:
    """Return the cells that hold a point, each once, shape (M, 3).

    Args:
        points: positions [m], shape (P, 3). Points that are not finite, with which depth cameras
            mark missing measurements, are ignored.
        resolution: side of the cells [m].

    Raises:
        ScenarioError: there is no finite point, or the points are too far from the origin.
    """
    try:
        array = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim != 2 or array.shape[1] != 3:
        given = Description(f"an array of shape {array.shape}")
        raise ScenarioError("points", given, "rows of x, y and z, or a file")
    finite = np.isfinite(array).all(axis=1)
    if not finite.any():
        missing = f", {len(array)} that are not finite" if len(array) else ""
        given = Description(f"no points{missing}")
        raise ScenarioError("points", given, "at least one point of finite coordinates")
    with np.errstate(over="ignore"):  # an overflow means too far away
        cells = np.floor(array[finite] / resolution)
    if np.abs(cells).max() > _LARGEST_CELL:
        given = Description(f"points up to {np.abs(array[finite]).max():g} m from the origin")
        expected = f"at most {_LARGEST_CELL} cells of {resolution:g} m"
        raise ScenarioError("points", given, expected)
    try:
        return unique(cells.astype(np.int64))
    except ScenarioError as error:
        raise error.inside("points") from None


def read_points(path: str | Path) -> FloatArray:
    """Return the points of a file as they are in it, shape (P, 3).

    Raises:
        ScenarioError: the file cannot be read or is damaged, or the extra `maps` is not installed.
    """
    path = checked_file(path, ENDINGS)
    read = {".npy": _npy, ".xyz": _xyz, ".ply": _ply, ".pcd": _pcd}[path.suffix.lower()]
    try:
        with quiet("trimesh"), np.errstate(all="ignore"):
            points = np.asarray(read(path), dtype=np.float64)
    except ScenarioError:
        raise
    except Exception as error:  # readers of damaged files may raise almost anything
        raise unreadable(path, error, _EXPECTED) from None
    if points.ndim != 2 or points.shape[1] < 3:
        given = Description(f"an array of shape {points.shape}")
        raise ScenarioError(named(path), given, _EXPECTED)
    return points[:, :3]


def _npy(path: Path) -> Any:
    with opened(path) as file:
        header = read_header(file)
        if header.dtype.kind not in "fiu":
            raise ValueError(f"its numbers are of type {header.dtype}")
        if header.size > check_readable(path) - file.tell():
            raise ValueError(f"its header says {header.shape}, for which it is too short")
        file.seek(0)
        return np.load(file, allow_pickle=False)


def _xyz(path: Path) -> Any:
    """Return the first three columns, separated by spaces or commas."""
    with opened(path) as file:
        lines = (line.decode(errors="replace") for line in iter(file.readline, b""))
        first = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    delimiter = "," if "," in first else ";" if ";" in first else None
    if not first:
        return np.zeros((0, 3))
    return np.loadtxt(path, usecols=(0, 1, 2), delimiter=delimiter, ndmin=2, encoding="utf-8")


def _ply(path: Path) -> Any:
    trimesh = library("trimesh")
    content = read_bytes(path)
    check_ply(content)
    content = trimesh.exchange.ply.load_ply(io.BytesIO(content), resolver=None)
    return content.get("vertices", np.zeros((0, 3)))


def _pcd(path: Path) -> Any:
    pypcd4 = library("pypcd4")
    check_pcd(read_bytes(path))
    cloud = pypcd4.PointCloud.from_path(path)
    points = cloud.numpy(("x", "y", "z"))
    if len(points) != cloud.points:
        raise ValueError(f"it ends after {len(points)} of {cloud.points} points")
    return points
