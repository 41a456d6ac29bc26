"""Files that maps are read from."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import record

LARGEST_FILE = 2 << 30
"""Largest size of a file that is read [bytes]."""


@record
class Source:
    """File that a map was read from, and how."""

    kind: str
    """key of the file in scenario files: `octomap`, `points` or `mesh`"""
    path: str
    """absolute path of the file"""
    sha256: str
    """hash of its content"""
    arguments: dict[str, Any]
    """further arguments with which it was read"""

    @property
    def changed(self) -> bool:
        """Whether the file is there, but with other content."""
        path = Path(self.path)
        return path.is_file() and hash_of(path) != self.sha256


def hash_of(path: Path) -> str:
    """Return the SHA-256 hash of a file's content."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def checked_file(path: str | Path) -> Path:
    """Return the absolute path of a file that is there and not too large.

    Raises:
        ScenarioError: it is not there, no file, empty or too large.
    """
    path = Path(path)
    try:
        size = path.stat().st_size if path.is_file() else None
    except (OSError, ValueError):
        size = None
    if size is None:
        raise ScenarioError(str(path), Description("no file"), "a readable file")
    if not 0 < size <= LARGEST_FILE:
        given = Description(f"a file of {size} bytes")
        raise ScenarioError(str(path), given, f"a file of 1 to {LARGEST_FILE} bytes")
    return path.resolve()
