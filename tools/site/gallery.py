"""The gallery's pictures, drawn by the code below them."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from tools.site.kept import hash_of_package

_SCENE = re.compile(
    r"!\[[^\]]*\]\(gallery/(?P<name>\w+)\.png\)(?:(?!\]\(gallery/).)*?^```python\n(?P<code>.*?)^```",
    flags=re.DOTALL | re.MULTILINE,
)


def scenes(page: Path) -> dict[str, str]:
    """Return the code of every scene of the gallery, by the name of its picture."""
    return {found["name"]: found["code"] for found in _SCENE.finditer(page.read_text())}


def draw_gallery(page: Path, folder: Path) -> list[Path]:
    """Run the code of every scene, which leaves its picture in `figure`, and write the pictures.

    Pictures are kept until their code or the package changes.

    Returns:
        Their paths, `gallery/NAME.png` in the folder, in the page's order.
    """
    drawn, package = list[Path](), hash_of_package()
    for name, code in scenes(page).items():
        path = folder / "gallery" / f"{name}.png"
        drawn.append(path)
        key, kept = hashlib.sha256(package + code.encode()).hexdigest(), path.with_suffix(".key")
        if path.exists() and kept.exists() and kept.read_text() == key:
            continue
        left: dict[str, object] = {}
        # the code is that of the page
        exec(compile(code, f"{page.name}: {name}", "exec"), left)  # noqa: S102
        path.parent.mkdir(parents=True, exist_ok=True)
        left["figure"].savefig(path, dpi=220)  # type: ignore[attr-defined]  # matplotlib's
        kept.write_text(key)
    return drawn


def as_grid(html: str) -> str:
    """Return the gallery's HTML with every scene in a cell of a grid, its code folded."""
    intro, *parts = re.split(r"(?=<h2 )", html)
    cells = []
    for part in parts:
        text, code = re.split(r"(?=<div class=\"[^\"]*highlight)", part, maxsplit=1)
        folded = f"<details><summary>Code</summary>{code}</details>"
        cells.append(f"<section>{text}{folded}</section>")
    return f'{intro}<div class="gallery">{"".join(cells)}</div>'
