"""Large arrays in records: as lists or arrays from users, as compressed text in files."""

from __future__ import annotations

import base64
import zlib
from typing import Annotated

import numpy as np
from pydantic import PlainSerializer, PlainValidator

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST, FloatArray, IntArray

MOST = 30_000_000
"""Largest number of cells, vertices or triangles."""

_MOST_BYTES = 24 * MOST
"""Largest size of an array [bytes], for text that would expand to more."""


def _whole_rows(value: object) -> IntArray:
    if isinstance(value, str):
        steps = np.frombuffer(_expanded(value), dtype="<i4").reshape(-1, 3)
        rows: IntArray = np.cumsum(steps, axis=0, dtype=np.int64)
        rows.setflags(write=False)
        return rows
    array = _rows(value, "whole numbers")
    rounded = np.rint(array)
    if not np.array_equal(array, rounded) or np.abs(array).max(initial=0.0) > 2**30:
        raise ScenarioError("", Description("other numbers"), "rows of three whole numbers")
    return _frozen(rounded.astype(np.int64))


def _rows_of_numbers(value: object) -> FloatArray:
    if isinstance(value, str):
        array = np.frombuffer(_expanded(value), dtype="<f8").reshape(-1, 3)
    else:
        array = _rows(value, "numbers")
    wrong = ~(np.abs(array) <= LARGEST).all(axis=1)  # also true for NaN
    if wrong.any():
        row = int(np.argmax(wrong))
        expected = f"three finite numbers, x, y and z, of at most {LARGEST:g}"
        raise ScenarioError(f"[{row}]", array[row].tolist(), expected)
    return _frozen(array)


def _rows(value: object, kind: str) -> FloatArray:
    """Return rows of three numbers as an array of shape (M, 3)."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) > MOST:
        given = Description(f"an array of shape {array.shape}")
        raise ScenarioError("", given, f"rows of three {kind}, at most {MOST}")
    return array


def _expanded(text: str) -> bytes:
    """Return the bytes of compressed text.

    Raises:
        ScenarioError: the text is damaged, or of an array that is too large.
    """
    expander = zlib.decompressobj()
    try:
        content = expander.decompress(base64.b64decode(text, validate=True), _MOST_BYTES)
        if expander.eof and len(content) % 24 in (0, 12):
            return content
    except (ValueError, zlib.error):
        pass
    raise ScenarioError("", Description("damaged text"), "an array as this package writes it")


def _frozen(array: np.ndarray) -> np.ndarray:
    array = np.array(array)
    array.setflags(write=False)
    return array


def _text_of_whole(array: IntArray) -> str:
    steps = np.diff(array, axis=0, prepend=np.zeros((1, 3), dtype=np.int64))
    return _text(steps.astype("<i4"))


def _text_of_numbers(array: FloatArray) -> str:
    return _text(array.astype("<f8"))


def _text(array: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(array.tobytes(), 9)).decode()


WholeRows = Annotated[
    IntArray,
    PlainValidator(_whole_rows, json_schema_input_type=list[tuple[int, int, int]] | str),
    PlainSerializer(_text_of_whole),
]
"""Rows of three whole numbers, read-only, shape (M, 3); compressed text in files."""

NumberRows = Annotated[
    FloatArray,
    PlainValidator(_rows_of_numbers, json_schema_input_type=list[tuple[float, float, float]] | str),
    PlainSerializer(_text_of_numbers),
]
"""Positions, read-only, shape (M, 3); compressed text in files."""
