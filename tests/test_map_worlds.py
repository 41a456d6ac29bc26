"""Worlds in SDF, URDF and MJCF: distances are Drake's, and files reach nothing else."""

from __future__ import annotations

import io
import logging
import os
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import trimesh
import yaml
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

import drake_rho as rho
from tests.arrays import FloatArray
from tests.test_cli import run
from tests.test_cli_json import read
from tests.written import as_yaml, from_yaml

# a solid that is not convex: an L
L_OBJ = """v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0
v 0 0 1\nv 2 0 1\nv 2 1 1\nv 1 1 1\nv 1 2 1\nv 0 2 1
f 1 4 2\nf 2 4 3\nf 1 5 4\nf 1 6 5\nf 7 8 10\nf 8 9 10\nf 7 10 11\nf 7 11 12
f 1 2 8\nf 1 8 7\nf 2 3 9\nf 2 9 8\nf 3 4 10\nf 3 10 9\nf 4 5 11\nf 4 11 10
f 5 6 12\nf 5 12 11\nf 6 1 7\nf 6 7 12
"""


def collision(name: str, geometry: str, pose: str = "0 0 0 0 0 0") -> str:
    return (
        f'<collision name="{name}"><pose>{pose}</pose><geometry>{geometry}</geometry></collision>'
    )


def sdf(content: str, pose: str = "0 0 0 0 0 0") -> str:
    return (
        '<?xml version="1.0"?><sdf version="1.7" xmlns:drake="http://drake.mit.edu">'
        f'<model name="m"><static>true</static><pose>{pose}</pose><link name="l">{content}</link>'
        "</model></sdf>"
    )


BALL = collision("ball", "<sphere><radius>0.5</radius></sphere>")
POLE = "<cylinder><radius>0.1</radius><length>3</length></cylinder>"
PIPE = "<cylinder><radius>0.2</radius><length>2</length></cylinder>"
HULL = "<mesh><uri>meshes/l.obj</uri><drake:declare_convex/></mesh>"
LAB = sdf(
    collision("plate", "<box><size>1 2 0.1</size></box>", "1 2 0.5 0 0 0")
    + collision("beam", "<box><size>4 0.2 0.3</size></box>", "1 2 2 0.1 0.2 0.3")
    + collision("pole", POLE, "4 0 0 0 0 0")
    + collision("pipe", PIPE, "0 4 1 1 .3 0")
    + collision("egg", "<ellipsoid><radii>0.3 0.4 0.5</radii></ellipsoid>", "-3 0 1 0 0 0")
    + collision("pill", "<capsule><radius>.2</radius><length>1</length></capsule>", "-2 2 1 1 1 0")
    + collision("ball", "<sphere><radius>0.5</radius></sphere>", "-2 -3 1 0 0 0")
    + collision("corner", "<mesh><uri>l.obj</uri><scale>1 2 0.5</scale></mesh>", "3 3 0 0.2 0 1")
    + collision("hull", HULL, "3 -4 0 0 1 0"),
    "0.5 0 0 0 0 0.2",
)  # fmt: skip
URDF = """<robot name="u"><link name="base"><collision name="block">
<origin xyz="0 0 1" rpy="0 0 0.4"/>
<geometry><box size="1 2 3"/></geometry></collision></link>
<link name="arm"><collision name="rod"><geometry><cylinder radius="0.1" length="2"/></geometry>
</collision><collision name="tip"><origin xyz="0 0 1"/><geometry><mesh filename="l.obj"/></geometry>
</collision></link><joint name="j" type="revolute"><parent link="base"/><child link="arm"/>
<origin xyz="2 0 1" rpy="0.3 0.2 0"/><axis xyz="0 0 1"/></joint></robot>"""
MJCF = """<mujoco model="x"><compiler meshdir="meshes"/><asset><mesh name="q" file="l.obj"/></asset>
<worldbody><geom name="post" type="cylinder" pos="3 0 0" size="0.2 1"/>
<body name="b" pos="1 2 3" euler="10 20 30"><geom name="rod" type="capsule" fromto="0 0 0 1 1 1"
size="0.1"/><geom name="hull" type="mesh" mesh="q"/></body></worldbody></mujoco>"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with worlds of all kinds and their meshes."""
    inner = tmp_path / "lab"
    (inner / "meshes").mkdir(parents=True)
    for path in (inner / "l.obj", inner / "meshes" / "l.obj", tmp_path / "outside.obj"):
        path.write_text(L_OBJ)
    for name, text in (("lab.sdf", LAB), ("arm.urdf", URDF), ("x.xml", MJCF)):
        (inner / name).write_text(text)
    return inner


