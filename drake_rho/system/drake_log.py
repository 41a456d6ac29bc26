"""Drake's log without what is no news to users: exit codes of solvers, addresses of scenes."""

from __future__ import annotations

import logging
import re

_NO_NEWS = re.compile(r"(\w+ returns |Meshcat (listening|connection) )")
"""Beginnings of lines that tell how each solver ended, which answers and errors tell, and where a
scene is served, which `Meshcat.web_url` tells, and to whom."""


def _is_news(record: logging.LogRecord) -> bool:
    """Return whether a line of Drake's log is of interest to users."""
    return _NO_NEWS.match(record.getMessage()) is None


def keep_to_news() -> None:
    """Hide lines of Drake's log that are no news, wherever a program or a notebook shows it."""
    logging.getLogger("drake").addFilter(_is_news)
