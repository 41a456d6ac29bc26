"""Notebooks for the site: their outputs, formulas as MathML, and links to its pages.

Outputs depend on a notebook, on the package and on the versions of others. They are kept by a hash
of these, so that only a change of one of them makes a notebook run again.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from tools.site.kept import hash_of_package
from tools.site.mathml import with_mathml

_LINK = re.compile(r"\]\((?:(\.\./)docs/)?([\w/]+)\.(?:ipynb|md)\)")
"""Link to a notebook in the same folder, or to a page of docs/, which the site has one up."""


def write_notebooks(notebooks: Sequence[Path], folder: Path) -> list[Path]:
    """Write copies of notebooks with their outputs, as `write_with_mathml` does, side by side.

    Args:
        notebooks: files without outputs.
        folder: folder of the copies, and of outputs that are kept.

    Returns:
        The copies' paths.

    Raises:
        CalledProcessError: a notebook fails; its error is printed.
    """
    package = hash_of_package()
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        run = partial(_with_outputs, folder=folder / "outputs", package=package)
        done = list(threads.map(run, notebooks))
    kept = {path.name for path in done}
    for path in (folder / "outputs").iterdir():
        if path.name not in kept:
            path.unlink()
    names = [path.name for path in notebooks]
    return [write_with_mathml(path, folder, name) for path, name in zip(done, names, strict=True)]


def _with_outputs(notebook: Path, *, folder: Path, package: bytes) -> Path:
    """Return the path of a notebook with its outputs, which is run unless it is there already."""
    key = hashlib.sha256(package + notebook.read_bytes()).hexdigest()
    path = folder / f"{key}.ipynb"
    if not path.exists():
        words = ["nbconvert", "--to", "notebook", "--execute", "--log-level", "ERROR"]
        place = ["--output-dir", str(folder), "--output", path.with_suffix(".part").name]
        call = [sys.executable, "-m", *words, *place, str(notebook)]
        subprocess.run(call, check=True)  # noqa: S603  # of this repository
        path.with_suffix(".part.ipynb").replace(path)
    return path


def write_with_mathml(notebook: Path, folder: Path, name: str | None = None) -> Path:
    """Write a copy of a notebook whose text has MathML in place of LaTeX, and links of the site.

    Args:
        notebook: file, with or without outputs.
        folder: folder of the copy, `notebooks/NAME.ipynb`.
        name: name of the copy; that of the file if not given.

    Returns:
        The copy's path.
    """
    content = json.loads(notebook.read_text())
    for cell in content["cells"]:
        if cell["cell_type"] == "markdown":
            text = _LINK.sub(r"](\1\2.html)", "".join(cell["source"]))
            cell["source"] = with_mathml(text)
    copy = folder / "notebooks" / (name or notebook.name)
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
