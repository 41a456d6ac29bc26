"""Notebooks for the site: formulas as MathML, which needs no script, and links to its pages."""

from __future__ import annotations

import json
import re
from pathlib import Path

from tools.site.mathml import with_mathml

_LINK = re.compile(r"\]\((?:(\.\./)docs/)?([\w/]+)\.(?:ipynb|md)\)")
"""Link to a notebook in the same folder, or to a page of docs/, which the site has one up."""


def write_with_mathml(notebook: Path, folder: Path) -> Path:
    """Write a copy of a notebook whose text has MathML in place of LaTeX, and links of the site.

    Args:
        notebook: file without outputs.
        folder: folder of the copy, `notebooks/NAME.ipynb`.

    Returns:
        The copy's path.
    """
    content = json.loads(notebook.read_text())
    for cell in content["cells"]:
        if cell["cell_type"] == "markdown":
            text = _LINK.sub(r"](\1\2.html)", "".join(cell["source"]))
            cell["source"] = with_mathml(text)
    copy = folder / "notebooks" / notebook.name
    copy.parent.mkdir(parents=True, exist_ok=True)
    copy.write_text(json.dumps(content))
    return copy


def quiet_kernels(folder: Path) -> Path:
    """Write IPython's settings under which kernels log errors only, and return their folder.

    A kernel warns that its connection, to this machine alone, is not encrypted.
    """
    settings = folder / "profile_default" / "ipython_kernel_config.py"
    settings.parent.mkdir(parents=True, exist_ok=True)
    settings.write_text('get_config().IPKernelApp.log_level = "ERROR"\n')
    return folder
