"""`Reader`: base class of files that `load_trajectories` reads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from drake_rho.motion.files import PlanFileError
from drake_rho.motion.polynomials import Polynomials
from drake_rho.scenario.errors import shorten, shortened
from drake_rho.system.files import reason_of

_LONGEST = 500
"""Largest number of characters of a reason, which may quote the file."""


class Reader:
    """Reader of trajectories in the files of a format."""

    name: ClassVar[str]
    """name of the format"""
    content: ClassVar[str]
    """description of what a file holds"""
    rated: ClassVar[bool] = True
    """whether the format holds samples at a rate"""
    read_by: ClassVar[str] = ""
    """how a file is read back; empty if it is not"""
    reads: ClassVar[str] = ""
    """files that `load_trajectories` reads, in words; empty for a format that is only written"""
    from_zero: ClassVar[bool] = False
    """whether times in files count from the beginning, and not on the scenario's clock"""
    tick: ClassVar[float] = 0.0
    """unit in which files count times [s]; 0 if they hold all digits"""

    def recognises(self, content: bytes) -> bool:
        """Return whether `read` understands files with this content."""
        return False

    def read(self, content: bytes, name: str) -> Mapping[str, Polynomials]:
        """Return the motions of vehicles, by name; of samples, straight lines between them.

        Args:
            content: content of a file that the format recognises.
            name: name of the file without its ending, for a vehicle that is not named in it.

        Raises:
            ValueError: the file is damaged; the message says where.
        """
        raise NotImplementedError

    def read_all(
        self, contents: Mapping[Path, bytes], topics: Mapping[str, str] | None
    ) -> Mapping[str, Polynomials]:
        """Return the motions of vehicles in one file, or in all those of a folder.

        Args:
            contents: contents of the files, each of which the format recognises.
            topics: topic or frame of each vehicle, for logs of ROS 2; None to find them.

        Raises:
            ValueError: a file is damaged, a vehicle is in two files, or topics were given for a
                format without any.
        """
        if topics is not None:
            raise ValueError(f"topics: got {len(topics)}, expected none with {self.reads}")
        motions = dict[str, Polynomials]()
        for file, content in contents.items():
            with naming(file):
                found = self.read(content, file.stem)
            if twice := found.keys() & motions.keys():
                raise PlanFileError(
                    f"{file}: got {shorten(min(twice))} again, expected each vehicle once"
                )
            motions |= found
        return motions


@contextmanager
def naming(file: Path) -> Iterator[None]:
    """Re-raise errors about the content of a file as errors that name it."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise PlanFileError(f"{file}: {shortened(reason_of(error), _LONGEST)}") from None
