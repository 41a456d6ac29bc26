"""Files that are damaged or hostile: one line each, and neither memory nor a terminal is taken."""

import contextlib
import io
import json
import os
import socket
import sqlite3
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from benchmarks.damaged_files import damaged
from drake_rho.cli.console import escaped
from drake_rho.cli.documents import json_of
from drake_rho.display.viewer.serve import serve
from tests.test_export import rough
from tests.written import from_yaml

SAME = 1e-11
"""Rounding of coordinates, in sizes of a mesh."""

STUDY = """\
name: s
repetitions: 2
scenarios: [{name: a, generator: random_transitions, parameters: {n: 2, duration: 5}}]
methods: [{name: p, planner: plan}]
"""

CORNERS = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 2.0) for z in (0.0, 2.0)])
FACES = np.array(
    [
        triangle
        for a, b, c, d in [
            (0, 1, 3, 2),
            (4, 6, 7, 5),
            (0, 4, 5, 1),
            (2, 3, 7, 6),
            (0, 2, 6, 4),
            (1, 5, 7, 3),
        ]
        for triangle in ((a, b, c), (a, c, d))
    ]
)


@pytest.mark.slow
def test_a_sample_of_damaged_files_is_refused_in_a_line_each(tmp_path: Path) -> None:
    assert [each for each in damaged(96, tmp_path, seed=7) if each.wrong] == []


def apart(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a block's triangles without common vertices, all of them rounded differently."""
    corners = CORNERS[FACES].reshape(-1, 3)
    noisy = corners + 2.0 * SAME * rng.uniform(-1.0, 1.0, corners.shape)
    return noisy, np.arange(len(noisy)).reshape(-1, 3)


def test_a_block_whose_corners_differ_by_rounding_is_a_solid() -> None:
    block = rho.Mesh(*apart(np.random.default_rng(1)))
    x = np.random.default_rng(2).uniform(-1.0, 3.0, (500, 3))
    inside = ((x > 0.0) & (x < 2.0)).all(axis=1)
    assert block.is_watertight
    np.testing.assert_array_equal(block.signed_distance(x) < 0.0, inside)


def test_a_block_with_corners_further_apart_is_a_surface() -> None:
    corners, faces = apart(np.random.default_rng(1))
    corners[0] += 1e-6
    assert not rho.Mesh(corners, faces).is_watertight


@pytest.mark.parametrize(
    "more",
    [[[0, 1, 3]], [[3, 1, 0]], [[0, 0, 1]], [[2, 2, 2], [0, 1, 1]]],
    ids=["twice", "turned", "no area", "no areas"],
)
def test_doubled_and_degenerate_triangles_leave_a_block_a_solid(more: list[list[int]]) -> None:
    block = rho.Mesh(CORNERS, np.concatenate([FACES, more]))
    assert block.is_watertight
    assert float(block.signed_distance(np.array([1.0, 1.0, 1.0]))) == pytest.approx(-1.0)


def test_a_sheet_beside_a_block_does_not_open_the_block() -> None:
    sheet = np.array([[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]])
    both = rho.Mesh(np.concatenate([CORNERS, sheet]), np.concatenate([FACES, [[8, 9, 10]]]))
    distances = both.signed_distance(np.array([[1.0, 1.0, 1.0], [5.2, 0.2, -0.5]]))
    assert not both.is_watertight
    np.testing.assert_allclose(distances, [-1.0, 0.5])


def test_a_block_in_a_block_and_blocks_that_touch_are_solids() -> None:
    nested = rho.Mesh(
        np.concatenate([CORNERS, 3.0 * CORNERS - 2.0]), np.concatenate([FACES, FACES + 8])
    )
    beside = rho.Mesh(
        np.concatenate([CORNERS, CORNERS + np.array([2.0, 0.0, 0.0])]),
        np.concatenate([FACES, FACES + 8]),
    )
    assert nested.is_watertight
    assert beside.is_watertight
    assert (nested.signed_distance(np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])) < 0.0).all()
    assert (beside.signed_distance(np.array([[1.0, 1.0, 1.0], [3.0, 1.0, 1.0]])) < 0.0).all()


