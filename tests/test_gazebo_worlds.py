"""Worlds of Gazebo: models by name, meshes of every kind, polylines, and what is skipped."""

from __future__ import annotations

import copy
import io
import math
import re
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

import drake_rho as rho
from tests.arrays import FloatArray
from tests.test_cli import run
from tests.test_cli_json import read

TRIANGLE = "<point>-20 0</point><point>20 0</point><point>0 10</point>"
NOTCHED = "".join(
    f"<point>{each}</point>" for each in ("0 0", "4 0", "4 3", "2 1", "0 3", "0 0", "0 0")
)
"""Square with a notch from above, whose last points repeat the first."""

WORLD = f"""<?xml version="1.0"?>
<sdf version="1.9">
  <world name="yard">
    <physics name="p" type="ode"><gravity>0 0 -9.81</gravity></physics>
    <plugin name="q" filename="libq.so"><anything><filename>a</filename></anything></plugin>
    <light name="sun" type="directional"/>
    <include><uri>model://crate</uri><name>one</name><pose>5 0 0 0 0 0.5</pose></include>
    <include><uri>
      model://crate
    </uri><name>two</name><pose>-5 1 0 0 0 0<relative_to>one</relative_to></pose></include>
    <model name="ridge"><static>true</static><pose>40 20 0 1.5708 0 0</pose><link name="l">
      <inertial><mass>-1</mass></inertial>
      <collision name="slope"><max_contacts>4</max_contacts><geometry><polyline>{TRIANGLE}
        <height>40</height></polyline></geometry><surface><bounce/></surface></collision>
      <collision name="pit"><pose>1 2 3 0 0 0</pose><geometry><polyline>{NOTCHED}
        <height>2</height></polyline></geometry></collision>
      <visual name="v"><geometry><mesh><uri>model://gone/v.dae</uri></mesh></geometry></visual>
    </link></model>
  </world>
</sdf>"""
CRATE = """<sdf version="1.9"><model name="crate"><link name="base"><pose>0 0 1 0 0 0</pose>
<sensor name="gps" type="navsat"><gz_frame_id>base</gz_frame_id></sensor>
<sensor name="bumper" type="contact"><contact><collision>box</collision></contact></sensor>
<collision name="box"><pose>0 0 0.5 0 0 0.2</pose><geometry><box><size>1 2 3</size></box></geometry>
</collision><collision name="lid"><geometry><mesh><uri>model://crate/lid.stl</uri><scale>.1 .2 .3
</scale></mesh></geometry></collision></link></model></sdf>"""
CONFIG = "<model><name>crate</name><sdf>model.sdf</sdf></model>"


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the variables of the machine that the tests run on."""
    for name in ("GZ_SIM_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    """Return the file of a world, with a folder of models beside its own folder."""
    (tmp_path / "worlds").mkdir()
    (tmp_path / "worlds" / "yard.sdf").write_text(WORLD)
    write_crate(tmp_path / "models")
    return tmp_path / "worlds" / "yard.sdf"


def write_crate(models: Path, name: str = "crate") -> None:
    """Write the model of a crate to a folder of models."""
    (models / name).mkdir(parents=True)
    (models / name / "model.config").write_text(CONFIG)
    (models / name / "model.sdf").write_text(CRATE)
    (models / name / "lid.stl").write_bytes(cube("stl"))


def cube(kind: str) -> bytes:
    """Return a cube of 2 m around (1, 2, 3) in a file of some kind."""
    library: Any = trimesh  # its functions have no types
    mesh = library.creation.box((2, 2, 2))
    mesh.apply_translation((1, 2, 3))
    found: str | bytes = mesh.export(file_type=kind)
    return found.encode() if isinstance(found, str) else found


def text_of(content: str) -> str:
    """Return a world of one link with the content."""
    model = f'<model name="m"><static>true</static><link name="l">{content}</link></model>'
    return f'<sdf version="1.9">{model}</sdf>'


def solid(geometry: str) -> str:
    return f'<collision name="c"><geometry>{geometry}</geometry></collision>'


def parsed(text: str) -> ElementTree.Element:
    return ElementTree.fromstring(text)  # noqa: S314 (written here)


class Independent:
    """Reader of worlds with the XML parser of the standard library alone."""

    def __init__(self, models: Path) -> None:
        self.models = models
        self.bounds = dict[str, FloatArray]()

    def read(self, element: ElementTree.Element, scope: str, pose: FloatArray) -> None:
        """Add the bounds of all collisions in an element."""
        for each in element:
            if each.tag not in ("world", "model", "include", "link", "collision"):
                continue
            here = pose @ matrix(each.findtext("pose") or "0 0 0 0 0 0")
            name = "::".join(filter(None, (scope, each.get("name", each.findtext("name", "")))))
            if each.tag == "include":
                folder = self.models / (each.findtext("uri") or "").strip().removeprefix("model://")
                model = parsed((folder / "model.sdf").read_text())[0]
                self.read(model, name, here)
            elif each.tag == "collision":
                points = self.corners(each) @ here[:3, :3].T + here[:3, 3]
                self.bounds[name] = np.array([points.min(axis=0), points.max(axis=0)])
            else:
                self.read(each, "" if each.tag == "world" else name, here)

    def corners(self, element: ElementTree.Element) -> FloatArray:
        """Return the corners of a geometry."""
        signs: FloatArray = np.array(list(product([-0.5, 0.5], repeat=3)))
        if (size := element.findtext("geometry/box/size")) is not None:
            return numbers(size) * signs
        if (scale := element.findtext("geometry/mesh/scale")) is not None:
            return numbers(scale) * (2.0 * signs + [1, 2, 3])
        outline = element.findall("geometry/polyline/point")
        flat = np.array([[*numbers(each.text or ""), 0.0] for each in outline])
        height = float(element.findtext("geometry/polyline/height", ""))
        return np.concatenate([flat, flat + np.array([0.0, 0.0, height])])


def numbers(text: str) -> FloatArray:
    return np.array(text.split(), dtype=float)


def matrix(text: str) -> FloatArray:
    """Return the matrix of a pose of SDF: position, roll, pitch and yaw."""
    *position, roll, pitch, yaw = map(float, text.split())
    found = np.eye(4)
    for a, b, angle in ((0, 1, yaw), (2, 0, pitch), (1, 2, roll)):
        turn = np.eye(4)
        turn[a, a] = turn[b, b] = math.cos(angle)
        turn[b, a] = math.sin(angle)
        turn[a, b] = -turn[b, a]
        found = found @ turn
    found[:3, 3] = position
    return found


def bounds_of(world: rho.World) -> dict[str, FloatArray]:
    """Return the bounds of the obstacles by their names."""
    shapes = {str(each.name): each.shape for each in world}
    return {
        name: np.array([shape.center - shape.extent, shape.center + shape.extent])
        for name, shape in shapes.items()
    }


def test_obstacles_and_their_bounds_are_those_of_an_independent_reader(yard: Path) -> None:
    reader = Independent(yard.parent.parent / "models")
    reader.read(parsed(WORLD), "", np.eye(4))
    found = bounds_of(rho.load_world(yard))
    assert sorted(found) == sorted(reader.bounds)
    assert len(found) == 6
    for name, expected in reader.bounds.items():
        np.testing.assert_allclose(found[name], expected, atol=1e-9, err_msg=name)


def test_a_world_tells_what_it_skipped_and_is_a_tuple_of_obstacles(yard: Path) -> None:
    world = rho.load_world(yard)
    counts = Counter(each.split()[0] for each in world.skipped)
    assert counts == Counter(
        physics=1, plugin=1, light=1, inertial=1, max_contacts=1, surface=1, visual=1, sensor=2,
        relative_to=1,
    )  # fmt: skip
    assert "physics p in world yard" in world.skipped
    assert "sensor gps in link base" in world.skipped
    again = copy.copy(world)
    assert isinstance(again, rho.World)
    assert (again.skipped, len(again)) == (world.skipped, len(world))
    assert isinstance(world, tuple)


def test_polylines_are_exact_solids_from_the_plane_upwards(yard: Path) -> None:
    named = {each.name: each.shape for each in rho.load_world(yard)}
    slope, pit = named["ridge::l::slope"], named["ridge::l::pit"]
    assert isinstance(slope, rho.Polytope)
    assert isinstance(pit, rho.Mesh)
    assert pit.is_watertight
    (yard.parent / "pit.sdf").write_text(
        text_of(solid(f"<polyline>{NOTCHED}<height>2</height></polyline>"))
    )
    (hole,) = rho.load_world(yard.parent / "pit.sdf")
    for x, expected in (
        ([2.0, 2.0, 1.0], 1.0 / math.sqrt(2.0)),  # in the notch
        ([2.0, 0.5, 1.0], -0.5),
        ([0.5, 1.5, 1.0], -0.5),
        ([1.0, 1.0, 3.0], 1.0),
        ([1.0, 1.0, -2.0], 2.0),
    ):
        assert hole.shape.signed_distance(np.array(x)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_any_simple_polygon_is_filled(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, int(rng.integers(5, 40))))
    radii = rng.uniform(0.5, 3.0, len(angles))
    corners = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    if seed % 2:
        corners = corners[::-1]
    points = "".join(f"<point>{x!r} {y!r}</point>" for x, y in corners.tolist())
    text = text_of(solid(f"<polyline>{points}<height>1.5</height></polyline>"))
    (tmp_path / "t.sdf").write_text(text)
    (star,) = rho.load_world(tmp_path / "t.sdf")
    if np.diff(angles, append=angles[0] + 2 * np.pi).max() > 3.0:
        return  # the centre is not in it
    assert isinstance(star.shape, rho.Mesh)
    assert star.shape.is_watertight
    mesh: Any = trimesh.Trimesh(star.shape.vertices, star.shape.triangles, process=False)
    x, y = corners.T
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert mesh.volume == pytest.approx(1.5 * area, rel=1e-9)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (["0 0", "1 0"], "2 different corners, expected a polygon"),
        (["0 0", "1 0", "1 0", "0 0"], "2 different corners, expected a polygon"),
        (["0 0", "2 2", "2 0", "0 2"], "a polygon that touches or crosses itself"),
        (["0 0", "2 0", "1 0"], "a polygon that touches or crosses itself"),
        (["0 0", "4 0", "4 4", "2 0", "0 4"], "a polygon that touches or crosses itself"),
        (["0 0", "1", "0 1"], "a point that is not x and y"),
        (["0 0", "1 a", "0 1"], "a text in the place of a number"),
        (["0 0", "1 inf", "0 1"], "a number that is not finite"),
        ([f"{k} {k * k}" for k in range(501)], "501 different corners"),
    ],
)
def test_polylines_that_are_no_polygon_are_refused(
    tmp_path: Path, points: list[str], words: str
) -> None:
    outline = "".join(f"<point>{each}</point>" for each in points)
    path = tmp_path / "t.sdf"
    path.write_text(text_of(solid(f"<polyline>{outline}<height>1</height></polyline>")))
    with pytest.raises(rho.ScenarioError, match=f"in the collision geometry c {words}"):
        rho.load_world(path)
    path.write_text(text_of(solid("<polyline><point>0 0</point></polyline>")))
    with pytest.raises(rho.ScenarioError, match="height missing of the collision geometry c"):
        rho.load_world(path)


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "glb", "dae"])
@pytest.mark.parametrize("form", ["sdf", "urdf"])
def test_meshes_of_every_kind_are_the_same_cube(tmp_path: Path, kind: str, form: str) -> None:
    (tmp_path / f"cube.{kind}").write_bytes(cube(kind))
    mesh = f"<mesh><uri>cube.{kind}</uri><scale>1 2 3</scale></mesh>"
    if form == "urdf":
        mesh = f'<mesh filename="cube.{kind}" scale="1 2 3"/>'
    text = text_of(solid(mesh))
    if form == "urdf":
        text = f'<robot name="m"><link name="l">{solid(mesh)}</link></robot>'
    (tmp_path / f"t.{form}").write_text(text)
    (found,) = rho.load_world(tmp_path / f"t.{form}")
    assert isinstance(found.shape, rho.Mesh)
    assert found.shape.is_watertight
    center = np.array([1, -6, 6]) if kind == "glb" else np.array([1, 4, 9])  # y is up in glTF
    np.testing.assert_allclose(found.shape.center, center, atol=1e-6)
    np.testing.assert_allclose(found.shape.extent, [1, 2, 3], atol=1e-6)


DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<unit name="cm" meter="0.01"/></asset><library_images><image id="i"><init_from>../a.png</init_from>
</image></library_images><library_geometries><geometry id="g"><mesh><source id="s">
<float_array id="a" count="12">0 0 0 100 0 0 100 200 0 0 200 0</float_array><technique_common>
<accessor source="#a" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><vcount>4</vcount>
<p>0 1 2 3</p></polylist></mesh></geometry></library_geometries><library_nodes><node id="n">
<translate>0 0 300</translate><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="w"><node id="o"><rotate>0 0 1 90</rotate>
<instance_node url="#n"/></node><node id="c"><instance_camera url="#k"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>"""


