"""Simulations come back from their files as they went, and damaged ones are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.simulation.closed_loop import fly
from tests.disturbed import disturbed, winds_for

ARRAYS = ("times", "positions", "velocities", "wind", "commands")


def _flown(seed: int) -> rho.Simulation:
    """With errors, so that windows begin where no one would have planned."""
    scenario = disturbed(seed)
    wind = winds_for(scenario, seed)["noise"]
    return fly(scenario, wind=wind, rng=np.random.default_rng(seed), replan_every=3)


@pytest.mark.parametrize("seed", range(4))
def test_a_simulation_comes_back_as_it_went(seed: int, tmp_path: Path) -> None:
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


def test_what_is_told_of_windows_comes_back(tmp_path: Path) -> None:
    """A wind beyond the declared one, which takes vehicles out of their tubes and their boxes."""
    scenario = disturbed(1)
    storm = rho.winds.constant(scenario, [0, 1, 1])
    simulation = fly(scenario, wind=lambda *state: 40.0 * storm(*state))
    told = [(each.kept, each.off_tube, each.infeasible) for each in simulation.flight.windows]
    assert any(off for _, off, _ in told)
    assert any(infeasible for *_, infeasible in told)
    rho.save(simulation, tmp_path / "storm.npz")
    loaded = rho.load(tmp_path / "storm.npz")
    assert isinstance(loaded, rho.Simulation)
    again = [(each.kept, each.off_tube, each.infeasible) for each in loaded.flight.windows]
    assert again == told


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
    """Which tell nothing but why a window had no plan."""
    flight = rho.plan_rho(disturbed(0))
    rho.save(flight, tmp_path / "flight.npz")
    with np.load(tmp_path / "flight.npz") as content:
        newer = ("learned", "not_avoided", "kept", "off_tube")
        old = {name: array for name, array in content.items() if name not in newer}
    np.savez(tmp_path / "old.npz", **old)
    loaded = rho.load(tmp_path / "old.npz")
    assert isinstance(loaded, rho.Flight)
    np.testing.assert_array_equal(loaded.plan.accelerations, flight.plan.accelerations)
