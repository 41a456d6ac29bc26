"""Maps read from files: what is in the file is what is kept clear of, and changes are noticed."""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import re
import struct
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import octomap
import pypcd4
import pytest
import trimesh
import yaml
from pydrake.math import RigidTransform, RollPitchYaw

import drake_rho as rho
from drake_rho.scenario.files import (
    scenario_from_json,
    scenario_from_yaml,
    scenario_to_json,
    scenario_to_yaml,
)
from drake_rho.scenario.maps import octomaps, source
from tests.scenarios import single
from tests.test_cli_json import PYRAMID
from tests.test_cli_missions import MISSION

POSE = RigidTransform(RollPitchYaw(0.1, -0.2, 0.7), [1.0, -2.0, 0.5])
POINTS = np.random.default_rng(28).uniform(-3.0, 3.0, (200, 3)).round(3)
YAML = """name: yard
grid: {step: 0.5, knots: 21}
vehicles: [{name: u, radius: 0.1, start: {position: [0, 0, 1]}, goal: {position: [10, 0, 1]}}]
limits: {acceleration: {lower: [-2, -2, -2], upper: [2, 2, 2]}}
obstacles:
  - {octomap: maps/tree.bt, unknown: free, rotation: [0, 0, 0.3]}
  - {shape: {points: maps/cloud.npy, resolution: 0.5, position: [5, 6, 0]}, velocity: [0.1, 0, 0]}
  - {mesh: maps/pyramid.obj, scale: 0.5, position: [3, 3, 3], rotation: [0.1, 0.2, 0.3]}
  - {shape: {mesh: maps/pyramid.obj, position: [3, 3, 6]}, name: roof}
  - {occupied: [[2, 8, 8]], resolution: 0.5}
  - {vertices: [[7, 3, 0], [8, 3, 0], [7, 4, 0]], triangles: [[0, 1, 2]]}
"""


def _single() -> rho.Scenario:
    """Return a scenario of one vehicle that has a radius, which maps ask for."""
    (vehicle,) = single().vehicles
    return dataclasses.replace(single(), vehicles=(dataclasses.replace(vehicle, radius=0.1),))


def _cells(centers: Any, side: float) -> set[tuple[int, ...]]:
    """Return the cells around positions."""
    return {tuple(each) for each in np.floor(np.asarray(centers) / side).astype(int).tolist()}


def _found(voxels: rho.Voxels) -> set[tuple[int, ...]]:
    return {tuple(each) for each in voxels.occupied.tolist()}


def _tree(occupied: Any, free: Any, side: float = 0.5, kind: Any = octomap.OcTree) -> Any:
    """Return an octree with cells at these positions."""
    tree = kind(side)
    for positions, is_occupied in ((free, False), (occupied, True)):
        for each in positions:
            tree.updateNode(np.asarray(each, dtype=float), is_occupied)
    return tree


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    """Return the path of a scenario with maps in a folder beside it."""
    (tmp_path / "maps").mkdir()
    tree = _tree([[5.1, 2.1, 1.1], [5.1, 2.6, 1.1], [5.6, 2.1, 2.1]], [[2.1, 2.1, 0.1]])
    tree.writeBinary(os.fsencode(tmp_path / "maps" / "tree.bt"))
    np.save(tmp_path / "maps" / "cloud.npy", POINTS)
    (tmp_path / "maps" / "pyramid.obj").write_text(PYRAMID)
    (tmp_path / "yard.yaml").write_text(YAML)
    return tmp_path / "yard.yaml"


@pytest.mark.parametrize("kind", [octomap.OcTree, octomap.ColorOcTree])
@pytest.mark.parametrize("ending", [".bt", ".ot"])
def test_cells_of_an_octomap_are_those_written(tmp_path: Path, kind: Any, ending: str) -> None:
    rng = np.random.default_rng(1)
    occupied, free = rng.uniform(-4.0, 4.0, (40, 3)), rng.uniform(-4.0, 4.0, (40, 3))
    tree, path = _tree(occupied, free, 0.25, kind), tmp_path / f"map{ending}"
    (tree.writeBinary if ending == ".bt" else tree.write)(os.fsencode(path))
    read = rho.Voxels.from_octomap(path, "free")
    assert _found(read) == _cells(occupied, 0.25)
    assert read.resolution == 0.25
    for cell in (np.array(list(_found(read))) + 0.5) * 0.25:
        assert tree.isNodeOccupied(tree.search(cell))


