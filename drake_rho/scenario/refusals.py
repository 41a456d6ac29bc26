"""Errors of pydantic as `ScenarioError`s, which name a field, its value and what was expected."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any, get_args

from pydantic import (
    ValidationError,
)

from drake_rho.scenario.errors import Description, ScenarioError, one_of


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
    if first["type"] == "json_invalid":
        return malformed_json(first["ctx"]["error"]).inside(parent)
    if first["type"] in _UNKNOWN:
        expected = "no field of this name" + _suggestion(str(names[-1]), kinds)
        return ScenarioError(where, first["input"], expected).inside(parent)
    if first["type"] in {"missing", "missing_argument"}:
        return ScenarioError(where, Description("nothing"), "a value").inside(parent)
    if first["type"] in _NO_RECORD:
        expected = _records(kinds, in_python=bool(parent))
        return ScenarioError(where, first["input"], expected).inside(parent)
    return ScenarioError(where, first["input"], _expectation(first["msg"])).inside(parent)


def malformed_json(reason: object) -> ScenarioError:
    """Return the error for a text that is no JSON, or is nested more deeply than readers go."""
    if "recursion" in str(reason):
        return ScenarioError("", Description("malformed JSON, nested too deeply"), "JSON")
    return ScenarioError("", Description("malformed JSON"), f"JSON; {reason}")


def _records(kinds: list[type], *, in_python: bool) -> str:
    """Return the expected record, as a call in Python or as the keys of a mapping in a file."""
    if in_python:
        others = " or another of these kinds" if len(kinds) > _KINDS_LISTED else ""
        return " or ".join(map(_call_of, kinds[:_KINDS_LISTED])) + others
    if len(kinds) > 1:
        return "a mapping of field names to values"
    return f"a mapping with the keys {', '.join(getattr(kinds[0], '__pydantic_fields__', {}))}"


_KINDS_LISTED = 3
"""Largest number of record types that an error lists."""


def _call_of(kind: type) -> str:
    """Return the call that creates a record, with its required fields."""
    fields: Any = getattr(kind, "__pydantic_fields__", {})
    required = [f"{name}=..." for name, field in fields.items() if field.is_required()]
    return f"{kind.__name__}({', '.join(required or ['...'])})"


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
    value = details["input"].get(field, Description("nothing"))
    return ScenarioError(field, value, one_of(words, str(value))).inside(where)


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
        if part in _TAGS:
            continue
        names.append(part)
        fields = [getattr(kind, "__pydantic_fields__", {}) for kind in kinds]
        found = [each[part].annotation for each in fields if part in each]
        if found:
            kinds = [kind for annotation in found for kind in _records_in(annotation)]
    return kinds, names


_TAGS = ("ConvexSet", "AnySet", "Vector", "None", "(value)", "(set)")
"""Tags of values that are no records, such as a user's own set (`drake_rho.scenario.sets`) and the
values of goals (`drake_rho.scenario.goals`)."""


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
    if close := get_close_matches(name, fields, 1):
        return f"; did you mean {close[0]}?"
    return f"; there are {', '.join(sorted(fields))}" if 0 < len(fields) <= _LISTED else ""


_LISTED = 12
"""Largest number of names of fields that an error lists."""


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
    message = message.replace("a valid integer", "an integer").partition(", got ")[0]
    message = message.replace("a valid number", "a number").partition(", unable to parse ")[0]
    message = message.replace("a valid string", "a text, in YAML perhaps in quotes")
    message = message.replace("a valid dictionary", "a mapping").partition(" or instance of ")[0]
    return message[:1].lower() + message[1:]
