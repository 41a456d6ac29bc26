"""Files that maps are read from."""

from __future__ import annotations

import errno
import hashlib
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drake_rho.scenario.errors import Description, MapChangedWarning, ScenarioError, shortened
from drake_rho.scenario.fields import record
from drake_rho.system.files import LARGEST_FILE, check_readable, opened, reason_of

_NO_FILES = {
    errno.ENOENT: "no file",
    errno.ENOTDIR: "no file",
    errno.EISDIR: "no regular file",
    errno.EINVAL: "no regular file",
}
"""Names for a path that is no file, by the number of the error."""

_ARCHIVES = (b"PK\x03\x04", b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf", b"\x28\xb5\x2f\xfd")
"""First bytes of archives and compressed files."""


@record
class Source:
    """File that a map was read from, and how."""

    kind: str
    """key of the file in scenario files: `octomap`, `points` or `mesh`"""
    path: str
    """absolute path of the file"""
    sha256: str
    """hash of its content, and of that of the files beside it"""
    arguments: dict[str, Any]
    """further arguments with which it was read, by their names in scenario files"""
    beside: tuple[str, ...] = ()
    """names of further files that it refers to, relative to its folder"""
    read: str = ""
    """hash of the arrays read from the file, to tell whether a map still has them"""

    @property
    def changed(self) -> bool:
        """Whether the file is there, but with other content."""
        path = Path(self.path)
        try:
            return path.is_file() and hash_of(path, self.beside) != self.sha256
        except OSError:  # not readable, so that nothing is known of it
            return False


def hash_of(path: Path, beside: Iterable[str] = ()) -> str:
    """Return the SHA-256 hash of the content of a file and of the existing files beside it."""
    digest = hashlib.sha256()
    for each in (path, *(path.parent / name for name in beside)):
        if each == path or each.is_file():
            with opened(each) as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


def hash_of_arrays(*arrays: np.ndarray | None) -> str:
    """Return a hash of arrays."""
    digest = hashlib.sha256()
    for each in arrays:
        if each is not None:
            digest.update(np.ascontiguousarray(each).tobytes())
    return digest.hexdigest()[:16]


def source_of(
    kind: str, path: Path, arguments: dict[str, Any], beside: Sequence[str] = ()
) -> Source:
    """Return the record of how a file was read."""
    return Source(kind, str(path), hash_of(path, beside), arguments, tuple(beside))


def warn_if_changed(source: Source, since: str) -> None:
    """Warn if the file of a map has other content than when it was read.

    Args:
        source: of the map.
        since: event since which it has changed, such as "the plan was saved".
    """
    if source.changed:
        warnings.warn(
            MapChangedWarning(f"{source.path}: the map has changed since {since}"), stacklevel=3
        )


def checked_file(path: str | Path, endings: Sequence[str]) -> Path:
    """Check that a file can be read, and return its absolute path by the given name.

    Args:
        path: of the file.
        endings: that it may have, in lower case.

    Raises:
        ScenarioError: it is not there or not a regular file, has another ending, is empty, too
            large or an archive.
    """
    path, name = Path(path), named(path)
    try:
        size = check_readable(path, LARGEST_FILE)
    except (OSError, ValueError) as error:
        number = getattr(error, "errno", errno.ENOENT)
        given = Description(_NO_FILES.get(number, reason_of(error)))
        raise ScenarioError(name, given, "a readable file") from None
    if path.suffix.lower() not in endings:
        given = Description(f"the ending {path.suffix}" if path.suffix else "no ending")
        raise ScenarioError(name, given, f"a file ending in {', '.join(endings)}")
    if size == 0:
        given = Description("a file of 0 bytes")
        raise ScenarioError(name, given, f"a file of 1 to {LARGEST_FILE} bytes")
    try:
        with opened(path) as file:
            beginning = file.read(8)
    except OSError as error:
        given = Description(reason_of(error))
        raise ScenarioError(name, given, "a readable file") from None
    if beginning.startswith(_ARCHIVES):
        raise ScenarioError(name, Description("an archive"), "the file that is in it, unpacked")
    return absolute(path)


def absolute(path: Path) -> Path:
    """Return the absolute path of a file by the given name, even if this is a link.

    Its folder is the one that contains the link, where files to which it refers are looked for.
    """
    return path.parent.resolve() / path.name


def named(path: str | Path) -> str:
    """Return a path as errors show it."""
    text = str(path)
    return text if text.isprintable() else repr(text)


def unreadable(path: Path, reason: object, expected: str) -> ScenarioError:
    """Return the error for a file that cannot be read, with the reason in one line."""
    text = shortened(str(reason)) or type(reason).__name__
    return ScenarioError(named(path), Description("a damaged file"), f"{expected}; {text}")
