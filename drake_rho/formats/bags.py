"""Records of messages in bags of ROS 2: MCAP files, and SQLite files of rosbag2.

Sizes are checked before anything is inflated or read, and nothing but messages is looked at.
"""

from __future__ import annotations

import sqlite3
import struct
import sys
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import closing
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from drake_rho.scenario.errors import shorten
from drake_rho.system.files import LARGEST_TEXT

MCAP, SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\x00"
"""Beginnings of files."""
ZSTD = b"\x28\xb5\x2f\xfd"
"""Beginning of what zstd has compressed."""
_LARGEST = 16 << 20
"""Largest size of a message that is read [bytes]: an object for each number takes much more."""
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MOST_TOPICS = 10_000
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNKS, _DATA_END = 2, 3, 4, 5, 6, 15
"""Kinds of records of MCAP."""


class Message(NamedTuple):
    """Message of a bag, as it was recorded."""

    topic: str
    kind: str
    """such as nav_msgs/msg/Path"""
    stamp: int
    """time at which it was recorded [ns]"""
    data: bytes
    """content in CDR"""


def messages(content: bytes, kinds: frozenset[str]) -> Iterator[Message]:
    """Yield the messages of some kinds in the content of a file.

    Raises:
        ValueError: the file is damaged; the message says where.
    """
    of_file = _of_mcap if content.startswith(MCAP) else _of_sqlite
    for each in of_file(content, kinds):
        if len(each.data) > _LARGEST:
            got = f"got a message of {len(each.data)} bytes"
            raise ValueError(f"topic {shorten(each.topic)}: {got}, expected at most {_LARGEST}")
        yield each


def _of_mcap(content: bytes, kinds: frozenset[str]) -> Iterator[Message]:
    """Yield messages of MCAP."""
    schemas, channels = dict[int, str](), dict[int, tuple[str, str]]()
    for place, code, record in _inflated(content):
        try:
            if code == _SCHEMA:
                schemas[_number(record, 0)] = _text(record, 2)[0]
            elif code == _CHANNEL:
                topic, after = _text(record, 4)
                kind = schemas.get(_number(record, 2), "")
                if kind in kinds and (encoding := _text(record, after)[0]) != "cdr":
                    raise ValueError(f"{topic}: got messages in {shorten(encoding)}, expected cdr")
                channels[_number(record, 0)] = topic, kind
            elif code == _MESSAGE:
                topic, kind = channels.get(_number(record, 0), ("", ""))
                if kind in kinds:
                    (stamp,) = struct.unpack_from("<Q", record, 6)
                    yield Message(topic, kind, stamp, bytes(record[22:]))
        except (ValueError, struct.error) as error:
            raise ValueError(f"record at {place}: {error}") from None


def _inflated(content: bytes) -> Iterator[tuple[str, int, memoryview]]:
    """Yield place, kind and content of every record, with chunks inflated.

    Raises:
        ValueError: a record is cut off, or chunks are damaged or inflate to too much.
    """
    left = LARGEST_TEXT
    for place, code, record in _records(memoryview(content)[len(MCAP) :], len(MCAP)):
        where = f"byte {place}"
        if code in (_FOOTER, _DATA_END):
            return
        if code != _CHUNKS:
            yield where, code, record
            continue
        try:
            _, _, size, check = _CHUNK.unpack_from(record)
            method, after = _text(record, _CHUNK.size)
            (length,) = struct.unpack_from("<Q", record, after)
            packed = record[after + 8 :]
            if length != len(packed):
                raise ValueError(f"got {len(packed)} bytes, expected {length}")
            left -= size
            if left < 0:
                raise ValueError(f"more than {LARGEST_TEXT} bytes, inflated")
            whole = _inflate(packed, method, size)
        except (ValueError, struct.error) as error:
            raise ValueError(f"chunk at {where}: {error}") from None
        if len(whole) != size or (check and zlib.crc32(whole) != check):
            raise ValueError(f"chunk at {where}: its size or checksum is another")
        for inner, kind, each in _records(memoryview(whole), 0):
            yield f"byte {inner} of the chunk at {where}", kind, each
    raise ValueError("cut off: expected an end of the records")


