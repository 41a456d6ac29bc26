"""The documentation site: its code runs, its API is complete, and its links work."""

from __future__ import annotations

import json
import re
import subprocess
import tomllib
from pathlib import Path
from typing import ClassVar

import pytest
import yaml

import drake_rho as rho
from tests.guides import blocks
from tools.site.gallery import draw_gallery, scenes
from tools.site.links import broken_links

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
BUILDS = "what builds the site is installed by make docs and make lint"
GUIDES = sorted([DOCS / "quick_start.md", *(DOCS / "guides").glob("*.md")])
WIDTH = 87
"""Characters of code that fit into the column of a page."""
TASKS = 40
"""Tasks of a newcomer, each with code to copy."""


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.stem)
def test_code_to_copy_is_short(page: Path) -> None:
    for block in blocks(page):
        if block.language == "python":
            assert len(block.text.splitlines()) < 15, block.text
        if block.language in ("python", "yaml", "sh"):
            assert max(map(len, block.text.splitlines())) <= WIDTH, block.text


def test_every_task_leads_to_code_or_a_command() -> None:
    text = (DOCS / "guides" / "index.md").read_text()
    tasks = re.findall(r"^\| .*\]\((\w+\.md)(?:#[\w-]+)?\) \|$", text, flags=re.MULTILINE)
    assert len(tasks) == TASKS
    for page in tasks:
        languages = {block.language for block in blocks(DOCS / "guides" / page)}
        assert languages & {"python", "sh"}, page


def test_the_gallery_has_scenes_of_every_kind() -> None:
    text = (DOCS / "gallery.md").read_text()
    films = text.count(".gif)")
    assert films == 2
    drawn = len(scenes(DOCS / "gallery.md"))
    assert drawn + films == text.count("## ") == text.count("![") >= 10


@pytest.mark.slow  # make docs draws them too
@pytest.mark.parametrize("name", scenes(DOCS / "gallery.md"))
def test_a_scene_of_the_gallery_is_planned_and_drawn(name: str) -> None:
    found: dict[str, object] = {}
    exec(scenes(DOCS / "gallery.md")[name], found)  # noqa: S102  # of the page
    figure = found["figure"]
    assert figure.axes  # type: ignore[attr-defined]  # matplotlib's


def test_every_public_name_is_in_the_api_once() -> None:
    pages = [page.read_text() for page in (DOCS / "api").glob("*.md")]
    named = re.findall(r"^::: drake_rho\.(\w+)$", "\n".join(pages), flags=re.MULTILINE)
    assert sorted(named) == sorted(rho.__all__)
    listed = re.findall(r"\]\[drake_rho\.(\w+)\]", (DOCS / "api" / "index.md").read_text())
    assert sorted(listed) == sorted(rho.__all__)


