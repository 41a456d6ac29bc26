"""Meshes with ten vehicles across each: a tree, a wall with an arched hole, a spiral stair."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

import drake_rho as rho
from benchmarks.map_scenes import tried
from benchmarks.tables import Cell, Goal, Table

COUNT, RADIUS, DURATION, STEP = 10, 0.15, 12.0, 0.25
"""Vehicles, their radius [m], T and h [s]."""

_RING = 3.2
"""Radius of the circle on which starts and goals are [m]."""


def run() -> Table:
    """Plan ten vehicles across each mesh."""
    rows, failures = list[tuple[Cell, ...]](), 0
    for name, make, around in (
        ("tree", _tree, 2.0 * np.pi),
        ("arch", _arch, np.pi),
        ("stair", _stair, 2.0 * np.pi),
    ):
        solid = make()
        mesh = rho.Mesh(solid.vertices, solid.faces)
        found = tried(_scenario(name, mesh, around))
        failures += not found.ok
        near = None
        if found.plan is not None:
            x = found.positions()
            x = x[np.abs(mesh.signed_distance(x)) < 2.0 * RADIUS]
            apart = trimesh.proximity.closest_point_naive(solid, x[::4])[1]
            near = float(f"{apart.min() - RADIUS:.2g}")
        cost = round(found.plan.cost, 4) if found.plan else None
        kind = (name, len(mesh.triangles), mesh.is_watertight, COUNT)
        shown = round(found.taken.processor, 2), round(found.taken.wall, 2)
        rows.append((*kind, found.ok, *shown, cost, near))
    return Table(
        name="map_meshes",
        title="Maps: meshes",
        columns=(
            "mesh",
            "triangles",
            "watertight",
            "vehicles",
            "planned and verified",
            "plan, processor [s]",
            "plan, wall [s]",
            "index f",
            "nearest triangle less the radius [m]",
        ),
        rows=tuple(rows),
        notes=(_WORK,),
        goals=(Goal("meshes without a plan", 0.0, float(failures)),),
        packages=("drake-rho", "drake", "numpy", "scipy", "trimesh"),
    )


def _scenario(name: str, mesh: rho.Mesh, around: float) -> rho.Scenario:
    """Return vehicles that change sides; `around` is the angle of the starts' arc [rad]."""
    vehicles = []
    for k in range(COUNT):
        angle = around * (k + 0.5) / COUNT - around / 2.0
        side = _RING * np.array([np.cos(angle), np.sin(angle)])
        start, goal = [*side, 1.2 + 0.6 * (k % 3)], [*-side, 1.2 + 0.6 * ((k + 1) % 3)]
        vehicles.append(rho.Vehicle(f"UAV-{k}", rho.State(start), rho.State(goal), radius=RADIUS))
    return rho.Scenario(
        name,
        rho.Grid.lasting(DURATION, step=STEP),
        vehicles,
        rho.Limits(
            position=rho.Box([-4, -4, 0.3], [4, 4, 3.2]), max_speed=3.0, max_acceleration=4.0
        ),
        [mesh],
        rho.Separation(2.0 * RADIUS, 2.0),
    )


def _joined(parts: list[Any]) -> Any:
    return trimesh.util.concatenate(parts)


def _tree() -> Any:
    """Return a trunk with twelve branches, each with a ball of leaves at its end."""
    rng = np.random.default_rng(0)
    parts = [trimesh.creation.cylinder(0.25, sections=16, segment=[[0, 0, 0], [0, 0, 3]])]
    for _ in range(12):
        angle, z, length = rng.uniform([0.0, 1.2, 1.0], [2.0 * np.pi, 3.0, 1.8])
        root = np.array([0.0, 0.0, z])
        tip = root + length * np.array([np.cos(angle), np.sin(angle), 0.5])
        leaves = trimesh.creation.icosphere(subdivisions=2, radius=0.35)
        leaves.apply_translation(tip)
        parts += [trimesh.creation.cylinder(0.08, sections=8, segment=[root, tip]), leaves]
    return _joined(parts)


def _arch() -> Any:
    """Return a wall of 6 m by 3.5 m, 0.6 m thick, with a hole of 1.2 m under a round arch."""
    turn = np.linspace(0.0, np.pi, 13)
    arch = np.column_stack([0.6 * np.cos(turn), 1.7 + 0.6 * np.sin(turn)])
    inner = np.concatenate([[[-0.6, 0.8], [0.6, 0.8]], arch])
    corners = np.array([[-3.0, 0.0], [3.0, 0.0], [3.0, 3.5], [-3.0, 3.5]])
    outer = np.array([corners[_corner(each)] for each in inner])
    count = len(inner)
    flat = np.concatenate([inner, outer])
    front = np.column_stack([np.full(2 * count, 0.3), flat])
    vertices = np.concatenate([front, front * [-1.0, 1.0, 1.0]])
    k, after = np.arange(count), np.roll(np.arange(count), -1)
    ring = [
        np.column_stack(each) for each in ((k, count + k, count + after), (k, count + after, after))
    ]
    back = [2 * count + each[:, ::-1] for each in ring]
    sides = []
    for first, turned in ((0, False), (count, True)):
        near, far = first + k, first + after
        pairs = ((near, far, 2 * count + far), (near, 2 * count + far, 2 * count + near))
        sides += [np.column_stack(each)[:, :: -1 if turned else 1] for each in pairs]
    return trimesh.Trimesh(vertices, np.concatenate([*ring, *back, *sides]))


def _corner(point: Any) -> int:
    """Return the number of the wall's corner in a point's quarter."""
    right, high = point[0] > 0.0, point[1] > 1.75
    return (2 if high else 1) if right else (3 if high else 0)


def _stair() -> Any:
    """Return twenty-four steps around a pole."""
    parts = [trimesh.creation.cylinder(0.2, sections=16, segment=[[0, 0, 0], [0, 0, 3.6]])]
    for k in range(24):
        step = trimesh.creation.box(bounds=[[0.1, -0.25, 0.0], [1.6, 0.25, 0.06]])
        turn = trimesh.transformations.rotation_matrix(2.0 * np.pi * k / 12, [0, 0, 1])
        turn[2, 3] = 0.15 * k
        parts.append(step.apply_transform(turn))
    return _joined(parts)


_WORK = f"""\
Ten vehicles of {RADIUS:g} m change sides within {DURATION:g} s, 3 m/s and 4 m/s², 0.3 m apart with
a downwash of 2, in 8 m by 8 m by 2.9 m. Distances from the triangles are those of trimesh, at every
fourth of 4001 instants near the mesh. The parts of the tree and of the stair overlap."""
