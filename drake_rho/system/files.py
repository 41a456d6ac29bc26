"""Reading of regular files, and atomic writing."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import IO

LARGEST_FILE = 2 << 30
"""Largest size of a file that is read [bytes]."""

LARGEST_TEXT = 256 << 20
"""Largest size of a text that is read whole [bytes]."""


def check_readable(path: str | Path, most: int = LARGEST_FILE) -> int:
    """Check that a file can be read to its end, and return its size [bytes].

    Pipes and devices have no known end, so they are refused before they are opened.

    Raises:
        OSError: the file is missing, not regular, or too large.
        ValueError: the path holds a null character.
    """
    found = os.stat(path)
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    if found.st_size > most:
        reason = f"a file of {found.st_size} bytes, more than {most}"
        raise OSError(errno.EFBIG, reason, str(path))
    return found.st_size


def opened(path: str | Path, most: int = LARGEST_FILE) -> BufferedReader:
    """Open a regular file for reading; the errors are those of `check_readable`."""
    check_readable(path, most)
    return open(path, "rb")


def read_bytes(path: str | Path, most: int = LARGEST_FILE) -> bytes:
    """Return the content of a regular file; the errors are those of `check_readable`."""
    with opened(path, most) as file:
        return file.read()


def read_text(path: str | Path, most: int = LARGEST_TEXT) -> str:
    """Return the text of a regular file in UTF-8, with or without a byte order mark.

    Raises:
        OSError: the file is missing, not regular, or too large.
        ValueError: the text is not UTF-8, or the path holds a null character.
    """
    try:
        return read_bytes(path, most).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError:
        raise ValueError("not a UTF-8 text file") from None


def reason_of(error: OSError | ValueError) -> str:
    """Return the reason why a file could not be read, as a short text."""
    return str(getattr(error, "strerror", None) or error)


@contextmanager
def atomic_write(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a binary file that replaces `path` when the block ends without an error.

    Links are followed, and a replaced file's mode is kept.

    Raises:
        OSError: the file cannot be written, or `path` exists and is not a regular file.
    """
    path = _replaceable(path)
    with _named(path):
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".drake_rho.")
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
        os.chmod(name, path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def check_replaceable(path: str | Path) -> None:
    """Check, before a long computation, that `atomic_write` will be able to write its result.

    Raises:
        OSError: the result cannot be written.
    """
    path = _replaceable(path)
    with _named(path), tempfile.TemporaryFile(dir=path.parent):
        pass


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Re-raise errors about a temporary file beside `path` as errors about its folder."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path.parent)) from None


def _replaceable(path: str | Path) -> Path:
    """Return the path of a regular file, or of a file yet to be written, with links followed."""
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
    return Path(os.path.realpath(path))


def _umask() -> int:
    """Return the process's file mode mask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
