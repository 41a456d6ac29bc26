"""Reading of text files whose errors name the file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.system.files import read_text, reason_of

LARGEST = 16 << 20
"""Largest size of a file of missions, waypoints or robots [bytes]."""


def text_of(path: Path, kind: str) -> str:
    """Return the text of a file.

    Args:
        path: path of the file.
        kind: words for the kind of file that is expected.

    Raises:
        ScenarioError: the file cannot be read.
    """
    try:
        return read_text(path, LARGEST)
    except (OSError, ValueError) as error:
        expected = f"a readable {kind}; {reason_of(error)}"
        raise ScenarioError("", Description("no text"), expected) from None


def text_or_none(path: str | Path) -> str | None:
    """Return the text of a file, None if it cannot be read."""
    try:
        return read_text(path, LARGEST)
    except (OSError, ValueError):
        return None


def another_file(text: str) -> Description:
    """Return words for a text of none of the kinds that are read: 'another file (a JSON list)'."""
    if not text.strip():
        return Description("another file (empty)")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return Description("another file (not JSON)")
    kind = "object" if isinstance(content, dict) else "value"
    kind = "list" if isinstance(content, list) else kind
    return Description(f"another file (a JSON {kind})")


@contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Put the path of a file before the fields of errors."""
    try:
        yield
    except ScenarioError as error:
        where = f"{path}: {error.field}" if error.field else str(path)
        raise ScenarioError(where, error.value, error.expected) from None
