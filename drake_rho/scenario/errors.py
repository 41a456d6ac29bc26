"""The package's base error, the error for an invalid scenario, and warnings."""

from __future__ import annotations

import pickle
import reprlib
from collections.abc import Sequence
from difflib import get_close_matches

_NAMES_LISTED = 12
"""Largest number of names that an error lists."""


_LONGEST = 600
"""Longest field and longest expected text in an error: both may come from outside."""


class DrakeRhoError(Exception):
    """Base class of all errors that drake_rho raises deliberately."""


class DrakeRhoWarning(UserWarning):
    """Base class of all warnings of drake_rho."""


class MapChangedWarning(DrakeRhoWarning):
    """Warning that the file of a map has another content than when it was read before."""


class MapScaleWarning(DrakeRhoWarning):
    """Warning that a map is far larger or smaller than the flight: perhaps in another unit."""


class MissionWarning(DrakeRhoWarning):
    """Warning of what a scenario lacks of a mission's file: items, or altitudes far from home."""


class Description(str):
    """Description of a value, shown in an error without quotation marks."""

    def __repr__(self) -> str:
        return str(self)


class ScenarioError(DrakeRhoError, ValueError):
    """Error for an invalid scenario, or an invalid part of one.

    Attributes:
        field: path of the field, such as `vehicles[0].start.position`; empty for a whole record.
        value: the value that was given.
        expected: description of what was expected instead.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        self.field = field
        self.value = value
        self.expected = expected
        super().__init__(field, value, expected)

    def __str__(self) -> str:
        where = f"{shortened(self.field, _LONGEST)}: " if self.field else ""
        return f"{where}got {shorten(self.value)}, expected {shortened(self.expected, _LONGEST)}"

    def __reduce__(self) -> tuple[type, tuple[str, object, str]]:
        """Support pickling: a value that cannot be pickled is replaced by its description."""
        value = self.value
        try:
            pickle.dumps(value)
        except Exception:  # arbitrary values may raise anything
            value = Description(shorten(value))
        return ScenarioError, (self.field, value, self.expected)

    def inside(self, parent: str) -> ScenarioError:
        """Return this error for the enclosing record, with `parent` before its field."""
        if not parent or not self.field or self.field.startswith("["):
            return ScenarioError(parent + self.field, self.value, self.expected)
        return ScenarioError(f"{parent}.{self.field}", self.value, self.expected)


def one_of(names: Sequence[str], name: str) -> str:
    """Return the text of the known names for an error about an unknown one, with the nearest."""
    if not names:
        return "none, since nothing has a name"
    few = ", ".join(names) if len(names) <= _NAMES_LISTED else f"{len(names)} names"
    close = "".join(f"; did you mean {each}?" for each in get_close_matches(name, names, 1))
    return f"one of {few}{close}"


def shorten(value: object, longest: int = 80) -> str:
    """Return the text of a value for an error message, at most `longest` characters."""
    try:
        text = str(value) if isinstance(value, float | Description) else reprlib.repr(value)
    except ValueError:  # an integer with more digits than Python converts to text
        text = "a number of thousands of digits"
    return shortened(text, longest)


def shortened(text: str, longest: int = 200) -> str:
    """Return text in one line of at most `longest` characters."""
    text = " ".join(text.split())
    return text if len(text) <= longest else text[: longest - 1] + "…"
