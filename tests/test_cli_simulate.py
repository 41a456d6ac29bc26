"""`drake-rho simulate`: winds by name, the report of a flight, and its file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from tests.test_cli import run

MISSION = """
name: gap
grid: {step: 0.25, knots: 25}
vehicles:
  - {name: scout, radius: 0.1, start: {position: [0, 0, 1]}, goal: {position: [5, 0.5, 1.5]}}
  - {name: cargo, radius: 0.1, start: {position: [5, 1.2, 1.2]}, goal: {position: [0, 0.3, 1]}}
limits:
  acceleration: {lower: [-3, -3, -3], upper: [3, 3, 3]}
separation: {distance: 0.5}
obstacles:
  - {center: [2.5, 0.2, 1.2], radius: 0.5}
"""
DISTURBED = """
disturbance: {acceleration: 0.4, position_error: 0.01, velocity_error: 0.02,
              feedback_every: 0.05, delay: 1, share: 0.4}
"""


@pytest.fixture
def mission(tmp_path: Path) -> str:
    """Write a file of two vehicles in wind."""
    path = tmp_path / "mission.yaml"
    path.write_text(MISSION + DISTURBED)
    return str(path)


@pytest.fixture
def calm(tmp_path: Path) -> str:
    """Write the same scenario without a disturbance."""
    path = tmp_path / "calm.yaml"
    path.write_text(MISSION)
    return str(path)


def _flown(path: Path) -> rho.Simulation:
    kept = rho.load(path)
    assert isinstance(kept, rho.Simulation)
    return kept


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--wind", "gust", "--direction", "0", "-2", "0"], "gust along 0 -2 0 from 1.5 s"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (
                ([], "wind: none; seed 1"),
                (["--wind", "constant"], "wind: constant along 1 0 0; seed 1"),
                (["--wind", "noise", "--seed", "7"], "wind: noise; seed 7"),
                (["--wind", "worst"], "worst for the first plan: "),
                (["--wind", "worst", "--direction", "0", "0", "1"], "worst along 0 0 1 by 1.25 s"),
            )
        ),
    ],
)
def test_a_scenario_is_flown_verified_saved_and_shown(
    words: list[str],
    expected: str,
    mission: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = tmp_path / "flown.npz"
    status, out, err = run(capsys, monkeypatch, "simulate", mission, *words, "-o", str(kept))
    assert status == 0, out + err
    assert err == ""
    assert expected in out
    assert "5 windows" in out
    simulation = _flown(kept)
    strongest = np.linalg.norm(simulation.wind, axis=2).max()
    assert strongest <= 0.4 * (1 + 1e-12)
    assert (strongest > 0.0) == bool(words)
    radii = simulation.radii()[:, None]
    assert np.all(simulation.errors() <= radii * (1 + 1e-9) + 1e-9)

    status, again, _ = run(capsys, monkeypatch, "verify", str(kept))
    assert status == 0
    assert "gap: all constraints hold" in again
    assert again in out  # except the wind, which no file stores, and the path of the file
    page = tmp_path / "page.html"
    status, out, _ = run(capsys, monkeypatch, "show", str(kept), "--html", str(page))
    assert status == 0
    assert page.stat().st_size > 1e6


def test_the_table_reports_errors_and_clearances(
    mission: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = tmp_path / "flown.npz"
    words = ("--wind", "noise", "-o", str(kept))
    _, out, _ = run(capsys, monkeypatch, "simulate", mission, *words)
    simulation = _flown(kept)
    (sphere,), apart = simulation.scenario.bodies, simulation.positions[:, 0]
    apart = np.linalg.norm(apart - simulation.positions[:, 1], axis=1).min() - 0.5
    for index, name in enumerate(("scout", "cargo")):
        (row,) = re.findall(rf"^{name} +(.*)$", out.partition("\nvehicle")[2], re.MULTILINE)
        numbers = [float(each) for each in row.split()]
        error, radii = simulation.errors()[:, index], simulation.radii()
        wide = radii > 1e-6
        distances = sphere.distances(simulation.positions[:, index], simulation.times)
        expected = [
            error.max(),
            100.0 * (error[wide] / radii[wide]).max(),
            distances.min() - 0.1,
            apart,
        ]
        np.testing.assert_allclose(numbers, expected, rtol=6e-3)


@pytest.mark.slow
def test_equal_seeds_give_equal_flights(
    mission: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flown = []
    for number, seed in enumerate(("3", "3", "4")):
        kept = tmp_path / f"{number}.npz"
        words = ("--wind", "noise", "--seed", seed, "-o", str(kept))
        run(capsys, monkeypatch, "simulate", mission, *words)
        flown.append(_flown(kept).positions)
    np.testing.assert_array_equal(flown[0], flown[1])
    assert np.abs(flown[0] - flown[2]).max() > 1e-3


def test_without_a_disturbance_a_scenario_flies_without_feedback(
    calm: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = tmp_path / "flown.npz"
    status, out, _ = run(capsys, monkeypatch, "simulate", calm, "-o", str(kept))
    assert status == 0
    assert "of radius" not in out
    assert _flown(kept).errors().max() <= 1e-9
    assert rho.error_tube(_flown(kept).scenario).position(6.0) == 0.0


@pytest.mark.slow
def test_a_quadrotor_is_distinguished_from_a_point_mass(
    mission: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept, figures = tmp_path / "flown.npz", tmp_path / "figures"
    words = ("--plant", "quadrotor", "--figures", str(figures), "--width", "3.5", "-o", str(kept))
    _, out, _ = run(capsys, monkeypatch, "simulate", mission, *words)
    simulation = _flown(kept)
    assert simulation.plant == "quadrotor"
    assert "gap: quadrotor without wind" in out
    missed = simulation.tracking_difference.max()
    assert f"differ from commands plus wind by up to {missed:.3g} m/s²" in out
    assert {"errors.png", "distances.png", "paths.png"} <= {path.name for path in figures.iterdir()}


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--wind", "storm"], "--wind"),
        (["--plant", "helicopter"], "--plant"),
        (["--seed", "-1"], "--seed"),
        (["--replan-every", "0"], "replan_every"),
        (["--direction", "1", "0", "0"], "--direction: got 1 0 0 with --wind none"),
        (["--wind", "noise", "--direction", "1", "0", "0"], "constant, gust or worst"),
        (["--wind", "gust", "--direction", "0", "0", "0"], "--direction: got 0 0 0"),
        (["--wind", "gust", "--direction", "nan", "0", "0"], "--direction: got nan"),
        (["--wind", "gust", "--direction", "1", "0"], "--direction"),
        (["-o", "flown.csv"], ".npz"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    words: list[str],
    complaint: str,
    mission: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    status, out, err = run(capsys, monkeypatch, "simulate", mission, *words)
    assert status == 2
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert complaint in err


@pytest.mark.parametrize("wind", ["constant", "gust", "noise", "worst"])
def test_wind_needs_a_scenario_that_declares_its_strength(
    wind: str,
    calm: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    status, out, err = run(capsys, monkeypatch, "simulate", calm, "--wind", wind)
    assert (status, out) == (2, "")
    assert "disturbance: {acceleration: 0.3}" in err


def test_a_flight_that_violates_a_constraint_exits_1(
    calm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wind is stronger than the scenario declares."""
    scenario = rho.load_scenario(calm)
    simulation = rho.simulate(scenario, wind=lambda t, p, v: np.full_like(p, 0.3), replan_every=24)
    rho.save(simulation, tmp_path / "off.npz")
    status, out, _ = run(capsys, monkeypatch, "verify", str(tmp_path / "off.npz"))
    assert status == 1
    assert "goal" in out


