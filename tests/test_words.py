"""Words of the field only: private ones that were in use are in no file that people read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PRIVATE = {
    "whoever": "any, or which one",
    "dearer": "costlier",
    "ways? round": "path around",
    "gives? way": "responsibility",
    "at leisure": "before the flight",
    "(makes?|made) (a|the) \\w+ as long as": "sensitivity",
}
"""Private words as patterns, and what is said instead."""

READ = sorted(
    path
    for pattern in ("drake_rho/**/*.py", "docs/**/*.md", "notebooks/*.ipynb", "*.md")
    for path in ROOT.glob(pattern)
)
"""Files that users or contributors read."""


@pytest.mark.parametrize("word", PRIVATE)
def test_no_file_has_a_private_word(word: str) -> None:
    """Identifiers, docstrings, messages and documents count alike."""
    pattern = re.compile(rf"(?<![a-z])({word})(?![a-z])", re.IGNORECASE)
    found = [
        f"{path.relative_to(ROOT)}:{number}: {PRIVATE[word]}"
        for path in READ
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if pattern.search(line)
    ]
    assert len(READ) > 400
    assert found == []
