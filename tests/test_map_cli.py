"""The command `map`, and maps where other commands read them."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import octomap
import pytest

import drake_rho as rho
from tests.scenarios import single, slow
from tests.test_cli import run
from tests.test_cli_json import PYRAMID, read
from tests.test_cli_missions import MISSION

Patch = pytest.MonkeyPatch
Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    """Return a folder, the current one, with a map of every kind."""
    monkeypatch.chdir(tmp_path)
    tree = octomap.OcTree(0.5)
    for position, occupied in (([0.1, 0.1, 1.1], True), ([0.1, 0.6, 1.1], True)):
        tree.updateNode(np.array(position), occupied)
    tree.updateNode(np.array([1.1, 1.1, 1.1]), False)
    tree.writeBinary(os.fsencode("tree.bt"))
    np.savetxt("cloud.xyz", [[0.1, 0.1, 0.1], [0.2, 0.2, 0.2], [0.9, 0.1, 0.1]])
    Path("pyramid.obj").write_text(PYRAMID)
    Path("surface.obj").write_text(PYRAMID.replace("f 2 3 4\n", ""))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ["tree.bt"],
            {
                "kind": "octomap",
                "lower_m": [0.0, 0.0, 1.0],
                "upper_m": [0.5, 1.0, 1.5],
                "resolution_m": 0.5,
                "cells": 2,
                "occupied_cells": 2,
                "free_cells": 1,
                "unknown_cells": 6,
                "triangles": None,
                "watertight": None,
                "parts": 1,
                "beyond_m": 0.0,
            },
        ),
        (["tree.bt", "--unknown", "occupied"], {"cells": 8, "occupied_cells": 2}),
        (["cloud.xyz", "--resolution", "0.5"], {"kind": "points", "cells": 2, "free_cells": None}),
        (
            ["pyramid.obj", "--scale", "2"],
            {"kind": "mesh", "triangles": 4, "watertight": True, "upper_m": [2.0, 2.0, 2.0]},
        ),
        (["surface.obj"], {"triangles": 3, "watertight": False, "cells": None, "vertices": 4}),
    ],
)
def test_a_map_is_described(
    words: list[str], expected: dict[str, object], capsys: Captured, monkeypatch: Patch
) -> None:
    status, out, err = run(capsys, monkeypatch, "map", *words, "--json")
    found = read(out, "map")
    assert (status, err) == (0, "")
    assert found["file"] == words[0]
    assert {name: found[name] for name in expected} == expected
    status, out, err = run(capsys, monkeypatch, "map", *words)
    assert (status, err) == (0, "")
    if found["watertight"] is not None:
        assert ("not watertight, a surface" in out) != found["watertight"]
    if found["unknown_cells"] is not None:
        assert "2 occupied, 1 free and 6 unknown cells" in out
    assert "exact" in out


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["none.bt"], "none.bt: got no file, expected a readable file"),
        (["maps.zip"], "'maps.zip': got no map, expected a file ending in .bt, .ot,"),
        (["cut.bt"], "cut.bt: got a damaged file, expected an OctoMap file"),
        (["cloud.xyz"], "'cloud.xyz': got no --resolution, expected --resolution, the side"),
        (["cloud.xyz", "--resolution", "0"], "resolution: got 0"),
        (["pyramid.obj", "--scale", "-1"], "scale: got -1"),
        (["pyramid.obj", "--unknown", "free"], "--unknown: got free, expected an OctoMap, not"),
        (["tree.bt", "--resolution", "1"], "--resolution: got 1.0, expected a point cloud, not"),
        (["cloud.xyz", "--scale", "1"], "--scale: got 1.0, expected a mesh, not 'cloud.xyz'"),
        (["tree.bt", "--unknown", "both"], "--unknown: got 'both', expected free or occupied"),
        (["tree.bt", "--figure", "out.txt"], "--figure: got 'out.txt', expected a file to write"),
        (["empty.obj"], "empty.obj: got no triangles, expected a mesh of triangles"),
    ],
)
def test_bad_maps_are_refused_in_one_line(
    words: list[str], complaint: str, capfd: Captured, monkeypatch: Patch
) -> None:
    Path("cut.bt").write_bytes(Path("tree.bt").read_bytes()[:-3])
    Path("empty.obj").write_text("v 0 0 0\n")
    status, out, err = run(capfd, monkeypatch, "map", *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert complaint in err


@pytest.mark.parametrize("words", [["tree.bt"], *slow(["surface.obj"])])
def test_a_map_is_drawn(words: list[str], capsys: Captured, monkeypatch: Patch) -> None:
    status, out, _ = run(capsys, monkeypatch, "map", *words, "--figure", "out.png")
    assert status == 0
    assert "drawn in out.png" in out
    assert Path("out.png").read_bytes().startswith(b"\x89PNG")


def test_a_mission_in_an_octomap_is_read(capsys: Captured, monkeypatch: Patch) -> None:
    Path("mission.json").write_text(MISSION)
    grid = ["--duration", "10", "--step", "0.2"]
    words = ["import", "mission.json", *grid, "--world", "tree.bt", "-o", "kept.yaml"]
    assert run(capsys, monkeypatch, *words)[0] == 0
    (tree, *_) = rho.load_scenario("kept.yaml").obstacles
    assert tree == rho.Voxels.from_octomap("tree.bt", "free")
    assert "octomap: tree.bt" in Path("kept.yaml").read_text()
    Path("tree.bt").write_bytes(b"nothing")
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "tree.bt: got a damaged file" in err


def test_a_changed_map_is_one_line_on_standard_error(capsys: Captured, monkeypatch: Patch) -> None:
    corners = np.array([[5.0, 50.0, 50.0], [6.0, 50.0, 50.0], [5.0, 51.0, 50.0]])
    mesh = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\n"
    Path("far.obj").write_text(mesh)
    content = {"obstacles": [{"mesh": "far.obj"}, {"mesh": "far.obj", "position": [0, 0, 9]}]}
    (vehicle,) = single().vehicles
    vehicle = dataclasses.replace(vehicle, radius=0.1)
    rho.save_scenario(dataclasses.replace(single(), vehicles=(vehicle,)), "s.yaml")
    with open("s.yaml", "a") as file:
        file.write(json.dumps(content)[1:-1].replace('"obstacles"', "obstacles") + "\n")
    text = Path("s.yaml").read_text().replace("obstacles: []\n", "")
    Path("s.yaml").write_text(text)
    rho.save_scenario(rho.load_scenario("s.yaml"), "s.yaml")
    Path("far.obj").write_text(mesh + "\n")
    words = ["assign", "s.yaml", "-o", "kept.yaml"]
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, err.count("\n")) == (0, 1)
    assert err.startswith("drake-rho: warning: ")
    assert "far.obj: the map has changed since the scenario was saved" in err
    assert "warning" not in out
    status, out, err = run(capsys, monkeypatch, *words, "--json")
    assert json.loads(out)["status"] == status == 0
    assert err.count("\n") == 1
    assert run(capsys, monkeypatch, *words, "--quiet") == (0, "", "")
