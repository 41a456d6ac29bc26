"""What `help` and completion show of a record: its fields with their units, and its methods."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from abc import ABCMeta
from itertools import pairwise
from typing import Any, TypeVar

from drake_rho.scenario.errors import Words

_Class = TypeVar("_Class")

_IN_SHORT = {
    "AnyObstacle": "Shape | Obstacle",
    "Count": "int",
    "Finite": "float",
    "FloatArray": "array",
    "IntArray": "array",
    "BoolArray": "array",
    "Margin": "float",
    "Name": "str",
    "Numbers": "numbers",
    "Points": "positions",
    "Positive": "float",
    "Vector": "x, y, z",
}
"""What annotations that only the package knows are called for people."""


class Described(ABCMeta):
    """The type of records: they tell their fields, each by the docstring under it."""

    def __dir__(cls) -> list[str]:
        """Names for people: nothing that a dataclass or pydantic keeps in the class."""
        return [name for name in super().__dir__() if not name.startswith("_")]

    @property
    def __doc__(cls) -> str | None:  # of the class that is described
        """The record's own docstring and its fields, each with its type and its unit."""
        own: str | None = vars(cls).get("__doc__")
        if own is None or "__match_args__" not in vars(
            cls
        ):  # still being made: not asked by people
            return own
        fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
        said = _said_of_fields(cls)
        lines = [
            f"    {name} ({_in_short(str(field.type))}): {said[name]}"
            for name, field in fields.items()
            if name in said
        ]
        return "\n".join([inspect.cleandoc(own), "", "Attributes:", *lines]) if lines else own

    @__doc__.setter
    def __doc__(cls, own: str | None) -> None:  # pydantic puts it back as it was
        vars(type)["__doc__"].__set__(cls, own)


def described(cls: type[_Class]) -> type[_Class]:
    """The same class as `Described`: made again, as the type of a class cannot be changed."""
    of_its_own = {"__dict__", "__weakref__", "__abstractmethods__", "_abc_impl"}
    content = {name: value for name, value in vars(cls).items() if name not in of_its_own}
    made: Any = Described(cls.__name__, cls.__bases__, content)
    return made  # type: ignore[no-any-return]  # of the same kind, by its content


def signature_of(cls: Any) -> inspect.Signature:
    """How a record is made, in short: its docstring says what the fields are."""
    parameters = []
    for field in dataclasses.fields(cls):
        default: object = inspect.Parameter.empty
        if field.default is not dataclasses.MISSING:
            default = field.default
        elif field.default_factory is not dataclasses.MISSING:
            default = Words("...")
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters.append(inspect.Parameter(field.name, kind, default=default))
    return inspect.Signature(parameters)


def _said_of_fields(cls: type) -> dict[str, str]:
    """The docstrings under the fields of a class and its bases, each in one line."""
    said: dict[str, str] = {}
    for each in reversed(cls.__mro__):
        if not isinstance(each, Described):
            continue
        try:
            (node,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        except (OSError, TypeError):  # without a source there is nothing to read
            continue
        body = node.body if isinstance(node, ast.ClassDef) else []
        for field, below in pairwise(body):
            match field, below:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    said[name] = " ".join(text.split())
    return said


class _Shortened(ast.NodeTransformer):
    def visit_Name(self, node: ast.Name) -> ast.Name:  # ast's name
        return ast.Name(_IN_SHORT.get(node.id, node.id))

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:  # ast's name
        match node:
            case ast.Subscript(value=ast.Name(id="Annotated"), slice=ast.Tuple(elts=[kind, *_])):
                return self.visit(kind)  # type: ignore[no-any-return]
        return self.generic_visit(node)


def _in_short(annotation: str) -> str:
    """An annotation as people read it: without bounds, and in common words."""
    return ast.unparse(_Shortened().visit(ast.parse(annotation, mode="eval")))