PCD = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count} 1 1\nWIDTH {points}\n"
    "HEIGHT 1\nPOINTS {points}\nDATA ascii\n0 0 0\n1 1 1\n"
)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.pcd", PCD.format(count=2147483648, points=2), "2147483650 values of 3 fields"),
        ("b.pcd", PCD.format(count=1, points=2147483648), "says 2147483648 points"),
        (
            "c.ply",
            "ply\nformat ascii 1.0\nelement vertex 999999999\nproperty float x\nend_header\n1\n",
            "at least 1999999998 bytes",
        ),
    ],
)
def test_claims_of_headers_are_compared_with_the_file(
    name: str, text: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(rho.ScenarioError, match=words):
        rho.Voxels.from_points(tmp_path / name, 1.0)


def test_an_array_that_claims_more_than_its_file_is_refused(tmp_path: Path) -> None:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 3)}
    )
    (tmp_path / "a.npy").write_bytes(file.getvalue())
    with pytest.raises(rho.ScenarioError, match="too short"):
        rho.Voxels.from_points(tmp_path / "a.npy", 1.0)


def test_numbers_of_gltf_are_no_more_than_its_buffers_hold(tmp_path: Path) -> None:
    accessor = {"count": 10**7, "componentType": 5126, "type": "VEC3"}
    (tmp_path / "a.gltf").write_text(
        json.dumps({"asset": {"version": "2.0"}, "accessors": [accessor]})
    )
    with pytest.raises(rho.ScenarioError, match=r"a\.gltf: got a damaged file.*10000000 numbers"):
        rho.Mesh.load(tmp_path / "a.gltf")


def test_a_damaged_gltf_is_named(tmp_path: Path) -> None:
    (tmp_path / "z.gltf").write_text('{"asset": {"version": "2.0"}, broken')
    with pytest.raises(rho.ScenarioError, match=r"z\.gltf: got a damaged file"):
        rho.Mesh.load(tmp_path / "z.gltf")


def test_an_array_of_another_shape_is_not_inflated(tmp_path: Path) -> None:
    plan = rho.plan(rho.load_scenario("courier"))
    rho.save(plan, tmp_path / "p.npz")
    huge = np.zeros((1, 100_000, 3))
    with (
        zipfile.ZipFile(tmp_path / "p.npz") as old,
        zipfile.ZipFile(tmp_path / "z.npz", "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for member in old.infolist():
            content = io.BytesIO(old.read(member))
            if member.filename == "plan.positions.npy":
                content = io.BytesIO()
                np.save(content, huge)
            new.writestr(member.filename, content.getvalue())
    with pytest.raises(ValueError, match=r"shape \(1, 100000, 3\), expected"):
        rho.load(tmp_path / "z.npz")


READERS: list[Callable[[Path], object]] = [
    rho.load_scenario,
    rho.load,
    rho.load_study,
    rho.Results,
    rho.Mesh.load,
    rho.load_world,
    lambda path: rho.Voxels.from_points(path, 1.0),
    lambda path: rho.Voxels.from_octomap(path, "free"),
    lambda path: rho.load_lsc_mission(path, grid=rho.Grid(1.0, 5)),
    rho.load_mission,
    rho.load_waypoints,
    rho.load_crazyflies,
]


@pytest.mark.parametrize("reader", READERS)
def test_pipes_are_no_regular_files(reader: Callable[[Path], object], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match=r"no(t a)? regular file"):
        reader(tmp_path / "pipe")


def test_a_link_is_read_by_its_own_name(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "scan.txt").write_text("0 0 0\n1 1 1\n")
    (tmp_path / "latest.xyz").symlink_to(tmp_path / "elsewhere" / "scan.txt")
    cloud = rho.Voxels.from_points(tmp_path / "latest.xyz", 1.0)
    assert len(cloud.occupied) == 2
    assert cloud.source is not None
    assert cloud.source.path == str(tmp_path / "latest.xyz")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &a {center: [0, 0, 0], radius: 1}\nb: [" + "*a, " * 200_000 + "]", "at most 500000"),
        ("a: &a [*a]", "inside of itself"),
    ],
)
def test_aliases_stand_for_a_limited_number_of_values(text: str, words: str) -> None:
    with pytest.raises(rho.ScenarioError, match=words):
        from_yaml(text)


