"""Libraries of the extras `maps` and `missions`, which are loaded only when needed."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from drake_rho.scenario.errors import Description, ScenarioError


def library(module: str, extra: str = "maps") -> Any:
    """Return a module of an extra.

    Raises:
        ScenarioError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        given = Description(f"no module {module}")
        expected = f"the extra {extra}: pip install 'drake-rho[{extra}]'"
        raise ScenarioError("", given, expected) from None


@contextmanager
def quiet(name: str) -> Iterator[list[str]]:
    """Collect a library's log messages instead of printing them, and drop its warnings.

    Args:
        name: of the library's logger.
    """
    texts = list[str]()
    handler = logging.Handler()
    handler.emit = lambda record: texts.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger(name)
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    logger.setLevel(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield texts
    finally:
        logger.setLevel(before[0])
        logger.propagate = before[1]
        logger.removeHandler(handler)
