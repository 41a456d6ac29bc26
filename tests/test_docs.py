"""The documents are true: code prints the documented output, and every name exists."""

from __future__ import annotations

import ast
import contextlib
import functools
import inspect
import io
import json
import re
import shutil
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.guides import blocks, calls, follow
from tests.scenarios import slow
from tests.studies import small
from tests.test_missions import MISSION as LSC_MISSION

ROOT = Path(__file__).parent.parent
DOCUMENTS = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
DOCUMENTS += [page.relative_to(ROOT).as_posix() for page in sorted(ROOT.glob("docs/**/*.md"))]
ELSEWHERE = ("docs/gallery.md", "docs/guides/recipes.md")
"""Documents that test_site.py and test_recipes.py follow."""
FOLLOWED = [
    document
    for document in DOCUMENTS
    if document not in ELSEWHERE and list(blocks(ROOT / document))
]
_FEWER = {"repetitions: 40 ": "repetitions: 1 "}
SHORTER = {
    "docs/campaigns.md": _FEWER,
    "docs/fleets.md": {"2000": "60"},
    "docs/guides/campaign.md": {
        "repetitions=200": "repetitions=4",
        "repetitions: 200": "repetitions: 4",
    },
    "docs/guides/compare.md": {"repetitions=40": "repetitions=4"},
    "docs/guides/tune.md": {"repetitions: 40": "repetitions: 2"},
    "docs/guides/film.md": {"--rate 10": "--rate 100"},
    "docs/viewer.md": {"--film flight.gif": "--html film.html"},  # filmed in guides/film.md
}
"""Replacements of long work: fewer runs, smaller fleets, shorter films."""


GIVEN = {
    "docs/export.md": ("plan.npz",),
    "docs/figures.md": ("runs.sqlite",),
    "docs/viewer.md": ("flight.npz",),
    "docs/guides/fleet.md": ("mission.json", "world.csv"),
}
"""Files of the reader that documents presuppose."""


@pytest.fixture(scope="session")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with all files that documents presuppose."""
    folder = tmp_path_factory.mktemp("desk")
    page = ROOT / "docs" / "command_line.md"
    (mission,) = (each for each in blocks(page) if each.title == "mission.yaml")
    (folder / "mission.yaml").write_text(mission.text)
    scenario = rho.load_scenario(folder / "mission.yaml")
    rho.save(rho.plan(scenario), folder / "plan.npz")
    rho.save(rho.plan_rho(scenario), folder / "flight.npz")
    (folder / "mission.json").write_text(json.dumps(LSC_MISSION))
    (folder / "world.csv").write_text("0, 0, 1, 0.5, 0.5, 2\n")  # a box in the middle
    rho.campaign(small(1), folder / "runs.sqlite")
    return folder


LONG = (
    "campaign.md",
    "campaigns.md",
    "compare.md",
    "fast.md",
    "figures.md",
    "film.md",
    "fleet.md",
    "fleets.md",
    "least_time.md",
    "maps.md",
    "mission.md",
    "mpc.md",
    "results.md",
    "tune.md",
    "viewer.md",
    "wind.md",
)
"""Documents that take several seconds each."""


@pytest.mark.parametrize(
    "document",
    [one for each in FOLLOWED for one in (slow(each) if Path(each).name in LONG else [each])],
)
def test_the_steps_of_a_document_work(
    document: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in GIVEN.get(document, ()):
        shutil.copy(desk / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    with socket.socket() as free:  # the documented port may be in use
        free.bind(("127.0.0.1", 0))
        port = {"8786": str(free.getsockname()[1])}
    follow(ROOT / document, SHORTER.get(document, {}) | port)


@pytest.mark.parametrize("document", sorted(set(DOCUMENTS) - {"CHANGELOG.md"}))
def test_functions_called_in_the_text_exist_and_accept_the_arguments(document: str) -> None:
    for call in calls(ROOT / document):
        root, *names = ast.unparse(call.func).split(".")
        if root != "rho" or any("(" in name for name in names):  # methods of returned objects
            continue
        found: Any = functools.reduce(getattr, names, rho)
        given = [argument for argument in call.args if not isinstance(argument, ast.Starred)]
        named = {keyword.arg: ... for keyword in call.keywords if keyword.arg is not None}
        inspect.signature(found).bind_partial(*given, **named)


def test_the_custom_diagram_in_the_documents_flies() -> None:
    text = (ROOT / "docs" / "api" / "wind.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    (code,) = (block for block in blocks if "DiagramBuilder" in block)
    found: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, found)  # noqa: S102  # of the document
    scenario = found["scenario"]
    states = found["states"].T.reshape(-1, len(scenario.vehicles), 6)
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


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_link_of_a_document_exists(document: str) -> None:
    text = (ROOT / document).read_text()
    pointers = re.findall(r"`([\w/]+\.py)::([\w.]+)`", text)
    assert pointers or document != "docs/paper.md"
    for path, name in pointers:
        assert name in _names(ROOT / path), f"{path}::{name}"
    for link in re.findall(r"\]\(([^):#]+)\)", text):
        if link.startswith("gallery/"):  # pictures drawn when the site is built
            continue
        assert (ROOT / document).parent.joinpath(link).exists(), link


@pytest.mark.parametrize("document", sorted(set(DOCUMENTS) - {"CHANGELOG.md"}))
def test_every_module_named_in_a_document_exists(document: str) -> None:
    for path in re.findall(r"`([\w/]+\.py)[`:]", (ROOT / document).read_text()):
        assert list(ROOT.glob(f"*/{path}")) or (ROOT / path).exists() or _is_module(path), path


def _is_module(name: str) -> bool:
    """Return whether a name without a folder is that of a module of the package."""
    return "/" not in name and any(ROOT.glob(f"*/**/{name}"))


def test_every_public_name_exists_once() -> None:
    assert len(set(rho.__all__)) == len(rho.__all__)
    assert all(hasattr(rho, name) for name in rho.__all__)
