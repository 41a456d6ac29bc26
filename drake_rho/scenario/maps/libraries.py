"""Libraries of the extra `maps`, which read files and are loaded only when needed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from drake_rho.scenario.errors import Description, ScenarioError


def library(module: str) -> Any:
    """Return a module of the extra `maps`.

    Raises:
        ScenarioError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        given = Description(f"no module {module}")
        raise ScenarioError("", given, "the extra maps: pip install 'drake-rho[maps]'") from None
