"""Arrays in NumPy files, with headers checked against the files before reading."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Mapping
from typing import IO, Any, NamedTuple

import numpy as np

_KINDS = "biufU"
"""Kinds of values of arrays: true or false, whole numbers, numbers and text."""


class Header(NamedTuple):
    """Shape and type that an array in a file claims to have."""

    shape: tuple[int, ...]
    """shape"""
    dtype: np.dtype[Any]
    """type of its values"""

    @property
    def size(self) -> int:
        """Size of its values [bytes]."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_header(file: IO[bytes]) -> Header:
    """Read the header of an array, up to its values.

    Raises:
        ValueError: there is no header, or the values are neither numbers nor text.
    """
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    if dtype.kind not in _KINDS or not all(isinstance(each, int) and each >= 0 for each in shape):
        raise ValueError(f"an array of type {dtype}")
    return Header(shape, dtype)


class Archive(Mapping[str, np.ndarray]):
    """Arrays of an `.npz` archive by name, each read on access.

    Args:
        file: the archive.
        most: largest size of an array [bytes].

    Raises:
        ValueError: the archive is damaged, or an array is larger.
    """

    def __init__(self, file: IO[bytes], most: int) -> None:
        self._archive = zipfile.ZipFile(file)
        self._headers = dict[str, Header]()
        for member in self._archive.infolist():
            name = member.filename.removesuffix(".npy")
            with self._archive.open(member) as content:
                header = read_header(content)
                if header.size != member.file_size - content.tell():
                    found = f"{member.file_size} bytes with a header of shape {header.shape}"
                    raise ValueError(f"{name} has {found}, whose numbers are more or fewer")
            if header.size > most:
                raise ValueError(f"{name} has {header.size} bytes, more than {most}")
            self._headers[name] = header

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array without reading its values."""
        return self._headers[name].shape

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._headers:
            raise KeyError(name)
        with self._archive.open(f"{name}.npy") as content:
            return np.lib.format.read_array(content, allow_pickle=False)

    def __iter__(self) -> Iterator[str]:
        return iter(self._headers)

    def __len__(self) -> int:
        return len(self._headers)
