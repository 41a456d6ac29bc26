"""The first tutorial shows what its text says; it has no checks of its own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho

NOTEBOOK = Path(__file__).parent.parent / "notebooks" / "start_here.ipynb"
LONGEST = 10
"""Largest number of lines of a cell."""


def cells() -> dict[str, str]:
    """Return the code of all cells, by their names."""
    content = json.loads(NOTEBOOK.read_text())["cells"]
    code = (cell for cell in content if cell["cell_type"] == "code")
    return {cell["id"]: "".join(cell["source"]) for cell in code}


def test_cells_are_short() -> None:
    for name, code in cells().items():
        assert len(code.splitlines()) <= LONGEST, name


@pytest.mark.slow
def test_every_step_shows_what_the_text_says(capsys: pytest.CaptureFixture[str]) -> None:
    found: dict[str, Any] = {}
    said: dict[str, str] = {}
    for name, code in cells().items():
        exec(code.replace("%matplotlib inline", ""), found)  # noqa: S102  # of the notebook
        said[name] = capsys.readouterr().out

    room, plan = found["room"], found["plan"]
    assert said["scenario"].strip() == str(room)
    report = rho.verify(plan)
    assert report.ok
    (nearest,) = [check for check in report.checks if check == report.clearance]
    assert nearest.constraint == "obstacle 1"
    assert nearest.value == pytest.approx(0.2, abs=1e-6)  # the radius
    assert rho.certify(plan).is_globally_optimal
    assert "there is a plan with any one of:" in said["diagnose"]
    assert "the same scenario: True" in said["file"]

    busy, flight = found["busy"], found["flight"]
    assert not rho.verify(replace(plan, scenario=busy)).ok  # it does not know the intruder
    assert rho.verify(flight.plan).ok
    assert [each.avoided for each in flight.sightings] == [True]
    (intruder,) = busy.bodies[3:]
    near = flight.plan.positions[0, 16] - intruder.centers(np.array([4.0]))[0]
    assert near @ intruder.velocity < 0.0  # behind it

    flown = found["flown"]
    assert rho.verify(flown).ok
    assert np.all(flown.errors()[:, 0] <= flown.radii() + 1e-9)
    assert flown.errors().max() < found["error"]
