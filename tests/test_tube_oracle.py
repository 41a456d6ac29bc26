"""The tube compared with an independent computation: supports of reachable sets by adjoints.

The vehicle, the feedback in force and the feedback on its way are one linear system, moved through
short pieces of time by matrix exponentials. The row that maps causes to a quantity at a time is
carried back to the beginning; the sum of the norms of all its parts is the reachable set's support.
Wind that is constant in each piece is weaker than arbitrary wind, by the square of the length of a
piece where the worst wind switches within one: so the sums are at most the radii, and nearly equal.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

import drake_rho as rho
from tests.scenarios import single
from tests.tolerances import ROUNDING

Array = NDArray[np.float64]

PIECES = 20
"""Pieces of a sample."""

AGREES = 0.01
"""Relative difference of the tube and the oracle with this number of pieces."""

POSITION, VELOCITY, FEEDBACK = 0, 1, 2
"""Components of a state: errors of position and velocity, feedback in force, queued feedback."""


@dataclasses.dataclass(frozen=True)
class Oracle:
    """System of one axis in pieces of a sample, and the bounds of its disturbances, SI."""

    gains: tuple[float, float]
    sample: float
    delay: int
    sizes: tuple[float, float, float, float, float]
    pieces: int
    predicted: bool

    def supports(self, sample: int, piece: int) -> Array:
        """Return the largest position, velocity and feedback after pieces of a sample, (3,)."""
        W, E_p, E_v, r_p, r_v = self.sizes
        through, wind = self._through_a_piece
        at_sample, n_p, n_v = self._at_a_sample
        rows = np.eye(3, 3 + self.delay)
        total = np.zeros(3)
        for j in range(sample, -1, -1):
            for _ in range(piece if j == sample else self.pieces):
                total += W * np.abs(rows @ wind)
                rows = rows @ through
            total += E_p * np.abs(rows @ n_p) + E_v * np.abs(rows @ n_v)
            rows = rows @ at_sample
        return np.asarray(total + np.abs(rows[:, :2]) @ (r_p, r_v))

    @cached_property
    def _through_a_piece(self) -> tuple[Array, Array]:
        """Return the transition of a state through a piece, and the effect of a wind of 1 in it."""
        size = 3 + self.delay
        rate = np.zeros((size + 1, size + 1))  # the last state is a constant wind
        rate[POSITION, VELOCITY] = rate[VELOCITY, FEEDBACK] = rate[VELOCITY, size] = 1.0
        whole = expm(rate * self.sample / self.pieces)
        return whole[:size, :size], whole[:size, size]

    @cached_property
    def _at_a_sample(self) -> tuple[Array, Array, Array]:
        """Return the transition of a state at a sample, and the effects of the errors of estimates.

        The new feedback is the last in the queue or, without delay, in force at once. If it
        predicts, it answers the state that the queue leads to.
        """
        size = 3 + self.delay
        jump, newest = np.eye(size), size - 1
        jump[FEEDBACK:] = 0.0
        jump[FEEDBACK : size - 1, FEEDBACK + 1 :] = np.eye(self.delay)  # the queue moves up
        gains = np.array(self.gains)
        if self.predicted:
            h = self.sample
            for place in range(newest, FEEDBACK, -1):
                jump[newest, place] = -gains @ (h**2 / 2.0, h)
                gains = gains @ np.array([[1.0, h], [0.0, 1.0]])
        jump[newest, [POSITION, VELOCITY]] = -gains
        unit = np.eye(size)[newest]
        return jump, -gains[0] * unit, -gains[1] * unit


def _drawn(seed: int) -> tuple[rho.ErrorTube, Oracle]:
    """Return a tube of random gains, sample, delay, errors and initial errors, and its oracle."""
    rng = np.random.default_rng(seed)
    sample, delay, predicted = 10 ** rng.uniform(-2.0, 0.5), seed % 6, seed // 6 % 2 == 1
    knots, parts = int(rng.integers(3, 6)), int(rng.integers(1, 9))
    while True:
        alpha, beta = rng.uniform([0.0, 0.0], [2.0, 2.0]) / (1 + delay) ** np.array([2, 1])
        roots = np.concatenate([[1.0, -2.0, 1.0], np.zeros(0 if predicted else delay)])
        roots[-2:] += alpha / 2.0 + beta, alpha / 2.0 - beta
        if np.abs(np.roots(roots)).max() < 1.0:
            break
    gains = alpha / sample**2, beta / sample
    W = 10 ** rng.uniform(-2.0, 1.0)
    errors = W * rng.uniform(0.0, 1.5, 4) * (rng.random(4) < 0.75)
    E_p, E_v, r_p, r_v = errors * np.array([sample**2, sample, sample**2, sample])
    grid = rho.Grid(sample * parts, knots, rng.uniform(-3.0, 3.0))
    around = rho.Disturbance(W, E_p, E_v, sample, delay, prediction=predicted)
    scenario = dataclasses.replace(single(grid=grid), disturbance=around)
    tube = rho.error_tube(scenario, (r_p, r_v), gains=gains)
    return tube, Oracle(gains, sample, delay, (W, E_p, E_v, r_p, r_v), PIECES, predicted)


@pytest.mark.parametrize("seed", range(36))
def test_radii_agree_with_supports_of_the_reachable_sets(seed: int) -> None:
    tube, oracle = _drawn(seed)
    rng = np.random.default_rng(seed)
    samples = {0, oracle.delay, tube.samples - 1, *rng.integers(0, tube.samples, 4)}
    rounded = 1e-14 * tube.sizes.sum() * np.array([tube.sample**2, tube.sample, 1.0])
    for sample in samples & set(range(tube.samples)):
        for piece in (0, 1, int(rng.integers(2, PIECES)), PIECES):
            time = tube.grid.start + (sample + piece / PIECES) * tube.sample
            radii = np.array([tube.position(time), tube.velocity(time), tube.acceleration(time)])
            found = oracle.supports(sample, piece)
            if piece == PIECES:  # the next sample's feedback begins at that time
                radii[FEEDBACK], found[FEEDBACK] = 0.0, 0.0
            assert np.all((1.0 - AGREES) * radii <= found + rounded)
            assert np.all(found <= (1.0 + ROUNDING) * radii + rounded)


@pytest.mark.parametrize("pieces", [8, 32, 128])
def test_finer_pieces_converge_with_the_square_of_their_length(pieces: int) -> None:
    """The remaining difference is therefore that of the pieces, and not one of the two models."""
    for seed in range(12):
        tube, oracle = _drawn(seed)
        finer = dataclasses.replace(oracle, pieces=pieces)
        found = finer.supports(tube.samples - 1, pieces)[:2]
        radii = np.array([tube.position(tube.grid.end), tube.velocity(tube.grid.end)])
        assert np.all(np.abs(1.0 - found / radii) <= 1.0 / pieces**2)


def test_a_wrong_delay_or_gain_is_detected() -> None:
    """The comparison has an effect: slightly different models do not agree."""
    for seed in range(12):
        tube, oracle = _drawn(seed)
        last, radius = tube.samples - 1, float(tube.position(tube.grid.end))
        for other in (
            dataclasses.replace(oracle, delay=oracle.delay + 1),
            dataclasses.replace(oracle, gains=(0.7 * oracle.gains[0], 0.7 * oracle.gains[1])),
        ):
            if tube.samples > oracle.delay + 2:
                assert abs(other.supports(last, PIECES)[POSITION] / radius - 1.0) > AGREES
