"""Checks of the headers of map files against the files, before libraries trust them.

A header of a few bytes may claim billions of numbers, for which a reader would reserve memory.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from typing import Any

from drake_rho.scenario.maps.stored import MOST

_LONGEST_HEADER = 1 << 16
"""Largest size of a header of text [bytes]."""

_MOST_FIELDS = 1000
"""Largest number of values of a point."""

_MOST_BYTES = 24 * MOST
"""Largest expanded size of a compressed or a referring file [bytes]."""

_LZF = 128
"""Largest factor by which the compression of PCD files shrinks anything."""

_SIZES = {"5120": 1, "5121": 1, "5122": 2, "5123": 2, "5125": 4, "5126": 4}
"""Sizes of the numbers of glTF [bytes], by their codes."""

_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Number of components of the types of glTF."""

_PLY_SIZES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "double": 8} | {
    f"{kind}{bits}": bits // 8 for kind in ("int", "uint", "float") for bits in (8, 16, 32, 64)
}
"""Sizes of the numbers of PLY [bytes], by their names; others have 4."""


def check_pcd(content: bytes) -> None:
    """Check that a PCD file holds as many points as its header claims.

    Raises:
        ValueError: it holds fewer, or has no header.
    """
    fields = dict[str, list[str]]()
    start = 0
    while "DATA" not in fields:
        end = content.find(b"\n", start, _LONGEST_HEADER)
        if end < 0:
            raise ValueError("it has no header of PCD")
        name, *values = content[start:end].decode("utf-8").split() or [""]
        fields[name] = values
        start = end + 1
    names, sizes = fields.get("FIELDS", []), _whole(fields.get("SIZE", []))
    counts = _whole(fields["COUNT"]) if "COUNT" in fields else [1] * len(names)
    (points,) = _whole(fields.get("POINTS", [])) or [0]
    if not len(names) == len(sizes) == len(counts) or not 0 < sum(counts) <= _MOST_FIELDS:
        raise ValueError(f"its header has {sum(counts)} values of {len(names)} fields for a point")
    claimed = points * sum(size * count for size, count in zip(sizes, counts, strict=True))
    length = len(content) - start
    match fields["DATA"]:
        case ["ascii"]:
            claimed = 2 * points * sum(counts) - 1  # a digit and a space or an end of the line
        case [kind] if "compressed" in kind:  # one writer has another letter in its middle
            packed, expanded = struct.unpack_from("<II", content, start)
            if packed > length or expanded != claimed or expanded > min(_LZF * packed, _MOST_BYTES):
                raise ValueError(f"it claims {expanded} bytes of points in {packed}")
            return
    if claimed > length:
        raise ValueError(f"its header says {points} points, for which {length} bytes are too few")


def check_ply(content: bytes) -> None:
    """Check that a PLY file may hold as many elements as its header claims.

    Raises:
        ValueError: it is too small, or has no header.
    """
    head, found, _ = content[:_LONGEST_HEADER].partition(b"end_header")
    lines = [line.split() for line in head.decode("utf-8").splitlines()]
    if not found or not lines or lines[0] != ["ply"]:
        raise ValueError("it has no header of PLY")
    is_ascii = any(line[:2] == ["format", "ascii"] for line in lines)
    length, least, count = len(content) - len(head), 0, 0
    for line in lines:
        if line[:1] == ["element"]:
            (count,) = _whole(line[2:3]) or [0]
        elif line[:1] == ["property"] and len(line) > 1:
            size = _PLY_SIZES.get(line[2 if line[1] == "list" else 1], 4)
            least += count * (2 if is_ascii else size)
    if least > length:
        raise ValueError(f"its header says at least {least} bytes of elements, where {length} are")


def check_gltf(content: bytes) -> None:
    """Check that the numbers of a glTF file are no more than its buffers may hold.

    Buffers and views are compared by their declared lengths, which the reader checks.

    Raises:
        ValueError: they are more, or the file has no content in JSON.
    """
    try:
        tree = json.loads(_json_of(content))
    except (RecursionError, struct.error) as error:
        raise ValueError(f"its JSON is damaged: {error}") from None
    if not isinstance(tree, dict):
        raise ValueError("its JSON has no asset")
    lengths = [each.get("byteLength") for each in _records(tree, "bufferViews")]
    expanded = 0
    for each in _records(tree, "accessors"):
        count, view = each.get("count"), each.get("bufferView")
        kind, width = str(each.get("componentType")), str(each.get("type"))
        size = _SIZES.get(kind, 4) * _WIDTHS.get(width, 16)
        if not isinstance(count, int) or not 0 <= count <= MOST:
            raise ValueError(f"it claims {count!r:.40} numbers")
        held = lengths[view] if isinstance(view, int) and 0 <= view < len(lengths) else len(content)
        if not isinstance(held, int) or count * size > held:
            raise ValueError(f"it claims {count} numbers in a part of {held!r:.40} bytes")
        expanded += count * size
    if expanded > _MOST_BYTES:
        raise ValueError(f"it claims {expanded} bytes of numbers")


def _json_of(content: bytes) -> bytes:
    """Return the JSON of a glTF file, at the beginning of a binary one."""
    if content[:4] != b"glTF":
        return content
    _, _, length, kind = struct.unpack_from("<IIII", content, 4)
    if kind != 0x4E4F534A or length > len(content) - 20:
        raise ValueError("its first part is not JSON, or not whole")
    return content[20 : 20 + length]


def _records(tree: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    found = tree.get(key, [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise ValueError(f"its {key} are no list of records")
    return found


def _whole(texts: Iterable[str]) -> list[int]:
    """Return whole numbers that are not negative, of at most nineteen digits.

    Raises:
        ValueError: a text is none.
    """
    found = list(texts)
    for each in found:
        if not each.isdecimal() or len(each) > 19:
            raise ValueError(f"its header has {each[:40]!r} in the place of a whole number")
    return [int(each) for each in found]
