"""Logs of PX4 (ULog), of which the estimated positions are read.

A log has a head, and messages with a length of two bytes and a letter for their kind: F for the
fields of a topic, A for the number of a topic that is logged, D for data of this number. Others are
skipped, and so is a last message that is cut off, as when power fails.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from drake_rho.formats.reader import Reader
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.trajectories import sampled
from drake_rho.scenario.errors import shorten

_MAGIC = b"ULog\x01\x12\x35"
_HEAD = 16
"""Length of the head [bytes]."""
_TOPIC = "vehicle_local_position"
_USED = ("timestamp", "timestamp_sample", "xy_valid", "z_valid", *"xyz")
_FIELD = re.compile(r"(\w{1,20})(?:\[(\d{1,5})\])? (\w{1,50})")
_TYPES = {f"{u}int{8 * n}_t": f"<{u or 'i'}{n}" for u in ("", "u") for n in (1, 2, 4, 8)}
_TYPES |= {"float": "<f4", "double": "<f8", "bool": "<u1", "char": "<u1"}
_SECOND = 1e6
"""Unit of time stamps in a second."""


class ULog(Reader):
    """Positions that PX4 estimated, relative to its local origin."""

    name = "ulog"
    content = "positions that PX4 estimated (vehicle_local_position)"
    read_by = "rho.load_trajectories(path)"
    reads = "a log of PX4 (ULog)"
    from_zero = True
    tick = 1.0 / _SECOND

    def recognises(self, content: bytes) -> bool:
        """Return whether the content begins as a log."""
        return content.startswith(_MAGIC)

    def read_all(
        self, contents: Mapping[Path, bytes], topics: Mapping[str, str] | None
    ) -> Mapping[str, Polynomials]:
        """Return the motion in one log, as `Reader.read_all`.

        Raises:
            ValueError: there are several: each has a clock and an origin of its own.
        """
        if len(contents) > 1:
            expected = "one: each has its own clock and origin (Trajectories joins what is aligned)"
            raise ValueError(f"got {len(contents)} logs of PX4, expected {expected}")
        return super().read_all(contents, topics)

    def read(self, content: bytes, name: str) -> dict[str, Polynomials]:
        """Return the motion between valid estimates, from the first of them on."""
        rows = _estimates(content)
        count, named = len(rows), rows.dtype.names or ()
        for flag in {"xy_valid", "z_valid"} & {*named}:
            rows = rows[rows[flag] != 0]
        if len(rows) < 2:
            got = f"got {len(rows)} valid estimates of {_TOPIC} among {count}"
            raise ValueError(f"{got}, expected two or more")
        sampling = "timestamp_sample" in named and rows["timestamp_sample"].all()
        stamps = rows["timestamp_sample" if sampling else "timestamp"]
        if (back := stamps[1:] <= stamps[:-1]).any():
            number = int(np.argmax(back)) + 2
            raise ValueError(f"valid estimate {number} of {_TOPIC}: expected a later time stamp")
        with np.errstate(invalid="ignore"):  # no numbers are refused below
            north, east, down = (rows[axis].astype(np.float64) for axis in "xyz")
        positions = np.stack([east, north, -down], axis=1)
        return {name: sampled(name, np.column_stack([(stamps - stamps[0]) / _SECOND, positions]))}


def _estimates(content: bytes) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return the estimates in a log as records of the fields that are used, in NED axes.

    Raises:
        ValueError: a message is damaged, or there is no estimate.
    """
    kind: np.dtype[np.void] | None = None
    number, data = None, list[bytes]()
    for place, letter, message in _messages(content):
        try:
            if kind is None and letter == b"F" and message.startswith(f"{_TOPIC}:".encode()):
                kind = _kind(message.decode("ascii").partition(":")[2])
            elif letter == b"A" and message[3:] == _TOPIC.encode() and message[0] == 0:
                (number,) = struct.unpack_from("<H", message, 1)
            elif (
                letter == b"D"
                and kind is not None
                and number == int.from_bytes(message[:2], "little")
            ):
                if len(message) < 2 + kind.itemsize:
                    raise ValueError(f"got {len(message)} bytes, expected {2 + kind.itemsize}")
                data.append(message[2 : 2 + kind.itemsize])
        except ValueError as error:
            raise ValueError(f"message at byte {place}: {error}") from None
    if kind is None or not data:
        raise ValueError(f"got no {_TOPIC}, expected estimates of positions")
    return np.frombuffer(b"".join(data), kind)


def _messages(content: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield place, kind and content of messages, up to one that is cut off.

    Data that were appended after a crash begin at offsets in the first message.
    """
    begin, ends = _HEAD, [len(content)]
    if content[_HEAD + 2 : _HEAD + 3] == b"B" and len(content) >= _HEAD + 43:
        offsets = struct.unpack_from("<3Q", content, _HEAD + 19)
        ends = [*(each for each in offsets if _HEAD < each < len(content)), *ends]
    for end in sorted(ends):
        while begin + 3 <= end:
            size = int.from_bytes(content[begin : begin + 2], "little")
            if begin + 3 + size > end:
                break
            yield begin, content[begin + 2 : begin + 3], content[begin + 3 : begin + 3 + size]
            begin += 3 + size
        begin = end


def _kind(fields: str) -> np.dtype[np.void]:
    """Return the type of records from a text such as `uint64_t timestamp;float[2] delta_xy;`.

    Raises:
        ValueError: a field is of no plain type, or one that is needed is not there.
    """
    found, place = dict[str, tuple[str, int]](), 0
    for field in filter(None, fields.split(";")):
        parts = _FIELD.fullmatch(field)
        if parts is None or parts[1] not in _TYPES:
            raise ValueError(f"got the field {shorten(field)}, expected a number and its name")
        kind = _TYPES[parts[1]]
        if parts[3].startswith("timestamp") and kind != "<u8":
            raise ValueError(f"got the field {shorten(field)}, expected uint64_t")
        if parts[3] in _USED and parts[2] is None:
            found[parts[3]] = (kind, place)
        place += np.dtype(kind).itemsize * int(parts[2] or 1)
    if missing := {"timestamp", *"xyz"} - found.keys():
        raise ValueError(f"expected a field {min(missing)}")
    return np.dtype(
        {
            "names": list(found),
            "formats": [kind for kind, _ in found.values()],
            "offsets": [place for _, place in found.values()],
        }
    )
