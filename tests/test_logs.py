"""Logs of ROS 2 and PX4, written here by rosbags, mcap and a few lines, and read back."""

from __future__ import annotations

import contextlib
import importlib
import io
import sqlite3
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from pyulog import ULog
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import drake_rho as rho
from drake_rho import cli
from tests.test_export import rough

STORE = get_typestore(Stores.ROS2_HUMBLE)
SECOND = 10**9
START = 1_700_000_000 * SECOND + 123_456_789
"""Time of Unix at which logs begin [ns]."""
PLACES = 1e-12
"""Rounding of positions [m] and of times since a log's start [s]."""

Samples = Iterable[tuple[int, tuple[float, float, float]]]
"""Stamps [ns] and positions."""


def new(kind: str, *values: Any) -> Any:
    """Return a message of a kind such as geometry_msgs/msg/Point."""
    return STORE.types[kind](*values)


def header(stamp: int, frame: str) -> Any:
    time = new("builtin_interfaces/msg/Time", *divmod(stamp, SECOND))
    return new("std_msgs/msg/Header", time, frame)


def pose(place: Iterable[float]) -> Any:
    turn = new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    return new("geometry_msgs/msg/Pose", new("geometry_msgs/msg/Point", *place), turn)


def stamped(stamp: int, place: Iterable[float], frame: str = "map") -> Any:
    return new("geometry_msgs/msg/PoseStamped", header(stamp, frame), pose(place))


