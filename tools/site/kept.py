"""What outputs of the documentation's code depend on, so that they are kept until it changes."""

from __future__ import annotations

import hashlib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def hash_of_package() -> bytes:
    """Return a hash of the package's files and of the versions of the packages that it uses."""
    found = hashlib.sha256((ROOT / "constraints.txt").read_bytes())
    for path in sorted((ROOT / "drake_rho").rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            found.update(path.relative_to(ROOT).as_posix().encode())
            found.update(path.read_bytes())
    return found.digest()
