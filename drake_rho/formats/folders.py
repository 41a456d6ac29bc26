"""Folders and archives with a file for each vehicle, written completely or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from drake_rho.system.files import atomic_write
from drake_rho.system.folders import exchanged

_LONGEST = 200
"""Largest number of bytes of a name before its ending; most file systems allow 255 in all."""
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Time of all files in an archive, fixed so that equal contents give equal archives."""


def file_names(names: Iterable[str], ending: str) -> list[str]:
    """Return file names from vehicles' names, distinct even where case does not count.

    Letters and digits of any language, spaces, `.`, `-` and `_` stay; all else becomes `_`. A
    repeated name gets a number.
    """
    taken: set[str] = set()
    found = []
    for name in names:
        stem = "".join(each if each.isalnum() or each in " .-_" else "_" for each in name)
        stem = stem.encode()[:_LONGEST].decode(errors="ignore").strip(" .") or "vehicle"
        free, number = stem, 1
        while free.casefold() in taken:
            number += 1
            free = f"{stem}-{number}"
        taken.add(free.casefold())
        found.append(f"{free}{ending}")
    return found


def check_folder(path: Path, names: Iterable[str] | None = None) -> None:
    """Check that a folder can be written.

    Args:
        path: path of the folder; an existing one is replaced if it holds no other files.
        names: names of the files to write; if not given, the folder's contents are not checked.

    Raises:
        ValueError: the folder holds other files.
        OSError: the path is not a folder, or its parent does not exist or is not writable.
    """
    with tempfile.TemporaryDirectory(dir=_beside(path), prefix=".drake_rho."):
        pass
    if not os.path.lexists(path):
        return
    if not path.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "not a folder", str(path))
    if names is not None and (others := {each.name for each in path.iterdir()} - set(names)):
        expected = "a folder that is new, empty, or holds no other files than those to be written"
        raise ValueError(f"path: got {str(path)!r} with {min(others)!r} in it, expected {expected}")


def write_folder(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a new folder beside `path`, which then replaces `path` in one step.

    If the file system cannot exchange two folders, there is an instant without a folder at `path`.

    Raises:
        ValueError: the folder at `path` holds other files.
        OSError: the path is not a folder or cannot be written.
    """
    check_folder(path, contents)
    path = Path(os.path.realpath(path))
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".drake_rho.") as beside:
        new, old = Path(beside, "new"), Path(beside, "old")
        new.mkdir()  # with the default mode, which a temporary folder does not have
        for name, content in contents.items():
            (new / name).write_bytes(content)
        if not path.exists():
            new.rename(path)
            return
        shutil.copymode(path, new)
        if exchanged(path, new):
            return
        path.rename(old)
        try:
            new.rename(path)
        except BaseException:
            old.rename(path)
            raise


def write_each(
    path: Path, names: Iterable[str], ending: str, contents: Iterable[bytes]
) -> list[Path]:
    """Write the file of the only vehicle, or a folder with a file for each; return their paths.

    Raises:
        ValueError: several vehicles are to be in one file.
    """
    files = dict(zip(file_names(names, ending), contents, strict=True))
    if path.suffix.lower() != ending:
        write_folder(path, files)
        return [path / name for name in files]
    if len(files) > 1:
        expected = "a folder, with format=: a file holds one vehicle"
        raise ValueError(f"path: got {str(path)!r} for {len(files)} vehicles, expected {expected}")
    with atomic_write(path) as file:
        file.writelines(files.values())
    return [path]


def write_archive(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into one archive (zip)."""
    with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), content, zipfile.ZIP_DEFLATED)


def _beside(path: Path) -> Path:
    """Return the folder that contains a path, with links resolved."""
    return Path(os.path.realpath(path)).parent