def test_every_page_is_in_the_navigation() -> None:
    text = (ROOT / "mkdocs.yml").read_text()
    listed = set(re.findall(r"([\w/]+\.(?:md|ipynb))$", text, flags=re.MULTILINE))
    pages = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")}
    notebooks = {f"notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert listed == pages | notebooks | {"changelog.md"}


def test_links_to_the_repository_become_links_of_the_site() -> None:
    class File:
        src_uri = "guides/fleet.md"

    class Page:
        file = File()
        meta: ClassVar[dict[str, object]] = {}

    hooks = pytest.importorskip("tools.site.hooks", reason=BUILDS)

    def there(text: str) -> str:
        return str(hooks.on_page_markdown(text, Page()))

    assert there("[a](../../figures/fig03.png)") == "[a](../figures/fig03.png)"
    assert there("![a](../../figures/fig03.png)") == "![a](../figures/fig03.png)"
    assert there("[b](../../benchmarks/results)") == "[b](../results/index.md)"
    assert there("[b](../fleets.md#how)") == "[b](../fleets.md#how)"
    assert there("[c](../../CHANGELOG.md)") == "[c](../changelog.md)"
    assert there("[plan.py](../../drake_rho/motion/plan.py)") == "`plan.py`"
    assert there("[d](https://drake.mit.edu) [e](#here)") == "[d](https://drake.mit.edu) [e](#here)"
    for path in ("docs/api/index.md", "CHANGELOG.md", "benchmarks/results/world_b6.md"):
        assert hooks.repository_path(str(hooks.site_path(path))) == path


def test_a_picture_is_drawn_again_only_if_its_code_has_changed(tmp_path: Path) -> None:
    page, count = tmp_path / "page.md", tmp_path / "count"
    written = f"with open({str(count)!r}, 'a') as file: file.write('x')"
    code = f"from matplotlib.figure import Figure\n{written}\nfigure = Figure()"
    for source, runs in ((code, 1), (code, 1), (f"{code}  # changed", 2)):
        page.write_text(f"## One\n\n![one](gallery/one.png)\n\n```python\n{source}\n```\n")
        assert draw_gallery(page, tmp_path / "made") == [tmp_path / "made" / "gallery" / "one.png"]
        assert len(count.read_text()) == runs


@pytest.mark.slow
def test_a_notebook_runs_again_only_if_it_has_changed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write = pytest.importorskip("tools.site.notebooks", reason=BUILDS).write_notebooks
    notebook, count = tmp_path / "count.ipynb", tmp_path / "count"
    code = f"n = open({str(count)!r}, 'a').write('x'); print('ran')"
    cell: dict[str, object] = {
        "cell_type": "code",
        "id": "a",
        "metadata": {},
        "outputs": [],
        "execution_count": None,
    }
    whole = {"metadata": {}, "nbformat": 4, "nbformat_minor": 5}
    for source, runs in ((code, 1), (code, 1), (f"{code}  # changed", 2)):
        notebook.write_text(json.dumps(whole | {"cells": [cell | {"source": source}]}))
        (copy,) = write([notebook], tmp_path / "made")
        assert copy == tmp_path / "made" / "notebooks" / "count.ipynb"
        assert len(count.read_text()) == runs
        (output,) = json.loads(copy.read_text())["cells"][0]["outputs"]
        assert "".join(output["text"]) == "ran\n"
        assert len(list((tmp_path / "made" / "outputs").iterdir())) == 1  # older ones are gone
    notebook.write_text(json.dumps(whole | {"cells": [cell | {"source": "1 / 0"}]}))
    with pytest.raises(subprocess.CalledProcessError):
        write([notebook], tmp_path / "made")
    assert "ZeroDivisionError" in capfd.readouterr().err


def test_links_of_notebooks_become_links_of_pages(tmp_path: Path) -> None:
    made = pytest.importorskip("tools.site.notebooks", reason=BUILDS).write_with_mathml
    notebook = ROOT / "notebooks" / "start_here.ipynb"
    written, there = _links(notebook), _links(made(notebook, tmp_path))
    assert all((notebook.parent / link).is_file() for link in written)
    assert len(there) == len(written)
    assert {"example_1.html", "../guides/index.html"} < set(there)
    assert all(link.endswith(".html") for link in there)


def _links(notebook: Path) -> list[str]:
    """Return the links in the last cell of a notebook."""
    text = "".join(json.loads(notebook.read_text())["cells"][-1]["source"])
    return re.findall(r"\]\(([^)]*)\)", text)


def test_formulas_are_mathml() -> None:
    with_mathml = pytest.importorskip("tools.site.mathml", reason=BUILDS).with_mathml
    text = with_mathml("with $p_1$ and\n$$\\begin{aligned}a&=b\\\\c&=d\\end{aligned}$$")
    assert text.startswith(
        'with <math xmlns="http://www.w3.org/1998/Math/MathML" display="inline">'
    )
    assert 'display="block"' in text
    assert text.count("<mtr>") == 2
    assert "$" not in text
    norms = with_mathml(r"$\lVert a \rVert + \lvert b \rvert$")
    assert re.findall('form="(.*?)"', norms) == ["prefix", "postfix"] * 2
    signs = with_mathml(r"$a = -b - (-c) - \bigl(1/2\bigr) - d$")
    assert re.findall('mo(?: form="(.*?)")?>&#x02212;', signs) == ["prefix", "", "prefix", "", ""]
    assert '<mo lspace="0" rspace="0">' in signs
    assert with_mathml("(in $a$), $b$ or").split("</math>")[1].startswith("),</span> <math")
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        assert "\\begin" not in with_mathml(path.read_text().replace("\\\\", "\\"))


CODE = """\
```console
$ pip install . $HOME
```

    ~~~sh
    echo $HOME $PATH
    ~~~

The span `$HOME` and ``the `$a$` span``; it costs 3 $ or 5 $."""


def test_code_has_no_formulas() -> None:
    with_mathml = pytest.importorskip("tools.site.mathml", reason=BUILDS).with_mathml
    assert with_mathml(CODE) == CODE
    assert with_mathml(CODE + " Now $x$").startswith(CODE + " Now <math")
    assert with_mathml(r"\$5 and \$6") == "&#36;5 and &#36;6"


def test_formulas_stay_in_their_paragraphs_lists_and_tables() -> None:
    with_mathml = pytest.importorskip("tools.site.mathml", reason=BUILDS).with_mathml
    markdown = pytest.importorskip("markdown", reason=BUILDS)

    def there(text: str) -> str:
        extensions = ["attr_list", "md_in_html", "tables"]
        page = markdown.markdown(with_mathml(text), extensions=extensions)
        page = re.sub("<math.*?</math>", "M", page).replace("\n\n", "\n")
        return re.sub("<span[^>]*>(.*?)</span>", r"\1", page)

    assert there("with *a* and\n$b_1$ and *c*") == "<p>with <em>a</em> and\nM and <em>c</em></p>"
    assert there("$b_1$ *c*\n\n$$\nd_1\n$$\n\n*e*") == ("<p>M <em>c</em></p>\nM\n<p><em>e</em></p>")
    item = there("- first\n\n    $$\n    d_1\n    $$\n\n    *e*\n\n- $f$ `g`")
    assert item.count("<li>") == item.count("M") == item.count("<em>") + item.count("<code>") == 2
    cells = there("| $a$ | b |\n|---|---|\n| $\\lvert c_1 \\rvert$ | $d$ $e$ |")
    assert re.findall("<t[hd]>(.*?)</t[hd]>", cells) == ["M", "b", "M", "M M"]


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.stem)
def test_every_formula_of_a_page_is_shown(page: Path) -> None:
    with_mathml = pytest.importorskip("tools.site.mathml", reason=BUILDS).with_mathml
    text = with_mathml(page.read_text())
    for formula in re.findall("<math.*?</math>", text):
        assert "\\" not in formula  # a command that is not known
        assert "merror" not in formula
    for block in blocks(page):
        text = text.replace(block.text, "")
    assert "$" not in re.sub("`[^`]*`", "", text)


