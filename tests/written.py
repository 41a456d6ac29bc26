"""Scenarios as the text of their files, and read from such text."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import drake_rho as rho


def as_yaml(scenario: rho.Scenario) -> str:
    """Return the YAML of a scenario's file."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.yaml"
        rho.save_scenario(scenario, file)
        return file.read_text(encoding="utf-8")


def from_yaml(text: str) -> rho.Scenario:
    """Return the scenario of a file with this text; errors do not name the file."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.yaml"
        file.write_text(text, encoding="utf-8")
        try:
            return rho.load_scenario(file)
        except rho.ScenarioError as error:
            field = error.field.removeprefix(str(file)).removeprefix(": ")
            raise rho.ScenarioError(field, error.value, error.expected) from None


def in_plan_file(scenario: rho.Scenario) -> tuple[str, rho.Scenario]:
    """Return the JSON of a scenario in the file of a plan, and the scenario read from there."""
    nothing = np.zeros((len(scenario.vehicles), scenario.grid.knots - 1, 3))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "plan.npz"
        rho.save(rho.Plan.from_accelerations(scenario, nothing), file)
        with np.load(file) as content:
            text = str(content["plan.scenario"])
        return text, rho.load(file).scenario