@pytest.mark.parametrize("ending", [".bt", ".ot"])
def test_leaves_larger_than_a_cell_become_all_of_their_cells(tmp_path: Path, ending: str) -> None:
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 3), axis=-1).reshape(-1, 3)
    tree = _tree((grid + 0.5) * 0.5, (grid - [8, 0, 0] + 0.5) * 0.5)
    path = tmp_path / f"cube{ending}"
    (tree.writeBinary if ending == ".bt" else tree.write)(os.fsencode(path))
    leaves = octomaps.read_leaves(path)
    assert (leaves.occupied, leaves.free, leaves.unknown) == (64, 64, 64)
    if ending == ".bt":  # the library prunes a tree when it writes this format
        assert sorted(leaves.sides.tolist()) == [4, 4]
    assert _found(rho.Voxels.from_octomap(path, "free")) == {tuple(each) for each in grid.tolist()}
    both = _found(rho.Voxels.from_octomap(path, "occupied"))
    assert both == {tuple(each) for each in [*grid.tolist(), *(grid - [4, 0, 0]).tolist()]}


def test_what_is_unknown_has_no_default_and_the_error_says_what_the_file_holds(yard: Path) -> None:
    path = yard.parent / "maps" / "tree.bt"
    holds = "the file has 3 occupied, 1 free and 76 unknown cells in its bounding box"
    with pytest.raises(rho.ScenarioError, match=f"unknown: got nothing, expected .*{holds}"):
        rho.Voxels.from_octomap(path)
    occupied = rho.Voxels.from_octomap(path, unknown="occupied")
    assert len(occupied.occupied) == 3 + 76
    assert (4, 4, 0) not in _found(occupied)


def test_points_are_in_the_cubes_that_hold_them(tmp_path: Path) -> None:
    known = rho.Voxels.from_points(POINTS, 0.4)
    assert _found(known) == _cells(POINTS, 0.4)
    assert known.signed_distance(POINTS).max() <= 1e-12
    with_nan = np.concatenate([POINTS, [[np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0]]])
    assert rho.Voxels.from_points(with_nan, 0.4) == known
    np.save(tmp_path / "c.npy", POINTS)
    np.savetxt(tmp_path / "c.xyz", POINTS, header="x y z", fmt="%.3f")
    np.savetxt(tmp_path / "comma.xyz", POINTS, delimiter=",", fmt="%.3f")
    for name, encoding in (("b.ply", "binary"), ("a.ply", "ascii")):
        trimesh.PointCloud(POINTS).export(tmp_path / name, encoding=encoding)
    cloud = pypcd4.PointCloud.from_points(POINTS, ("x", "y", "z"), (np.float64,) * 3)
    for encoding in pypcd4.Encoding:
        cloud.save(tmp_path / f"{encoding.value}.pcd", encoding=encoding)
    files = sorted(path for path in tmp_path.iterdir())
    assert len(files) == 5 + len(pypcd4.Encoding)
    for path in files:
        read = rho.Voxels.from_points(path, 0.4)
        assert _found(read) == _found(known), path.name
        assert read.source is not None
        assert (read.source.kind, read.source.path) == ("points", str(path))


def test_a_grid_has_the_cells_that_are_true() -> None:
    grid = np.zeros((3, 4, 5), dtype=bool)
    grid[1, 2, 3] = grid[0, 0, 4] = True
    read = rho.Voxels.from_grid(grid, 0.5, origin=[1, 1, 1])
    assert _found(read) == {(1, 2, 3), (0, 0, 4)}
    assert read.signed_distance(np.array([1.75, 2.25, 2.75])) < 0.0


@pytest.mark.parametrize("ending", ["obj", "stl", "ply", "glb", "gltf"])
def test_a_mesh_is_all_geometries_where_their_nodes_place_them(tmp_path: Path, ending: str) -> None:
    scene = trimesh.Scene(trimesh.creation.box((1.0, 2.0, 3.0)))
    shifted = trimesh.transformations.translation_matrix([10.0, 0.0, 0.0])
    scene.add_geometry(trimesh.creation.box((1.0, 1.0, 1.0)), transform=shifted)
    path = tmp_path / f"mesh.{ending}"
    if ending == "gltf":
        for name, content in scene.export(file_type="gltf").items():
            (tmp_path / name.replace("model.gltf", "mesh.gltf")).write_bytes(content)
    elif ending == "glb":
        scene.export(path)
    else:
        scene.to_mesh().export(path)
    read = rho.Mesh.load(path, scale=2.0, pose=POSE)
    assert read.is_watertight
    assert len(read.triangles) == 24
    corners = [[-0.5, -1.0, -1.5], [10.5, 0.5, 0.5]]
    for corner in corners:
        placed = POSE @ (2.0 * np.array(corner))
        assert np.linalg.norm(read.vertices - placed, axis=1).min() < 1e-6
    assert read.signed_distance(POSE @ np.array([20.0, 0.0, 0.0])) == pytest.approx(-1.0, abs=1e-6)


