"""Archives (zip) of other programs, of which no more is inflated than their headers claim.

Nothing is written to the disk, so that a name in an archive cannot lead out of it.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from drake_rho.scenario.errors import shorten
from drake_rho.system.files import LARGEST_TEXT

_BEGINNING = b"PK"
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Ways of packing that inflate piece by piece."""
_DAMAGES = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError)
"""Errors of damaged archives; RuntimeError of encrypted and unsupported ones too."""


class Members:
    """Files of an archive, whose sizes together are bounded."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive, self._left = archive, LARGEST_TEXT

    @property
    def names(self) -> list[str]:
        """Names of its files, without folders, and without hidden files as systems add them."""
        return [
            name
            for name in self._archive.NameToInfo
            if not name.startswith("__MACOSX/")
            and not name.rpartition("/")[2].startswith(".")
            and not name.endswith("/")
        ]

    def read(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            ValueError: there is no such file, all together are too large, or it is packed in an
                unusual way.
            Exception: the archive is damaged; `open_archive` makes a ValueError of it.
        """
        member = self._archive.NameToInfo.get(name)
        if member is None:
            raise ValueError(f"got a reference to {shorten(name)}, expected a file in the archive")
        self._left -= member.file_size
        if self._left < 0:
            raise ValueError(f"more than {LARGEST_TEXT} bytes, inflated")
        if member.compress_type not in _METHODS:
            got = f"got compression {member.compress_type}"
            raise ValueError(f"{shorten(name)}: {got}, expected {_METHODS[1]}, deflate, or none")
        with self._archive.open(member) as stream:
            return stream.read(member.file_size + 1)


@contextmanager
def open_archive(content: bytes, kind: str) -> Iterator[Members]:
    """Open an archive.

    Args:
        content: content of its file.
        kind: words for what is expected, as "a Skybrush show".

    Raises:
        ValueError: it is damaged.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            yield Members(archive)
    except _DAMAGES as error:
        raise ValueError(f"not {kind}, or damaged ({error})") from None


def is_archive(content: bytes) -> bool:
    """Return whether a content begins as an archive."""
    return content.startswith(_BEGINNING)


def names_in(content: bytes) -> list[str]:
    """Return the names of the files in an archive; none if it is no archive, or a damaged one."""
    if not is_archive(content):
        return []
    try:
        with open_archive(content, "an archive") as archive:
            return archive.names
    except ValueError:
        return []
