"""Errors of a vehicle under sampled feedback, integrated by hand: a twin of the tube's mathematics.

The equations are p'' = u + w and the sampled feedback; no code of the library is used.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Loop:
    """Feedback law u = -k_p e_p - k_v e_v on a state known from measurements `delay` samples ago.

    If it is predicted, the newest measurement that has arrived is propagated to the present by the
    feedback since; otherwise the feedback uses the measurement of `delay` samples ago itself.
    """

    gains: tuple[float, float]
    sample: float
    delay: int
    samples: int
    predicted: bool = True

    def is_stable(self) -> bool:
        """Return whether errors decay.

        They do if the roots of z^d (z - 1)² + (α/2 + β) z + α/2 - β are in the unit disc, with
        d = 0 if the state is predicted.
        """
        alpha, beta = self.gains[0] * self.sample**2, self.gains[1] * self.sample
        polynomial = np.concatenate(
            [[1.0, -2.0, 1.0], np.zeros(0 if self.predicted else self.delay)]
        )
        polynomial[-2:] += alpha / 2.0 + beta, alpha / 2.0 - beta
        return bool(np.abs(np.roots(polynomial)).max() < 1.0)


def fly(
    loop: Loop,
    times: Array,
    wind: Array,
    position_errors: Array,
    velocity_errors: Array,
    position: Array,
    velocity: Array,
    lost: NDArray[np.bool_] | None = None,
) -> tuple[Array, Array, Array]:
    """Return errors of position and velocity at `times`, (B, ...), and the feedback, (J, ...).

    Args:
        loop: the feedback.
        times: increasing from 0, every sample among them, shape (B,).
        wind: from each time to the next, shape (B - 1, ...).
        position_errors: at every sample, shape (J, ...).
        velocity_errors: at every sample, shape (J, ...).
        position: initial error, shape (...).
        velocity: initial error, shape (...).
        lost: whether the measurement of each sample is lost, shape (J,); none is if not given.
    """
    p, v, measured = position, velocity, list[tuple[Array, Array]]()
    arrives = np.ones(loop.samples, dtype=bool) if lost is None else ~lost
    feedback = list[Array]()
    positions, velocities = [p], [v]
    u = np.zeros_like(p)
    for k in range(len(times) - 1):
        j = round(float(times[k]) / loop.sample)
        if j == len(feedback) and abs(times[k] - j * loop.sample) < 1e-9 * loop.sample:
            measured.append((p + position_errors[j], v + velocity_errors[j]))
            u = _feedback(loop, measured, feedback, arrives)
            feedback.append(u)
        s, a = times[k + 1] - times[k], u + wind[k]
        p, v = p + s * v + s**2 / 2.0 * a, v + s * a
        positions.append(p)
        velocities.append(v)
    assert len(feedback) == loop.samples
    return np.array(positions), np.array(velocities), np.array(feedback)


def _feedback(
    loop: Loop,
    measured: list[tuple[Array, Array]],
    feedback: list[Array],
    arrives: NDArray[np.bool_],
) -> Array:
    """Return the feedback of sample j from the measurements of samples 0 to j."""
    j = len(measured) - 1
    known = [k for k in range(j - loop.delay + 1) if arrives[k]]
    if not known:
        return np.zeros_like(measured[0][0])
    (p, v), h = measured[known[-1]], loop.sample
    for u in feedback[known[-1] :] if loop.predicted else []:
        p, v = p + h * v + h**2 / 2.0 * u, v + h * u
    return np.asarray(-loop.gains[0] * p - loop.gains[1] * v)


def fine_times(loop: Loop, parts: int) -> Array:
    """Return times that divide every sample into equal parts."""
    return np.asarray(loop.sample / parts * np.arange(loop.samples * parts + 1))


def summed_responses(
    loop: Loop,
    parts: int,
    sizes: tuple[float, float, float, float, float],
    lost: NDArray[np.bool_] | None = None,
) -> tuple[Array, Array, Array]:
    """Return radii of position and velocity at fine times, and of the feedback, by brute force.

    Every cause is integrated separately: wind in each part of each sample, each error of the
    estimate, each initial error. The norms of their effects are added up.

    Args:
        loop: the feedback.
        parts: number of parts of a sample.
        sizes: bounds of wind, of errors of position and velocity, and of both initially, SI.
        lost: as for `fly`.
    """
    times, J = fine_times(loop, parts), loop.samples
    winds = J * parts
    causes = winds + 2 * J + 2
    wind, n_p, n_v = np.zeros((winds, causes)), np.zeros((J, causes)), np.zeros((J, causes))
    first_p, first_v = np.zeros(causes), np.zeros(causes)
    wind[np.arange(winds), np.arange(winds)] = sizes[0]
    n_p[np.arange(J), winds + np.arange(J)] = sizes[1]
    n_v[np.arange(J), winds + J + np.arange(J)] = sizes[2]
    first_p[-2], first_v[-1] = sizes[3], sizes[4]
    flown = fly(loop, times, wind, n_p, n_v, first_p, first_v, lost)
    p, v, u = (np.abs(each).sum(axis=1) for each in flown)
    return p, v, u
