"""Files that are written completely or not at all."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO


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
        OSError: it will not be able to.
    """
    path = _replaceable(path)
    with _named(path), tempfile.TemporaryFile(dir=path.parent):
        pass


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Reraise errors about a temporary file beside `path` as errors about its folder."""
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
