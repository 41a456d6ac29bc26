"""Standard output and error for readers that may close a pipe before the command ends."""

from __future__ import annotations

import io
import os
from typing import TextIO


class _Stream(io.FileIO):
    """Stream that ends the command silently, with status 141, once its pipe is closed.

    The closed pipe is handled here for every writer. rich and typer would exit with status 1, which
    means that constraints are violated.
    """

    def write(self, data: object) -> int:
        try:
            return super().write(data)  # type: ignore[arg-type]  # any buffer
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())  # absorbs the remaining output
            if isinstance(error, BrokenPipeError):
                raise SystemExit(141) from None
            raise


def pipe_safe(stream: TextIO) -> TextIO:
    """Return a stream that tolerates a closed pipe and a terminal that lacks some characters.

    A stream that is not the system's, as in a test, or closed (None), is returned unchanged.
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
