"""What is refused before the work is begun, so that its result is not lost after it."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

from drake_rho.motion.files import ENDINGS
from drake_rho.scenario.files import check_replaceable


def check_kept(output: str | None, figures: str | None) -> None:
    """See that a plan and its figures can be kept.

    Raises:
        ValueError: they cannot.
    """
    check_writable(output, ENDINGS, "--output")
    check_folder(figures)


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
