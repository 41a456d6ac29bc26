"""Filter of Drake's log: hides exit codes of solvers and addresses of scenes."""

from __future__ import annotations

import logging
import re

_NO_NEWS = re.compile(r"(\w+ returns |Meshcat (listening|connection) )")
"""Beginnings of redundant lines: exit codes of solvers, which results and errors give too, and
addresses and connections of scenes, for which there is `Meshcat.web_url`."""


def _is_news(record: logging.LogRecord) -> bool:
    """Return whether a line of Drake's log is of interest to users."""
    return _NO_NEWS.match(record.getMessage()) is None


def keep_to_news() -> None:
    """Hide redundant lines of Drake's log, wherever a program or a notebook shows it."""
    logging.getLogger("drake").addFilter(_is_news)
