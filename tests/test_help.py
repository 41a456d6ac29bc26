"""The `help` of a record shows its fields with units, and no internals."""

from __future__ import annotations

import dataclasses
import inspect
import json
import pydoc
from typing import Any

import pytest

import drake_rho as rho
from drake_rho.scenario.described import Described

RECORDS = [
    name
    for name in rho.__all__
    if isinstance(getattr(rho, name), type) and dataclasses.is_dataclass(getattr(rho, name))
]


def _help(record: type) -> str:
    return pydoc.plain(pydoc.render_doc(record))


@pytest.mark.parametrize("kind", RECORDS)
def test_help_shows_every_field_and_nothing_of_pydantic(kind: str) -> None:
    record: Any = getattr(rho, kind)
    assert isinstance(record, Described)
    text, fields = _help(record), [field.name for field in dataclasses.fields(getattr(rho, kind))]
    own = inspect.cleandoc(vars(record)["__doc__"])
    assert own.splitlines()[0] in text
    for name in fields:
        assert f" {name} (" in text, name
    for word in ("pydantic", "Annotated", "__dataclass", "_equal", "FieldInfo"):
        assert word not in text, word


def test_help_has_units_types_and_defaults() -> None:
    text = _help(rho.Grid)
    assert "Grid(step, knots, start=0.0)" in text
    assert "step (float): h, the time from one knot to the next [s]" in text
    assert "knots (int): K, the number of knots" in text
    text = _help(rho.Plan)
    assert "positions (array): p[k] at the knots [m], shape (N, K, 3)" in text
    assert "limits=..." in _help(rho.Scenario)


def test_completion_shows_fields_and_methods_only() -> None:
    assert [name for name in dir(rho.Grid) if name.startswith("_")] == []
    assert {"duration", "times", "lasting"} <= set(dir(rho.Grid))
    assert {"step", "knots", "start", "duration"} <= set(dir(rho.Grid(1.0, 2)))


def test_the_schema_describes_a_record_without_fields_and_examples() -> None:
    schema = rho.scenario_schema()
    kinds = schema["$defs"]
    first = "Time grid of a flight: knots k = 1..K with the step h between them."
    assert kinds["Grid"]["description"] == first
    assert inspect.cleandoc(vars(rho.Grid)["__doc__"]).startswith(first)
    for word in ("Attributes:", "Examples:", ">>>"):
        assert word not in json.dumps(schema)


def test_a_record_without_source_code_keeps_its_own_docstring() -> None:
    made: dict[str, Any] = {"Described": Described}
    text = 'class R(metaclass=Described):\n    """Of a string."""\n    a: int = 0\n'
    exec(text, made)  # noqa: S102  # written above
    record: Any = dataclasses.dataclass(made["R"])
    assert record.__doc__ == "Of a string."
