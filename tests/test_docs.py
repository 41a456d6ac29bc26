"""The documents are true: the README's code prints what it says, and what they name exists."""

from __future__ import annotations

import ast
import contextlib
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
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


def test_the_diagram_of_ones_own_in_the_documents_flies() -> None:
    text = (ROOT / "docs" / "flight.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    (code,) = (block for block in blocks if "DiagramBuilder" in block)
    found: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, found)  # noqa: S102  # the document's own
    scenario, states = found["scenario"], found["states"].T.reshape(-1, 4, 6)
    assert len(found["controller"].flight.windows) == len(rho.plan_rho(scenario).windows)
    missed = np.linalg.norm(states[-1, :, :3] - scenario.fleet.goal_positions, axis=1)
    assert np.all(missed > 0.0)
    assert np.all(missed <= rho.error_tube(scenario).position(scenario.grid.end))


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


DOCUMENTS = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
DOCUMENTS += [page.relative_to(ROOT).as_posix() for page in sorted(ROOT.glob("docs/**/*.md"))]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_everything_a_document_points_to_exists(document: str) -> None:
    text = (ROOT / document).read_text()
    pointers = re.findall(r"`([\w/]+\.py)::([\w.]+)`", text)
    assert pointers or document != "docs/paper.md"
    for path, name in pointers:
        assert name in _names(ROOT / path), f"{path}::{name}"
    for link in re.findall(r"\]\(([^):#]+)\)", text):
        if link.startswith("gallery/"):  # pictures that are drawn when the site is built
            continue
        assert (ROOT / document).parent.joinpath(link).exists(), link


def test_every_public_name_exists_once() -> None:
    assert len(set(rho.__all__)) == len(rho.__all__)
    assert all(hasattr(rho, name) for name in rho.__all__)
