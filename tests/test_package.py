"""The distributed package: its metadata, the contents of its wheel, and its citation."""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import json
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import drake_rho as rho
from tests.scenarios import slow
from tools.publishing import addresses, description

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Return the wheel made of the source distribution, as `python -m build` makes it."""
    folder = tmp_path_factory.mktemp("wheel")
    unpack = [
        sys.executable,
        "-m",
        "tarfile",
        "-e",
        str(_built("sdist", ROOT, folder)),
        str(folder),
    ]
    subprocess.run(unpack, check=True)
    (unpacked,) = (each for each in folder.iterdir() if each.is_dir())
    return zipfile.ZipFile(_built("wheel", unpacked, folder))


def _built(kind: str, source: Path, folder: Path) -> Path:
    """Build a distribution of a source tree with the project's backend, and return its path."""
    build = f"import hatchling.build as b; print(b.build_{kind}({str(folder)!r}))"
    command = [sys.executable, "-c", build]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=True)
    return folder / done.stdout.split()[-1]


def test_a_wheel_has_every_file_of_the_package_and_nothing_else(wheel: zipfile.ZipFile) -> None:
    packed = {name for name in wheel.namelist() if ".dist-info/" not in name}
    source = ROOT / "drake_rho"
    files = [path for path in source.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    assert packed == {path.relative_to(ROOT).as_posix() for path in files}
    assert {"drake_rho/py.typed", "drake_rho/scenario/library/paper.yaml"} <= packed


def test_the_installed_metadata_are_those_of_the_project() -> None:
    found = importlib.metadata.metadata("drake-rho")
    assert found["Version"] == PROJECT["version"] == rho.__version__
    assert found["Summary"] == PROJECT["description"]
    assert found["License-Expression"] == PROJECT["license"]
    assert found["Requires-Python"] == PROJECT["requires-python"]


def test_the_citation_has_the_version_of_the_package() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["cff-version"] == "1.2.0"
    assert cited["version"] == PROJECT["version"]
    assert cited["license"] == PROJECT["license"]
    assert {"message", "title", "authors", "references"} <= set(cited)


def test_every_public_name_is_listed_with_its_static_type() -> None:
    code = "import drake_rho, json; print(json.dumps(dir(drake_rho)))"
    reported = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    listed = json.loads(reported.stdout)  # before any name was accessed
    assert {*rho.__all__, "__version__"} <= set(listed)
    assert [name for name in listed if not name.startswith("__")] == sorted(rho.__all__)
    source = ast.parse((ROOT / "drake_rho" / "__init__.pyi").read_text())
    imports = [node for node in source.body if isinstance(node, ast.ImportFrom)]
    typed = [(alias, node.module) for node in imports for alias in node.names]
    assert [alias.asname for alias, _ in typed] == [alias.name for alias, _ in typed]
    assert sorted(alias.name for alias, _ in typed) == sorted(rho.__all__)
    for alias, module in typed:
        found = getattr(importlib.import_module(f"drake_rho.{module}"), alias.name)
        assert found is getattr(rho, alias.name)
    with pytest.raises(AttributeError, match="has no attribute 'plann'"):
        rho.plann  # type: ignore[attr-defined]  # noqa: B018  # no such name


def test_importing_the_package_loads_nothing_else() -> None:
    code = "import sys, drake_rho; print({'numpy', 'pydrake', 'pydantic'} & set(sys.modules))"
    reported = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert reported.stdout.strip() == "set()"


@pytest.mark.parametrize(
    "loading", ["typer", "numpy", *slow("pydrake.solvers", "drake_rho.planning.planners.plan")]
)
def test_ctrl_c_while_the_command_loads_is_one_line(loading: str) -> None:
    code = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, *rest):\n"
        f"        if name == {loading!r}:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "sys.argv = ['drake-rho', '--version']\n"
        "import drake_rho.__main__\n"
    )
    reported = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (reported.returncode, reported.stdout, reported.stderr) == (
        130,
        "",
        "drake-rho: interrupted\n",
    )


@pytest.mark.parametrize("repository", [None, "https://example.org/drake_rho"])
def test_no_link_of_the_description_is_broken(repository: str | None) -> None:
    """On an index page, links are complete addresses of files that exist, or text."""
    text = description(repository)
    targets = re.findall(r"\]\(([^)]+)\)", text) + re.findall(r'<img src="([^"]+)"', text)
    assert all(each.startswith("https://") for each in targets)
    if repository is None:
        assert not any("example.org" in each for each in targets)
        assert "figures/" not in text
    else:
        own = [each.removeprefix(repository) for each in targets if each.startswith(repository)]
        assert len(own) > 10
        for each in own:
            assert (ROOT / re.sub(r"^/(raw|blob)/main/", "", each).partition("#")[0]).exists(), each


def test_a_built_package_has_the_description(wheel: zipfile.ZipFile) -> None:
    (name,) = (each for each in wheel.namelist() if each.endswith("/METADATA"))
    metadata = wheel.read(name).decode()
    assert description(addresses().get("repository")) in metadata
    assert "Description-Content-Type: text/markdown" in metadata


def test_the_readme_is_short() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.split()) <= 700
    assert len(text.splitlines()) <= 110