def test_a_pose_turns_cells_as_it_turns_points() -> None:
    matrix = POSE.GetAsMatrix4()
    read = rho.Voxels.from_points(POINTS, 0.3, pose=POSE)
    assert read == rho.Voxels.from_points(POINTS, 0.3, pose=matrix)
    moved = POINTS @ matrix[:3, :3].T + matrix[:3, 3]
    assert read.signed_distance(moved).max() <= 1e-9
    assert rho.Voxels.from_points(POINTS, 0.3, pose=np.eye(4)).rotation is None
    for wrong in (3, np.eye(3), 2.0 * np.eye(4), [[np.nan] * 4] * 4):
        with pytest.raises(rho.ScenarioError, match=r"pose: got .* expected a pose: a 4 x 4"):
            rho.Voxels.from_points(POINTS, 0.3, pose=wrong)  # type: ignore[arg-type]


def test_copies_of_maps_are_equal(yard: Path) -> None:
    for each in rho.load_scenario(yard).obstacles:
        again = pickle.loads(pickle.dumps(each))  # noqa: S301  # written above
        assert again == each
        shape = again.shape if isinstance(again, rho.Obstacle) else again
        if isinstance(shape, rho.Voxels):
            assert shape.occupied.dtype == np.int64


def _damaged(tmp_path: Path, whole: bytes, ending: str, size: int) -> Path:
    path = tmp_path / f"damaged{ending}"
    path.write_bytes(whole[:size])
    return path


@pytest.mark.parametrize("kind", [octomap.OcTree, octomap.ColorOcTree])
@pytest.mark.parametrize("ending", [".bt", ".ot"])
def test_an_octomap_cut_anywhere_is_refused_in_one_line(
    tmp_path: Path, kind: Any, ending: str, capfd: pytest.CaptureFixture[str]
) -> None:
    tree, path = _tree(POINTS[:10], POINTS[10:20], kind=kind), tmp_path / f"whole{ending}"
    (tree.writeBinary if ending == ".bt" else tree.write)(os.fsencode(path))
    whole = path.read_bytes()
    for size in range(len(whole)):
        with pytest.raises(rho.ScenarioError, match=f"damaged{ending}: got") as caught:
            rho.Voxels.from_octomap(_damaged(tmp_path, whole, ending, size), "free")
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # the library itself would print


HEADER = b"# Octomap OcTree binary file\nid OcTree\nsize %d\nres %s\ndata\n"
BAD_OCTOMAPS = {
    "more than 16 levels": HEADER % (100001, b"0.1") + b"\x03\x00" * 100000 + b"\x01\x00",
    "its header says 7": HEADER % (7, b"0.1") + b"\x02\x00",
    "its resolution is 0 m": HEADER % (2, b"0") + b"\x02\x00",
    "tree of type OcTreeStamped": HEADER.replace(b"id OcTree", b"id OcTreeStamped") % (2, b"1"),
    "its number of nodes is": HEADER % (10**12, b"0.1"),
    "its header has further lines": HEADER.replace(b"data", b"colour 3\ndata") % (2, b"0.1"),
    "no header of OctoMap": b"hello\ndata\n",
    "a tree without nodes": HEADER % (0, b"0.1"),
    "an archive": b"PK\x03\x04 and so on",
    "at least one occupied cell": HEADER % (2, b"0.1") + b"\x01\x00",
}


@pytest.mark.parametrize("reason", BAD_OCTOMAPS)
def test_a_bad_octomap_is_refused_with_its_reason(tmp_path: Path, reason: str) -> None:
    path = tmp_path / "bad.bt"
    path.write_bytes(BAD_OCTOMAPS[reason])
    with pytest.raises(rho.ScenarioError, match=f"bad.bt: got .*{reason}"):
        rho.Voxels.from_octomap(path, "free")


