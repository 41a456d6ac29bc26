"""Notebooks contain no code of their own; nbmake, which collects them as tests, runs them.

Cells with the tag `check` assert what the other cells show; the site is built without them. The
first tutorial has none: `test_start_here.py` checks it.
"""

from __future__ import annotations

import ast
import html
import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.scenarios import slow

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
BUILDS = "what builds the site is installed by make docs and make lint"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_has_no_definitions_no_plotting_and_no_outputs(path: Path) -> None:
    cells = json.loads(path.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    for cell in code:
        assert cell["outputs"] == []
        assert cell["execution_count"] is None
        lines = [line for line in cell["source"] if not line.startswith("%")]
        for node in ast.walk(ast.parse("".join(lines))):
            assert not isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Lambda)
            if isinstance(node, ast.Import | ast.ImportFrom):
                assert "matplotlib" not in ast.unparse(node)
    if path.stem.startswith("example"):
        text = "".join("".join(cell["source"]) for cell in cells)
        number = int(path.stem[-1])
        for figure in range(4 * number - 1, 4 * number + 3):
            assert f"**Fig. {figure}**" in text
        assert "assert rho.verify" in text
        assert text.count("_figure(") == 4


def test_there_is_a_notebook_for_every_example() -> None:
    names = {path.stem for path in NOTEBOOKS}
    assert {"start_here", "example_1", "example_2", "example_3", "example_4"} <= names
    assert {"fleet", "flight", "maps", "online", "program", "time", "trust", "world"} <= names
    assert "referee" in names


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_only_cells_with_the_tag_check_assert(path: Path) -> None:
    shown, checks = _code(path, check=False), _code(path, check=True)
    assert bool(checks) == (path.stem != "start_here")
    for tree in checks:
        assert any(isinstance(node, ast.Assert) for node in ast.walk(tree))
        assert not any(isinstance(node, ast.Import | ast.ImportFrom) for node in ast.walk(tree))
    for tree in shown:
        assert not any(isinstance(node, ast.Assert) for node in ast.walk(tree))
    cells = json.loads(path.read_text())["cells"]
    hidden = [each["metadata"].get("jupyter") == {"source_hidden": True} for each in cells]
    assert hidden == [_is_check(each) for each in cells]  # folded in JupyterLab


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_other_cell_depends_on_a_check(path: Path) -> None:
    shown, checks = _code(path, check=False), _code(path, check=True)
    of_checks_only = _names(checks, ast.Store) - _names(shown, ast.Store)
    assert not of_checks_only & _names(shown, ast.Load)


@pytest.mark.parametrize(
    "path",
    [one for each in NOTEBOOKS for one in ([each] if each.stem == "fleet" else slow(each))],
    ids=lambda path: path.stem,
)
def test_the_site_shows_no_checks(path: Path, tmp_path: Path) -> None:
    convert = pytest.importorskip("mkdocs_jupyter.convert", reason=BUILDS)
    made = pytest.importorskip("tools.site.notebooks", reason=BUILDS).write_with_mathml
    copy = str(made(path, tmp_path))
    options = _site_options()["remove_tag_config"]
    page = convert.nb2html(copy, execute=False, remove_tag_config=options)
    code = [cell for cell in _cells(path) if cell["cell_type"] == "code"]
    assert _sources(page) == ["".join(cell["source"]) for cell in code if not _is_check(cell)]
    everything = convert.nb2html(copy, execute=False)
    assert _sources(everything) == ["".join(cell["source"]) for cell in code]


def _cells(path: Path) -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads(path.read_text())["cells"]
    return cells


def _is_check(cell: dict[str, Any]) -> bool:
    return "check" in cell["metadata"].get("tags", [])


def _code(path: Path, *, check: bool) -> list[ast.Module]:
    """Return the syntax trees of a notebook's code cells, of checks or of all others."""
    return [
        ast.parse("".join(line for line in cell["source"] if not line.startswith("%")))
        for cell in _cells(path)
        if cell["cell_type"] == "code" and _is_check(cell) == check
    ]


def _names(trees: list[ast.Module], use: type[ast.expr_context]) -> set[str]:
    """Return the names that cells assign (`Store`) or use (`Load`)."""
    nodes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Name)]
    return {node.id for node in nodes if isinstance(node.ctx, use)}


def _sources(page: str) -> list[str]:
    """Return the code of a rendered notebook's cells."""
    found = re.findall(r'class="clipboard-copy-txt"[^>]*>(.*?)</div>', page, flags=re.DOTALL)
    return [html.unescape(each) for each in found]


def _site_options() -> dict[str, Any]:
    """Return the options of mkdocs-jupyter by which the site is built."""
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    (options,) = (each["mkdocs-jupyter"] for each in config["plugins"] if "mkdocs-jupyter" in each)
    return dict(options)