def odometry(stamp: int, place: Iterable[float], frame: str = "map") -> Any:
    still = new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    moved = new("geometry_msgs/msg/PoseWithCovariance", pose(place), np.zeros(36))
    twist = new("geometry_msgs/msg/Twist", still, still)
    turned = new("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
    return new("nav_msgs/msg/Odometry", header(stamp, frame), "base_link", moved, turned)


def transforms(stamp: int, frames: Mapping[str, tuple[str, Iterable[float]]]) -> Any:
    turn = new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    found = [
        new(
            "geometry_msgs/msg/TransformStamped",
            header(stamp, parent),
            child,
            new("geometry_msgs/msg/Transform", new("geometry_msgs/msg/Vector3", *place), turn),
        )
        for child, (parent, place) in frames.items()
    ]
    return new("tf2_msgs/msg/TFMessage", found)


def path(samples: Samples) -> Any:
    poses = [stamped(stamp, place) for stamp, place in samples]
    return new("nav_msgs/msg/Path", poses[0].header, poses)


def write_bag(
    folder: Path,
    recorded: Iterable[tuple[str, int, Any]],
    plugin: StoragePlugin = StoragePlugin.MCAP,
) -> Path:
    """Write topics, stamps and messages as a rosbag2, and return its folder."""
    with Writer(folder, version=8, storage_plugin=plugin) as bag:
        connections = dict[str, Any]()
        for topic, stamp, message in recorded:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(connections[topic], stamp, bytes(STORE.serialize_cdr(message, kind)))
    return folder


def write_mcap(file: Path, recorded: Iterable[tuple[str, int, Any]], kind: CompressionType) -> Path:
    """Write topics, stamps and messages as a compressed MCAP file."""
    with open(file, "wb") as out:
        writer, channels = McapWriter(out, compression=kind), dict[str, int]()
        writer.start(profile="ros2")
        for topic, stamp, message in recorded:
            if topic not in channels:
                schema = writer.register_schema(message.__msgtype__, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE.serialize_cdr(message, message.__msgtype__))
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()  # type: ignore[no-untyped-call]
    return file


def line(count: int, at: float = 0.0, begin: int = START) -> list[tuple[int, Any]]:
    """Return stamps every tenth of a second and one nanosecond, and places along a line."""
    step = SECOND // 10 + 1
    return [(begin + k * step, (0.1 * k, at, 1.0 + 0.01 * k)) for k in range(count)]


def same(found: rho.Trajectories, vehicle: str, samples: Samples, begin: int) -> None:
    """Check that a vehicle has positions at exactly these times since the beginning of a log."""
    motion, table = found.motions[vehicle], list(samples)
    times = np.array([(stamp - begin) / SECOND for stamp, _ in table])
    np.testing.assert_array_equal(motion.instants, times)
    expected = np.array([place for _, place in table])
    np.testing.assert_allclose(found.at(times, vehicle).positions, expected, atol=PLACES)


def read(path: Path, scenario: rho.Scenario | None = None, **options: Any) -> rho.Trajectories:
    return rho.load_trajectories(path, scenario, max_acceleration=20.0, **options)


@pytest.mark.parametrize("name", ["plan.mcap", "bag"])
@pytest.mark.parametrize("start", [0.0, -3.0, 1.7e9])
def test_an_exported_bag_is_read_as_the_same_motion(
    name: str, start: float, tmp_path: Path
) -> None:
    plan = rough(step=0.1, steps=7, start=start)
    rho.export(plan, tmp_path / name, format="mcap", rate=13.0)
    found = read(tmp_path / name, plan.scenario)
    assert set(found.names) == set(plan.scenario.names)
    for vehicle in found.names:
        times = np.clip(found.motions[vehicle].instants, *plan.times[[0, -1]])
        expected = plan.at(times, vehicle=vehicle).positions
        rounding = 8.0 * np.finfo(float).eps * abs(start)  # of the clock, at a metre a second
        positions = found.at(times, vehicle).positions
        np.testing.assert_allclose(positions, expected, atol=PLACES + rounding)


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_poses_odometry_transforms_and_paths_are_read(
    plugin: StoragePlugin, tmp_path: Path
) -> None:
    one, two, three, four = (line(9, at=k, begin=START + k) for k in range(4))
    recorded = [("/one/pose", s, stamped(s, p)) for s, p in one]
    recorded += [("/site/two/odom", s, odometry(s, p)) for s, p in two]
    recorded += [("/tf", s, transforms(s, {"three": ("map", p)})) for s, p in three]
    recorded += [("/four", 7, path(four))]
    found = read(write_bag(tmp_path / "bag", recorded, plugin))
    assert set(found.names) == {"one", "site/two", "three", "four"}
    for vehicle, samples in zip(
        ("one", "site/two", "three", "four"), (one, two, three, four), strict=True
    ):
        same(found, vehicle, samples, START)


@pytest.mark.parametrize("kind", [CompressionType.LZ4, CompressionType.ZSTD, CompressionType.NONE])
def test_compressed_files_and_messages_without_stamps_are_read(
    kind: CompressionType, tmp_path: Path
) -> None:
    recorded = [("/scout/pose", s, stamped(0, p)) for s, p in line(2000)]
    found = read(write_mcap(tmp_path / "x.mcap", recorded, kind))
    same(found, "scout", line(2000), START)


def test_what_was_measured_comes_before_what_was_planned(tmp_path: Path) -> None:
    recorded = [("/a/plan", START, path(line(5, at=9.0)))]
    recorded += [("/a/pose", s, stamped(s, p)) for s, p in line(5)]
    recorded += [("/a/goal", START, odometry(START, (9.0, 9.0, 9.0)))]  # once: no motion
    bag = write_bag(tmp_path / "bag", recorded)
    same(read(bag), "a", line(5), START)
    same(read(bag, topics={"b": "/a/plan"}), "b", line(5, at=9.0), START)


def test_a_later_plan_replaces_the_rest_of_an_earlier_one(tmp_path: Path) -> None:
    early, late = line(6), line(9, at=1.0)[3:]
    recorded = [("/a/plan", START, path(early)), ("/a/plan", START + SECOND, path(late))]
    found = read(write_bag(tmp_path / "bag", recorded))
    same(found, "a", [*early[:3], *late], START)


def test_frames_on_vehicles_are_left_out(tmp_path: Path) -> None:
    recorded = [
        ("/tf", s, transforms(s, {"scout": ("map", p), "camera": ("scout", (0.1, 0.0, 0.0))}))
        for s, p in line(4)
    ]
    assert read(write_bag(tmp_path / "bag", recorded)).names == ("scout",)


def test_files_of_one_log_are_read_together(tmp_path: Path) -> None:
    both = write_bag(tmp_path / "one", [("/a/pose", s, stamped(s, p)) for s, p in line(9)[:5]])
    more = [("/a/pose", s, stamped(s, p)) for s, p in line(9)[5:]]
    more += [("/b/pose", s, stamped(s, p)) for s, p in line(9, at=3.0)]
    other = write_bag(tmp_path / "two", more)
    (other / "two.mcap").rename(both / "two.mcap")
    found = read(both)
    same(found, "a", line(9), START)
    same(found, "b", line(9, at=3.0), START)


@pytest.mark.parametrize(
    ("recorded", "options", "words"),
    [
        ([], {}, "got no positions at two times, expected messages of Odometry, PoseStamped"),
        (
            [(f"/a/{t}", s, stamped(s, p)) for t in "bc" for s, p in line(3)],
            {},
            "'a': got positions on /a/b and /a/c, expected one; topics= chooses",
        ),
        (
            [(f"/{t}/pose", s, stamped(s, p, t)) for t in "bc" for s, p in line(3)],
            {},
            "got positions in the frames 'b' and 'c', expected one frame",
        ),
        (
            [("/a/pose", s, stamped(s, p)) for s, p in line(3)],
            {"topics": {"a": "/b"}},
            "topics: got '/b', expected one of a/pose",
        ),
        (
            [("/a/pose", s, stamped(START, p)) for s, p in line(3)]
            + [("/a/pose", s, stamped(s, p)) for s, p in line(3)],
            {},
            rf"'a': got the positions .* at {START} ns, expected one at each stamp",
        ),
    ],
)
def test_logs_that_are_ambiguous_are_refused(
    recorded: Any, options: Any, words: str, tmp_path: Path
) -> None:
    folder = write_bag(tmp_path / "bag", [*recorded, ("/x", 1, pose((0.0, 0.0, 0.0)))])
    with pytest.raises(rho.PlanFileError, match=f"{folder}: {words}"):
        read(folder) if not options else read(folder, **options)


def test_equal_positions_of_a_stamp_are_one(tmp_path: Path) -> None:
    recorded = [("/a/pose", s, stamped(s, p)) for s, p in line(5) for _ in range(2)]
    same(read(write_bag(tmp_path / "bag", recorded)), "a", line(5), START)


def test_other_files_beside_a_bag_are_left_out(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [("/a/pose", s, stamped(s, p)) for s, p in line(5)])
    (bag / "readme.txt").write_text("flown on a sunny day")
    same(read(bag), "a", line(5), START)


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("FILE", "bag.db3.zstd: got a whole file compressed by zstd, as bags can be, expected it"),
        ("MESSAGE", "topic '/a/pose', at .* ns: got a bag compressed message by message .zstd."),
    ],
)
def test_a_compressed_bag_is_refused_with_how_it_is(mode: str, words: str, tmp_path: Path) -> None:
    store, kind = CompressionFormat.ZSTD, StoragePlugin.SQLITE3
    writer = Writer(tmp_path / "bag", version=8, storage_plugin=kind)
    writer.set_compression(CompressionMode[mode], store)
    with writer:
        message = "geometry_msgs/msg/PoseStamped"
        topic = writer.add_connection("/a/pose", message, typestore=STORE)
        for s, p in line(3):
            writer.write(topic, s, bytes(STORE.serialize_cdr(stamped(s, p), message)))
    with pytest.raises(rho.PlanFileError, match=words):
        read(tmp_path / "bag")


