"""Notebooks with their formulas as MathML, which browsers show without a script."""

from __future__ import annotations

import json
from pathlib import Path

from tools.site.mathml import with_mathml


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


def quiet_kernels(folder: Path) -> Path:
    """Write IPython's settings under which kernels log errors only, and return their folder.

    A kernel warns that its connection, to this machine alone, is not encrypted.
    """
    settings = folder / "profile_default" / "ipython_kernel_config.py"
    settings.parent.mkdir(parents=True, exist_ok=True)
    settings.write_text('get_config().IPKernelApp.log_level = "ERROR"\n')
    return folder
