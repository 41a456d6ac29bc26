"""The blocks of a page of the documentation, and running them as a reader would."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_FENCE = re.compile(
    r"^```(?P<language>\w+)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<text>.*?)^```$",
    flags=re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    """as `python`, `sh`, `yaml`, or `text` for what the block before prints"""
    title: str | None
    """the file that it is, if it is one"""
    text: str
    """what stands in it"""


def blocks(page: Path) -> Iterator[Block]:
    """The blocks of a page, in order."""
    for found in _FENCE.finditer(page.read_text()):
        yield Block(found["language"], found["title"], found["text"])


def follow(page: Path) -> None:
    """Do in the current folder what a page says, from top to bottom.

    Files are written, code is run, each block by itself, and commands are given. Raises what they
    raise, and an AssertionError where a block does not print what stands below it.
    """
    printed = ""
    for block in blocks(page):
        if block.title is not None:
            Path(block.title).write_text(block.text)
        elif block.language == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(block.text, page.name, "exec"), {})  # noqa: S102  # the page's own
            printed = out.getvalue()
        elif block.language == "text":
            assert printed == block.text
        elif block.language == "sh":
            for line in block.text.splitlines():
                _command(line)


def _command(line: str) -> None:
    words = shlex.split(line, comments=True)
    assert words[0] == "drake-rho", line
    done = subprocess.run(
        [sys.executable, "-m", "drake_rho", *words[1:]], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
