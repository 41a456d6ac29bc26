"""Building blocks of records: validated field types and the `record` decorator."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from typing import Annotated, Any, TypeVar, dataclass_transform

import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
)
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo

from drake_rho.scenario.described import described, field_descriptions, signature_of
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.refusals import scenario_error

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

LARGEST = 1e12
"""Largest magnitude of any number in a record [SI]: far beyond any flight, and safe to square."""


def _no_truth_value(value: object) -> object:
    if isinstance(value, bool | np.bool_):  # would be accepted as 0 or 1 otherwise
        raise ScenarioError("", value, "a number")
    return value


def _truth_value(value: object) -> bool:
    if not isinstance(value, bool | np.bool_):  # 1 and "yes" would be accepted otherwise
        raise ScenarioError("", value, "true or false")
    return bool(value)


def _in_range(value: float) -> float:
    if not 1.0 / LARGEST <= value <= LARGEST:
        raise ScenarioError("", value, f"a number between {1.0 / LARGEST:g} and {LARGEST:g}")
    return value


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ScenarioError("", text, "printable characters only")
    return text


NOT_BOOLEAN = BeforeValidator(_no_truth_value)
"""Validator of numeric fields that rejects `True` and `False`."""

# Bounds precede the validator functions: only then does the JSON schema name them by its keywords.
Finite = Annotated[
    float,
    Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False),
    NOT_BOOLEAN,
]
Margin = Annotated[
    float,
    Field(ge=0.0, le=1e6, allow_inf_nan=False),
    NOT_BOOLEAN,
]
"""Required distance from something [m]."""
Positive = Annotated[
    float,
    Field(gt=0.0, allow_inf_nan=False),
    NOT_BOOLEAN,
    AfterValidator(_in_range),
]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
Count = Annotated[int, NOT_BOOLEAN]
Ordinal = Annotated[int, Field(ge=1)]
"""Number of an obstacle or a requirement, from 1."""
Boolean = Annotated[bool, BeforeValidator(_truth_value)]
Name = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(_printable)]
"""Printable name, short enough to be read at a glance and to fit into a legend."""

Colour = Annotated[str, Field(pattern="^#[0-9a-fA-F]{6}$")]
"""Colour of a light as #rrggbb."""


def read_only(values: npt.ArrayLike) -> FloatArray:
    """Return `values` as a read-only array, copied unless it already is one that owns its data."""
    array = np.asarray(values, dtype=np.float64)
    if array is values and array.base is None and not array.flags.writeable:
        return array
    array = np.array(array)
    array.setflags(write=False)
    return array


def _vector(value: object) -> FloatArray:
    numbers = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(numbers, list | tuple) and len(numbers) == 3 and not any(map(_nested, numbers)):
        try:
            array = read_only(numbers)
        except (TypeError, ValueError, OverflowError):
            array = read_only([np.nan] * 3)
        if np.all(np.abs(array) <= LARGEST):  # never with a NaN
            return array
    expected = f"three finite numbers, x, y and z, of at most {LARGEST:g}"
    raise ScenarioError("", numbers, expected)


def _nested(value: object) -> bool:
    return isinstance(value, list | tuple | dict | bool)


Vector = Annotated[
    FloatArray,
    PlainValidator(_vector, json_schema_input_type=tuple[Finite, Finite, Finite]),
    PlainSerializer(np.ndarray.tolist),
]
"""x, y and z as a read-only array of shape (3,)."""


def _points(value: object) -> FloatArray:
    rows = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(rows, list | tuple):
        raise ScenarioError("", rows, "a list of positions")
    if len(rows) > _MOST:
        raise ScenarioError("", Description(f"{len(rows)} positions"), f"at most {_MOST}")
    points = []
    for index, row in enumerate(rows):
        try:
            points.append(_vector(row))
        except ScenarioError as error:
            raise error.inside(f"[{index}]") from None
    return read_only(np.array(points).reshape(-1, 3))


def numbers_of(value: object) -> FloatArray:
    """Return `value` as a read-only array of shape (M,).

    Raises:
        ScenarioError: it is not a list of finite numbers.
    """
    numbers = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(numbers, list | tuple) and not any(map(_nested, numbers)):
        with suppress(TypeError, ValueError, OverflowError):
            array = read_only(numbers)
            if array.shape == (len(numbers),) and np.all(np.abs(array) <= LARGEST):
                return array
    raise ScenarioError("", numbers, f"a list of finite numbers of at most {LARGEST:g}")


_MOST = 100_000
"""Largest number of positions in one list."""

Points = Annotated[
    FloatArray,
    PlainValidator(_points, json_schema_input_type=list[tuple[Finite, Finite, Finite]]),
    PlainSerializer(np.ndarray.tolist),
]
"""Positions as a read-only array of shape (M, 3)."""

Numbers = Annotated[
    FloatArray,
    PlainValidator(numbers_of, json_schema_input_type=list[Finite]),
    PlainSerializer(np.ndarray.tolist),
]
"""Numbers as a read-only array of shape (M,)."""

_Record = TypeVar("_Record")


