"""Fields of a scenario by their paths, as in error messages: `vehicles[0].start.position`.

A path may end inside a vector, as in `vehicles[0].start.position[2]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_rho.scenario.errors import ScenarioError

_PATH = re.compile(r"\w+(\[\d+\])*(\.\w+(\[\d+\])*)*")
_PART = re.compile(r"\[(\d+)\]|(\w+)")


def put(content: Any, path: str, value: object) -> None:
    """Replace the value of an existing field in nested mappings and lists.

    Args:
        content: scenario as mappings and lists with every field, absent ones as None.
        path: path of the field.
        value: new value, in the form of a file's entry.

    Raises:
        ScenarioError: there is no such field.
    """
    parent, last = _place(content, path)
    parent[last] = value


def add(content: Any, path: str, value: object) -> None:
    """Add an offset to a field that is a number or a list of numbers.

    Args:
        content: scenario as mappings and lists with every field, absent ones as None.
        path: path of the field.
        value: a number, or a list with as many numbers as the field; a number is not added to a
            list.

    Raises:
        ScenarioError: there is no such field, or nothing can be added to its value.
    """
    parent, last = _place(content, path)
    before, offset = (_numbers(each) for each in (parent[last], value))
    if before is None:
        expected = f"the path of a number or of a list of numbers; {parent[last]!r} stands there"
        raise ScenarioError("", path, expected)
    if offset is None or offset.shape != before.shape:
        kind = "a number" if before.ndim == 0 else f"a list of {len(before)} numbers"
        raise ScenarioError(path, value, f"{kind}, as the field to which it is added")
    parent[last] = (before + offset).tolist()


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return a hint such as '; did you mean radius?' for a mistyped name, or an empty string."""
    return "".join(f"; did you mean {each}?" for each in get_close_matches(name, list(known), 1))


def _numbers(value: object) -> NDArray[Any] | None:
    """Return a number or a list of numbers as an array; None if the value is neither."""
    entries = value if isinstance(value, list) else [value]
    if any(isinstance(each, bool) or not isinstance(each, int | float) for each in entries):
        return None
    return np.array(value)


def _place(content: Any, path: str) -> tuple[Any, Any]:
    """Return the mapping or list that holds a field, and the field's key or index in it.

    Raises:
        ScenarioError: there is no such field.
    """
    if not _PATH.fullmatch(path):
        expected = "the path of a field, as vehicles[0].start.position"
        raise ScenarioError("", path, expected)
    *parts, last = [int(index) if index else name for index, name in _PART.findall(path)]
    walked = ""
    for part in parts:
        content = _at(content, part, path, walked)[part]
        walked += f"[{part}]" if isinstance(part, int) else f".{part}" if walked else part
    return _at(content, last, path, walked), last


def _at(content: Any, part: str | int, path: str, walked: str) -> Any:
    """Return the content after checking that it has a part with this key or index.

    Raises:
        ScenarioError: there is no such part.
    """
    where = walked or "the scenario"
    if isinstance(part, str) and isinstance(content, Mapping):
        if part in content:
            return content
        has = f"{where} has {', '.join(content)}"
        expected = f"a field that exists: {has}{suggestion(part, content)}"
    elif isinstance(part, int) and isinstance(content, list):
        if part < len(content):
            return content
        expected = f"a field that exists: {where} has {len(content)} entries, counted from 0"
    elif content is None:
        expected = f"a field that exists: {where} is not given"
    else:
        kind = "list" if isinstance(content, list) else "single value"
        expected = f"a field that exists: {where} is a {kind}"
    raise ScenarioError("", path, expected)