def test_collada_files_are_placed_by_their_nodes_in_their_unit(tmp_path: Path) -> None:
    (tmp_path / "t.dae").write_text(DAE)
    sheet = rho.Mesh.load(tmp_path / "t.dae", scale=2.0)
    assert (len(sheet.triangles), sheet.is_watertight) == (2, False)
    np.testing.assert_allclose(sheet.center, [-2, 1, 6], atol=1e-12)
    np.testing.assert_allclose(sheet.extent, [2, 1, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<asset>", "<!DOCTYPE a [<!ENTITY b 'c'>]>", "a DOCTYPE or an ENTITY|not well-formed"),
        ("<vcount>4", "<vcount>2000000000", "2000000000 corners in 4 numbers"),
        ("<vcount>4", "<vcount>-4", "-4 corners in 4 numbers"),
        ("0 1 2 3</p>", "0 1 2 -1</p>", "numbers in a p"),
        ("0 1 2 3</p>", "0 1 2 c</p>", "could not convert"),
        ("<vcount>4", "<vcount>2", "2 corners in 4 numbers"),
        ("0 1 2 3</p>", "0 1 2 9</p>", "a damaged file"),
        ('url="#g"', 'url="#h"', "not found"),
        ('<instance_geometry url="#g"', '<instance_node url="#n"', "in each other without end"),
        ('<instance_geometry url="#g"', '<instance_controller url="#b"', "meshes with bones"),
        ('meter="0.01"', 'meter="-1"', "its unit is -1 m"),
        ("<scene>", "<scenery/><extra>", "a damaged file"),
        ("100 0 0", "nan 0 0", "numbers in a float_array"),
    ],
)
def test_damaged_collada_files_are_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    (tmp_path / "t.dae").write_text(DAE.replace(old, new, 1))
    with pytest.raises(rho.ScenarioError, match=words) as caught:
        rho.Mesh.load(tmp_path / "t.dae")
    assert "t.dae" in str(caught.value)


