"""The documents are true: the README's code prints what it says, and what they name exists."""

from __future__ import annotations

import ast
import contextlib
import io
import re
from pathlib import Path

import pytest

import drake_rho as rho

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def _blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)


def test_the_readmes_code_prints_what_it_says() -> None:
    (code,), (expected,) = _blocks("python"), _blocks("text")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, {})  # noqa: S102  # the README's own
    assert printed.getvalue() == expected


def test_the_readmes_scenario_is_planned(tmp_path: Path) -> None:
    (text,) = _blocks("yaml")
    (tmp_path / "mission.yaml").write_text(text)
    scenario = rho.load_scenario(tmp_path / "mission.yaml")
    for plan in (rho.plan_scp(scenario), rho.plan_rho(scenario).plan):
        assert rho.verify(plan).ok


def _names(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
            if isinstance(node, ast.ClassDef):
                names |= {
                    f"{node.name}.{child.name}" for child in node.body if hasattr(child, "name")
                }
    return names


@pytest.mark.parametrize(
    "document",
    ["README.md", "CONTRIBUTING.md", "docs/paper.md", "docs/design.md", "docs/flight.md"],
)
def test_everything_a_document_points_to_exists(document: str) -> None:
    text = (ROOT / document).read_text()
    pointers = re.findall(r"`([\w/]+\.py)::([\w.]+)`", text)
    assert pointers or document != "docs/paper.md"
    for path, name in pointers:
        assert name in _names(ROOT / path), f"{path}::{name}"
    for link in re.findall(r"\]\(([^):#]+)\)", text):
        assert (ROOT / document).parent.joinpath(link).exists(), link


def test_every_public_name_exists_once() -> None:
    assert len(set(rho.__all__)) == len(rho.__all__)
    assert all(hasattr(rho, name) for name in rho.__all__)
