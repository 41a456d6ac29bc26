"""Valid files of every kind that is read, small ones, and how each is read."""

from __future__ import annotations

import dataclasses
import io
import json
import struct
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks import damage
from benchmarks.damage import OF_BYTES, OF_TEXT
from benchmarks.format_kinds import Kind, format_kinds

SCENARIO = """\
name: yard
grid: {knots: 11, step: 0.5}
vehicles:
- {name: scout, start: {position: [-4, 0, 2]}, goal: {position: [4, 0.5, 2]}, radius: 0.2}
- {name: mule, start: {position: [0, -4, 2]}, goal: {position: [0, 4, 2]}, radius: 0.2}
separation: {distance: 0.5}
limits: {acceleration: {lower: [-4, -4, -4], upper: [4, 4, 4]}}
obstacles:
- {center: [0, 0, 2], radius: 0.5}
"""

_ALIASES = """\
name: yard
grid: {knots: 11, step: 0.5}
vehicles:
- &one {name: scout, start: &rest {position: [-4, 0, 2]}, goal: {position: [4, 0, 2]}}
- {<<: *one, name: mule, start: {position: [-4, 4, 2]}, goal: {position: [4, 4, 2]}}
"""

_STUDY = """\
name: small
repetitions: 2
scenarios:
- {name: a, generator: random_transitions, parameters: {n: 2, duration: 5}}
methods:
- {name: p, planner: plan}
"""

_SDF = """<?xml version="1.0"?><sdf version="1.7"><model name="m"><static>true</static>
<link name="l"><pose>0 0 1 0 0 0</pose><collision name="c"><geometry><box><size>1 2 3</size></box>
</geometry></collision><collision name="d"><geometry><sphere><radius>0.5</radius></sphere>
</geometry></collision></link></model></sdf>"""

_URDF = """<?xml version="1.0"?><robot name="r"><link name="l"><collision><origin xyz="0 0 1"/>
<geometry><cylinder radius="0.5" length="2"/></geometry></collision></link></robot>"""

_MJCF = """<mujoco model="m"><worldbody><body pos="0 0 1"><geom type="box" size="1 2 3"/>
<geom type="capsule" size="0.2 1"/></body></worldbody></mujoco>"""

_MISSION = {
    "quadrotors": {
        "crazyflie": {
            "max_vel": [1.0] * 3,
            "max_acc": [2.0] * 3,
            "radius": 0.15,
            "downwash": 2.0,
            "nominal_velocity": 1.0,
        }
    },
    "world": [{"dimension": [-5, -5, 0, 5, 5, 3]}],
    "agents": [
        {"type": "crazyflie", "start": [-2, 0, 1], "goal": [2, 0, 1]},
        {"type": "crazyflie", "start": [0, -2, 1], "goal": [0, 2, 1]},
    ],
    "obstacles": [{"type": "static", "pose": [0, 0, 0.5], "dimensions": [0.2, 0.2, 0.2]}],
}


_ROBOTS = b"""\
robots:
  cf1: {enabled: true, uri: 'radio://0/80/2M/E7E7E7E701', initial_position: [0, 0, 0], type: cf21}
  cf2: {enabled: false, uri: 'radio://0/80/2M/E7E7E7E702', initial_position: [0, 0.5, 0]}
robot_types:
  cf21: {motion_capture: {enabled: true, marker: default_single_marker}, big_quad: false}
"""

_ON_GRID = ("--duration", "5", "--step", "0.5", "-o", "imported.yaml")


def kinds(folder: Path) -> list[Kind]:
    """Return a valid file of each kind.

    Args:
        folder: for files on the way.
    """
    found = [*_scenarios(), *_records(folder), *_maps(folder), *_meshes(folder), *_worlds()]
    return [*found, *format_kinds(folder, rho.plan(scenario(folder)))]


def scenario(folder: Path) -> rho.Scenario:
    """Return the scenario of the files."""
    path = folder / "scenario.yaml"
    path.write_text(SCENARIO)
    return rho.load_scenario(path)


def _scenarios() -> list[Kind]:
    cells = [[i, j, 0] for i in range(3) for j in range(3)]
    with_map = f"{SCENARIO}- {{occupied: {cells}, resolution: 0.2, origin: [2, 2, 0]}}\n"
    with_file = f"{SCENARIO}- {{mesh: mesh.obj}}\n"
    mission = json.dumps(_MISSION, indent=1)
    with_world = ("import", "mission.json", "--world", "{}", *_ON_GRID)
    return [
        Kind("scenario (YAML)", ".yaml", SCENARIO.encode(), ("read", "{}"), OF_TEXT),
        Kind("scenario with aliases", ".yaml", _ALIASES.encode(), ("read", "{}"), OF_TEXT),
        Kind("scenario with a map", ".yaml", with_map.encode(), ("read", "{}"), OF_TEXT),
        Kind("scenario with a map's file", ".yaml", with_file.encode(), ("read", "{}"), OF_TEXT),
        Kind("mission (LSC)", ".json", mission.encode(), ("import", "{}", *_ON_GRID), OF_TEXT),
        Kind("world (LSC-DR)", ".csv", b"0,0,1,1,1,2\n2,2,1,1,1,2\n", with_world, OF_TEXT),
        Kind("robots (Crazyswarm2)", ".yaml", _ROBOTS, ("import", "{}", *_ON_GRID), OF_TEXT),
        Kind("study", ".yaml", _STUDY.encode(), ("study", "{}"), OF_TEXT),
    ]


