"""The fenced blocks of the documentation, and a runner that follows them as a reader would."""

from __future__ import annotations

import ast
import contextlib
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from json import loads
from pathlib import Path
from typing import Any
from unittest.mock import patch

import yaml

import drake_rho as rho
from drake_rho import cli

ROOT = Path(__file__).parent.parent

_FENCE = re.compile(
    r"^```(?P<language>\w*)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<text>.*?)^```$",
    flags=re.DOTALL | re.MULTILINE,
)

NOT_RUN = ("", "console", "xml")
"""Languages of blocks that are not run: drawings, installation (needs a network), files."""


@dataclass(frozen=True)
class Block:
    """Fenced block of a page."""

    language: str
    """`python`, `sh`, `yaml`, or `text` for the output of the block before"""
    title: str | None
    """name of the file that the block shows, if any"""
    text: str
    """content of the block"""


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page, in order."""
    for found in _FENCE.finditer(page.read_text()):
        yield Block(found["language"], found["title"], found["text"])


def calls(page: Path) -> Iterator[ast.Call]:
    """Yield the calls of this package in a page's text outside blocks, as `rho.plan(scenario)`.

    Arguments may be left out, as in `rho.plan(progress=)`.
    """
    text = _FENCE.sub("", page.read_text())
    for span in re.findall(r"`(rho\.[^`]+\([^`]*\))`", text):
        code = re.sub(r"=(?=[,)])", "=...", " ".join(span.split()))
        yield from (node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call))


def follow(page: Path, shorter: Mapping[str, str]) -> None:
    """Follow a page from top to bottom in the current folder.

    Files are written, each block of code is run by itself, commands are executed, and pieces of
    YAML are completed to a scenario or read as a study. Errors of all of these are passed on; an
    AssertionError is raised where a block does not print the text below it, or its language is
    unknown.

    Args:
        page: Markdown file.
        shorter: replacements of words, so that long work takes seconds.
    """
    printed = ""
    with contextlib.ExitStack() as background, _unwatched():
        for block in blocks(page):
            text = _in_place(block.text, shorter)
            if block.title is not None:
                Path(block.title).write_text(text)
            if block.language == "python":
                printed = _run(text, page.name)
            elif block.language == "sh":
                for line in text.splitlines():
                    printed = _line(line, shorter, background)
            elif block.language == "yaml":
                _read(text)
            elif block.language == "text":
                assert _matches(printed, text), f"{page}: got\n{printed}expected\n{text}"
            else:
                assert block.language in NOT_RUN, f"{page}: a block of {block.language!r}"


def _matches(printed: str, text: str) -> bool:
    """Return whether the output matches a text in which a line `...` stands for any lines."""
    lines = "".join(f"{line.rstrip()}\n" for line in printed.splitlines())
    pieces = [re.escape(piece) for piece in re.split(r"^\.\.\.\n", text, flags=re.MULTILINE)]
    return re.fullmatch(r"(?:.*\n)*".join(pieces), lines) is not None


def _run(code: str, name: str) -> str:
    """Run some code and return what it prints; it may import files of the current folder."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), patch.object(sys, "path", [str(Path.cwd()), *sys.path]):
        exec(compile(code, name, "exec"), {"__name__": "__main__"})  # noqa: S102  # of the page
    return out.getvalue()


def _read(text: str) -> None:
    """Read a study, a scenario, or a part of a scenario."""
    content = yaml.safe_load(text)
    if "methods" in content:
        rho.Study(**content)
        return
    whole: dict[str, Any] = {
        "name": "a part",
        "grid": {"step": 0.25, "knots": 41},
        "vehicles": [
            {"name": "v", "start": {"position": [0, 0, 1]}, "goal": {"position": [1, 0, 1]}}
        ],
    }
    assert rho.verify(rho.plan(rho.Scenario(**(whole | content)))).ok


def _in_place(text: str, shorter: Mapping[str, str]) -> str:
    """Return the text with long work replaced by shorter work."""
    for long, short in shorter.items():
        text = text.replace(long, short)
    return text


def _line(line: str, shorter: Mapping[str, str], background: contextlib.ExitStack) -> str:
    """Run the commands of a line, and return the output of the last one.

    Commands may be joined by `&&`; output may go to a file by `>`, or be inspected by `| jq .path`.
    Commands of `make` are only checked to exist, and servers run in the background until the page
    ends.
    """
    printed = ""
    for command in " ".join(_tokens(line)).split(" && "):
        before, _, file = command.partition(" > ")
        words, _, query = before.partition(" | jq .")
        given = shlex.split(words)
        if given[0] == "drake-rho":
            printed = _drake_rho(line, given)
        elif given[0] == "make":
            looked_at = ["make", "--dry-run", *given[1:]]
            subprocess.run(looked_at, cwd=ROOT, check=True, capture_output=True)
        elif given[0] == "dask":
            serving = subprocess.Popen([sys.executable, "-m", "dask", *given[1:]])
            background.callback(serving.wait)
            background.callback(serving.kill)
        else:
            raise AssertionError(f"unknown command: {line}")
        if file:
            Path(file).write_text(_in_place(printed, shorter))
        if query:
            found = loads(printed)
            for name in query.split("."):
                found = found[name]
    return printed


def _tokens(line: str) -> list[str]:
    """Split a line into words, quoted where necessary, without its comment."""
    marks = ("&&", ">", "|")
    words = shlex.split(line, comments=True)
    return [word if word in marks else shlex.quote(word) for word in words]


def _drake_rho(line: str, words: list[str]) -> str:
    """Run a `drake-rho` command in this process, and return what it prints."""
    out, err = io.StringIO(), io.StringIO()
    with (
        patch.object(sys, "argv", words),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            cli.main()
            status: object = 0
        except SystemExit as left:
            status = left.code
    assert status == 0, f"{line}\n{out.getvalue()}{err.getvalue()}"
    return out.getvalue()


@contextlib.contextmanager
def _unwatched() -> Iterator[None]:
    """Let servers start with nobody watching and end at once."""
    with (
        patch("drake_rho.cli.commands.on_interrupt", lambda: lambda: None),
        patch("webbrowser.open", lambda url: True),
    ):
        yield
