"""Folders and archives with a file for each vehicle, written whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from drake_rho.scenario.files import replacing

_LONGEST = 200
"""Most bytes of a name before its ending; most file systems allow 255 in all."""
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The time of all files in an archive, so that the same content gives the same archive."""


def file_names(names: Iterable[str], ending: str) -> list[str]:
    """File names that tell vehicles by their names, each its own also where case does not count.

    Letters and digits of any language, spaces, `.`, `-` and `_` stay; all else becomes `_`. A name
    that is taken gets a number.
    """
    taken: set[str] = set()
    found = []
    for name in names:
        kept = "".join(each if each.isalnum() or each in " .-_" else "_" for each in name)
        kept = kept.encode()[:_LONGEST].decode(errors="ignore").strip(" .") or "vehicle"
        free, number = kept, 1
        while free.casefold() in taken:
            number += 1
            free = f"{kept}-{number}"
        taken.add(free.casefold())
        found.append(f"{free}{ending}")
    return found


def check_folder(path: Path, names: Iterable[str] | None = None) -> None:
    """See that a folder can be written.

    Args:
        path: where; what is there already is replaced if it is a folder without other files.
        names: of the files; if not given, what is in the folder is not looked at.

    Raises:
        ValueError: other files are in it.
        OSError: something else is there, or there is no folder to make it in, or none to write to.
    """
    with tempfile.TemporaryDirectory(dir=_beside(path), prefix=".drake_rho."):
        pass
    if not os.path.lexists(path):
        return
    if not path.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "not a folder", str(path))
    if names is not None and (others := {each.name for each in path.iterdir()} - set(names)):
        expected = "a folder that is new, empty, or has none but the files that are written"
        raise ValueError(f"path: got {str(path)!r} with {min(others)!r} in it, expected {expected}")


def write_folder(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a new folder beside, which then takes the place of `path`.

    Raises:
        ValueError: other files are there.
        OSError: it cannot be written, or something else is there.
    """
    check_folder(path, contents)
    path = Path(os.path.realpath(path))
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".drake_rho.") as beside:
        new, old = Path(beside, "new"), Path(beside, "old")
        new.mkdir()  # with the mode of any new folder, which a temporary one has not
        for name, content in contents.items():
            (new / name).write_bytes(content)
        if not path.exists():
            new.rename(path)
            return
        shutil.copymode(path, new)
        path.rename(old)
        try:
            new.rename(path)
        except BaseException:
            old.rename(path)
            raise


def write_archive(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into one archive (zip)."""
    with replacing(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), content, zipfile.ZIP_DEFLATED)


def _beside(path: Path) -> Path:
    """The folder that a path is in, links followed."""
    return Path(os.path.realpath(path)).parent