def _stl(*corners: Any) -> bytes:
    """Return a binary STL of one triangle."""
    return bytes(80) + struct.pack("<I12fH", 1, 0, 0, 1, *np.ravel(corners), 0)


BAD_MESHES: dict[str, tuple[str, bytes]] = {
    "no triangles": (".obj", b"v 0 0 0\nv 1 0 0\n"),
    "vertex 2 at": (".obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n"),
    "vertex 3 at": (".stl", _stl([0, 0, 0], [1, 0, 0], [0, np.inf, 0])),
    "a face has a vertex that is not there": (
        ".obj",
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n",
    ),
    r"bad\.obj: got a damaged file, .*a face has a vertex": (
        ".obj",
        b"v 0 0 0\nv 1 0 0\nf 1 2 9\n",
    ),
    "a damaged file, expected": (".ply", b"ply\nformat ascii 1.0\nelement vertex 9\n"),
    "expected a mesh": (".glb", b"glTF and more"),
    r"bad\.gltf: got a reference to '\.\./up\.bin', a file elsewhere": (
        ".gltf",
        b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "../up.bin", "byteLength": 4}]}',
    ),
    "the ending .py": (".gltf", b'{"buffers": [{"uri": "own.py", "byteLength": 4}]}'),
    "not all at one place": (".stl", _stl([1, 1, 1], [1, 1, 1], [1, 1, 1])),
    "an archive": (".obj", b"\x1f\x8b\x08 and so on"),
    "a file of 1 to": (".obj", b""),
    "the ending .zip, expected a file ending in .obj": (".zip", b"PK\x03\x04"),
}


@pytest.mark.parametrize("reason", BAD_MESHES)
def test_a_bad_mesh_is_refused_with_its_reason(tmp_path: Path, reason: str) -> None:
    ending, content = BAD_MESHES[reason]
    path = tmp_path / f"bad{ending}"
    path.write_bytes(content)
    (tmp_path / "own.py").write_text("1")
    with pytest.raises(rho.ScenarioError, match=reason) as caught:
        rho.Mesh.load(path)
    assert "\n" not in str(caught.value)


BAD_POINTS: dict[str, tuple[str, bytes]] = {
    "no points": (".xyz", b"# only a comment\n"),
    "no points, 1 that are not finite": (".xyz", b"nan 0 0\n"),
    "a damaged file": (".xyz", b"1 2 3\n4 5\n"),
    "a damaged file, expected a point cloud": (".npy", b"\x93NUMPY and so on"),
    "damaged file": (".pcd", b"VERSION 0.7\nFIELDS x y\n"),
    "its header says 2 points": (
        ".pcd",
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\n"
        b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA binary\n" + bytes(12),
    ),
    "spread over": (".xyz", b"0 0 0\n1e6 1e6 1e6\n"),
    "from the origin": (".xyz", b"0 0 1e300\n"),
}


@pytest.mark.parametrize("reason", BAD_POINTS)
def test_a_bad_cloud_is_refused_with_its_reason(tmp_path: Path, reason: str) -> None:
    ending, content = BAD_POINTS[reason]
    path = tmp_path / f"bad{ending}"
    path.write_bytes(content)
    with pytest.raises(rho.ScenarioError, match=reason) as caught:
        rho.Voxels.from_points(path, 0.01)
    assert f"bad{ending}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: rho.Voxels.from_points(POINTS, 0.0), "resolution: got 0.0"),
        (lambda: rho.Voxels.from_points(POINTS, float("nan")), "resolution: got nan"),
        (lambda: rho.Voxels.from_points(POINTS, True), "resolution: got True"),
        (lambda: rho.Voxels.from_points(POINTS[:0], 0.1), "points: got no points"),
        (lambda: rho.Voxels.from_points(POINTS[:, :2], 0.1), "points: got an array of shape"),
        (lambda: rho.Voxels.from_grid(np.ones((2, 2)), 0.1), "array: got an array of shape"),
        (lambda: rho.Voxels.from_grid(np.zeros((2, 2, 2), bool), 0.1), "at least one occupied"),
        (lambda: rho.Voxels([[0, 0, 0], [2**30] * 3], 0.1), "cells that spread over"),
        (lambda: rho.Mesh.load("a\0b.obj"), r"'a\\x00b.obj': got no file"),
        (lambda: rho.Mesh.load("no.obj"), "no.obj: got no file"),
        (lambda: rho.Mesh.load(".", 1.0), "got no regular file"),
        (lambda: rho.Mesh.load("no.obj", scale=0.0), "scale: got 0.0"),
        (lambda: rho.Voxels.from_points("/dev/zero", 1.0), "/dev/zero: got no regular file"),
    ],
)
def test_wrong_arguments_are_refused(make: Callable[[], object], complaint: str) -> None:
    with pytest.raises(rho.ScenarioError, match=complaint):
        make()