def test_exponential_aliases_are_refused() -> None:
    lines = ["a0: &a0 [0, 0, 0, 0, 0, 0, 0, 0, 0]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    with pytest.raises(rho.ScenarioError, match="at most 500000"):
        from_yaml("\n".join(lines))


def test_a_world_has_a_limited_number_of_links(tmp_path: Path) -> None:
    shape = "<collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision>"
    links = "".join(f"<link name='l{k}'>{shape}</link>" for k in range(1501))
    (tmp_path / "w.sdf").write_text(
        f"<sdf version='1.7'><model name='m'><static>true</static>{links}</model></sdf>"
    )
    with pytest.raises(rho.ScenarioError, match="a world of 1501 link, expected at most 1500"):
        rho.load_world(tmp_path / "w.sdf")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the store of a small study."""
    folder = tmp_path_factory.mktemp("store")
    (folder / "s.yaml").write_text(STUDY)
    rho.campaign(rho.load_study(folder / "s.yaml"), folder / "r.sqlite")
    return folder / "r.sqlite"


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("UPDATE runs SET cost = '=cmd()'", "as the cost of run 1, expected a number"),
        ("UPDATE study SET study = '{}'", "got a damaged study"),
        ("UPDATE study SET study = replace(hex(zeroblob(50000)), '0', '[')", "got a damaged study"),
        ("UPDATE runs SET method = hex(zeroblob(100000))", "as the method of run 1, expected text"),
        ("UPDATE runs SET method = hex(zeroblob(1000))", "got a run of '000"),
        ("ALTER TABLE plans RENAME TO p2; CREATE VIEW plans AS SELECT * FROM p2", "other tables"),
    ],
)
def test_a_damaged_store_is_named_in_a_short_line(
    store: Path, statement: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "d.sqlite").write_bytes(store.read_bytes())
    with sqlite3.connect(tmp_path / "d.sqlite") as connection:
        connection.executescript(statement)
    connection.close()
    with pytest.raises(ValueError, match=words) as raised:
        str(rho.Results(tmp_path / "d.sqlite"))
    assert str(raised.value).startswith(str(tmp_path / "d.sqlite"))
    assert len(str(raised.value)) < 500


def test_characters_that_control_a_terminal_are_escaped() -> None:
    assert escaped("a\x1b[31mb\x9b\u202ec\x07\r") == r"a\x1b[31mb\u009b\u202ec\x07\x0d"
    assert escaped("Grün, \N{RACING CAR}, 北京\n\ta") == "Grün, \N{RACING CAR}, 北京\n\ta"
    assert json.loads(escaped(json.dumps("\x9b\u202e\x7f", ensure_ascii=False))) == "\x9b\u202e\x7f"


def test_the_page_is_for_its_own_name_only() -> None:
    server = serve("<p>page</p>")
    port = int(server.url.rpartition(":")[2])

    def answer(host: str) -> bytes:
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.sendall(f"GET / HTTP/1.1\r\n{host}\r\n".encode())
            return client.recv(12)[9:]

    try:
        assert answer(f"Host: localhost:{port}\r\n") == b"200"
        assert answer("Host: 127.0.0.1:9\r\n") == b"200"
        assert answer("Host: [::1]:9\r\n") == b"200"
        assert answer("Host: evil.example\r\n") == b"421"
        assert answer("") == b"421"
    finally:
        server.close()


@pytest.mark.slow
def test_clients_that_hang_up_or_wait_are_no_matter(capfd: pytest.CaptureFixture[str]) -> None:
    server = serve("x" * 10_000_000)
    port = int(server.url.rpartition(":")[2])
    try:
        for _ in range(3):
            client = socket.create_connection(("127.0.0.1", port))
            client.sendall(b"GET / HTTP/1.0\r\nHost: localhost\r\n\r\n")
            client.recv(1000)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()
        waiting = [socket.create_connection(("127.0.0.1", port)) for _ in range(60)]
        for each in waiting:
            each.close()
    finally:
        server.close()
    assert capfd.readouterr().err == ""


def test_nan_and_infinity_are_null() -> None:
    text = json_of({"cost": np.nan, "rows": ({"bound": np.float64(-np.inf)},)})
    assert json.loads(text) == {"cost": None, "rows": [{"bound": None}]}


def _show(path: Path, trajectory: object, **files: bytes) -> Path:
    """Write a show with one drone, and further files."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        drones = [{"settings": {"trajectory": trajectory}}]
        archive.writestr("show.json", json.dumps({"version": 1, "swarm": {"drones": drones}}))
        for name, content in files.items():
            archive.writestr(f"{name}.json", content)
    return path


def _points(*points: object) -> dict[str, object]:
    return {"version": 1, "points": list(points)}


START = [0, [0, 0, 0], []]


def test_an_exported_show_is_read_as_the_same_motion(tmp_path: Path) -> None:
    plan = rough(step=0.25)
    rho.export(plan, tmp_path / "x.skyc")
    read, times = rho.load_trajectories(tmp_path / "x.skyc"), np.linspace(0.0, plan.times[-1], 77)
    assert read.names == plan.scenario.names
    found, expected = read.at(times), plan.at(times)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-12)
    np.testing.assert_allclose(found.velocities, expected.velocities, atol=1e-11)


