"""Damages of files: bits, ends, numbers, claims, encodings, depth and characters of terminals."""

from __future__ import annotations

import io
import re
import sqlite3
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

Damage = Callable[[bytes, np.random.Generator], bytes]

_NUMBER = re.compile(rb"(?<![\w.])-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w.])")
_NUMBERS = (
    b"nan",
    b"inf",
    b"-inf",
    b"1e308",
    b"1e999",
    b"-1",
    b"0",
    b"1e-300",
    b"4294967295",
    b"2147483648",
    b"99999999999999999999",
    b"1" * 5000,
    b"x",
    b'"1"',
    b"[]",
)
_WORDS = (
    b"\x1b[31m\x1b]0;owned\x07",
    "\u202e\u2066".encode(),
    b"\xff\xfe\xfd",
    b"\x00",
    b"=cmd()",
    b"/dev/zero",
    b"../../../etc/passwd",
    b"!!python/object:os.system",
    b"&a [*a, *a]",
    b"[" * 100_000,
    b"{" * 1000,
    b"<a>" * 1000,
    b"a" * 100_000,
    b"\n" * 1000,
)


def bits(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with one to sixteen bits flipped."""
    array = np.frombuffer(content, np.uint8).copy()
    for place in rng.integers(len(array), size=1 << rng.integers(5)):
        array[place] ^= 1 << int(rng.integers(8))
    return array.tobytes()


def first_bits(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with bits flipped in its first 256 bytes, where headers are."""
    return bits(content[:256], rng) + content[256:]


def shorter(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the beginning of the content, or nothing."""
    return content[: rng.integers(len(content))]


def number(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with one number, or its text, replaced by another."""
    found = list(_NUMBER.finditer(content[:100_000]))
    if not found:
        return four_bytes(content, rng)
    place = found[rng.integers(len(found))]
    return content[: place.start()] + _NUMBERS[rng.integers(len(_NUMBERS))] + content[place.end() :]


def four_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with four bytes replaced by a number that is large, or negative."""
    place = 4 * int(rng.integers(max(len(content) // 4, 1)))
    values = (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0x7F800000, 0x7FC00000, 0x00FFFFFF, 0)
    value = values[rng.integers(len(values))]
    return content[:place] + value.to_bytes(4, "little") + content[place + 4 :]


def word(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with something in it that controls, nests or goes elsewhere."""
    place = int(rng.integers(len(content) + 1))
    return content[:place] + _WORDS[rng.integers(len(_WORDS))] + content[place:]


def name(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with one word of it replaced."""
    found = list(re.finditer(rb"[A-Za-z_]{2,}", content[:100_000]))
    if not found:
        return word(content, rng)
    place = found[rng.integers(len(found))]
    return content[: place.start()] + _WORDS[rng.integers(len(_WORDS))] + content[place.end() :]


def lines(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with two lines exchanged, one left out, or one there very often."""
    parts = content.split(b"\n")
    i, j = rng.integers(len(parts), size=2)
    match int(rng.integers(3)):
        case 0:
            parts[i], parts[j] = parts[j], parts[i]
        case 1:
            del parts[i]
        case _:
            parts[i:i] = [parts[i]] * 2000
    return b"\n".join(parts)


def encoding(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content in another encoding, or after a byte order mark."""
    text = content.decode("latin-1")
    return (text.encode("utf-16"), b"\xef\xbb\xbf" + content, text.encode("cp500", "replace"))[
        rng.integers(3)
    ]


def twice(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with a part of it repeated."""
    i, j = sorted(rng.integers(len(content), size=2))
    return content[:j] + content[i:]


OF_BYTES: tuple[Damage, ...] = (bits, first_bits, shorter, number, four_bytes, word, twice)
"""Damages of any file."""

OF_TEXT: tuple[Damage, ...] = (bits, shorter, number, number, word, name, name, lines, encoding)
"""Damages of files of text."""


def array(content: bytes, rng: np.random.Generator) -> bytes:
    """Return an archive of arrays with one of them damaged, left out or claimed to be huge."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w", 8) as new:
        members = old.infolist()
        chosen, how = rng.integers(len(members)), int(rng.integers(4))
        for number_, member in enumerate(members):
            inner = old.read(member)
            if number_ == chosen:
                if how == 0:
                    continue
                if how == 1:
                    inner = OF_BYTES[rng.integers(len(OF_BYTES))](inner, rng)
                elif how == 2:
                    inner = np.lib.format.magic(1, 0) + _header(rng) + bytes(1 << 20)
                else:
                    inner = _text_of(rng)
            new.writestr(member.filename, inner)
    return made.getvalue()


def _header(rng: np.random.Generator) -> bytes:
    """Return the header of an array that claims much."""
    shape = "(1000000, 1000000, 3)" if rng.random() < 0.5 else "(43690, 3)"
    kind = ("<f8", "|O", "<U99999999", "|V9")[rng.integers(4)]
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return len(text).to_bytes(2, "little") + text.encode()


def _text_of(rng: np.random.Generator) -> bytes:
    """Return an array of text, or of numbers that are none."""
    values = ("[" * 10_000, "{}", "nan", np.full((2, 11, 3), np.nan), np.zeros(0), np.arange(9))
    file = io.BytesIO()
    np.save(file, np.asarray(values[rng.integers(len(values))]), allow_pickle=False)
    return file.getvalue()


def table(content: bytes, rng: np.random.Generator, folder: Path) -> bytes:
    """Return a store with one value replaced, or a definition that is not its own."""
    path = folder / "store"
    path.write_bytes(content)
    connection = sqlite3.connect(path)
    if rng.random() < 0.15:
        connection.execute("ALTER TABLE runs RENAME TO older")
        connection.execute(
            "CREATE VIEW runs AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) "
            "SELECT older.* FROM older, c"
        )
    else:
        names = [row[1] for row in connection.execute("PRAGMA table_info(runs)")]
        of_study = rng.random() < 0.3
        column = "study" if of_study else names[rng.integers(len(names))]
        values = (
            "=cmd()",
            "{",
            "{}",
            "[" * 100_000,
            "x" * 200_000,
            b"\xff\xfe",
            -1,
            1e300,
            "\x1b[31m",
        )
        value = values[rng.integers(len(values))]
        kind = "study" if of_study else "runs"
        connection.execute(f"UPDATE OR IGNORE {kind} SET {column} = ?", (value,))  # noqa: S608
    connection.commit()
    connection.close()
    return path.read_bytes()