def test_files_are_bounded_in_size(yard: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "LARGEST_FILE", 20)
    with pytest.raises(rho.ScenarioError, match=r"pyramid.obj: got a file of \d+ bytes, more"):
        rho.Mesh.load(yard.parent / "maps" / "pyramid.obj")
    monkeypatch.setattr(octomaps, "MOST", 2)
    monkeypatch.setattr(source, "LARGEST_FILE", 1000)
    with pytest.raises(rho.ScenarioError, match=r"tree.bt: got 3 cells, expected at most 2"):
        rho.Voxels.from_octomap(yard.parent / "maps" / "tree.bt", "free")


@pytest.mark.parametrize("module", ["octomap", "trimesh", "pypcd4"])
def test_without_the_extra_one_line_says_how_to_install_it(
    yard: Path, module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    maps = yard.parent / "maps"
    (maps / "c.pcd").write_text("VERSION 0.7\n")
    readers: dict[str, Callable[[], object]] = {
        "octomap": lambda: rho.Voxels.from_octomap(maps / "tree.bt", "free"),
        "trimesh": lambda: rho.Mesh.load(maps / "pyramid.obj"),
        "pypcd4": lambda: rho.Voxels.from_points(maps / "c.pcd", 0.1),
    }
    with pytest.raises(rho.ScenarioError, match=r"pip install 'drake-rho\[maps\]'"):
        readers[module]()
    assert len(rho.Voxels.from_points(maps / "cloud.npy", 0.5).occupied)


def test_a_scenario_refers_to_maps_beside_it_and_is_saved_so(yard: Path, tmp_path: Path) -> None:
    scenario = rho.load_scenario(yard)
    tree, cloud, pyramid, roof, *inline = scenario.obstacles
    assert isinstance(tree, rho.Voxels)
    assert tree.rotation is not None
    np.testing.assert_allclose(tree.rotation, RollPitchYaw(0, 0, 0.3).ToRotationMatrix().matrix())
    assert isinstance(cloud, rho.Obstacle)
    assert cloud.shape == rho.Voxels.from_points(
        yard.parent / "maps" / "cloud.npy", 0.5, RigidTransform([5.0, 6.0, 0.0])
    )
    pose = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [3.0, 3.0, 3.0])
    assert isinstance(pyramid, rho.Mesh)
    np.testing.assert_allclose(pyramid.vertices[1], pose @ np.array([0.5, 0.0, 0.0]))
    assert isinstance(roof, rho.Obstacle)
    elsewhere = tmp_path / "further" / "down"
    elsewhere.mkdir(parents=True)
    rho.save_scenario(scenario, elsewhere / "again.yaml")
    text = (elsewhere / "again.yaml").read_text()
    content = yaml.safe_load(text)
    assert content["obstacles"][0]["octomap"] == "../../maps/tree.bt"
    assert content["obstacles"][1]["shape"]["points"] == "../../maps/cloud.npy"
    assert content["obstacles"][2]["mesh"] == "../../maps/pyramid.obj"
    assert all(each.source is None for each in inline if isinstance(each, rho.Voxels | rho.Mesh))
    assert {"occupied", "vertices"} <= {key for each in content["obstacles"] for key in each}
    assert str(tmp_path) not in text
    assert rho.load_scenario(elsewhere / "again.yaml") == scenario


