"""Vehicle names in drawings: shown literally, never parsed as markup or as a path."""

from __future__ import annotations

_BRIEF = 24
"""Largest number of characters of a name in a label."""
_LINE = 40
"""Largest number of characters in a line of a legend."""


def as_text(name: str) -> str:
    """Escape a name for matplotlib, which reads text between dollar signs as mathematics."""
    return name.replace("$", r"\$")


def brief(name: str) -> str:
    """Shorten a long name in its middle, since names often differ only at their ends."""
    if len(name) <= _BRIEF:
        return name
    return f"{name[: _BRIEF // 2]}…{name[1 - _BRIEF // 2 :]}"


def in_lines(name: str) -> str:
    """Break a name into lines that fit into a legend."""
    return "\n".join(name[first : first + _LINE] for first in range(0, len(name), _LINE))


def as_path(name: str) -> str:
    """Return the name as one segment of a Meshcat path, percent-encoded (`/` becomes `%2F`).

    Three things are escaped: the path separator, the angle brackets of Meshcat's own objects, and
    the names of properties that every JavaScript object has, which Meshcat's page would mistake for
    existing nodes of its tree.
    """
    if name in _OF_EVERY_OBJECT:
        return f"%{ord(name[0]):02X}{name[1:]}"
    return name.translate(_ESCAPES)


_ESCAPES = {ord(letter): f"%{ord(letter):02X}" for letter in "%/<>"}
_OF_EVERY_OBJECT = frozenset(
    [
        *("constructor", "hasOwnProperty", "isPrototypeOf", "propertyIsEnumerable"),
        *("toLocaleString", "toString", "valueOf", "__proto__"),
        *("__defineGetter__", "__defineSetter__", "__lookupGetter__", "__lookupSetter__"),
    ]
)
