"""Planners from outside this package, named as `package.module:function`."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable, Mapping
from typing import Any

from drake_rho.scenario.errors import ScenarioError


def name_of(value: object) -> object:
    """Return the name of a function; any other value is returned unchanged."""
    if inspect.isroutine(value):
        return f"{value.__module__}:{value.__qualname__}"
    return value


def named(name: str) -> Callable[..., Any]:
    """Return the function with a name, after importing its module.

    Raises:
        ScenarioError: there is no such function, or its module cannot be imported.
    """
    expected = "a function that can be imported, as package.module:function"
    try:
        found = pkgutil.resolve_name(name)
    except Exception as error:  # a module may raise anything when it is imported
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise ScenarioError("function", name, f"{expected}; {why}") from None
    if not callable(found):
        raise ScenarioError("function", name, expected)
    function: Callable[..., Any] = found
    return function


def check_arguments(function: Callable[..., Any], arguments: Mapping[str, object]) -> None:
    """Check that a function accepts a scenario and arguments by name.

    Raises:
        ScenarioError: the function does not accept them.
    """
    try:
        inspect.signature(function).bind(None, **arguments)
    except (TypeError, ValueError) as error:
        expected = f"those that the function takes after the scenario; {error}"
        raise ScenarioError("arguments", dict(arguments), expected) from None
