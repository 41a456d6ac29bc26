"""Building blocks of records: validated field types and the `record` decorator."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from contextlib import suppress
from difflib import get_close_matches
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args

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

from drake_rho.scenario.described import described, signature_of
from drake_rho.scenario.errors import ScenarioError, Words

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

LARGEST = 1e12
"""Largest magnitude of any number in a record [SI]: far beyond any flight, and safe to square."""


def _no_truth_value(value: object) -> object:
    if isinstance(value, bool | np.bool_):  # would be accepted as 0 or 1 otherwise
        raise ScenarioError("", value, "a number")
    return value


def _in_range(value: float) -> float:
    if not 1.0 / LARGEST <= value <= LARGEST:
        raise ScenarioError("", value, f"a number between {1.0 / LARGEST:g} and {LARGEST:g}")
    return value


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ScenarioError("", text, "printable characters only")
    return text


NO_TRUTH = BeforeValidator(_no_truth_value)
"""Validator of numeric fields that rejects `True` and `False`."""

# Bounds precede the validator functions: only then does the JSON schema name them by its keywords.
Finite = Annotated[
    float,
    Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False),
    NO_TRUTH,
]
Margin = Annotated[
    float,
    Field(ge=0.0, le=1e6, allow_inf_nan=False),
    NO_TRUTH,
]
"""Distance to be kept from something [m]."""
Positive = Annotated[
    float,
    Field(gt=0.0, allow_inf_nan=False),
    NO_TRUTH,
    AfterValidator(_in_range),
]
Count = Annotated[int, NO_TRUTH]
Name = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(_printable)]
"""Printable name, short enough to be read at a glance and to fit into a legend."""


def locked(values: npt.ArrayLike) -> FloatArray:
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
            array = locked(numbers)
        except (TypeError, ValueError, OverflowError):
            array = locked([np.nan] * 3)
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
        raise ScenarioError("", Words(f"{len(rows)} positions"), f"at most {_MOST}")
    points = []
    for index, row in enumerate(rows):
        try:
            points.append(_vector(row))
        except ScenarioError as error:
            raise error.inside(f"[{index}]") from None
    return locked(np.array(points).reshape(-1, 3))


def numbers_of(value: object) -> FloatArray:
    """Return `value` as a read-only array of shape (M,).

    Raises:
        ScenarioError: it is no list of finite numbers.
    """
    numbers = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(numbers, list | tuple) and not any(map(_nested, numbers)):
        with suppress(TypeError, ValueError, OverflowError):
            array = locked(numbers)
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
    description = inspect.cleandoc(cls.__doc__ or "").partition("\n\nExamples:")[0]
    config = ConfigDict(
        extra="forbid",
        arbitrary_types_allowed=True,
        use_attribute_docstrings=True,
        json_schema_extra={"description": description},
    )
    made: Any = pydantic_dataclass(described(cls), frozen=True, eq=False, config=config)
    validate: Callable[..., None] = made.__init__

    names = [field.name for field in dataclasses.fields(made)]

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


def unchecked(old: _Record, **changes: object) -> _Record:
    """Return a copy of a record with other values, which are not validated.

    The values have to be valid and the arrays read-only. Cached properties are not copied, as they
    may not hold for the copy; `changes` can include those that do. This function is meant for the
    states that a plan has reached: validating each of a thousand vehicles again in every window
    takes longer than planning it.
    """
    copy = object.__new__(type(old))
    attributes, values = copy.__dict__, old.__dict__
    for name in old.__dataclass_fields__:  # type: ignore[attr-defined]  # every record has it
        attributes[name] = values[name]
    attributes.update(changes)
    return copy


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
    fields = (locked(each) if isinstance(each, np.ndarray) else each for each in values)
    made.__dict__.update(zip(names, fields, strict=True))
    return made


def scenario_error(error: ValidationError, root: type, parent: str = "") -> ScenarioError:
    """Return the first of pydantic's errors as a `ScenarioError`, unknown names before others.

    Args:
        error: raised by pydantic.
        root: record or model that was validated.
        parent: path of that record, put before the field's.
    """
    details = error.errors(include_url=False)
    unknown = [one for one in details if one["type"] in _UNKNOWN]
    first = (unknown or details)[0]
    kinds, names = _along(root, first["loc"])
    where = _path(names)
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, ScenarioError):
        return cause.inside(where).inside(parent)
    if (wrong_tag := _wrong_tag(first, where, kinds)) is not None:
        return wrong_tag.inside(parent)
    if first["type"] in _UNKNOWN:
        expected = "no field of this name" + _suggestion(str(names[-1]), kinds)
        return ScenarioError(where, first["input"], expected).inside(parent)
    if first["type"] in {"missing", "missing_argument"}:
        return ScenarioError(where, Words("nothing"), "a value").inside(parent)
    if first["type"] in _NO_RECORD:
        return ScenarioError(where, first["input"], "a mapping of field names to values").inside(
            parent
        )
    return ScenarioError(where, first["input"], _expectation(first["msg"])).inside(parent)


def _wrong_tag(details: Any, where: str, kinds: list[type]) -> ScenarioError | None:
    """Return the error for a wrong discriminator, the field that names the kind of a record.

    Args:
        details: of one of pydantic's errors.
        where: path of the record.
        kinds: records that are allowed there.

    Returns:
        The error, or None if pydantic's error is about something else.
    """
    field = str(details.get("ctx", {}).get("discriminator", "")).strip("'")
    if details["type"] not in _NO_TAG or not field.isidentifier():
        return None
    fields = [getattr(kind, "__pydantic_fields__", {}) for kind in kinds]
    words = [word for each in fields if field in each for word in get_args(each[field].annotation)]
    value = details["input"].get(field, Words("nothing"))
    close = get_close_matches(str(value), words, 1)
    expected = f"one of {', '.join(words)}" + "".join(f"; did you mean {each}?" for each in close)
    return ScenarioError(field, value, expected).inside(where)


def _along(root: type, location: tuple[int | str, ...]) -> tuple[list[type], list[int | str]]:
    """Return the record types possible at a location, and the path without their names.

    Where a field allows several record types, pydantic's location also contains the name of the
    type, or the tag that identifies it.
    """
    kinds: list[type] = [root]
    names = list[int | str]()
    for part in location:
        of_this_name = [kind for kind in kinds if kind.__name__ == part]
        if not of_this_name and len(kinds) > 1:
            of_this_name = [kind for kind in kinds if part in _words_of(kind)]
        if of_this_name:
            kinds = of_this_name
            continue
        names.append(part)
        fields = [getattr(kind, "__pydantic_fields__", {}) for kind in kinds]
        found = [each[part].annotation for each in fields if part in each]
        if found:
            kinds = [kind for annotation in found for kind in _records_in(annotation)]
    return kinds, names


def _words_of(kind: type) -> list[object]:
    """Return the tags that identify a record type: values of required one-value fields."""
    fields: Any = getattr(kind, "__pydantic_fields__", {})
    words = [get_args(field.annotation) for field in fields.values() if field.is_required()]
    return [each[0] for each in words if len(each) == 1]


def _records_in(annotation: object) -> list[type]:
    """Return the record types that an annotation contains."""
    if isinstance(annotation, type) and hasattr(annotation, "__pydantic_fields__"):
        return [annotation]
    return [kind for part in get_args(annotation) for kind in _records_in(part)]


def _suggestion(name: str, kinds: list[type]) -> str:
    """Return a hint such as '; did you mean radius?' for a mistyped name, or an empty string."""
    fields = {field for kind in kinds for field in getattr(kind, "__pydantic_fields__", {})}
    if (other := _OTHER_NAMES.get(name)) in fields:
        return f"; did you mean {other}?"
    return "".join(f"; did you mean {each}?" for each in get_close_matches(name, fields, 1))


_OTHER_NAMES = {"max_velocity": "max_speed", "speed": "max_speed"}
"""Common names of fields that are spelled more like another field."""

_NO_TAG = {"union_tag_invalid", "union_tag_not_found"}
_UNKNOWN = {"unexpected_keyword_argument", "extra_forbidden"}
_NO_RECORD = {"dataclass_type", "dataclass_exact_type", "union_tag_invalid", "union_tag_not_found"}


def _path(location: list[int | str]) -> str:
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).removeprefix(".")


def _expectation(message: str) -> str:
    for beginning in ("Input should be ", "Tuple should have ", "String should have "):
        message = message.removeprefix(beginning)
    message = message.replace("a valid tuple", "a list").partition(" after validation")[0]
    return message[:1].lower() + message[1:]
