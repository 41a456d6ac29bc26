"""Polynomials for Crazyswarm2, evaluated by a reader of its documented convention.

A row of a file is a piece: its duration, then eight coefficients each of x, y, z and yaw, for the
powers of the time since the piece began, from the constant up. Pieces follow one another.
"""

from __future__ import annotations

import csv
import dataclasses
from itertools import pairwise
from math import factorial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.formats.clearance import spare_of
from drake_rho.formats.pieces import as_pieces
from tests.scenarios import box, fleet, sampled_separation, single, slow
from tests.tolerances import ROUNDING

HEADER = ["duration"] + [f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(8)]
MEMORY, BYTES = 4096, 4 * 33
"""Memory of a Crazyflie for trajectories, and of a piece: 33 numbers in single precision."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """One row of a file."""

    duration: float
    coefficients: np.ndarray
    """coefficients of x, y, z and yaw, shape (4, 8)"""

    def at(self, time: float, derivative: int = 0) -> np.ndarray:
        """Return x, y, z and yaw, or their derivatives, as sums of powers."""
        return np.array(
            [
                sum(
                    factorial(k) / factorial(k - derivative) * c * time ** (k - derivative)
                    for k, c in enumerate(row)
                    if k >= derivative
                )
                for row in self.coefficients
            ]
        )


def _read(path: Path) -> list[Piece]:
    with open(path, encoding="ascii", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == HEADER
    numbers = [[float(cell) for cell in row] for row in rows]
    assert all(len(row) == 33 for row in numbers)
    return [Piece(row[0], np.reshape(row[1:], (4, 8))) for row in numbers]


def _flown(pieces: list[Piece], elapsed: float, derivative: int = 0) -> np.ndarray:
    """Return the position, or its derivative, at a time after the start."""
    for piece in pieces:
        if elapsed <= piece.duration:
            return piece.at(elapsed, derivative)[:3]
        elapsed -= piece.duration
    return pieces[-1].at(pieces[-1].duration, derivative)[:3]


def _random(steps: int, *, seed: int = 0, step: float = 0.25, size: float = 1.0) -> rho.Plan:
    rng = np.random.default_rng(seed)
    scenario = single(
        grid=rho.Grid(step, steps + 1, 3.0), start=rho.State([1, 2, 3], size * rng.normal(size=3))
    )
    return rho.Plan.from_accelerations(scenario, size * rng.normal(size=(1, steps, 3)))


@pytest.mark.parametrize("steps", [1, 2, 17, 31])
def test_a_plan_that_fits_is_exported_exactly(steps: int, tmp_path: Path) -> None:
    plan = _random(steps)
    written = rho.export(plan, tmp_path / "swarm", format="crazyswarm")
    assert (written.deviation, written.spare) == (0.0, None)
    pieces = _read(tmp_path / "swarm" / "solo.csv")
    assert len(pieces) == max(2, steps)  # a single row is no table for its reader
    assert sum(each.duration for each in pieces) == pytest.approx(plan.scenario.grid.duration)
    path = plan.trajectory("solo")
    ways = [path, path.derivative(1), path.derivative(2)]
    for elapsed in np.random.default_rng(1).uniform(0.0, plan.scenario.grid.duration, 200):
        for derivative, way in enumerate(ways):
            expected = way.value(3.0 + elapsed).ravel()
            got = _flown(pieces, elapsed, derivative)
            np.testing.assert_allclose(got, expected, rtol=0, atol=100 * ROUNDING)
    assert all(not np.any(piece.coefficients[3]) for piece in pieces)  # heading along x
    assert all(not np.any(piece.coefficients[:, 3:]) for piece in pieces)  # quadratic


@pytest.mark.parametrize("steps", [32, 49, 61, 62, 200, *slow(1000)])
def test_a_plan_that_does_not_fit_is_merged_into_fewer_pieces(steps: int, tmp_path: Path) -> None:
    plan = _random(steps, seed=steps)
    written = rho.export(plan, tmp_path / "swarm", format="crazyswarm")
    pieces = _read(written.files[0])
    assert 30 * BYTES < len(pieces) * BYTES <= MEMORY < (len(pieces) + 1) * BYTES
    assert sum(each.duration for each in pieces) == pytest.approx(plan.scenario.grid.duration)
    path, speed = plan.trajectory("solo"), plan.trajectory("solo").derivative(1)
    scale = np.abs(plan.positions).max()
    for before, after in pairwise(pieces):  # they join, in position and velocity
        for derivative in (0, 1):
            one, other = before.at(before.duration, derivative), after.at(0.0, derivative)
            np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING * scale)
    passed = 0.0
    for piece in pieces:  # they follow the plan, in position and velocity
        for time, at in ((passed, 0.0), (passed + piece.duration, piece.duration)):
            there, fast = path.value(3.0 + time).ravel(), speed.value(3.0 + time).ravel()
            np.testing.assert_allclose(piece.at(at)[:3], there, rtol=0, atol=ROUNDING * scale)
            np.testing.assert_allclose(piece.at(at, 1)[:3], fast, rtol=0, atol=ROUNDING * scale)
        passed += piece.duration
    dense = np.linspace(0.0, plan.scenario.grid.duration, 40 * steps + 1)
    off = max(
        float(np.linalg.norm(_flown(pieces, time) - path.value(3.0 + time).ravel()))
        for time in dense
    )
    assert 0.95 * written.deviation < off <= written.deviation


def test_a_polynomial_motion_is_merged_exactly() -> None:
    constant = rho.Plan.from_accelerations(single(), np.tile([1.0, -2.0, 0.5], (1, 16, 1)))
    pieces = as_pieces(constant.motion(), 3)
    assert pieces.deviations.max() < 1e-11
    np.testing.assert_allclose(pieces.coefficients[..., 3:], 0.0, atol=1e-9)
    assert as_pieces(_random(16).motion(), 3).deviations.max() > 1e-3


@given(
    steps=st.integers(2, 60),
    most=st.integers(1, 12),
    seed=st.integers(0, 1000),
    size=st.sampled_from([1e-3, 1.0, 1e4]),
    step=st.sampled_from([0.01, 1.0, 60.0]),
)
@settings(max_examples=20)
def test_no_piece_deviates_more_than_reported(
    steps: int, most: int, seed: int, size: float, step: float
) -> None:
    plan = _random(steps, seed=seed, step=step, size=size)
    motion = plan.motion()
    pieces = as_pieces(motion, most)
    assert len(pieces.durations) == min(most, steps)
    assert pieces.durations.max() - pieces.durations.min() <= step * (1 + ROUNDING)
    begins = np.concatenate([[0.0], np.cumsum(pieces.durations)])
    scale = ROUNDING * np.abs(plan.positions).max()
    for number, (begin, duration) in enumerate(
        zip(begins[:-1], pieces.durations.tolist(), strict=True)
    ):
        t = np.linspace(0.0, duration, 101)
        got = sum(c * t[:, None] ** k for k, c in enumerate(pieces.coefficients[0, number].T))
        off = np.linalg.norm(got - motion.at("position", begin + t)[0], axis=1).max()
        assert off <= pieces.deviations[0] + scale


def _room(gap: float, downwash: float = 1.0, *, beside: bool = False) -> rho.Plan:
    """Return two vehicles past a sphere that is `gap` further away than necessary.

    They fly above each other or, with `beside`, side by side, with as much separation to spare.
    """
    rng = np.random.default_rng(7)
    apart = np.array([0, 1.0 + gap, 0]) if beside else np.array([0, 0, downwash * (1.0 + gap)])
    starts = np.array([0.0, 0.0, 5.0]) + np.array([np.zeros(3), apart])
    scenario = fleet(
        starts,
        starts + np.array([30.0, 0.0, 0.0]),
        grid=rho.Grid(0.25, 101),
        separation=rho.Separation(1.0, downwash),
        obstacles=[rho.Sphere([15.0, -2.0, 5.0], 2.0 - gap)],
        limits=rho.Limits(position=rho.Box([-5, -50, -50], [50, 50, 50])),
    )
    along = np.zeros((2, 100, 3))
    along[:, :, 0] = 0.05 * rng.normal(size=(2, 100))  # rough along the path, and beside it
    along[:, :, 0] += 30.0 / 25.0**2 * 2.0
    wave = np.tile([1.0, -1.0, -1.0, 1.0], 25) * 0.01
    along[0, :, 1], along[1, :, 1] = -wave, wave
    if not beside:
        along[0, :, 2], along[1, :, 2] = -wave, wave
    return rho.Plan.from_accelerations(scenario, along)


def _least_clearance(pieces: list[list[Piece]], plan: rho.Plan) -> float:
    """Return the least clearance from sphere and partner in written pieces, sampled by hand."""
    scenario, apart = plan.scenario, plan.scenario.separation
    assert apart is not None
    sphere = scenario.obstacles[0]
    assert isinstance(sphere, rho.Sphere)
    times = np.linspace(0.0, scenario.grid.duration, 20_001)
    p = np.array([[_flown(each, time) for time in times[::4]] for each in pieces])
    least = float(np.linalg.norm(p - sphere.center, axis=-1).min()) - sphere.radius
    way = (p[0] - p[1]) / [1.0, 1.0, apart.downwash]
    return min(least, float(np.linalg.norm(way, axis=1).min()) - apart.distance)


@pytest.mark.parametrize("downwash", [*slow(0.5, 1.0), 2.0])
@pytest.mark.parametrize("beside", [True, False])
def test_remaining_clearances_are_never_less_than_reported(
    downwash: float, beside: bool, tmp_path: Path
) -> None:
    plan = _room(0.02, downwash, beside=beside)
    written = rho.export(plan, tmp_path / "swarm", format="crazyswarm")
    assert written.spare is not None
    assert written.deviation > 1e-6
    apart = sampled_separation(plan) - 1.0
    assert written.spare.before <= apart + 1e-6
    pieces = [_read(file) for file in written.files]
    assert written.spare.left <= _least_clearance(pieces, plan)
    assert written.spare.keeps_clear
    assert "they still hold" in str(written)
    assert written.spare.left < written.spare.before


def test_lack_of_clearance_is_reported(tmp_path: Path) -> None:
    plan = _room(0.02)
    near = rho.Plan.from_accelerations(
        dataclasses.replace(
            plan.scenario,
            separation=rho.Separation(sampled_separation(plan) - 1e-7, 1.0),
        ),
        plan.accelerations,
    )
    checked = [each for each in rho.verify(near).checks if each.constraint == "separation"]
    assert all(each.holds for each in checked)
    written = rho.export(near, tmp_path / "swarm", format="crazyswarm")
    assert written.spare is not None
    assert not written.spare.keeps_clear
    assert written.spare.left == pytest.approx(-2.0 * written.deviation, rel=0.2)
    assert "nothing to spare" in str(written)
    assert f"violated by up to {-written.spare.left:.3g} m" in str(written)


def test_every_vehicle_and_constraint_has_its_own_clearance(tmp_path: Path) -> None:
    plan = _room(0.02, 0.5, beside=True)  # flat: a metre along z counts for two
    report = rho.verify(plan)
    left = {(c.vehicle, c.constraint): -c.excess for c in report.checks if c.asked}
    off = np.array([0.003, 0.001])
    found = spare_of(plan, off)
    expected = [
        left["v0", "obstacle 1"] - 0.003,
        left["v1", "obstacle 1"] - 0.001,
        left["v0", "position box"] - 0.003,
        left["v1", "position box"] - 0.001,
        left["v0", "separation"] - 2.0 * (0.003 + 0.001),
        left["v1", "separation"] - 2.0 * (0.001 + 0.003),
    ]
    assert found.left == pytest.approx(min(expected), abs=1e-3 * off.min())
    assert min(expected) == expected[4]
    assert spare_of(plan, np.zeros(2)).left == spare_of(plan, off).before


def test_only_required_instants_count_for_clearances(paper: rho.Scenario) -> None:
    plan = rho.plan_convex(paper)  # inside the sphere between its knots, which is allowed
    found = spare_of(plan, np.full(4, 0.5))
    assert found.before == pytest.approx(0.0, abs=1e-6)
    assert found.left == pytest.approx(-0.5, abs=1e-6)


def test_a_single_vehicle_in_free_space_has_no_clearance(tmp_path: Path) -> None:
    written = rho.export(_random(40), tmp_path / "swarm", format="crazyswarm")
    assert written.spare is not None
    assert written.spare.keeps_clear
    assert "which has no distances to keep" in str(written)
    boxed = dataclasses.replace(_random(40).scenario, limits=rho.Limits(position=box(1e3)))
    plan = rho.Plan.from_accelerations(boxed, _random(40).accelerations)
    assert "they still hold" in str(rho.export(plan, tmp_path / "swarm", format="crazyswarm"))
