"""Names of vehicles where they are drawn: shown as they are, never read as markup or as a path."""

from __future__ import annotations

_BRIEF = 24
"""Most characters of a name beside what it names."""
_LINE = 40
"""Most characters in a line of a legend."""


def as_text(name: str) -> str:
    """The name for matplotlib, which reads mathematics between two dollar signs."""
    return name.replace("$", r"\$")


def brief(name: str) -> str:
    """A long name without its middle, since names often differ at their ends only."""
    if len(name) <= _BRIEF:
        return name
    return f"{name[: _BRIEF // 2]}…{name[1 - _BRIEF // 2 :]}"


def in_lines(name: str) -> str:
    """The whole name in lines that fit into a legend."""
    return "\n".join(name[first : first + _LINE] for first in range(0, len(name), _LINE))


def as_path(name: str) -> str:
    """The name as one part of a path in Meshcat, escaped as in an address (`/` is `%2F`).

    Escaped are the separator, the angle brackets of Meshcat's own objects, and names that every
    JavaScript object has, which its page would take for vehicles it knows already.
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