@pytest.mark.slow
def test_a_scenario_without_a_plan_is_explained(
    mission: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "storm.yaml"
    path.write_text((MISSION + DISTURBED).replace("acceleration: 0.4", "acceleration: 40"))
    status, out, err = run(capsys, monkeypatch, "simulate", str(path), "--wind", "noise")
    assert (status, out) == (3, "")
    assert "Traceback" not in err


def test_a_saved_plan_is_tracked_as_from_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = rho.plan(rho.load_scenario("courier"))
    saved, other = str(tmp_path / "plan.npz"), str(tmp_path / "flown.npz")
    rho.save(plan, saved)
    status, _, words = run(capsys, monkeypatch, "simulate", saved, "-o", other)
    assert status == 0, words
    errors = np.random.default_rng(1).spawn(2)[1]  # of estimates, from the default seed
    flown, same = rho.load(other), rho.simulate(plan, rng=errors)
    assert isinstance(flown, rho.Simulation)
    np.testing.assert_array_equal(flown.positions, same.positions)
    status, _, words = run(capsys, monkeypatch, "simulate", saved, "--replan-every", "3")
    assert status == 2
    assert "--replan-every: got 3, expected a scenario with it" in words
    status, _, words = run(capsys, monkeypatch, "simulate", other)
    assert status == 2
    assert "got a simulation, expected a plan or a flight" in words
