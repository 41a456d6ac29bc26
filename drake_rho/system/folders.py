"""Exchange of two folders in one step."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

_AT_FDCWD = -100
"""File descriptor of the working directory in Linux system calls."""

_EXCHANGE = 2
"""Flag, on both systems, for exchanging the names of two files or folders."""


def exchanged(one: Path, other: Path) -> bool:
    """Exchange the names of two folders of one file system in one step.

    Even if the process is killed, each name denotes a complete folder at all times.

    Returns:
        Whether they were exchanged; not every system and file system supports it.
    """
    first, second = os.fsencode(one), os.fsencode(other)
    try:
        library = ctypes.CDLL(None)
        if sys.platform == "darwin":
            return bool(library.renamex_np(first, second, _EXCHANGE) == 0)
        return bool(library.renameat2(_AT_FDCWD, first, _AT_FDCWD, second, _EXCHANGE) == 0)
    except (AttributeError, OSError, TypeError):  # no such function, or no such library
        return False