def _records(folder: Path) -> list[Kind]:
    plan = rho.plan(scenario(folder))
    flight = rho.plan_rho(plan.scenario, replan_every=5)
    simulation = rho.simulate(plan)
    block = rho.Voxels([[0, 0, 0], [1, 0, 0]], 0.2, [3, 3, 0])
    mapped = rho.plan(dataclasses.replace(plan.scenario, obstacles=(block,)))
    found = list[Kind]()
    for name, each in (
        ("plan", plan),
        ("flight", flight),
        ("simulation", simulation),
        ("plan with a map", mapped),
    ):
        path = folder / "saved.npz"
        rho.save(each, path)
        damages = (*OF_BYTES, *[damage.array] * 5)
        found.append(Kind(name, ".npz", path.read_bytes(), ("verify", "{}"), damages))
    for ending, command in ((".json", "verify"), (".csv", "table")):
        path = folder / f"exported{ending}"
        rho.export(plan, path, format=ending[1:])
        found.append(Kind(f"plan ({ending})", ending, path.read_bytes(), (command, "{}"), OF_TEXT))
    path = folder / "store.sqlite"
    study = folder / "study.yaml"
    study.write_text(_STUDY)
    rho.campaign(rho.load_study(study), path)

    def of_table(content: bytes, rng: np.random.Generator) -> bytes:
        return damage.table(content, rng, folder)

    damages = (*OF_BYTES, *[of_table] * 5)
    return [*found, Kind("store", ".sqlite", path.read_bytes(), ("results", "{}"), damages)]


def _maps(folder: Path) -> list[Kind]:
    points = np.random.default_rng(0).uniform(0.0, 2.0, (40, 3)).astype(np.float32)
    text = "\n".join(" ".join(f"{x:.3f}" for x in each) for each in points).encode() + b"\n"
    head = (
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 40\nHEIGHT 1\n"
        b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 40\nDATA "
    )
    ply = b"ply\nformat ascii 1.0\nelement vertex 40\n" + b"".join(
        b"property float %c\n" % axis for axis in b"xyz"
    )
    array = io.BytesIO()
    np.save(array, points)
    compressed = folder / "compressed.pcd"
    import pypcd4

    cloud = pypcd4.PointCloud.from_points(points, ("x", "y", "z"), (np.float32,) * 3)
    cloud.save(compressed, encoding=pypcd4.Encoding.BINARY_COMPRESSED)
    command = ("map", "{}", "--resolution", "0.1")
    return [
        Kind("PCD, text", ".pcd", head + b"ascii\n" + text, command, OF_TEXT),
        Kind("PCD, binary", ".pcd", head + b"binary\n" + points.tobytes(), command, OF_BYTES),
        Kind("PCD, compressed", ".pcd", compressed.read_bytes(), command, OF_BYTES),
        Kind("points (PLY)", ".ply", ply + b"end_header\n" + text, command, OF_TEXT),
        Kind("points (XYZ)", ".xyz", text, command, OF_TEXT),
        Kind("points (NPY)", ".npy", array.getvalue(), command, OF_BYTES),
        *_octomaps(folder),
    ]


def _octomaps(folder: Path) -> list[Kind]:
    import octomap

    found = list[Kind]()
    for ending, write in ((".bt", "writeBinary"), (".ot", "write")):
        tree = octomap.OcTree(0.1)
        for each in np.random.default_rng(1).uniform(0.0, 2.0, (60, 3)):
            tree.updateNode(each, bool(each[0] > 1.0))
        path = folder / f"tree{ending}"
        content = getattr(tree, write)(str(path).encode())
        content = path.read_bytes() if path.exists() else content
        command = ("map", "{}", "--unknown", "free")
        found.append(Kind(f"OctoMap ({ending})", ending, content, command, OF_BYTES))
    return found


def _meshes(folder: Path) -> list[Kind]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    found = list[Kind]()
    for name, kind, ending, damages in (
        ("STL, text", "stl_ascii", ".stl", OF_TEXT),
        ("STL, binary", "stl", ".stl", OF_BYTES),
        ("OBJ", "obj", ".obj", OF_TEXT),
        ("PLY, binary", "ply", ".ply", OF_BYTES),
        ("glTF, binary", "glb", ".glb", OF_BYTES),
    ):
        made = ball.export(file_type=kind)
        content = made.encode() if isinstance(made, str) else made
        found.append(Kind(name, ending, content, ("map", "{}"), damages))
    (length,) = struct.unpack_from("<I", found[-1].content, 12)
    tree = json.loads(found[-1].content[20 : 20 + length])
    tree["buffers"][0]["uri"] = "numbers.bin"
    (folder / "numbers.bin").write_bytes(found[-1].content[28 + length :])
    (folder / "mesh.obj").write_bytes(found[2].content)
    content = json.dumps(tree, indent=1).encode()
    return [*found, Kind("glTF", ".gltf", content, ("map", "{}"), OF_TEXT)]


def _worlds() -> list[Kind]:
    return [
        Kind(name, ending, text.encode(), ("map", "{}"), OF_TEXT)
        for name, ending, text in (
            ("SDF", ".sdf", _SDF),
            ("URDF", ".urdf", _URDF),
            ("MJCF", ".xml", _MJCF),
        )
    ]
