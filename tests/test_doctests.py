"""The examples in docstrings print the documented output."""

from __future__ import annotations

import doctest
import importlib
import inspect
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho

SOURCE = Path(rho.__file__).parent
MODULES = [
    ".".join(["drake_rho", *path.relative_to(SOURCE).with_suffix("").parts])
    for path in sorted(SOURCE.rglob("*.py"))
    if ">>>" in path.read_text()
]
MAIN = (
    "Scenario load_scenario plan plan_convex plan_rho verify certify diagnose simulate campaign "
    "save export error_tube random_transitions paths_figure Plan Grid Limits Obstacle Sphere Box"
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_print_the_documented_output(name: str, tmp_path: Path) -> None:
    known = {"rho": rho, "np": np, "folder": tmp_path}
    reported = doctest.testmod(importlib.import_module(name), extraglobs=known)
    assert reported.attempted > 0
    assert reported.failed == 0


@pytest.mark.parametrize("name", MAIN.split())
def test_the_main_functions_have_an_example(name: str) -> None:
    assert ">>>" in str(inspect.getdoc(getattr(rho, name)))