@pytest.mark.parametrize(
    ("page", "complaint"),
    [
        ('<a href="b.html">', "a.html links to b.html, which is not there"),
        ('<img src="c.png">', "a.html links to c.png, which is not there"),
        ('<a href="#there">', "a.html links to #there, where there is no such place"),
        ('<script src="https://x.org/y.js"></script>', "a.html loads https://x.org/y.js"),
        ('<link rel="stylesheet" href="//x.org/y.css">', "a.html loads //x.org/y.css"),
        ('<iframe src="http://localhost:7000">', "a.html loads http://localhost:7000"),
        ('<p id="here"><a href="a.html#here">', None),
        ('<p id="über"><a href="#%C3%BCber">', None),
        ('<a href="https://drake.mit.edu"><a href="mailto:a@b.c"><a href="#">', None),
        ('<iframe src="about:srcdoc" srcdoc="&lt;a href=b.html&gt;">', None),
    ],
)
def test_faults_of_a_page_are_reported(page: str, complaint: str | None, tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(page)
    assert broken_links(tmp_path) == ([] if complaint is None else [complaint])


def test_the_site_requests_no_external_fonts_or_scripts() -> None:
    class Loader(yaml.SafeLoader):
        pass

    # a safe loader
    config = yaml.load((ROOT / "mkdocs.yml").read_text(), Loader)  # noqa: S506
    assert config["theme"]["font"] is False
    assert config["use_directory_urls"] is False
    assert config["extra"]["polyfills"] == ["assets/iframe-worker.js"]
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert any("mkdocs-material" in each for each in extras["optional-dependencies"]["docs"])


def test_pages_are_for_keyboards_and_screen_readers() -> None:
    hooks = pytest.importorskip("tools.site.hooks", reason=BUILDS)
    page = (
        '<div class="md-search" role="dialog"></div><div class="highlight-ipynb hl-python"></div>'
    )
    page += '<script src="https://example.org/x.js"></script>'
    found = hooks.on_post_page(page)
    assert 'role="dialog" aria-label="Search"' in found
    assert 'class="highlight-ipynb hl-python" tabindex="0"' in found
    assert "<script" not in found
    style = (DOCS / "assets" / "site.css").read_text()
    assert "text-decoration: underline" in style  # links do not rely on colour
