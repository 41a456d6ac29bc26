"""Distributions of a field or parameter, each given by its key, as in `{uniform: [0, 1]}`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, PlainSerializer, PlainValidator, Tag

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import Count, Finite, FloatArray, numbers_of, read_only, record


def _pair(value: object) -> FloatArray:
    """Return two numbers, shape (2,), or two lists of equal lengths, shape (2, M)."""
    rows = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(rows, list | tuple) and len(rows) == 2:
        if not any(isinstance(row, list | tuple | np.ndarray) for row in rows):
            return numbers_of(rows)
        both = [numbers_of(row) for row in rows]
        if len(both[0]) == len(both[1]) > 0:
            return read_only(np.array(both))
    raise ScenarioError("", rows, "two numbers, or two lists of as many")


Pair = Annotated[
    FloatArray,
    PlainValidator(
        _pair,
        json_schema_input_type=tuple[Finite, Finite] | tuple[list[Finite], list[Finite]],
    ),
    PlainSerializer(np.ndarray.tolist),
]
"""Two numbers, or two vectors, whose entries are then drawn independently."""


class Distribution(ABC):
    """Distribution of values in the form of a file's entries."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a number, a list of numbers, or an entry of a choice."""


@record
class Uniform(Distribution):
    """Uniform distribution between two values."""

    uniform: Pair
    """lower and upper end, in the unit of the field"""

    def __post_init__(self) -> None:
        _check_rising("uniform", self.uniform)

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a number or a list of numbers."""
        return np.asarray(rng.uniform(*self.uniform)).tolist()


@record
class LogUniform(Distribution):
    """Distribution between two values above 0 whose logarithm is uniform."""

    log_uniform: Pair
    """lower and upper end, in the unit of the field"""

    def __post_init__(self) -> None:
        _check_rising("log_uniform", self.log_uniform)
        if np.any(self.log_uniform <= 0.0):
            raise ScenarioError("log_uniform", self.log_uniform.tolist(), "numbers above 0")

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a number or a list of numbers."""
        return np.exp(rng.uniform(*np.log(self.log_uniform))).tolist()


@record
class Normal(Distribution):
    """Normal distribution."""

    normal: Pair
    """mean and standard deviation, in the unit of the field"""

    def __post_init__(self) -> None:
        if np.any(self.normal[1] < 0.0):
            raise ScenarioError("normal", self.normal.tolist(), "a deviation of at least 0")

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a number or a list of numbers."""
        return np.asarray(rng.normal(*self.normal)).tolist()


@record
class Integers(Distribution):
    """Uniform distribution of integers."""

    integers: tuple[Count, Count]
    """least and greatest integer, both included"""

    def __post_init__(self) -> None:
        _check_rising("integers", np.array(self.integers))

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw an integer."""
        return int(rng.integers(*self.integers, endpoint=True))


@record
class Choice(Distribution):
    """Choice from a list, each entry with the same probability."""

    choice: Annotated[tuple[Any, ...], Field(min_length=1)]
    """values, in the form that the field takes"""

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw one of the values."""
        return self.choice[int(rng.integers(len(self.choice)))]


def _check_rising(field: str, pair: FloatArray) -> None:
    if np.any(pair[0] > pair[1]):
        raise ScenarioError(field, pair.tolist(), "the lower end first")


_KINDS: dict[str, type[Distribution]] = {
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "normal": Normal,
    "integers": Integers,
    "choice": Choice,
}


def _kind(value: object) -> str:
    """Return the name of a value's record type, or of the type that a mapping's key denotes."""
    if isinstance(value, Mapping):
        found = next((_KINDS[key] for key in value if key in _KINDS), None)
        if found is None:
            expected = f"a distribution: a mapping with one of {', '.join(_KINDS)}"
            raise ScenarioError("", dict(value), expected)
        return found.__name__
    return type(value).__name__


def is_distribution(value: object) -> bool:
    """Return whether a value is a distribution, or a mapping with the key of one."""
    if isinstance(value, Mapping):
        return any(key in _KINDS for key in value)
    return isinstance(value, Distribution)


if TYPE_CHECKING:
    AnyDistribution = Distribution
else:
    AnyDistribution = Annotated[
        Annotated[Uniform, Tag("Uniform")]
        | Annotated[LogUniform, Tag("LogUniform")]
        | Annotated[Normal, Tag("Normal")]
        | Annotated[Integers, Tag("Integers")]
        | Annotated[Choice, Tag("Choice")],
        Discriminator(_kind),
    ]
"""One of the distributions, distinguished by its key."""
