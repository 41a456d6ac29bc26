"""Valid files of other programs' formats, small ones: missions, shows, tables and logs."""

from __future__ import annotations

import dataclasses
import io
import json
import sqlite3
import struct
import zipfile
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.damage import OF_BYTES, OF_TEXT, Damage

BOUND = 20.0
"""Bound on the acceleration between samples [m/s²]."""

_HOME = [47.397742, 8.545594, 488.0]


@dataclasses.dataclass(frozen=True)
class Kind:
    """Kind of a file."""

    name: str
    """name in tables"""
    ending: str
    """ending of its files"""
    content: bytes
    """content of a valid one"""
    command: tuple[str, ...]
    """command line that reads it, in which {} stands for its path; `read` only reads a scenario,
    `table` reads a table of states with the scenario, `mission`, `waypoints` and `trajectories`
    read files of other programs"""
    damages: tuple[Damage, ...]
    """damages of it"""


def format_kinds(folder: Path, plan: rho.Plan) -> list[Kind]:
    """Return a valid file of each format that is read.

    Args:
        folder: for files on the way.
        plan: written in the formats that hold its motion.
    """
    waypoints = b"time [s],x [m],y [m],z [m]\n0,0,0,1\n2,1,0,1\n4,2,0,1.5\n"
    mission = json.dumps(_mission(), indent=1).encode()
    found = [
        Kind("mission (.plan)", ".plan", mission, ("mission", "{}"), OF_TEXT),
        Kind("mission (.waypoints)", ".waypoints", _items(), ("mission", "{}"), OF_TEXT),
        Kind("waypoints", ".csv", waypoints, ("waypoints", "{}"), OF_TEXT),
    ]
    rho.export(plan, folder / "show.skyc")
    rho.export(plan, folder / "swarm", format="crazyswarm")
    rho.export(plan, folder / "states.csv", format="csv")
    rho.export(plan, folder / "log.mcap", rate=2.0)
    names = sorted(each.name for each in (folder / "swarm").iterdir())
    for name, path, damages in (
        ("show (.skyc)", folder / "show.skyc", (*OF_BYTES, *[_member] * 5)),
        ("polynomials", folder / "swarm" / names[0], OF_TEXT),
        ("positions", folder / "states.csv", OF_TEXT),
        ("log of ROS 2 (MCAP)", folder / "log.mcap", OF_BYTES),
        ("log of ROS 2 (MCAP, plain)", _plain(folder, None), OF_BYTES),
        ("log of ROS 2 (MCAP, lz4)", _plain(folder, "LZ4"), OF_BYTES),
        ("log of ROS 2 (MCAP, zstd)", _plain(folder, "ZSTD"), OF_BYTES),
        ("log of ROS 2 (SQLite)", _database(folder), OF_BYTES),
        ("log of PX4 (ULog)", _ulog(folder), OF_BYTES),
    ):
        content, command = path.read_bytes(), ("trajectories", "{}")
        found.append(Kind(name, path.suffix, content, command, damages))
    return found


def _mission() -> dict[str, object]:
    """Return a mission of QGroundControl with every kind of item and fence."""

    def item(command: int, north: float, *params: float) -> dict[str, object]:
        place = [_HOME[0] + north, _HOME[1], 20.0]
        own = {"type": "SimpleItem", "command": command, "frame": 3, "autoContinue": True}
        return own | {"params": [*params, *[0.0] * (4 - len(params)), *place], "doJumpId": 1}

    items = [item(22, 0.0), item(16, 1e-4, 2.0), item(178, 0.0, 1.0, 3.0), item(19, 2e-4, 3.0)]
    circle = {"circle": {"center": _HOME[:2], "radius": 300.0}, "inclusion": True, "version": 1}
    corners = [[_HOME[0] + a, _HOME[1] + b] for a, b in ((4e-4, 0), (5e-4, 0), (4e-4, 1e-4))]
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            **{"version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 5},
            **{"hoverSpeed": 5, "plannedHomePosition": _HOME},
            "items": [*items, item(16, 3e-4), item(20, 0.0)],
        },
        "geoFence": {
            "version": 2,
            "circles": [circle],
            "polygons": [{"polygon": corners, "inclusion": False, "version": 1}],
        },
        "rallyPoints": {"version": 2, "points": []},
    }


