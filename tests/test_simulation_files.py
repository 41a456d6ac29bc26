"""Simulations are read back unchanged, and damaged files are refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import disturbed, winds_for

ARRAYS = ("times", "positions", "velocities", "wind", "commands")


def _flown(seed: int) -> rho.Simulation:
    """Return a flight with errors, so that windows begin off the plan."""
    scenario = disturbed(seed)
    wind = winds_for(scenario, seed)["noise"]
    return rho.simulate(scenario, wind=wind, rng=np.random.default_rng(seed), replan_every=3)


@pytest.mark.parametrize("seed", range(4))
def test_a_simulation_is_read_back_unchanged(seed: int, tmp_path: Path) -> None:
    simulation = _flown(seed)
    rho.save(simulation, tmp_path / "flight.npz")
    loaded = rho.load(tmp_path / "flight.npz")
    assert isinstance(loaded, rho.Simulation)
    assert loaded.plant == simulation.plant
    assert loaded.scenario == simulation.scenario
    assert loaded.statistics == simulation.statistics
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(simulation, name))
    for one, other in zip(loaded.flight.windows, simulation.flight.windows, strict=True):
        assert one.plan.scenario == other.plan.scenario
        np.testing.assert_array_equal(one.plan.accelerations, other.plan.accelerations)
        for name in ("first_knot", "infeasible", "learned", "not_avoided", "kept", "off_tube"):
            assert getattr(one, name) == getattr(other, name)
    np.testing.assert_array_equal(loaded.errors(), simulation.errors())
    np.testing.assert_array_equal(loaded.radii(), simulation.radii())
    rho.save(loaded, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "flight.npz").read_bytes()


def test_records_of_windows_are_read_back(tmp_path: Path) -> None:
    flown = _flown(1)
    first, *others = flown.flight.windows
    off = {"off_tube": ("v0", "v1"), "learned": (1, 2), "not_avoided": (2,)}
    reported = (first, *(dataclasses.replace(each, kept=True, **off) for each in others))  # type: ignore[arg-type]
    reported = (*reported[:-1], dataclasses.replace(reported[-1], infeasible="no room", kept=False))
    flight = dataclasses.replace(flown.flight, windows=reported)
    rho.save(dataclasses.replace(flown, flight=flight), tmp_path / "storm.npz")
    loaded = rho.load(tmp_path / "storm.npz")
    assert isinstance(loaded, rho.Simulation)
    for one, other in zip(loaded.flight.windows, reported, strict=True):
        for name in ("infeasible", "learned", "not_avoided", "kept", "off_tube"):
            assert getattr(one, name) == getattr(other, name)


@pytest.mark.parametrize(
    "changes",
    [
        {"simulation.positions": np.zeros((3, 1, 3))},
        {"simulation.times": np.zeros(5)},
        {"simulation.wind": np.array("words")},
        {"plant": None},
        {"simulation.commands": None},
        {"first_knots": None},
        {"kept": np.array("[1]")},
        {"off_tube": np.array("[]")},
        {"format": np.array("drake_rho flight 1")},
        {"format": np.array("drake_rho simulation 2")},
    ],
)
def test_a_damaged_simulation_is_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    path = tmp_path / "flight.npz"
    rho.save(_flown(0), path)
    with np.load(path) as content:
        changed = {k: v for k, v in (dict(content) | changes).items() if v is not None}
    np.savez(path, **changed)
    with pytest.raises(rho.PlanFileError, match=r"flight\.npz"):
        rho.load(path)


def test_flights_of_earlier_versions_are_read(tmp_path: Path) -> None:
    """They contain nothing of a window but the reason why it had no plan."""
    flight = rho.plan_rho(disturbed(0))
    rho.save(flight, tmp_path / "flight.npz")
    with np.load(tmp_path / "flight.npz") as content:
        newer = ("learned", "not_avoided", "kept", "off_tube")
        old = {name: array for name, array in content.items() if name not in newer}
    np.savez(tmp_path / "old.npz", **old)
    loaded = rho.load(tmp_path / "old.npz")
    assert isinstance(loaded, rho.Flight)
    np.testing.assert_array_equal(loaded.plan.accelerations, flight.plan.accelerations)