@dataclass_transform(frozen_default=True)
def record(cls: type[_Record]) -> type[_Record]:
    """Make `cls` a frozen, validated dataclass that raises `ScenarioError` on bad input.

    Fields are validated when the record is created, and unknown names are rejected. Two records
    are equal if all their fields are equal. The docstring under a field is its description in the
    JSON schema and in `help`, which shows nothing of pydantic.
    """
    config = ConfigDict(extra="forbid", arbitrary_types_allowed=True, json_schema_extra=_describe)
    made: Any = pydantic_dataclass(described(cls), frozen=True, eq=False, config=config)
    for field in dataclasses.fields(made):
        if isinstance(field.default, FieldInfo):  # required, after a field that is not
            delattr(made, field.name)
    validate: Callable[..., None] = made.__init__

    names = [field.name for field in dataclasses.fields(made) if not field.kw_only]

    def init(self: object, *args: object, **kwargs: object) -> None:
        positional = dict(zip(names, args, strict=False))
        if len(args) > len(names) or positional.keys() & kwargs.keys():
            raise TypeError(f"{made.__name__} takes these fields, each once: {', '.join(names)}")
        try:  # every field is passed by name, so that pydantic's errors name it too
            validate(self, **positional, **kwargs)
            return
        except ValidationError as error:
            refusal = scenario_error(error, made, made.__name__.lower())
        raise refusal  # outside of `except`: pydantic's error as context may not be picklable

    made.__init__ = init
    made.__signature__ = signature_of(made)
    made.__eq__ = _equal
    made.__reduce__ = _reduce
    made.__hash__ = None  # records hold arrays and are equal by value, so they cannot be keys
    return made  # type: ignore[no-any-return]  # `made` is declared as Any above


def _describe(schema: dict[str, Any], cls: type) -> None:
    """Add the docstrings of a record and its fields to its JSON schema.

    They are read from the source, which takes longer than all else when a record is made, so only
    where a schema is asked for.
    """
    schema["description"] = inspect.cleandoc(vars(cls)["__doc__"] or "").partition("\n\nExamples:")[
        0
    ]
    for name, text in field_descriptions(cls).items():
        if name in schema.get("properties", {}):
            schema["properties"][name]["description"] = text


def record_kind(value: object, kinds: Mapping[str, Sequence[str]], otherwise: str) -> str:
    """Return the name of a record's type, or of the type that a mapping describes.

    Mistyped keys are matched to the closest known ones.

    Args:
        value: a record or a mapping.
        kinds: keys that identify the types; of several, the first in this order is taken.
        otherwise: the type of a mapping with none of these keys.
    """
    if not isinstance(value, Mapping):
        return type(value).__name__
    known = [key for keys in kinds.values() for key in keys]
    close = {match for key in value for match in get_close_matches(str(key), known, 1, 0.75)}
    return next((kind for kind, keys in kinds.items() if close.intersection(keys)), otherwise)


def unchecked(old: _Record, **changes: object) -> _Record:
    """Return a copy of a record with other values, which are not validated.

    The values have to be valid and the arrays read-only. Cached properties are not copied, as they
    may not hold for the copy; `changes` can include those that do. This function is meant for
    states reached in flight: validating each of a thousand vehicles again in every window takes
    longer than planning it.
    """
    copy = object.__new__(type(old))
    attributes, values = copy.__dict__, old.__dict__
    for name in old.__dataclass_fields__:  # type: ignore[attr-defined]  # every record has it
        attributes[name] = values[name]
    attributes.update(changes)
    return copy


def _equal(self: Any, other: Any) -> bool:
    if self is other or type(self) is not type(other):
        return self is other
    names = [field.name for field in dataclasses.fields(self)]
    return all(_same(getattr(self, name), getattr(other, name)) for name in names)


def _same(mine: object, theirs: object) -> bool:
    """Return whether two values are equal, arrays as a whole."""
    if isinstance(mine, np.ndarray) or isinstance(theirs, np.ndarray):
        return isinstance(theirs, type(mine)) and np.array_equal(mine, theirs)  # type: ignore[arg-type]
    return bool(mine == theirs)


def _reduce(self: Any) -> tuple[Callable[..., object], tuple[object, ...]]:
    """Support copying and pickling: the copy has the same fields but no cached properties."""
    return _restored, (type(self), *(getattr(self, each.name) for each in dataclasses.fields(self)))


def _restored(kind: type, *values: object) -> object:
    """Return the record with these field values, its arrays read-only again.

    The values are not validated again: a state reached in flight may not be a valid initial
    scenario, for example where a vehicle is inside an obstacle that became known too late.
    """
    made: object = object.__new__(kind)
    names = (each.name for each in dataclasses.fields(kind))
    fields = (_locked(each) if isinstance(each, np.ndarray) else each for each in values)
    made.__dict__.update(zip(names, fields, strict=True))
    return made


def _locked(array: np.ndarray) -> np.ndarray:
    """Return a read-only copy of an array, with whole numbers where it has them."""
    array = np.array(array)
    array.setflags(write=False)
    return array
