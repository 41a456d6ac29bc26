"""The package's base error and the error for a scenario that makes no sense."""

from __future__ import annotations

import pickle
import reprlib


class DrakeRhoError(Exception):
    """Base of every error that drake_rho raises on purpose."""


class Words(str):
    """A value described rather than quoted: shown without quotation marks in an error."""

    def __repr__(self) -> str:
        return str(self)


class ScenarioError(DrakeRhoError, ValueError):
    """A scenario, or a part of one, is not what it must be.

    Attributes:
        field: path of the field, as in `vehicles[0].start.position`; empty for a whole record.
        value: what was given.
        expected: what was expected instead, in words.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        self.field = field
        self.value = value
        self.expected = expected
        super().__init__(field, value, expected)

    def __str__(self) -> str:
        where = f"{self.field}: " if self.field else ""
        return f"{where}got {shorten(self.value)}, expected {self.expected}"

    def __reduce__(self) -> tuple[type, tuple[str, object, str]]:
        """For another process, where a value that cannot get there is what is said of it."""
        value = self.value
        try:
            pickle.dumps(value)
        except Exception:  # what a value of any kind raises
            value = Words(shorten(value))
        return ScenarioError, (self.field, value, self.expected)

    def inside(self, parent: str) -> ScenarioError:
        """This error as seen from the record that holds this one under `parent`."""
        if not parent or not self.field or self.field.startswith("["):
            return ScenarioError(parent + self.field, self.value, self.expected)
        return ScenarioError(f"{parent}.{self.field}", self.value, self.expected)


def shorten(value: object, longest: int = 80) -> str:
    """Return a value as an error shows it, in a few words."""
    try:
        text = str(value) if isinstance(value, float | Words) else reprlib.repr(value)
    except ValueError:  # an integer of more digits than Python writes
        text = "a number of thousands of digits"
    text = " ".join(text.split())
    return text if len(text) <= longest else text[: longest - 1] + "…"
