"""Standard output and error, whose reader may leave before the command does."""

from __future__ import annotations

import io
import os
from typing import TextIO


class _Stream(io.FileIO):
    """A stream that ends the command, without a word, once nobody reads it any more.

    Noticed here it is the same whoever writes; rich and typer would make status 1 of it, which is
    that of broken constraints.
    """

    def write(self, data: object) -> int:
        try:
            return super().write(data)  # type: ignore[arg-type]  # any buffer
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())  # what is left to write
            if isinstance(error, BrokenPipeError):
                raise SystemExit(141) from None
            raise


def pipe_safe(stream: TextIO) -> TextIO:
    """The stream for a reader that may leave and a terminal that may lack some signs.

    What is none of the system's, as in a test, or closed (None), is returned as it is.
    """
    buffer = getattr(stream, "buffer", None)
    if not isinstance(getattr(buffer, "raw", buffer), io.FileIO):
        return stream
    return io.TextIOWrapper(
        io.BufferedWriter(_Stream(stream.fileno(), "w", closefd=False)),
        encoding=stream.encoding,
        errors="replace",
        line_buffering=True,
    )