def test_maps_without_a_file_of_theirs_are_saved_inline(yard: Path, tmp_path: Path) -> None:
    scenario = rho.load_scenario(yard)
    assert scenario_from_yaml(scenario_to_yaml(scenario)) == scenario
    assert scenario_from_json(scenario_to_json(scenario)) == scenario
    tree = scenario.obstacles[0]
    assert isinstance(tree, rho.Voxels)
    pruned = dataclasses.replace(tree, occupied=tree.occupied[:1])  # not what the file holds
    changed = dataclasses.replace(scenario, obstacles=(pruned, *scenario.obstacles[1:]))
    rho.save_scenario(changed, tmp_path / "pruned.yaml")
    assert rho.load_scenario(tmp_path / "pruned.yaml") == changed
    (yard.parent / "maps" / "tree.bt").unlink()
    rho.save_scenario(scenario, tmp_path / "gone.yaml")
    assert rho.load_scenario(tmp_path / "gone.yaml") == scenario


def test_the_schema_lists_maps_in_files(yard: Path) -> None:
    schema = rho.scenario_schema()
    jsonschema.validate(yaml.safe_load(YAML), schema)
    assert {"OctomapFile", "PointsFile", "MeshFile"} <= schema["$defs"].keys()
    assert "stored_map" not in json.dumps(schema)
    wrong = yaml.safe_load(YAML.replace("unknown: free", "unknown: perhaps"))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(wrong, schema)
    rho.save_scenario(rho.load_scenario(yard), yard)
    jsonschema.validate(yaml.safe_load(yard.read_text()), schema)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("unknown: free, ", "", r"obstacles\[0\].unknown: got nothing, .*the file has 3 occupied"),
        ("tree.bt", "none.bt", r"obstacles\[0\].octomap: got maps/none.bt: no file"),
        ("tree.bt", "pyramid.obj", r"obstacles\[0\].octomap: got maps/pyramid.obj: the ending"),
        ("unknown: free", "unknwn: free", r"obstacles\[0\].unknwn: .* did you mean unknown"),
        ("resolution: 0.5, pos", "resolution: 0, pos", r"\[1\].shape.resolution: got 0"),
        ("scale: 0.5", "scale: -1", r"obstacles\[2\].scale: got -1"),
        ("mesh: maps/pyramid.obj, scale: 0.5", "stored_map: 0", r"\[2\].stored_map: got 0"),
    ],
)
def test_errors_name_the_field_and_the_file(yard: Path, old: str, new: str, complaint: str) -> None:
    text = YAML.replace(old, new, 1)
    if "stored_map" in new:
        text = text.replace("stored_map: 0, position: [3, 3, 3], rotation: [0.1, 0.2, 0.3]", new)
    yard.write_text(text)
    with pytest.raises(rho.ScenarioError, match=f"yard.yaml: .*{complaint}") as caught:
        rho.load_scenario(yard)
    assert "\n" not in str(caught.value)


def test_a_plan_keeps_its_maps_and_says_that_a_file_has_changed(yard: Path) -> None:
    scenario = rho.load_scenario(yard)
    plan = rho.plan_convex(scenario.without_obstacles())
    plan = rho.Plan(scenario, plan.positions, plan.velocities, plan.accelerations, plan.statistics)
    saved, exported = yard.parent / "plan.npz", yard.parent / "plan.json"
    rho.save(plan, saved)
    rho.export(plan, exported, format="json")
    rho.save_scenario(scenario, yard)
    assert rho.load(saved).scenario == rho.load(exported).scenario == scenario
    mesh = yard.parent / "maps" / "pyramid.obj"
    mesh.write_text(PYRAMID.replace("v 1 0 0", "v 2 0 0"))
    for path in (saved, exported):
        with pytest.warns(rho.MapChangedWarning, match="changed since the plan was saved") as found:
            assert rho.load(path).scenario == scenario  # of the plan, not of the file
        assert len(found) == 1
        assert str(mesh) in str(found[0].message)
    with pytest.warns(rho.MapChangedWarning, match="pyramid.obj: the map has changed since the"):
        again = rho.load_scenario(yard)
    assert again.obstacles[0] == scenario.obstacles[0]
    changed = again.obstacles[2]
    assert isinstance(changed, rho.Mesh)
    assert np.ptp(changed.vertices, axis=0).max() > 0.9
    mesh.unlink()
    assert rho.load(saved).scenario == scenario


def test_a_change_beside_a_gltf_is_noticed(tmp_path: Path) -> None:
    for name, content in trimesh.Scene(trimesh.creation.box()).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    read = rho.Mesh.load(tmp_path / "model.gltf").source
    assert read is not None
    assert not read.changed
    buffer = tmp_path / read.beside[0]
    buffer.write_bytes(buffer.read_bytes()[:-1] + b"\x00\x01")
    assert read.changed