def _items() -> bytes:
    """Return a mission of MAVLink."""
    rows = [(0, 16, 0.0, 0.0, 488.0), (3, 22, 0.0, 0.0, 20.0), (3, 16, 2.0, 1e-4, 20.0)]
    rows += [(3, 178, 1.0, 0.0, 0.0), (3, 16, 0.0, 2e-4, 25.0), (3, 20, 0.0, 0.0, 0.0)]
    lines = ["QGC WPL 110"]
    for number, (frame, command, first, north, altitude) in enumerate(rows):
        place = f"{_HOME[0] + north}\t{_HOME[1]}\t{altitude}"
        lines.append(
            f"{number}\t{int(number == 0)}\t{frame}\t{command}\t{first}\t3\t0\t0\t{place}\t1"
        )
    return "\n".join(lines).encode() + b"\n"


def _messages() -> list[tuple[str, str, int, bytes]]:
    """Return topics, kinds, stamps and contents of poses and transforms, in CDR."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    new = {kind.rpartition("/")[2]: each for kind, each in store.types.items()}
    turn, found = new["Quaternion"](0.0, 0.0, 0.0, 1.0), []
    for k in range(5):
        stamp = 1_700_000_000 * 10**9 + k * 10**8
        header = new["Header"](new["Time"](*divmod(stamp, 10**9)), "map")
        pose = new["Pose"](new["Point"](0.1 * k, 0.0, 1.0), turn)
        moved = new["Transform"](new["Vector3"](0.1 * k, 2.0, 1.0), turn)
        for topic, message in (
            ("/scout/pose", new["PoseStamped"](header, pose)),
            ("/tf", new["TFMessage"]([new["TransformStamped"](header, "mule", moved)])),
        ):
            kind = message.__msgtype__
            found.append((topic, kind, stamp, bytes(store.serialize_cdr(message, kind))))
    return found


def _plain(folder: Path, compression: str | None) -> Path:
    """Write a log in MCAP, without chunks unless it is compressed."""
    from mcap.writer import CompressionType, Writer

    path, channels = folder / f"log-{compression}.mcap", dict[str, int]()
    with open(path, "wb") as file:
        kind = CompressionType[compression or "NONE"]
        writer = Writer(file, compression=kind, use_chunking=compression is not None)
        writer.start(profile="ros2")
        for topic, kind_, stamp, data in _messages():
            if topic not in channels:
                schema = writer.register_schema(kind_, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _database(folder: Path) -> Path:
    """Write a log in SQLite, with the tables of rosbag2."""
    path = folder / "log.db3"
    database, topics = sqlite3.connect(path), dict[str, int]()
    database.execute(
        "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
        "serialization_format TEXT, offered_qos_profiles TEXT)"
    )
    database.execute(
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB)"
    )
    for topic, kind, stamp, data in _messages():
        if topic not in topics:
            topics[topic] = len(topics) + 1
            row = (topics[topic], topic, kind, "cdr", "")
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
        database.execute(
            "INSERT INTO messages VALUES (NULL, ?, ?, ?)", (topics[topic], stamp, data)
        )
    database.commit()
    database.close()
    return path


def _ulog(folder: Path) -> Path:
    """Write a log of PX4 with estimates of positions."""
    fields = b"uint64_t timestamp;float[2] delta;float x;float y;float z;bool xy_valid;"
    entries = [(b"B", bytes(40)), (b"F", b"vehicle_local_position:" + fields)]
    entries.append((b"A", b"\0\1\0vehicle_local_position"))
    for k in range(9):
        numbers = struct.pack("<HQ5f?", 1, 100_000 * k, 0.0, 0.0, 0.1 * k, 0.0, -1.0, True)
        entries.append((b"D", numbers))
    path = folder / "log.ulg"
    body = b"".join(struct.pack("<H", len(each)) + letter + each for letter, each in entries)
    path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + body)
    return path


def _member(content: bytes, rng: np.random.Generator) -> bytes:
    """Return an archive with one of its files damaged."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w", 8) as new:
        members = old.infolist()
        chosen = int(rng.integers(len(members)))
        for number, member in enumerate(members):
            inner = old.read(member)
            if number == chosen:
                inner = OF_TEXT[rng.integers(len(OF_TEXT))](inner, rng)
            new.writestr(member.filename, inner)
    return made.getvalue()