def test_logs_are_samples_and_topics_are_of_ros(tmp_path: Path) -> None:
    recorded = [("/a/pose", s, stamped(s, p)) for s, p in line(3)]
    folder = write_bag(tmp_path / "bag", recorded)
    with pytest.raises(ValueError, match="max_acceleration: got None, expected a bound"):
        rho.load_trajectories(folder)
    (tmp_path / "x.csv").write_text("0,0,0,0\n1,1,1,1\n")
    with pytest.raises(rho.PlanFileError, match="topics: got 1, expected none with a table"):
        read(tmp_path / "x.csv", topics={"a": "/a"})


def test_without_rosbags_one_line_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError(name)

    file = write_mcap(tmp_path / "x.mcap", [], CompressionType.NONE)
    monkeypatch.setattr(importlib.import_module("drake_rho.formats.mcap"), "import_module", missing)
    with pytest.raises(rho.PlanFileError, match=r"expected the extra ros: pip install") as caught:
        read(file)
    assert str(file) in str(caught.value)


def test_the_command_line_judges_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = rho.plan(rho.load_scenario("paper"))
    bag = str(rho.export(plan, tmp_path / "bag", format="mcap", rate=20.0).path)
    scenario = ["--scenario", "paper"]
    topics = [f"--topic={each}=/{each.replace('-', '_')}/path" for each in plan.scenario.names]

    def status(*words: str) -> object:
        monkeypatch.setattr("sys.argv", ["drake-rho", "verify", bag, *words])
        with pytest.raises(SystemExit) as left:
            cli.main()
        return left.value.code

    bound = ["--max-acceleration", "20"]
    assert status(*scenario, *bound) in (0, 6)
    assert status(*scenario, *bound, *topics) in (0, 6)
    capsys.readouterr()
    assert status(*scenario, *bound, "--topic", "x") == 2
    assert status("--topic", "UAV-1=/x") == 2
    assert status(*scenario) == 2
    assert len(capsys.readouterr().err.splitlines()) == 3


