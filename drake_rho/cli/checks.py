"""Checks of output options before the work begins, so that no result is lost after it."""

from __future__ import annotations

import dataclasses
import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_width
from drake_rho.display.viewer.film import ENDINGS as ENDINGS_OF_FILMS
from drake_rho.display.viewer.film import check_film, size_of
from drake_rho.motion.files import ENDINGS
from drake_rho.system.files import check_replaceable


@dataclasses.dataclass(frozen=True)
class Drawing:
    """Figures to draw."""

    folder: str
    """folder of the figures"""
    file_format: str
    """file format: png, pdf or svg"""
    width: float
    """width of each figure [in]"""


def check_outputs(output: str | None, drawing: Drawing | None) -> None:
    """Check that a result and its figures can be written.

    Raises:
        ValueError: the file or the folder cannot be written.
    """
    check_writable(output, ENDINGS, "--output")
    check_folder(None if drawing is None else drawing.folder)


def requested_drawing(
    folder: str | None, file_format: str | None, width: float | None
) -> Drawing | None:
    """Return the figures that the options request, or None.

    Raises:
        ValueError: a format or a width is given without a folder, or text could not be read at
            the width.
    """
    if folder is None:
        for option, given in (("--format", file_format), ("--width", width)):
            if given is not None:
                raise ValueError(f"{option}: got {given} without --figures, expected both or none")
        return None
    return drawing_in(folder, file_format, width)


def drawing_in(folder: str, file_format: str | None, width: float | None) -> Drawing:
    """Return the figures to draw in a folder, with defaults for format and width.

    Raises:
        ValueError: text could not be read at the width.
    """
    width = DOUBLE_COLUMN if width is None else check_width(width)
    return Drawing(folder, file_format or "png", width)


@contextmanager
def options_named(**options: str) -> Iterator[None]:
    """Name options in place of the arguments and fields that errors begin with.

    Args:
        options: options by the names of arguments and fields, as `path="--output"`.

    Raises:
        ValueError: the error of the context, if its first word is one of these names.
    """
    try:
        yield
    except ValueError as error:
        name, _, rest = str(error).partition(": ")
        if (option := options.get(name.rpartition(".")[2])) is None:
            raise
        raise ValueError(f"{option}: {rest}") from None


def check_writable(output: str | None, endings: tuple[str, ...], option: str) -> None:
    """Check that a file can be written and has one of the endings.

    Raises:
        ValueError: the file cannot be written, or has another ending.
    """
    if output is None:
        return
    try:
        if Path(output).suffix.lower() not in endings:
            raise OSError(errno.EINVAL, "another ending")
        check_replaceable(output)
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the path
        reason = getattr(error, "strerror", error)
        expected = f"a file to write, ending in {' or '.join(endings)} ({reason})"
        raise ValueError(f"{option}: got {output!r}, expected {expected}") from None


def check_film_option(film: str | None, size: str | None = None) -> None:
    """Check that a film can be made and written.

    Raises:
        ValueError: the file cannot be written, or has another ending; the size is not one.
        DrakeRhoError: a program that films need is not installed.
    """
    if size is not None:
        if film is None:
            raise ValueError(f"--size: got {size} without --film, expected the film that it is for")
        size_of(size)
    if film is not None:
        check_writable(film, ENDINGS_OF_FILMS, "--film")
        check_film(film)


def check_folder(folder: str | None) -> None:
    """Check that figures can be written to a folder, which need not exist yet.

    Raises:
        ValueError: the folder cannot be created or written to.
    """
    if folder is None:
        return
    try:
        if not folder:
            raise OSError(errno.EINVAL, "empty")
        path = Path(folder)
        nearest = next(each for each in (path, *path.parents) if os.path.lexists(each))
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except (OSError, ValueError) as error:
        expected = f"a folder to write to ({getattr(error, 'strerror', error)})"
        raise ValueError(f"--figures: got {folder!r}, expected {expected}") from None


def check_interface(host: str) -> None:
    """Check that a network interface is named; Meshcat takes a blank name as "*", all interfaces.

    Raises:
        ValueError: the name is blank.
    """
    if not host.strip():
        expected = "a network interface, such as localhost, or * for all"
        raise ValueError(f"--host: got {host!r}, expected {expected}")


def check_rate(rate: float | None) -> None:
    """Check that a playback rate is reasonable.

    At a rate of 0.01, ten seconds of flight take a quarter of an hour; at 1000, an hour of flight
    takes four seconds.

    Raises:
        ValueError: the rate is below 0.01 or above 1000, or not a number.
    """
    if rate is not None and not 0.01 <= rate <= 1000.0:
        raise ValueError(f"--rate: got {rate:g}, expected 0.01 to 1000")
