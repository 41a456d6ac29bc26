"""What is refused before the work is begun, so that its result is not lost after it."""

from __future__ import annotations

import dataclasses
import errno
import os
import tempfile
from pathlib import Path

from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_width
from drake_rho.display.viewer.film import ENDINGS as ENDINGS_OF_FILMS
from drake_rho.display.viewer.film import check_film
from drake_rho.motion.files import ENDINGS
from drake_rho.scenario.files import check_replaceable


@dataclasses.dataclass(frozen=True)
class Drawing:
    """What figures are to be made."""

    folder: str
    """where"""
    file_format: str
    """png, pdf or svg"""
    width: float
    """of each [in]"""


def check_kept(output: str | None, drawing: Drawing | None) -> None:
    """See that a plan and its figures can be kept.

    Raises:
        ValueError: they cannot.
    """
    check_writable(output, ENDINGS, "--output")
    check_folder(None if drawing is None else drawing.folder)


def asked_drawing(
    folder: str | None, file_format: str | None, width: float | None
) -> Drawing | None:
    """The figures that options ask for, if any.

    Raises:
        ValueError: they are none that can be drawn, or have no folder.
    """
    if folder is None:
        for option, given in (("--format", file_format), ("--width", width)):
            if given is not None:
                raise ValueError(f"{option}: got {given} without --figures, expected it with them")
        return None
    return drawing_in(folder, file_format, width)


def drawing_in(folder: str, file_format: str | None, width: float | None) -> Drawing:
    """The figures of a folder, by what is given of them.

    Raises:
        ValueError: letters could not be read at the width.
    """
    width = DOUBLE_COLUMN if width is None else check_width(width)
    return Drawing(folder, file_format or "png", width)


def check_writable(output: str | None, endings: tuple[str, ...], option: str) -> None:
    """See that a file can be written and has one of the endings.

    Raises:
        ValueError: it cannot, or has another.
    """
    if output is None:
        return
    try:
        if Path(output).suffix.lower() not in endings:
            raise OSError(errno.EINVAL, "another ending")
        check_replaceable(output)
    except (OSError, ValueError) as error:  # the latter of a NUL
        reason = getattr(error, "strerror", error)
        expected = f"a file to write, ending in {' or '.join(endings)} ({reason})"
        raise ValueError(f"{option}: got {output!r}, expected {expected}") from None


def check_film_option(film: str | None) -> None:
    """See that a film can be made and kept.

    Raises:
        ValueError: it cannot be kept, or has another ending.
        DrakeRhoError: something is not installed.
    """
    if film is not None:
        check_writable(film, ENDINGS_OF_FILMS, "--film")
        check_film(film)


def check_folder(folder: str | None) -> None:
    """See that figures can be written to a folder, or to one that is made for them.

    Raises:
        ValueError: they cannot.
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
    """See that a network interface is named: Meshcat takes no name for every one, as it does "*".

    Raises:
        ValueError: it is blank.
    """
    if not host.strip():
        raise ValueError(f"--host: got {host!r}, expected a network interface, as localhost, or *")


def check_rate(rate: float | None) -> None:
    """See that a playback can be watched.

    At 0.01 ten seconds of flight last a quarter of an hour, at 1000 an hour of flight four seconds.

    Raises:
        ValueError: it is slower or faster, or no number.
    """
    if rate is not None and not 0.01 <= rate <= 1000.0:
        raise ValueError(f"--rate: got {rate:g}, expected 0.01 to 1000")