def test_nodes_that_multiply_are_refused(tmp_path: Path) -> None:
    nodes = "".join(
        f'<node id="n{k}">' + f'<instance_node url="#n{k + 1}"/>' * 10 + "</node>"
        for k in range(12)
    )
    text = DAE.replace("<library_nodes>", f"<library_nodes>{nodes}").replace('"#n"', '"#n0"')
    (tmp_path / "t.dae").write_text(text)
    with pytest.raises(rho.ScenarioError, match="nodes, more than 10000"):
        rho.Mesh.load(tmp_path / "t.dae")


@pytest.mark.parametrize("way", ["argument", "GZ_SIM_RESOURCE_PATH", "SDF_PATH", "beside"])
def test_models_are_found_in_resource_folders(
    tmp_path: Path, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "deep" / "er" / "worlds"
    folder.mkdir(parents=True)
    (folder / "yard.sdf").write_text(WORLD)
    models = folder / "models" if way == "beside" else tmp_path / "elsewhere"
    write_crate(models)
    given: list[str | Path] = [tmp_path, str(models)] if way == "argument" else []
    if way not in ("argument", "beside"):
        with pytest.raises(rho.ScenarioError, match="a reference to crate, which is not there"):
            rho.load_world(folder / "yard.sdf")
        monkeypatch.setenv(way, f":relative:/not/there:{models}")
    assert len(rho.load_world(folder / "yard.sdf", resource_path=given)) == 6


def test_a_resource_path_that_is_not_there_is_an_error(yard: Path) -> None:
    with pytest.raises(
        rho.ScenarioError, match=r"resource_path: got /not/there, expected a folder"
    ):
        rho.load_world(yard, resource_path="/not/there")


@pytest.mark.parametrize(
    "uri",
    [
        "model://crate/../../outside.stl",
        "model://../outside.stl",
        "model://..%2Foutside.stl",
        "model://crate/link.stl",
        "model://linked/outside.stl",
        "https://fuel.gazebosim.org/1.0/a/models/crate/tip/files/../../outside.stl",
        "file:///etc/hostname.stl",
    ],
)
def test_nothing_outside_of_the_resource_folders_is_read(yard: Path, uri: str) -> None:
    root, models = yard.parent.parent, yard.parent.parent / "models"
    (root / "outside.stl").write_bytes(cube("stl"))
    (models / "crate" / "link.stl").symlink_to(root / "outside.stl")
    (models / "linked").symlink_to(root)
    for path in (yard.parent / "t.sdf", models / "crate" / "model.sdf"):
        path.write_text(text_of(solid(f"<mesh><uri>{uri}</uri></mesh>")))
    for path in (yard.parent / "t.sdf", yard):
        with pytest.raises(rho.ScenarioError, match="refer"):
            rho.load_world(path)


def test_models_that_are_only_on_a_server_are_named_in_one_error(yard: Path) -> None:
    oak, pine = (f"https://fuel.gazebosim.org/1.0/OpenRobotics/models/{n} Tree" for n in "OP")
    includes = "".join(f"<include><uri>\n {each} </uri></include>" for each in (oak, pine, oak))
    yard.write_text(f'<sdf version="1.9"><world name="w">{includes}</world></sdf>')
    with pytest.raises(rho.ScenarioError) as caught:
        rho.load_world(yard)
    assert f"of {oak}, {pine}" in str(caught.value)
    assert "got 2 references to models that are only on a server" in str(caught.value)
    for name in ("O Tree", "P Tree", "crate"):
        write_crate(yard.parent / "models", name)
    names = iter("abc")
    yard.write_text(
        re.sub("</include>", lambda _: f"<name>{next(names)}</name></include>", yard.read_text())
    )
    assert len(rho.load_world(yard)) == 6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            f'<sdf version="1.9"><world name="w"><population name="p"><model name="m">'
            f'<link name="l">{solid("<sphere><radius>1</radius></sphere>")}</link></model>'
            "</population></world></sdf>",
            "a collision c in the element population p",
        ),
        (
            '<sdf version="1.9"><world name="w"><wurld><include><uri>model://crate</uri></include>'
            "</wurld></world></sdf>",
            "a include in the element wurld",
        ),
        (
            text_of(solid("<sphere><radius>1</radius></sphere>")).replace(
                "<geometry>", "<poze>1 2 3 0 0 0</poze><geometry>"
            ),
            "poze",
        ),
        (WORLD.replace("<uri>", "<uri a='b'>"), "the attribute a of a uri in an include"),
        (WORLD.replace("<pose>5", "<pose frame=''>5"), "the attribute frame of a pose in an"),
        (WORLD.replace("<sdf", "<!DOCTYPE a [<!ENTITY b 'c'>]><sdf"), "a DOCTYPE or an ENTITY"),
    ],
)
def test_nothing_that_may_move_or_be_an_obstacle_is_skipped(
    yard: Path, text: str, words: str
) -> None:
    yard.write_text(text)
    with pytest.raises(rho.ScenarioError, match=words):
        rho.load_world(yard)