def in_drake(path: Path) -> tuple[list[str], Any, list[Any]]:
    """Return geometries' names, a function that returns their distances [m], and what it needs."""
    builder = DiagramBuilder()
    plant, scene = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    query = scene.get_query_output_port().Eval(scene.GetMyContextFromRoot(context))
    ids = query.inspector().GetAllGeometryIds(Role.kProximity)

    def distances(x: FloatArray) -> dict[str, float]:
        found = {each.id_G: each.distance for each in query.ComputeSignedDistanceToPoint(x)}
        return {query.inspector().GetName(each).rpartition("::")[2]: found[each] for each in ids}

    names = [query.inspector().GetName(each).rpartition("::")[2] for each in ids]
    return names, distances, [diagram, context, query]


@pytest.mark.parametrize("name", ["lab.sdf", "arm.urdf", "x.xml"])
def test_distances_from_every_geometry_are_those_of_drake(folder: Path, name: str) -> None:
    obstacles = rho.load_world(folder / name)
    names, distances, _kept = in_drake(folder / name)
    own = {str(each.name).rpartition("::")[2]: each.shape for each in obstacles}
    assert sorted(own) == sorted(names)
    rng = np.random.default_rng(4)
    compared = 0
    for x in rng.uniform(-6.0, 6.0, (60, 3)):
        for each, expected in distances(x).items():
            if expected > 0.0:
                # Drake stops its search for the nearest point of an ellipsoid early
                tolerance = 1e-3 if each == "egg" else 1e-6
                assert own[each].signed_distance(x) == pytest.approx(expected, abs=tolerance), each
                compared += 1
    assert compared > 50 * len(names)


def test_shapes_stay_simple_where_they_can(folder: Path) -> None:
    kinds = {each.name: type(each.shape) for each in rho.load_world(folder / "lab.sdf")}
    assert kinds == {
        "m::l::plate": rho.Posed,  # the model is turned
        "m::l::beam": rho.Posed,
        "m::l::pole": rho.Cylinder,
        "m::l::pipe": rho.Posed,
        "m::l::egg": rho.Posed,
        "m::l::pill": rho.Capsule,
        "m::l::ball": rho.Sphere,
        "m::l::corner": rho.Mesh,
        "m::l::hull": rho.Polytope,
    }
    back = RigidTransform(RollPitchYaw(0, 0, -0.2), [0, 0, 0])
    plate = rho.load_world(folder / "lab.sdf", back)[0].shape
    assert isinstance(plate, rho.Box)
    middle = back.multiply(RigidTransform(RollPitchYaw(0, 0, 0.2), [0.5, 0, 0])).multiply(
        [1, 2, 0.5]
    )
    np.testing.assert_allclose(plate.center, middle, atol=1e-12)


@pytest.mark.parametrize("tilt", [1e-13, 1e-11, 1e-8, 1e-7])
def test_a_pole_that_leans_slightly_is_not_made_upright(folder: Path, tilt: float) -> None:
    (folder / "t.sdf").write_text(sdf(collision("pole", POLE, f"0 0 0 {tilt} 0 0")))
    (pole,) = rho.load_world(folder / "t.sdf")
    assert isinstance(pole.shape, rho.Cylinder if tilt < 1e-12 else rho.Posed)
    far = np.array([0.0, -9.0, 0.0])  # the upper end leans to it by half the height
    lean = 1.5 * tilt
    assert pole.shape.support(far) / 9.0 == pytest.approx(0.1 + lean, abs=1e-12)


def test_a_chain_of_inclusions_has_an_end(folder: Path) -> None:
    for k in range(2000):
        (folder / f"{k}.sdf").write_text(_include(f"{k + 1}.sdf"))
    with pytest.raises(rho.ScenarioError, match="more than 100 files that include"):
        rho.load_world(folder / "0.sdf")


def test_a_plane_becomes_a_wide_box_below_it(folder: Path) -> None:
    plane = collision("floor", "<plane><normal>0 0 1</normal></plane>", "1 2 3 0 0 0")
    (folder / "floor.sdf").write_text(sdf(plane))
    (floor,) = rho.load_world(folder / "floor.sdf")
    assert isinstance(floor.shape, rho.Box)
    np.testing.assert_allclose(
        [floor.shape.lower, floor.shape.upper], [[-99, -98, 2], [101, 102, 3]]
    )
    x = np.array([5.0, -7.0, 9.5])
    assert floor.shape.signed_distance(x) == pytest.approx(
        in_drake(folder / "floor.sdf")[1](x)["floor"]
    )