# Logs of PX4

FIELDS = (
    "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float[2] delta_xy;"
    "bool xy_valid;bool z_valid;uint8_t[6] _padding0;"
)


def entry(letter: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + letter + content


def estimate(stamp: int, place: Iterable[float], valid: bool = True) -> bytes:
    """Return the message of an estimate in NED at a time [µs]."""
    numbers = struct.pack("<HQQ5f2?", 3, stamp + 250, stamp, *place, 0.0, 0.0, valid, True)
    return entry(b"D", numbers)


def ulog(*entries: bytes, fields: str = FIELDS, appended: int = 0) -> bytes:
    flags = entry(
        b"B", bytes(8) + bytes([appended > 0]) + bytes(7) + struct.pack("<3Q", appended, 0, 0)
    )
    made = entry(b"F", b"vehicle_local_position:" + fields.encode())
    logged = entry(b"A", b"\x00" + struct.pack("<H", 3) + b"vehicle_local_position")
    info = entry(b"I", b"\x0achar[3] abxyz")
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 5)
    return head + flags + info + made + logged + b"".join(entries)


def test_a_log_of_px4_is_read_in_axes_east_north_up(tmp_path: Path) -> None:
    rows = [(7_000_000 + 100_001 * k, (0.1 * k, 2.0, -1.0 - k)) for k in range(20)]
    entries = [estimate(*row, valid=k > 2) for k, row in enumerate(rows)]
    file = tmp_path / "scout.ulg"
    file.write_bytes(ulog(*entries) + entries[-1][:20])  # cut off when power failed
    found = read(file)
    assert found.names == ("scout",)
    judge = io.StringIO()
    with contextlib.redirect_stdout(judge):
        data = ULog(str(file)).get_dataset("vehicle_local_position").data
    valid = data["xy_valid"] > 0
    times = (data["timestamp_sample"][valid] - data["timestamp_sample"][valid][0]) / 1e6
    np.testing.assert_array_equal(found.motions["scout"].instants, times)
    expected = np.stack([data["y"], data["x"], -data["z"]], axis=1)[valid]
    np.testing.assert_allclose(found.at(times, "scout").positions, expected, atol=1e-9)
    assert valid.sum() == 17


def test_data_appended_after_a_crash_are_read(tmp_path: Path) -> None:
    rows = [estimate(100_000 * k, (0.0, 0.1 * k, -1.0)) for k in range(6)]
    size = len(ulog(*rows[:3])) + 20
    content = ulog(*rows[:3], rows[3][:20], *rows[3:], appended=size)
    (tmp_path / "scout.ulg").write_bytes(content)
    assert len(read(tmp_path / "scout.ulg").motions["scout"].instants) == 6


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (ulog(), "got no vehicle_local_position, expected estimates"),
        (
            ulog(estimate(1, (0, 0, 0)), estimate(2, (0, 0, 0), valid=False)),
            "got 1 valid .* among 2",
        ),
        (
            ulog(estimate(2, (0, 0, 0)), estimate(2, (0, 0, 0))),
            "valid estimate 2 of .* a later time",
        ),
        (ulog(estimate(1, (0, 0, 0)), estimate(2, (0, np.nan, 0))), "x: got numbers beyond"),
        (ulog(entry(b"D", b"\x03\x00abc")), "message at byte .*: got 5 bytes, expected 40"),
        (ulog(fields="uint64_t[4000000000] x;"), "message at byte .*: got the field"),
        (ulog(fields="vehicle_local_position x;"), "message at byte .*: got the field"),
        (ulog(fields="float timestamp;float x;"), "message at byte .*, expected uint64_t"),
        (
            ulog(fields="uint64_t timestamp;float x;float y;"),
            "message at byte .*: expected a field z",
        ),
        (
            ulog(estimate(1, (0, 0, 0)), fields="uint64_t[99999] w;" + FIELDS),
            "message at byte .*: got 40 bytes, expected 800032",
        ),
    ],
)
def test_a_damaged_log_of_px4_is_refused(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "x.ulg").write_bytes(content)
    with pytest.raises(rho.PlanFileError, match=f"x.ulg: {words}"):
        read(tmp_path / "x.ulg")


