"""MkDocs hooks: pages from elsewhere in the repository, and their links.

Links are written for the repository, where they work in any editor. In the site a file of the
repository is where `PLACES` puts it; a link to one that is not in the site becomes its text.
"""

from __future__ import annotations

import os
import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from drake_rho import __version__
from tools.publishing import addresses
from tools.site.gallery import as_grid, draw_gallery
from tools.site.mathml import with_mathml
from tools.site.notebooks import quiet_kernels, write_notebooks

ROOT = Path(__file__).parents[2]
MADE = ROOT / "build" / "site"
PLACES = {
    "docs": "",
    "figures": "figures",
    "notebooks": "notebooks",
    "benchmarks/results": "results",
    "CHANGELOG.md": "changelog.md",
}
"""Site folder or file for each folder or file of the repository."""

BOOSTS = {"guides/": 4.0, "glossary.md": 2.0, "api/": 0.5, "results/": 0.02, "changelog.md": 0.2}
"""Weights of pages in the search: tasks come before references, and these before tables."""

_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
_LABEL_AND_NUMBER = re.compile(
    r"(TokenSet\.prototype\.toString=function\(\)\{[^}]*?\w\+\w\.id)(?=\})"
)
_CELL = re.compile(r'<div class="highlight-ipynb[^>]*"')
_SCRIPT_FROM_ELSEWHERE = re.compile(r'<script[^>]*\bsrc="(?:https?:[^"]*)?"[^>]*></script>')


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Set version and addresses; omit the page for missing pages, whose links need a server."""
    known = addresses()
    config.repo_url, config.site_url = known.get("repository"), known.get("site")
    config.copyright = f"{config.site_name} {__version__}, {config.copyright}"
    config.theme.static_templates.discard("404.html")
    os.environ["IPYTHONDIR"] = str(quiet_kernels(MADE / "ipython"))
    return config


@event_priority(100)  # before mkdocs-jupyter, which turns notebooks into pages
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add files outside docs/: figures, notebooks, results and the gallery's pictures."""
    found = [ROOT / "CHANGELOG.md", *(ROOT / "figures").iterdir()]
    results = sorted((ROOT / "benchmarks" / "results").glob("*.md"))
    for path in [*found, *results]:
        place = site_path(path.relative_to(ROOT).as_posix())
        files.append(File.generated(config, place or path.name, abs_src_path=str(path)))
    files.append(File.generated(config, "results/index.md", content=_contents(results)))
    made = []
    if "mkdocs-jupyter" in config.plugins:
        made += write_notebooks(sorted((ROOT / "notebooks").glob("*.ipynb")), MADE)
    made += draw_gallery(ROOT / "docs" / "gallery.md", MADE)
    for path in made:
        place = path.relative_to(MADE).as_posix()
        files.append(File(place, str(MADE), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Return the page's Markdown with the links of the site, and formulas as MathML."""
    here = page.file.src_uri
    boosts = [boost for place, boost in BOOSTS.items() if here.startswith(place)]
    page.meta["search"] = {"boost": boosts[0] if boosts else 1.0}
    if here.endswith(".ipynb"):  # `write_with_mathml` has done it, and outputs stay as they are
        return markdown
    source = repository_path(here)

    def link(found: re.Match[str]) -> str:
        text, target = found.groups()
        path, _, anchor = target.partition("#")
        if ":" in target or not path:
            return found.group()
        wanted = site_path(posixpath.normpath(posixpath.join(posixpath.dirname(source), path)))
        if wanted is None:
            return f"`{text}`" if text.endswith(".py") else text
        relative = posixpath.relpath(wanted, posixpath.dirname(here) or ".")
        return f"[{text}]({relative}{'#' + anchor if anchor else ''})"

    return _LINK.sub(link, with_mathml(markdown))


def on_page_content(html: str, page: Page, **_: object) -> str:
    """Return the gallery's page as a grid of scenes; other pages are returned as they are."""
    return as_grid(html) if page.file.src_uri == "gallery.md" else html


def on_post_page(output: str, **_: object) -> str:
    """Return the page without external scripts, and with what keyboards and screen readers need.

    Formulas are MathML, so nothing is requested. The code of a cell can be reached by the keyboard,
    which scrolls it, as the theme does for other code, and the search has a name.
    """
    output = _SCRIPT_FROM_ELSEWHERE.sub("", output)
    output = _CELL.sub(r'\g<0> tabindex="0"', output)
    return output.replace('role="dialog"', 'role="dialog" aria-label="Search"', 1)


def on_post_build(config: MkDocsConfig) -> None:
    """End numbers of nodes with a comma where the search names nodes of its tree of words.

    Without it a letter that is a digit runs into the number beside it, two nodes have one name,
    and words that begin with some digit find nothing (olivernn/lunr.js#503).
    """
    for path in (Path(config.site_dir) / "assets/javascripts/workers").glob("search.*.js"):
        path.write_text(_LABEL_AND_NUMBER.sub(r'\1+","', path.read_text()))


def site_path(path: str) -> str | None:
    """Return the place of a file of the repository in the site, or None."""
    for folder, place in PLACES.items():
        if path == folder and "." not in folder:
            return posixpath.join(place, "index.md")
        if path == folder:
            return place
        if path.startswith(folder + "/"):
            return posixpath.join(place, path.removeprefix(folder + "/"))
    return None


def repository_path(place: str) -> str:
    """Return the file of the repository at a place in the site: the inverse of `site_path`."""
    folders = {where: folder for folder, where in PLACES.items() if where}
    if place in folders:
        return folders[place]
    first, _, rest = place.partition("/")
    return f"{folders[first]}/{rest}" if rest and first in folders else f"docs/{place}"


def _contents(results: list[Path]) -> str:
    """Return a page that lists the tables of benchmarks."""
    titles = [path.read_text().partition("\n")[0].lstrip("# ") for path in results]
    lines = [f"- [{title}]({path.name})" for title, path in zip(titles, results, strict=True)]
    return "\n".join(["# What benchmarks measured", "", *lines, ""])