def test_meshes_in_gltf_are_turned_as_drake_turns_them(folder: Path) -> None:
    library: Any = trimesh  # its functions have no types
    mesh = library.load(io.BytesIO(L_OBJ.encode()), file_type="obj")
    for name, content in library.Scene(mesh).export(file_type="gltf").items():
        (folder / name).write_bytes(content)
    uri, at = "<mesh><uri>model.gltf</uri><scale>1 2 3</scale>%s</mesh>", "1 2 3 .1 .2 .3"
    both = collision("a", uri % "", at) + collision("b", uri % "<drake:declare_convex/>", at)
    (folder / "t.sdf").write_text(sdf(both))
    surface, hull = rho.load_world(folder / "t.sdf")
    assert (type(surface.shape), type(hull.shape)) == (rho.Mesh, rho.Polytope)
    np.testing.assert_allclose(surface.shape.center, hull.shape.center, atol=1e-6)
    np.testing.assert_allclose(surface.shape.extent, hull.shape.extent, atol=1e-6)


def test_the_command_map_lists_what_a_world_holds(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def answer(*words: str) -> tuple[int, str, str]:
        return run(capsys, monkeypatch, "map", *words)

    document = read(answer(str(folder / "lab.sdf"), "--json")[1], "map")
    assert (document["kind"], len(document["obstacles"])) == ("world", 9)
    assert document["obstacles"][2].startswith("m::l::pole: cylinder of radius 0.1 m")
    assert "b::hull" in answer(str(folder / "x.xml"))[1]
    status, _, error = answer(str(folder / "lab.sdf"), "--figure", str(folder / "a.png"))
    assert status != 0
    assert "--figure" in error


YAML = """name: yard
grid: {step: 0.5, knots: 21}
vehicles: [{name: u, radius: 0.1, start: {position: [-9, 0, 1]}, goal: {position: [9, 0, 1]}}]
obstacles:
  - {center: [0, 9, 0], radius: 1}
  - {world: lab/lab.sdf, position: [1, 0, 0], rotation: [0, 0, 0.5]}
  - {center: [0, -9, 0], radius: 1}
"""


def test_a_world_in_a_scenario_expands_in_its_place_and_is_saved_so(folder: Path) -> None:
    path = folder.parent / "yard.yaml"
    path.write_text(YAML)
    jsonschema.Draft202012Validator(rho.scenario_schema()).validate(yaml.safe_load(YAML))
    scenario = rho.load_scenario(path)
    pose = RigidTransform(RollPitchYaw(0, 0, 0.5), [1, 0, 0])
    expected = rho.load_world(folder / "lab.sdf", pose)
    assert [str(each) for each in scenario.obstacles[:1]] == [str(rho.Sphere([0, 9, 0], 1.0))]
    for one, other in zip(scenario.bodies[1:-1], expected, strict=True):
        assert (one.name, type(one.shape)) == (other.name, type(other.shape))
        np.testing.assert_allclose(one.shape.center, other.shape.center, atol=1e-12)
    assert scenario.obstacle_name(2) == "obstacle 2 (m::l::plate)"
    rho.save_scenario(scenario, folder / "saved.yaml")
    assert "world" not in (folder / "saved.yaml").read_text()
    assert rho.load_scenario(folder / "saved.yaml") == scenario
    assert from_yaml(as_yaml(scenario)) == scenario


@pytest.mark.parametrize(
    ("world", "words"),
    [
        ("{world: none.sdf}", r"obstacles\[1\]\.world: got none\.sdf: no file"),
        ("{world: lab/lab.sdf, scale: 2}", r"obstacles\[1\]\.scale: .*no field of this name"),
        ("{world: lab/lab.sdf, position: [1]}", r"obstacles\[1\]\.position: .*three finite"),
        ("{world: 3}", r"obstacles\[1\]\.world: got 3"),
    ],
)
def test_errors_in_references_name_their_place(folder: Path, world: str, words: str) -> None:
    given = "{world: lab/lab.sdf, position: [1, 0, 0], rotation: [0, 0, 0.5]}"
    file = folder.parent / "asked.yaml"
    file.write_text(YAML.replace(given, world))
    with pytest.raises(rho.ScenarioError, match=words):
        rho.load_scenario(file)


def _mesh(uri: str) -> str:
    return sdf(collision("c", f"<mesh><uri>{uri}</uri></mesh>"))


def _include(uri: str) -> str:
    return f'<sdf version="1.7"><world name="w"><include><uri>{uri}</uri></include></world></sdf>'


@pytest.mark.parametrize(
    "uri",
    [
        "../outside.obj",
        "meshes/../../outside.obj",
        "%2e%2e/outside.obj",
        "/etc/hostname.obj",
        "file:///etc/hostname.obj",
        "http://example.org/a.obj",
        "package://drake_models/veggies/yellow_bell_pepper_low.obj",
        "package://../outside.obj",
        "package://meshes/../../outside.obj",
        "model://elsewhere/a.obj",
        "..\\outside.obj",
        "link.obj",
        "linked/outside.obj",
        "missing.obj",
    ],
)
@pytest.mark.parametrize("kind", ["sdf", "include", "nested", "urdf", "mjcf", "meshdir"])
def test_nothing_outside_of_the_folder_is_read(folder: Path, uri: str, kind: str) -> None:
    (folder / "link.obj").symlink_to(folder.parent / "outside.obj")
    (folder / "linked").symlink_to(folder.parent)
    path = folder / {"urdf": "t.urdf", "mjcf": "t.xml", "meshdir": "t.xml"}.get(kind, "t.sdf")
    (folder / "inner.sdf").write_text(_mesh(uri))
    mjcf = '<mujoco model="m"><compiler %s/><asset><mesh name="q" file="%s"/></asset><worldbody>'
    mjcf += '<geom type="mesh" mesh="q"/></worldbody></mujoco>'
    text = {
        "sdf": _mesh(uri),
        "include": _include(uri),
        "nested": _include("inner.sdf"),
        "urdf": URDF.replace("l.obj", uri),
        "mjcf": mjcf % ("", uri),
        "meshdir": mjcf % (f'meshdir="{uri}"', "l.obj"),
    }[kind]
    path.write_text(text)
    with pytest.raises(rho.ScenarioError, match="refer") as caught:
        rho.load_world(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("m.obj", f"mtllib ../outside.mtl\n{L_OBJ}"),
        ("m.obj", f"mtllib /etc/hostname\n{L_OBJ}"),
        ("m.gltf", '{"asset": {"version": "2.0"}, "buffers": [{"uri": "../b.bin"}]}'),
    ],
)
def test_meshes_refer_to_nothing_outside_of_the_folder(folder: Path, name: str, text: str) -> None:
    (folder.parent / "b.bin").write_bytes(b"0")
    (folder / name).write_text(text)
    (folder / "t.sdf").write_text(_mesh(name))
    with pytest.raises(rho.ScenarioError, match="a reference to"):
        rho.load_world(folder / "t.sdf")