def test_a_scenario_names_its_resource_folders(yard: Path) -> None:
    root = yard.parent.parent
    (root / "models").rename(root / "things")
    text = """name: yard
grid: {step: 0.5, knots: 21}
vehicles: [{name: u, radius: 0.1, start: {position: [-9, 0, 9]}, goal: {position: [9, 0, 9]}}]
obstacles: [{world: worlds/yard.sdf, resource_path: [things]}]
"""
    (root / "yard.yaml").write_text(text)
    assert len(rho.load_scenario(root / "yard.yaml").bodies) == 6
    (root / "yard.yaml").write_text(text.replace("[things]", "[models]"))
    with pytest.raises(rho.ScenarioError, match=r"obstacles\[0\]\.resource_path: got .*models"):
        rho.load_scenario(root / "yard.yaml")


def test_the_command_map_takes_resource_folders_and_counts_what_is_skipped(
    yard: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (yard.parent.parent / "models").rename(yard.parent.parent / "things")
    words = ("map", str(yard), "--resource-path", str(yard.parent.parent / "things"))
    document = read(run(capsys, monkeypatch, *words, "--json")[1], "map")
    assert (len(document["obstacles"]), len(document["skipped"])) == (6, 10)
    assert "1 physics, 1 plugin, 1 light" in " ".join(run(capsys, monkeypatch, *words)[1].split())
    status, _, error = run(capsys, monkeypatch, "map", "a.bt", "--resource-path", "b")
    assert status != 0
    assert "--resource-path: got b, expected a world" in error


def test_vertices_that_differ_by_rounding_are_joined_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    library: Any = trimesh
    mesh = library.load(io.BytesIO(cube("stl")), file_type="stl", process=False)
    exact = rho.Mesh(mesh.vertices, mesh.faces)
    vertices = np.array(mesh.vertices)
    vertices[0] += 3e-10
    moved = rho.Mesh(vertices, mesh.faces)
    assert (exact.is_watertight, exact.moved_vertices) == (True, 0)
    assert (moved.is_watertight, moved.moved_vertices) == (True, 1)
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    rows += ["f " + " ".join(map(str, face + 1)) for face in np.array(mesh.faces)]
    (tmp_path / "cube.obj").write_text("\n".join(rows))
    words = ("map", str(tmp_path / "cube.obj"))
    assert read(run(capsys, monkeypatch, *words, "--json")[1], "map")["moved_vertices"] == 1
    assert "1 vertices count as one with others beside" in run(capsys, monkeypatch, *words)[1]


def test_a_closed_mesh_whose_corners_are_rounded_to_single_precision_has_an_inside() -> None:
    library: Any = trimesh
    ball = library.creation.icosphere(3, 100.0)
    corners = np.array(ball.vertices)[np.array(ball.faces)].reshape(-1, 3).astype(np.float32)
    moved = np.random.default_rng(5).random(corners.shape) < 0.5
    corners[moved] = np.nextafter(corners, np.float32(1e9))[moved]
    mesh = rho.Mesh(corners.astype(float), np.arange(len(corners)).reshape(-1, 3))
    assert mesh.is_watertight
    assert mesh.moved_vertices > 1000
    assert float(mesh.signed_distance(np.zeros(3))) == pytest.approx(-99.0, abs=1.5)
    corners[0] += 0.01  # a gap is no rounding
    assert not rho.Mesh(corners.astype(float), mesh.triangles).is_watertight


def mutated(text: str, rng: np.random.Generator) -> str:
    """Return a text with a place damaged, or an element removed, doubled, renamed or rewritten."""
    if rng.random() < 0.3:
        at, length = rng.integers(len(text)), rng.integers(1, 30)
        return text[:at] + "".join(map(chr, rng.integers(32, 127, 3))) + text[at + length :]
    tree = parsed(text.replace("xmlns", "space"))
    parents = [each for each in tree.iter() if len(each)]
    parent = parents[int(rng.integers(len(parents)))]
    element = parent[int(rng.integers(len(parent)))]
    match rng.integers(5):
        case 0:
            parent.remove(element)
        case 1:
            parent.append(element)
        case 2:
            element.tag = str(rng.choice([each.tag for each in tree.iter()]))
        case 3:
            element.text = str(
                rng.choice(["", "-1", "1e999", "0 0 0", "../a", "\u00e4", "1 2 3 4 5 6"])
            )
        case 4:
            element.attrib = {"name": str(rng.choice(["", "__a__", "a::b", "world", "l"]))}
    return ElementTree.tostring(tree, encoding="unicode").replace("space", "xmlns")


MUTATIONS = 300
"""Number of damaged files in the test."""


@pytest.mark.slow
def test_a_damaged_world_is_read_or_refused_in_one_line_that_names_a_file(yard: Path) -> None:
    rng = np.random.default_rng(7)
    root = yard.parent.parent
    crate = root / "models" / "crate"
    sources = {yard: WORLD, crate / "model.sdf": CRATE, crate / "model.config": CONFIG}
    sources[crate / "lid.dae"] = DAE
    complaints = list[str]()
    (crate / "model.sdf").write_text(CRATE.replace("lid.stl", "lid.dae"))
    sources[crate / "model.sdf"] = CRATE.replace("lid.stl", "lid.dae")
    for path, text in sources.items():
        path.write_text(text)
    assert len(rho.load_world(yard)) == 6
    for _ in range(MUTATIONS):
        path = list(sources)[int(rng.integers(len(sources)))]
        path.write_text(mutated(sources[path], rng))
        try:
            rho.load_world(yard)
        except rho.ScenarioError as error:
            complaints.append(str(error))
        path.write_text(sources[path])
    assert 0.3 * MUTATIONS < len(complaints) < MUTATIONS
    assert [each for each in complaints if "\n" in each or f"{root}/" not in each] == []