def _records(content: memoryview, begin: int) -> Iterator[tuple[int, int, memoryview]]:
    """Yield places, from `begin` on, kinds and contents of records.

    Raises:
        ValueError: a record is cut off.
    """
    at = 0
    while at < len(content):
        code, size = _HEAD.unpack_from(content, at) if at + 9 <= len(content) else (0, 0)
        if at + 9 + size > len(content):
            raise ValueError(f"byte {begin + at}: cut off, in a record of {size} bytes")
        yield begin + at, code, content[at + 9 : at + 9 + size]
        at += 9 + size


def _inflate(packed: memoryview, method: str, size: int) -> bytes:
    """Return the content of a chunk, at most one byte more than its size.

    Raises:
        ValueError: it is damaged, or packed in another way than by lz4 or zstd.
    """
    if method == "":
        return bytes(packed)
    if method == "lz4":
        lz4 = import_module("lz4.frame").LZ4FrameDecompressor()
        try:
            return bytes(lz4.decompress(bytes(packed), max_length=size + 1))
        except RuntimeError as error:
            raise ValueError(str(error)) from None
    if method == "zstd":
        zstd = import_module(
            "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
        )
        try:
            return bytes(zstd.ZstdDecompressor().decompress(packed, max_length=size + 1))
        except zstd.ZstdError as error:
            raise ValueError(str(error)) from None
    raise ValueError(f"got compression {shorten(method)}, expected lz4 or zstd")


def _number(record: memoryview, at: int) -> int:
    found: int = struct.unpack_from("<H", record, at)[0]
    return found


def _text(record: memoryview, at: int) -> tuple[str, int]:
    """Return the text at a place of a record, and the place after it.

    Raises:
        ValueError, struct.error: there is none.
    """
    (length,) = struct.unpack_from("<I", record, at)
    if at + 4 + length > len(record):
        raise ValueError(f"got a text of {length} bytes, expected at most {len(record) - at - 4}")
    return bytes(record[at + 4 : at + 4 + length]).decode(), at + 4 + length


def _of_sqlite(content: bytes, kinds: frozenset[str]) -> Iterator[Message]:
    """Yield messages of a database of rosbag2, which is read as a copy without its journal."""
    with tempfile.TemporaryDirectory(prefix="drake_rho.") as folder:
        copy = Path(folder, "bag.db3")
        copy.write_bytes(content)
        address = f"{copy.as_uri()}?mode=ro&immutable=1"
        try:
            with closing(sqlite3.connect(address, uri=True)) as database:
                yield from _rows(database, len(content), kinds)
        except (sqlite3.Error, OverflowError) as error:
            raise ValueError(f"not a rosbag2, or damaged ({error})") from None


def _rows(database: sqlite3.Connection, size: int, kinds: frozenset[str]) -> Iterator[Message]:
    """Yield messages of a database.

    Args:
        database: which may compute values, so that their sizes are bounded.
        size: size of its file, of which its rows together are no more [bytes].
        kinds: kinds to yield.
    """
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(size, LARGEST_TEXT))
    database.execute("PRAGMA trusted_schema = OFF")
    made = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchmany(99)
    if not {("topics",), ("messages",)} <= {*made}:
        raise ValueError("got no tables topics and messages, expected those of a rosbag2")
    found = database.execute("SELECT id, name, type, serialization_format FROM topics")
    topics = {number: names for number, *names in found.fetchmany(_MOST_TOPICS)}
    rows = database.execute("SELECT id, topic_id, timestamp, data FROM messages")
    for row, topic, stamp, data in rows:
        name, kind, encoding = topics.get(topic, ("", "", ""))
        size -= len(data) + 1 if isinstance(data, bytes) else 1
        if size < 0:
            raise ValueError(f"message {shorten(row)}: got more bytes than the file has")
        if kind not in kinds:
            continue
        if not (encoding == "cdr" and isinstance(name, str) and isinstance(stamp, int)):
            raise ValueError(f"message {shorten(row)}: expected a topic in cdr, and a time stamp")
        if not isinstance(data, bytes):
            raise ValueError(f"message {shorten(row)}: expected bytes")
        yield Message(name, kind, stamp, data)
