"""Distributions of a field or parameter, each told apart by its key, as `{uniform: [0, 1]}`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, PlainSerializer, PlainValidator, Tag

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import Count, Finite, FloatArray, locked, numbers_of, record


def _pair(value: object) -> FloatArray:
    """Two numbers, shape (2,), or two lists of as many, shape (2, M)."""
    rows = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(rows, list | tuple) and len(rows) == 2:
        if not any(isinstance(row, list | tuple | np.ndarray) for row in rows):
            return numbers_of(rows)
        both = [numbers_of(row) for row in rows]
        if len(both[0]) == len(both[1]) > 0:
            return locked(np.array(both))
    raise ScenarioError("", rows, "two numbers, or two lists of as many")


Pair = Annotated[
    FloatArray,
    PlainValidator(
        _pair,
        json_schema_input_type=tuple[Finite, Finite] | tuple[list[Finite], list[Finite]],
    ),
    PlainSerializer(np.ndarray.tolist),
]
"""Two numbers, or two vectors, whose entries are then drawn each by itself."""


class Draws(ABC):
    """What gives a value as it may stand in a file."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Any:
        """A number, a list of numbers, or what else stands in a choice."""


@record
class Uniform(Draws):
    """Evenly between two values."""

    uniform: Pair
    """the lower and the upper end, in the unit of the field"""

    def __post_init__(self) -> None:
        _check_rising("uniform", self.uniform)

    def draw(self, rng: np.random.Generator) -> Any:
        """A number or a list of numbers."""
        return np.asarray(rng.uniform(*self.uniform)).tolist()


@record
class LogUniform(Draws):
    """Between two values above 0, its logarithm evenly."""

    log_uniform: Pair
    """the lower and the upper end, in the unit of the field"""

    def __post_init__(self) -> None:
        _check_rising("log_uniform", self.log_uniform)
        if np.any(self.log_uniform <= 0.0):
            raise ScenarioError("log_uniform", self.log_uniform.tolist(), "numbers above 0")

    def draw(self, rng: np.random.Generator) -> Any:
        """A number or a list of numbers."""
        return np.exp(rng.uniform(*np.log(self.log_uniform))).tolist()


@record
class Normal(Draws):
    """The normal distribution."""

    normal: Pair
    """mean and standard deviation, in the unit of the field"""

    def __post_init__(self) -> None:
        if np.any(self.normal[1] < 0.0):
            raise ScenarioError("normal", self.normal.tolist(), "a deviation of at least 0")

    def draw(self, rng: np.random.Generator) -> Any:
        """A number or a list of numbers."""
        return np.asarray(rng.normal(*self.normal)).tolist()


@record
class Integers(Draws):
    """Whole numbers, each with the same probability."""

    integers: tuple[Count, Count]
    """the least and the greatest, both included"""

    def __post_init__(self) -> None:
        _check_rising("integers", np.array(self.integers))

    def draw(self, rng: np.random.Generator) -> Any:
        """A whole number."""
        return int(rng.integers(*self.integers, endpoint=True))


@record
class Choice(Draws):
    """One of a list, each with the same probability."""

    choice: Annotated[tuple[Any, ...], Field(min_length=1)]
    """values as they may stand in the field"""

    def draw(self, rng: np.random.Generator) -> Any:
        """One of the values."""
        return self.choice[int(rng.integers(len(self.choice)))]


def _check_rising(field: str, pair: FloatArray) -> None:
    if np.any(pair[0] > pair[1]):
        raise ScenarioError(field, pair.tolist(), "the lower end first")


_KINDS: dict[str, type[Draws]] = {
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "normal": Normal,
    "integers": Integers,
    "choice": Choice,
}


def _kind(value: object) -> str:
    """The name of the record that a value is, or that the key of a mapping tells."""
    if isinstance(value, Mapping):
        found = next((_KINDS[key] for key in value if key in _KINDS), None)
        if found is None:
            expected = f"a distribution: a mapping with one of {', '.join(_KINDS)}"
            raise ScenarioError("", dict(value), expected)
        return found.__name__
    return type(value).__name__


def is_distribution(value: object) -> bool:
    """Whether a value is a distribution, or a mapping with the key of one."""
    if isinstance(value, Mapping):
        return any(key in _KINDS for key in value)
    return isinstance(value, Draws)


if TYPE_CHECKING:
    AnyDistribution = Draws
else:
    AnyDistribution = Annotated[
        Annotated[Uniform, Tag("Uniform")]
        | Annotated[LogUniform, Tag("LogUniform")]
        | Annotated[Normal, Tag("Normal")]
        | Annotated[Integers, Tag("Integers")]
        | Annotated[Choice, Tag("Choice")],
        Discriminator(_kind),
    ]
"""One of the distributions, told apart by its key."""