def test_windows_of_a_flight_share_one_stored_map(yard: Path) -> None:
    occupied = np.argwhere(np.random.default_rng(3).random((30, 30, 30)) < 0.3)
    occupied += 50
    scenario = dataclasses.replace(_single(), obstacles=(rho.Voxels(occupied, 0.5),))
    plan = rho.plan_convex(scenario.without_obstacles())
    plan = rho.Plan(scenario, plan.positions, plan.velocities, plan.accelerations, plan.statistics)
    window = rho.Window(0, plan, plan)
    path = yard.parent / "flight.npz"
    rho.save(plan, path)
    once = path.stat().st_size
    rho.save(rho.Flight(plan, (window,)), path)
    assert path.stat().st_size < once + 8000 < 2 * once
    read = rho.load(path)
    assert read.scenario == scenario
    assert read.windows[0].plan.scenario.obstacles[0] is read.scenario.obstacles[0]


def test_plans_of_older_files_hold_their_maps_themselves(yard: Path) -> None:
    scenario = rho.load_scenario(yard)
    plan = rho.plan_convex(scenario.without_obstacles())
    plan = rho.Plan(scenario, plan.positions, plan.velocities, plan.accelerations, plan.statistics)
    path = yard.parent / "plan.npz"
    rho.save(plan, path)
    with np.load(path) as archive:
        content = {name: archive[name] for name in archive if not name.startswith("map")}
    content["plan.scenario"] = np.array(scenario_to_json(scenario))
    np.savez_compressed(path, **content)
    assert rho.load(path).scenario == scenario
    content["plan.scenario"] = np.array(scenario_to_json(scenario, []))
    np.savez_compressed(path, **content)
    with pytest.raises(rho.PlanFileError, match="one of the 0 maps of the file"):
        rho.load(path)


@pytest.mark.parametrize("scale", [1e-5, 1e5])
def test_a_map_in_another_unit_is_warned_of(scale: float) -> None:
    corners = scale * np.array([[1, 0, 0], [2, 0, 0], [1, 1, 0], [1, 0, 1]]) + [50.0, 50.0, 50.0]
    mesh, shown = rho.Mesh(corners, [[0, 1, 2]]), re.escape(f"{scale:.3g}")
    with pytest.warns(rho.MapScaleWarning, match=f"obstacle 1: a map of {shown} m beside"):
        scenario = dataclasses.replace(_single(), obstacles=(mesh,))
    text = scenario_to_json(scenario)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scenario_from_json(text, under_way=True)
        dataclasses.replace(_single(), obstacles=(rho.Mesh(corners / scale, [[0, 1, 2]]),))


def test_a_mission_in_an_octomap(tmp_path: Path) -> None:
    (tmp_path / "mission.json").write_text(MISSION)
    tree = _tree([[0.1, 0.1, 1.1], [0.1, 0.6, 1.1]], [[0.1, 1.1, 1.1]])
    tree.writeBinary(os.fsencode(tmp_path / "forest.bt"))
    scenario = rho.load_lsc_mission(
        tmp_path / "mission.json", grid=rho.Grid(0.2, 51), world=tmp_path / "forest.bt"
    )
    assert scenario.name == "mission in forest"
    assert scenario.obstacles[0] == rho.Voxels.from_octomap(tmp_path / "forest.bt", "free")
    (tmp_path / "forest.bt").write_bytes(b"nothing")
    with pytest.raises(rho.ScenarioError, match=r"forest.bt: got a damaged file"):
        rho.load_lsc_mission(
            tmp_path / "mission.json", grid=rho.Grid(0.2, 51), world=tmp_path / "forest.bt"
        )


def test_a_surface_that_is_there_twice_encloses_nothing() -> None:
    """Two faces of a pyramid, doubled, have each edge an even number of times and no inside."""
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    faces = [[0, 2, 1], [0, 1, 3]]
    inside = np.array([0.1, 0.1, 0.1])
    for triangles in (faces, faces + faces):
        sheet = rho.Mesh(corners, triangles)
        assert not sheet.is_watertight
        assert sheet.signed_distance(inside) > 0.0
    closed = [*faces, [0, 3, 2], [1, 2, 3]]
    for triangles in (closed, closed + closed, [*closed, closed[0]]):
        solid = rho.Mesh(corners, triangles)
        assert solid.is_watertight
        assert solid.signed_distance(inside) < 0.0
