"""Type checks of public functions' arguments, with one error that names the accepted types."""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from numbers import Real
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.errors import shorten
from drake_rho.scenario.fields import FloatArray

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


class _Kind(NamedTuple):
    """One kind of value that an argument accepts."""

    name: str
    """name of the kind in error messages"""
    has: Callable[[object], bool]
    """predicate that is true for values of this kind"""
    type: type | None = None
    """class whose instances are all of this kind; None if `has` must decide"""


_NAMES = {
    "ConvexSet": "a convex set",
    "HasMatrix": "a pose of Drake",
    "SolverInterface": "a Drake solver",
    "str": "a string",
}
"""Plain names of types in error messages."""

_READERS = {"Scenario": "rho.load_scenario", "Plan": "rho.load", "Flight": "rho.load"}
"""Functions that read objects, for errors about a name or path in place of one."""


def checked(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return the function with a check of its arguments' types before each call.

    The accepted types are those of the annotations. Any kind of number, but no truth value, is
    accepted as a number; the function itself decides which values are valid.

    Raises (when it is called):
        TypeError: an argument is of none of the accepted kinds.
        ValueError: an argument is a string, but none of the accepted ones.
    """
    signature = inspect.signature(function)
    names = tuple(signature.parameters)
    known = frozenset(names)

    @functools.wraps(function)
    def run(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        kinds, types_of = kinds_of(function), _types_of(function)
        for name, value in chain(zip(names, args, strict=False), kwargs.items()):
            if name not in kinds or isinstance(value, types_of[name]):
                continue  # the common case has to be fast: a flight's windows take a millisecond
            if not any(kind.has(value) for kind in kinds[name]):
                try:
                    signature.bind(*args, **kwargs)
                except TypeError:  # wrong number of arguments: Python's own message is better
                    break
                raise _refusal(name, value, kinds[name])
        for name in kwargs.keys() - known:  # a function with `passes_to` would accept it
            raise TypeError(
                f"{function.__qualname__}() got an unexpected keyword argument {name!r}"
            )
        return function(*args, **kwargs)

    return run


def passes_to(
    other: Callable[..., object],
) -> Callable[[Callable[_Arguments, _Result]], Callable[_Arguments, _Result]]:
    """Return a decorator for functions that pass `**` keyword arguments on to another one.

    Their signatures and annotations list each of these arguments, before the function's own keyword
    arguments, for help, completion and `checked`.
    """

    def listed(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
        signature = inspect.signature(function)
        own = [each for each in signature.parameters.values() if each.kind != each.VAR_KEYWORD]
        passed = [
            each
            for name, each in inspect.signature(other).parameters.items()
            if each.kind == each.KEYWORD_ONLY and name not in signature.parameters
        ]
        parameters = sorted([*own, *passed], key=lambda each: (each.kind, each in own))
        shown = signature.replace(parameters=parameters)
        function.__signature__ = shown  # type: ignore[attr-defined]  # `inspect` reads it
        hints = inspect.get_annotations(function, eval_str=True)
        of_other = inspect.signature(other, eval_str=True).parameters
        hints |= {each.name: of_other[each.name].annotation for each in passed}
        named = [*shown.parameters, "return"]
        function.__annotations__ = {name: hints[name] for name in named if name in hints}
        return function

    return listed


def _refusal(name: str, value: object, kinds: tuple[_Kind, ...]) -> TypeError | ValueError:
    """Return the error for an argument that is of none of the accepted kinds."""
    names = [kind.name for kind in kinds]
    expected = " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
    plain = value is None or isinstance(value, str | bool | Real)
    got = shorten(value) if plain else f"an object of type {type(value).__name__}"
    if isinstance(value, type):
        got = f"the class {value.__name__}"
    words = isinstance(value, str) and any(name.startswith("'") for name in names)
    hint = ""
    if isinstance(value, str | Path):
        hint = next((f"; {_READERS[each]} reads one" for each in names if each in _READERS), "")
    elif "Scenario" in names and hasattr(value, "scenario"):
        hint = "; it has one as its attribute `scenario`"
    elif "Figure" in names:
        hint = "; rho.paths_figure draws one"
    return (ValueError if words else TypeError)(f"{name}: got {got}, expected {expected}{hint}")


@functools.cache
def kinds_of(function: Callable[..., object]) -> dict[str, tuple[_Kind, ...]]:
    """Return the accepted kinds of each restricted argument, by name."""
    hints = get_type_hints(function)
    hints.pop("return", None)
    kinds = {name: [_kind_of(part) for part in _parts_of(hint)] for name, hint in hints.items()}
    return {
        name: tuple(kind for kind in each if kind is not None)
        for name, each in kinds.items()
        if None not in each
    }


@functools.cache
def _types_of(function: Callable[..., object]) -> dict[str, tuple[type, ...]]:
    """Return the classes whose instances are all accepted, by the argument's name."""
    return {
        name: tuple(kind.type for kind in kinds if kind.type is not None)
        for name, kinds in kinds_of(function).items()
    }


def _parts_of(hint: Any) -> list[Any]:
    """Return the members of a union, or the single values of a literal type."""
    if hint == npt.ArrayLike:  # a union with many members that are not numbers
        return [FloatArray]
    if get_origin(hint) in (Union, types.UnionType):
        return [part for each in get_args(hint) for part in _parts_of(each)]
    if get_origin(hint) is Annotated:
        return _parts_of(get_args(hint)[0])
    if get_origin(hint) is Literal:
        return [Literal[word] for word in get_args(hint)]
    return [hint]


def _kind_of(hint: Any) -> _Kind | None:
    """Return the kind that a part of an annotation stands for, or None if it accepts everything."""
    origin = get_origin(hint)
    if origin is Literal:
        (word,) = get_args(hint)
        return _Kind(repr(word), lambda value: isinstance(value, str) and value == word)
    if origin is Callable or (isinstance(hint, type) and _is_called(hint)):
        return _Kind("a function", callable)
    if origin is np.ndarray:
        return _Kind("numbers", _are_numbers)
    if origin is Mapping:
        return _Kind("a mapping", lambda value: isinstance(value, Mapping))
    if isinstance(origin, type) and issubclass(origin, Iterable):
        return _sequence_of([_kind_of(part) for part in _parts_of(get_args(hint)[0])])
    if hint is None or hint is type(None):
        return _Kind("None", lambda value: value is None, types.NoneType)
    if hint in (int, float):
        return _Kind("a number", _is_number, float)
    if hint is bool:
        return _Kind("True or False", lambda value: isinstance(value, bool | np.bool_))
    open_protocol = _is_protocol(hint) and not getattr(hint, "_is_runtime_protocol", False)
    if not isinstance(hint, type) or open_protocol or hint is object:
        return None
    name = _NAMES.get(hint.__name__, hint.__name__)
    return _Kind(name, lambda value: isinstance(value, hint), hint)


def _sequence_of(kinds: list[_Kind | None]) -> _Kind:
    """Return the kind of sequences of some kinds. Iterators are not consumed to check elements."""

    def has(value: object) -> bool:
        if not isinstance(value, list | tuple) or None in kinds:
            return isinstance(value, Iterable) and not isinstance(value, str)
        return all(any(kind.has(each) for kind in kinds if kind) for each in value)

    names = " or ".join(kind.name for kind in kinds if kind)
    return _Kind(f"a sequence of {names.replace('a number', 'numbers') or 'values'}", has)


def _is_number(value: object) -> bool:
    """Return whether a value is a number; True and False are not."""
    return isinstance(value, Real) and not isinstance(value, bool)


def _are_numbers(value: object) -> bool:
    """Return whether a value can be converted to an array of numbers."""
    try:
        np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return True


def _is_called(hint: type) -> bool:
    """Return whether an annotation is a protocol of callables."""
    return _is_protocol(hint) and "__call__" in vars(hint)


def _is_protocol(hint: type) -> bool:
    """Return whether a class is a protocol; `typing.is_protocol` needs Python 3.13."""
    return bool(getattr(hint, "_is_protocol", False))