@pytest.mark.parametrize("uri", ["package://meshes/l.obj", "package://lab/l.obj", "meshes/l.obj"])
def test_packages_and_models_in_the_folder_are_found(folder: Path, uri: str) -> None:
    (folder / "table").mkdir()
    (folder / "table" / "model.config").write_text(
        "<model><sdf version='1.7'>table.sdf</sdf></model>"
    )
    (folder / "table" / "table.sdf").write_text(_mesh(uri if ":" in uri else "../l.obj"))
    (folder / "t.sdf").write_text(_include("model://table"))
    (found,) = rho.load_world(folder / "t.sdf")
    assert isinstance(found.shape, rho.Mesh)


def test_files_of_the_working_directory_do_not_stand_in_for_those_of_the_world(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = folder.parent / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "inner.sdf").write_text(sdf(BALL))
    (folder / "inner.sdf").write_text(_mesh("l.obj"))
    (folder / "t.sdf").write_text(_include("inner.sdf"))
    monkeypatch.chdir(elsewhere)
    (found,) = rho.load_world(folder / "t.sdf")
    assert isinstance(found.shape, rho.Mesh)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("t.sdf", "<sdf><model>", r"t\.sdf: got a damaged file, expected XML in UTF-8; no element"),
        ("t.sdf", "<!DOCTYPE a [<!ENTITY b 'c'>]>" + sdf(BALL), "a DOCTYPE or an ENTITY"),
        ("t.sdf", sdf(BALL).replace("sphere", "spheer"), "geometry ball, of kind spheer"),
        ("t.sdf", sdf(collision("hill", "<heightmap/>")), "geometry hill, of kind heightmap"),
        (
            "t.sdf",
            sdf(collision("c", "<cone><radius>1</radius></cone>")),
            "geometry c, of kind con",
        ),
        ("t.sdf", sdf(collision("c", "<mesh><uri>a.vtk</uri></mesh>")), "kind mesh in .vtk"),
        ("t.sdf", sdf(""), r"t\.sdf: got no collision geometry"),
        ("t.sdf", sdf(BALL).replace("0.5", "-1"), r"radius -1 of the collision geometry ball"),
        ("t.sdf", sdf(collision("sheet", "<box><size>9 9 1e-5</size></box>")), "sheet.*flat shape"),
        ("t.sdf", _include("t.sdf"), "includes itself"),
        ("t.xml", MJCF.replace('type="cylinder"', 'type="hfield"'), "post, of kind hfield"),
        ("t.xml", MJCF.replace('mesh="q"', 'mesh="r"'), "ignored"),
        ("t.sdf", sdf(BALL).replace("0.5", "0.0"), r"radius 0\.0 of the collision geometry ball"),
        ("t.xml", "<mujoco model='a'/>", "no collision geometry"),
        ("t.xml", MJCF.replace('model="x"', ""), "must have a name"),
        ("t.xml", MJCF.replace('size="0.2 1"', 'size="-1 1"'), "size -1 1 of the coll.* post"),
        ("t.xml", MJCF.replace("1 1 1", "0 0 0"), "length > 0"),
        (
            "t.xml",
            MJCF.replace("body", "frame").replace("worldframe", "worldbody"),
            "the element geom in a frame",
        ),
        (
            "t.xml",
            MJCF.replace("<body", "<replicate count='2'><geom size='1'/></replicate><body"),
            "element geom in a replicate",
        ),
        ("t.sdf", sdf('<collision name="c"/>' + BALL), "geometry c in a link, of nothing"),
        ("t.sdf", sdf(collision("c", "") + BALL), "geometry c in a link, of nothing"),
        ("t.sdf", sdf(collision("c", POLE + "<empty/>")), "in a link, of cylinder, empty, exp"),
        ("t.sdf", sdf(collision("c", "<sphere/>")), "radius missing of the collision geometry c"),
        (
            "t.sdf",
            _mesh("l.obj").replace("</uri>", "</uri><submesh/>"),
            "geometry c, of kind submesh",
        ),
        ("t.urdf", URDF.replace("1 2 3", "1 -2 3"), "size 1 -2 3 of the collision geometry block"),
        ("t.urdf", URDF.replace("1 2 3", "1 2"), "Expected 3 values"),
        ("t.sdf", "<a>" * 20_000 + "</a>" * 20_000, "more than 100 elements in each other"),
        ("t.sdf", _mesh("a" * 300 + ".obj"), "a reference to aaa"),
        ("t.sdf", _mesh("a%00.obj"), "a reference to a%00"),
        ("t.txt", "", r"the ending \.txt"),
    ],
)
def test_other_worlds_are_refused_with_a_reason(
    folder: Path, name: str, text: str, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (folder / name).write_text(text)
    with pytest.raises(rho.ScenarioError, match=words):
        rho.load_world(folder / name)
    assert capfd.readouterr() == ("", "")


def test_large_files_and_floods_of_inclusions_are_refused(
    folder: Path,
) -> None:
    include = "<include><uri>%s.sdf</uri></include>"
    for k in range(5):
        inner = include % (k + 1) * 10 if k < 4 else "<model name='m'/>"
        (folder / f"{k}.sdf").write_text(
            f"<sdf version='1.7'><world name='w'>{inner}</world></sdf>"
        )
    with pytest.raises(rho.ScenarioError, match="11111 inclusions"):
        rho.load_world(folder / "0.sdf")
    (folder / "big.obj").touch()
    os.truncate(folder / "big.obj", (64 << 20) + 1)
    (folder / "t.sdf").write_text(_mesh("big.obj"))
    with pytest.raises(rho.ScenarioError, match=r"big\.obj: got a file of 67108865 bytes"):
        rho.load_world(folder / "t.sdf")


def test_reading_is_quiet_and_leaves_the_log_of_drake_as_it_was(
    folder: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    visual = "<geom name='floor' type='plane' size='1 1 1' unknown='3'/>"
    (folder / "x.xml").write_text(
        MJCF.replace("<worldbody>", f"<option foo='1'/><worldbody>{visual}")
    )
    before = logging.getLogger("drake").level, logging.getLogger("drake").propagate
    assert len(rho.load_world(folder / "x.xml")) == 4
    assert (logging.getLogger("drake").level, logging.getLogger("drake").propagate) == before
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


def test_a_flight_through_a_world_is_planned_and_verified(folder: Path) -> None:
    flight = rho.Vehicle("u", rho.State([-5, 0, 1]), rho.State([6, 2.5, 1]), radius=0.2)
    obstacles = rho.load_world(folder / "lab.sdf")
    scenario = rho.Scenario("lab", rho.Grid.lasting(8, step=0.5), [flight], obstacles=obstacles)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
