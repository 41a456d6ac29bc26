"""Notebooks contain no code of their own; nbmake, which collects them as tests, runs them."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))


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
    assert {"fleet", "flight", "trust", "world"} <= names
