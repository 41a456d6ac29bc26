"""What the records are made of: validated vectors, and the decorator that makes a record."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, dataclass_transform

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, PlainSerializer, PlainValidator, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass

from drake_rho.scenario.errors import ScenarioError, Words

FloatArray = npt.NDArray[np.float64]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


def locked(values: npt.ArrayLike) -> FloatArray:
    """A copy of `values` that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _vector(value: object) -> FloatArray:
    try:
        array = locked(value)  # type: ignore[arg-type]  # whatever it is, numpy says if it won't do
    except (TypeError, ValueError):
        array = locked([])
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        shown = value.tolist() if isinstance(value, np.ndarray) else value
        raise ScenarioError("", shown, "three finite numbers: x, y and z")
    return array


Vector = Annotated[
    FloatArray,
    PlainValidator(_vector, json_schema_input_type=tuple[Finite, Finite, Finite]),
    PlainSerializer(np.ndarray.tolist),
]
"""x, y and z as a write-locked array of shape (3,)."""

_Record = TypeVar("_Record")


@dataclass_transform(frozen_default=True)
def record(cls: type[_Record]) -> type[_Record]:
    """Make `cls` a frozen, validated dataclass that raises `ScenarioError` on bad input.

    Fields are checked when the record is made; unknown names are refused; two records are equal
    if all their fields are. The docstring under a field is its description in the JSON schema.
    """
    config = ConfigDict(
        extra="forbid",
        arbitrary_types_allowed=True,
        use_attribute_docstrings=True,
    )
    made: Any = pydantic_dataclass(cls, frozen=True, eq=False, config=config)
    validate: Callable[..., None] = made.__init__

    names = [field.name for field in dataclasses.fields(made)]

    def init(self: object, *args: object, **kwargs: object) -> None:
        if len(args) > len(names):
            raise TypeError(f"{made.__name__} takes {len(names)} fields: {', '.join(names)}")
        try:  # every field by its name, so that a complaint names it too
            validate(self, **dict(zip(names, args, strict=False)), **kwargs)
        except ValidationError as error:
            raise scenario_error(error, made.__name__.lower()) from None

    made.__init__ = init
    made.__eq__ = _equal
    made.__hash__ = None  # arrays inside: equal by value, so not usable as a key
    return made  # type: ignore[no-any-return]  # pydantic's decorator is typed as Any above


def _equal(self: Any, other: Any) -> bool:
    if type(self) is not type(other):
        return False
    fields = dataclasses.fields(self)
    return all(
        np.array_equal(mine, theirs) if isinstance(mine, np.ndarray) else mine == theirs
        for mine, theirs in (
            (getattr(self, field.name), getattr(other, field.name)) for field in fields
        )
    )


def scenario_error(error: ValidationError, parent: str = "") -> ScenarioError:
    """The first of pydantic's complaints as one `ScenarioError`, unknown names before others."""
    complaints = error.errors(include_url=False)
    unknown = [one for one in complaints if one["type"] in _UNKNOWN]
    first = (unknown or complaints)[0]
    where = _path(first["loc"])
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, ScenarioError):
        return cause.inside(where).inside(parent)
    if first["type"] in _UNKNOWN:
        return ScenarioError(where, first["input"], "no such field").inside(parent)
    if first["type"] in {"missing", "missing_argument"}:
        return ScenarioError(where, Words("nothing"), "a value").inside(parent)
    if first["type"] in {"dataclass_type", "dataclass_exact_type"}:
        return ScenarioError(where, first["input"], "field names with values").inside(parent)
    return ScenarioError(where, first["input"], _expectation(first["msg"])).inside(parent)


_UNKNOWN = {"unexpected_keyword_argument", "extra_forbidden"}


def _path(location: tuple[int | str, ...]) -> str:
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).removeprefix(".")


def _expectation(message: str) -> str:
    message = message.removeprefix("Input should be ").removeprefix("Value error, ")
    message = message.replace("a valid tuple", "a list")
    return message[:1].lower() + message[1:]