def test_curves_of_different_degrees_are_read(tmp_path: Path) -> None:
    line, bent = [2, [3, 0, 0], []], [3, [3, 0, 3], [[3, 0, 1.5]]]
    cubic = [4.5, [0, 0, 0], [[1, 1, 1], [2, 2, 2]]]
    trajectory = _points(START, line, bent, cubic) | {"takeoffTime": 10}
    found = rho.load_trajectories(_show(tmp_path / "x.skyc", trajectory))
    assert (found.start, found.end) == (10.0, 14.5)
    x = found.at([10.0, 11.0, 12.0, 12.5, 13.75, 14.5]).positions[0]
    middle = (np.array([3, 0, 3]) + 3 * np.ones(3) + 3 * 2 * np.ones(3)) / 8  # de Casteljau
    expected = np.array([[0, 0, 0], [1.5, 0, 0], [3, 0, 0], [3, 0, 1.5], middle, [0, 0, 0]])
    np.testing.assert_allclose(x, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("trajectory", "words"),
    [
        ({"$ref": "./../secret.json#"}, "expected a file in the archive"),
        ({"$ref": "/etc/passwd"}, "expected a file in the archive"),
        ({"$ref": "file:///etc/passwd"}, "expected a file in the archive"),
        ({"$ref": "%2e%2e/x.json"}, "expected a file in the archive"),
        ({"$ref": "./deep.json#"}, "damaged"),
        ({"$ref": "./no.json#"}, "no.json: not valid JSON"),
        ({"$ref": "./nan.json#"}, "got NaN, expected a finite number"),
        ({"version": 2, "points": []}, "drone 1: not a trajectory of version 1"),
        (_points(START), "expected a list of two or more"),
        (_points(START, START), "point 2: got 0, expected a time after 0 s"),
        (_points(START, [1, [0, 0], []]), "drone 1: not a trajectory of version 1"),
        (_points(START, [1, [0, 0, 1e300], []]), "expected x, y and z of at most 1e"),
        (_points(START, [1, [0, 0, "up"], []]), "drone 1: not a trajectory"),
        (
            _points(START, [1, [0, 0, 1], [[0, 0, 0]] * 9]),
            "point 2: got 9 control points, expected at most 6",
        ),
        (_points(START, 7), "drone 1: not a trajectory"),
        (None, "drone 1: not a trajectory"),
    ],
)
def test_a_damaged_show_is_refused(trajectory: object, words: str, tmp_path: Path) -> None:
    (tmp_path / "secret.json").write_text(json.dumps(_points(START, [1, [1, 1, 1], []])))
    files = {"deep": b"[" * 100_000, "no": b"{", "nan": b'{"version": NaN}'}
    path = _show(tmp_path / "x.skyc", trajectory, **files)
    with pytest.raises(rho.PlanFileError, match=words) as caught:
        rho.load_trajectories(path)
    assert "\n" not in str(caught.value)


def test_a_show_that_inflates_without_end_is_refused_before_it_does(tmp_path: Path) -> None:
    path = _show(tmp_path / "x.skyc", {"$ref": "./bomb.json#"}, bomb=b" " * (257 << 20))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(rho.PlanFileError, match="more than 268435456 bytes, inflated"):
        rho.load_trajectories(path)


def test_a_cut_or_changed_show_is_refused_or_read(tmp_path: Path) -> None:
    path = _show(tmp_path / "x.skyc", _points(START, [1, [1, 1, 1], []]))
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    for number in range(300):
        content = bytearray(whole)
        content[rng.integers(len(whole))] ^= int(rng.integers(1, 256))
        path.write_bytes(content[: rng.integers(len(whole))] if number % 3 == 0 else content)
        with contextlib.suppress(rho.PlanFileError):  # no other error
            rho.load_trajectories(path)
