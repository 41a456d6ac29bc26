"""A point cloud of a million points: time and memory to load it, and a plan through its cells."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import drake_rho as rho
from benchmarks.map_scenes import Array, beyond_radius, tried
from benchmarks.tables import Cell, Goal, Table

POINTS, RESOLUTION = 1_000_000, 0.1
"""Number of points, and side of the cells [m]."""

_LOAD = """
import json, resource, sys, time
import drake_rho as rho
begun, worked = time.perf_counter(), time.process_time()
found = rho.Voxels.from_points(sys.argv[1], float(sys.argv[2]))
seconds, processor = time.perf_counter() - begun, time.process_time() - worked
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
print(json.dumps([len(found.occupied), processor, seconds, peak]))
"""
"""Script of the fresh process that loads the cloud."""


def run() -> Table:
    """Load the cloud from two formats, and plan four vehicles through it."""
    cloud, rows = _hall(), list[tuple[Cell, ...]]()
    slowest = largest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for name in ("cloud.npy", "cloud.ply"):
            path = Path(folder) / name
            if path.suffix == ".npy":
                np.save(path, cloud)
            else:
                trimesh.PointCloud(cloud).export(path)
            command = [sys.executable, "-c", _LOAD, str(path), str(RESOLUTION)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
            cells, processor, seconds, peak = json.loads(done.stdout)
            slowest, largest = max(slowest, seconds), max(largest, peak)
            shown = round(processor, 2), round(seconds, 2), round(peak, 2)
            rows.append((name, cells, *shown, None, None))
    voxels = rho.Voxels.from_points(cloud, RESOLUTION)
    found = tried(_scenario(voxels))
    near = float(f"{beyond_radius(found, voxels):.2g}") if found.plan else None
    taken = round(found.taken.processor, 2), round(found.taken.wall, 2)
    rows.append(("plan", len(voxels.occupied), *taken, None, found.ok, near))
    return Table(
        name="map_points",
        title="Maps: a point cloud of a million points",
        columns=(
            "work",
            "cells",
            "processor [s]",
            "wall [s]",
            "peak memory [GiB]",
            "planned and verified",
            "nearest cell less the radius [m]",
        ),
        rows=tuple(rows),
        notes=(_WORK,),
        goals=(
            Goal("slowest load [s]", 10.0, slowest),
            Goal("largest peak memory [GiB]", 2.0, largest),
            Goal("four vehicles without a plan", 0.0, float(not found.ok)),
        ),
    )


def _hall() -> Array:
    """Return points on the floor, the walls and twelve pillars of a hall, shape (POINTS, 3)."""
    rng, pillars = np.random.default_rng(0), [(x, y) for x in (-6, -2, 2, 6) for y in (-4, 0, 4)]
    low, high = np.array([-10.0, -7.5, 0.0]), np.array([10.0, 7.5, 4.0])
    points = rng.uniform(low, high, (POINTS, 3))
    kind = rng.integers(6, size=POINTS)
    points[kind == 0, 2] = 0.0
    for axis in (0, 1):
        walls = kind == 1 + axis
        points[walls, axis] = rng.choice([low[axis], high[axis]], int(walls.sum()))
    rest = kind >= 3
    turn = rng.uniform(0.0, 2.0 * np.pi, int(rest.sum()))
    middle = np.array(pillars)[rng.integers(len(pillars), size=len(turn))]
    points[rest, :2] = middle + 0.4 * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(points + rng.normal(0.0, 0.005, points.shape))


def _scenario(voxels: rho.Voxels) -> rho.Scenario:
    """Return four vehicles that cross the hall and each other."""
    vehicles = [
        rho.Vehicle(f"UAV-{k}", rho.State([-9, y, 1.5]), rho.State([9, -y, 1.5]), radius=0.3)
        for k, y in enumerate([-5.0, -2.0, 2.0, 5.0])
    ]
    return rho.Scenario(
        "hall",
        rho.Grid.lasting(15.0, step=0.25),
        vehicles,
        rho.Limits(
            position=rho.Box([-9.9, -7.4, 0.1], [9.9, 7.4, 4.0]), max_speed=4, max_acceleration=4
        ),
        [voxels],
        rho.Separation(0.6, 2.0),
    )


_WORK = f"""\
A scan of a hall of 20 m by 15 m by 4 m, {POINTS} points with noise of 5 mm on the floor, the walls
and twelve pillars, in cells of {RESOLUTION:g} m. A fresh process loads it and imports the package;
its peak memory counts both. Four vehicles of 0.3 m cross the hall in 15 s."""
