"""Exchange of two folders in one step."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

_AT_FDCWD = -100
"""Number that stands for the working directory in calls of Linux."""

_EXCHANGE = 2
"""Flag of both systems that exchanges the names of two files or folders."""


def exchanged(one: Path, other: Path) -> bool:
    """Exchange the names of two folders of one file system in one step.

    Whatever ends the process, each name stands for a whole folder at any time.

    Returns:
        Whether they were exchanged. Not every system and file system can.
    """
    first, second = os.fsencode(one), os.fsencode(other)
    try:
        library = ctypes.CDLL(None)
        if sys.platform == "darwin":
            return bool(library.renamex_np(first, second, _EXCHANGE) == 0)
        return bool(library.renameat2(_AT_FDCWD, first, _AT_FDCWD, second, _EXCHANGE) == 0)
    except (AttributeError, OSError, TypeError):  # no such function, or no such library
        return False