def test_logs_of_px4_are_read_one_by_one(tmp_path: Path) -> None:
    content = ulog(*(estimate(k, (0, 0, 0)) for k in range(3)))
    for name in ("a", "b"):
        (tmp_path / f"{name}.ulg").write_bytes(content)
    with pytest.raises(
        rho.PlanFileError, match="got 2 logs of PX4, expected one: each has its own"
    ):
        read(tmp_path)


# Hostile files


def record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def chunk(size: int, method: bytes, packed: bytes, check: int = 0) -> bytes:
    """Return an MCAP file with one chunk that claims a size."""
    head = struct.pack("<QQQI", 0, 0, size, check) + struct.pack("<I", len(method)) + method
    inside = record(6, head + struct.pack("<Q", len(packed)) + packed)
    return b"\x89MCAP0\r\n" + record(1, bytes(8)) + inside + record(15, bytes(4))


def zstd_of(content: bytes) -> bytes:
    found: bytes = importlib.import_module("mcap.writer").zstandard.compress(content)
    return found


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (chunk(1 << 40, b"zstd", b"x"), "chunk at byte 25: more than 268435456 bytes, inflated"),
        (chunk(1000, b"zstd", zstd_of(bytes(1 << 30))), "its size or checksum is another"),
        (chunk(1000, b"lz4", lz4.frame.compress(bytes(1 << 30))), "its size or checksum"),
        (chunk(1000, b"zstd", b"no zstd"), "chunk at byte 25: "),
        (chunk(1000, b"lz4", b"no lz4 here"), "chunk at byte 25: "),
        (chunk(3, b"", b"abc"), "chunk at byte 25.*|byte 0: cut off"),
        (chunk(3, b"", b"abc", check=zlib.crc32(b"x")), "its size or checksum is another"),
        (chunk(3, b"xz", b"abc"), "got compression 'xz', expected lz4 or zstd"),
        (b"\x89MCAP0\r\n" + b"\x05" + b"\xff" * 8, "byte 8: cut off, in a record of 184467"),
        (b"\x89MCAP0\r\n" + record(1, bytes(8)), "cut off: expected an end of the records"),
        (b"\x89MCAP0\r\n" + record(3, b"\0\0\xff\xff\xff\xff"), "got a text of 4294967295 bytes"),
    ],
)
def test_claims_of_a_bag_are_checked_before_anything_is_inflated(
    content: bytes, words: str, tmp_path: Path
) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(rho.PlanFileError, match=f"x.mcap: .*{words}"):
        read(tmp_path / "x.mcap")


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT * FROM m", "no tables"),
        ("DROP TABLE topics", "got no tables topics and messages"),
        ("UPDATE messages SET data = 'text'", "message 1: expected bytes"),
        ("UPDATE messages SET data = x'00'", "topic '/a/pose', at .* ns: not a message of"),
        ("UPDATE messages SET timestamp = 'now'", "message 1: expected a topic in cdr, and a time"),
        ("UPDATE topics SET serialization_format = 'x'", "message 1: expected a topic in cdr"),
        ("UPDATE messages SET data = zeroblob(20000000)", "got a message of 20000000 bytes"),
        (
            "DROP TABLE messages; CREATE TABLE messages (id INTEGER, topic_id INTEGER, timestamp "
            "INTEGER, data BLOB AS (zeroblob(900000000))); INSERT INTO messages VALUES (1, 1, 1)",
            "not a rosbag2, or damaged .string or blob too big",
        ),
    ],
)
def test_a_damaged_database_is_refused(statement: str, words: str, tmp_path: Path) -> None:
    recorded = [("/a/pose", s, stamped(s, p)) for s, p in line(3)]
    bag = write_bag(tmp_path / "bag", recorded, StoragePlugin.SQLITE3)
    with contextlib.closing(sqlite3.connect(bag / "bag.db3")) as database:
        database.executescript(statement)
    with pytest.raises(rho.PlanFileError, match=f"{words}"):
        read(bag)


def test_a_link_out_of_a_bag_is_refused(tmp_path: Path) -> None:
    recorded = [("/a/pose", s, stamped(s, p)) for s, p in line(3)]
    outside = write_bag(tmp_path / "outside", recorded) / "outside.mcap"
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "x.mcap").symlink_to(outside)
    with pytest.raises(rho.PlanFileError, match="got a link to a file outside its folder"):
        read(tmp_path / "bag")
