"""Notebooks with their formulas as MathML, which browsers show without a script."""

from __future__ import annotations

import json
import re
from pathlib import Path

from latex2mathml.converter import convert

_FORMULA = re.compile(r"\$\$(.+?)\$\$|\$(.+?)\$", flags=re.DOTALL)


def write_with_mathml(notebook: Path, folder: Path) -> Path:
    """Write a copy of a notebook whose text has MathML in place of LaTeX.

    Args:
        notebook: file without outputs.
        folder: folder of the copy, `notebooks/NAME.ipynb`.

    Returns:
        The copy's path.
    """
    content = json.loads(notebook.read_text())
    for cell in content["cells"]:
        if cell["cell_type"] == "markdown":
            cell["source"] = with_mathml("".join(cell["source"]))
    copy = folder / "notebooks" / notebook.name
    copy.parent.mkdir(parents=True, exist_ok=True)
    copy.write_text(json.dumps(content))
    return copy


def with_mathml(text: str) -> str:
    """Return text with MathML in place of its LaTeX formulas, inline and displayed."""

    def formula(found: re.Match[str]) -> str:
        displayed, inline = found.groups()
        return _mathml(displayed, "block") if displayed else _mathml(inline, "inline")

    return _FORMULA.sub(formula, text)


def _mathml(latex: str, display: str) -> str:
    # `aligned` is known only by the name of its stand-alone environment
    known = latex.replace("{aligned}", "{align*}").replace(r"\tfrac", r"\frac")
    mathml: str = convert(known, display=display)
    return re.sub(
        r'columnalign="(left|right)"', r'style="text-align: \1"', mathml
    )  # as browsers do
