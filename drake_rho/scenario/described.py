"""Records that describe themselves: `help` and completion list fields, units and methods."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from abc import ABCMeta
from collections.abc import Callable
from itertools import pairwise
from typing import Any, ClassVar, TypeVar

from pydantic.fields import FieldInfo

from drake_rho.scenario.errors import Description

_Class = TypeVar("_Class")

_PLAIN_NAMES = {
    "Aimed": "x, y, z | ConvexSet | None",
    "AnyFormation": "Formation",
    "AnyGoal": "State | Goal",
    "AnyObstacle": "Shape | Obstacle",
    "AnySet": "ConvexSet",
    "ConvexShape": "Shape",
    "Count": "int",
    "Finite": "float",
    "FloatArray": "array",
    "FreeOrVector": "x, y, z | None",
    "IntArray": "array",
    "BoolArray": "array",
    "Beside": "str",
    "Colour": "str",
    "Number": "int",
    "Margin": "float",
    "Name": "str",
    "NotNegative": "float",
    "Numbers": "numbers",
    "Obstacles": "tuple[Shape | Obstacle, ...]",
    "Ordinal": "int",
    "Points": "positions",
    "Positive": "float",
    "Vector": "x, y, z",
    "_Size": "float",
}
"""Plain names, as shown by `help`, of annotations that only this package defines."""


class Described(ABCMeta):
    """Metaclass of records, which lists each field in `help` with the docstring under it."""

    def __dir__(cls) -> list[str]:
        """Return the public names, without those added by a dataclass or pydantic."""
        return [name for name in super().__dir__() if not name.startswith("_")]

    @property
    def __doc__(cls) -> str | None:  # of the class, not of the metaclass
        """Docstring of the record, followed by its fields with their types and units."""
        own: str | None = vars(cls).get("__doc__")
        if own is None or "__match_args__" not in vars(cls):  # the class is still being created
            return own
        fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
        descriptions = {
            name: " ".join(text.split()) for name, text in field_descriptions(cls).items()
        }
        lines = [
            f"    {name} ({_plain_annotation(str(field.type))}): {descriptions[name]}"
            for name, field in fields.items()
            if name in descriptions
        ]
        return "\n".join([inspect.cleandoc(own), "", "Attributes:", *lines]) if lines else own

    @__doc__.setter
    def __doc__(cls, own: str | None) -> None:  # pydantic assigns the original docstring again
        vars(type)["__doc__"].__set__(cls, own)


class ShownInNotebooks:
    """Record that a notebook shows as a figure."""

    _html_of: ClassVar[Callable[[object], str] | None] = None

    @staticmethod
    def shown_by(html_of: Callable[[object], str]) -> None:
        """Set the function that returns the HTML of all records, which know nothing of displays."""
        ShownInNotebooks._html_of = html_of

    def _repr_html_(self) -> str | None:
        """Return the HTML of the record for notebooks; None to show its text."""
        draw = ShownInNotebooks._html_of
        return None if draw is None else draw(self)


def described(cls: type[_Class]) -> type[_Class]:
    """Return a copy of a class whose metaclass is `Described`.

    The class is created anew, because the metaclass of an existing class cannot be changed.
    """
    per_class = {"__dict__", "__weakref__", "__abstractmethods__", "_abc_impl"}
    content = {name: value for name, value in vars(cls).items() if name not in per_class}
    made: Any = Described(cls.__name__, cls.__bases__, content)
    return made  # type: ignore[no-any-return]  # it has the content of `cls`


def signature_of(cls: Any) -> inspect.Signature:
    """Return the constructor's signature without annotations: the docstring lists the types."""
    parameters = []
    for field in dataclasses.fields(cls):
        default: object = inspect.Parameter.empty
        if isinstance(field.default, FieldInfo):  # required, after a field that is not
            default = Description("...")
        elif field.default is not dataclasses.MISSING:
            default = field.default
        elif field.default_factory is not dataclasses.MISSING:
            default = Description("...")
        plain, keyword = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
        kind = keyword if field.kw_only else plain
        parameters.append(inspect.Parameter(field.name, kind, default=default))
    return inspect.Signature(
        sorted(parameters, key=lambda each: each.kind)
    )  # fields of bases first


def field_descriptions(cls: type) -> dict[str, str]:
    """Return the docstrings under the fields of a class and its bases."""
    descriptions: dict[str, str] = {}
    for each in reversed(cls.__mro__):
        if not isinstance(each, Described):
            continue
        try:
            (node,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        except (OSError, TypeError):  # the source is not available
            continue
        body = node.body if isinstance(node, ast.ClassDef) else []
        for field, below in pairwise(body):
            match field, below:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    descriptions[name] = inspect.cleandoc(text)
    return descriptions


class _Shortened(ast.NodeTransformer):
    def visit_Name(self, node: ast.Name) -> ast.Name:  # name prescribed by `ast`
        return ast.Name(_PLAIN_NAMES.get(node.id, node.id))

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:  # name prescribed by `ast`
        match node:
            case ast.Subscript(value=ast.Name(id="Annotated"), slice=ast.Tuple(elts=[kind, *_])):
                return self.visit(kind)  # type: ignore[no-any-return]
        return self.generic_visit(node)


def _plain_annotation(annotation: str) -> str:
    """Return an annotation in plain names and without bounds, as `help` shows it."""
    return ast.unparse(_Shortened().visit(ast.parse(annotation, mode="eval")))
