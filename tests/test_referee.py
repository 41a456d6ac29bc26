"""Trajectories of other planners, judged at every instant: polynomials exactly, samples in bounds.

Random polynomials are judged beside dense samples of them, computed here by Horner's rule.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

import drake_rho as rho

Array = np.ndarray[Any, np.dtype[np.float64]]

ROUNDING = 1e-9
"""Relative difference of values computed in two ways."""
DENSE = 401
"""Samples of each piece beside which it is judged."""


def drake(instants: Array, coefficients: Array) -> PiecewisePolynomial:
    """Return a trajectory of Drake from coefficients of shape (J, 3, D + 1)."""
    pieces = [np.array([[Polynomial(axis)] for axis in piece]) for piece in coefficients]
    return PiecewisePolynomial(pieces, instants)


def values(instants: Array, coefficients: Array, order: int) -> tuple[Array, Array]:
    """Return dense times (M,) and values of a derivative (N, M, 3), by Horner's rule."""
    c = coefficients
    for _ in range(order):
        c = c[..., 1:] * np.arange(1.0, c.shape[-1])
    s = np.diff(instants)[:, None] * np.linspace(0.0, 1.0, DENSE)
    found = np.zeros((*c.shape[:3], DENSE))
    for k in range(c.shape[-1] - 1, -1, -1):
        found = found * s[:, None] + c[..., k, None]
    times = (instants[:-1, None] + s).reshape(-1)
    return times, np.moveaxis(found, 2, 3).reshape(len(c), -1, 3)


def field(vehicles: int, seconds: float) -> rho.Scenario:
    """Return a scenario with boxes, norms, obstacles at rest and in motion, and a separation."""
    corner = [(-3.9, -3.5 + 0.7 * n, -3.9) for n in range(vehicles)]
    box = rho.Box((-4.0, -4.0, -4.0), (4.0, 4.0, 4.0))
    moving = rho.Track([0.0, seconds / 3.0, seconds], [(-3, 2, 3), (0, 3, 3), (3, 2, 0)])
    return rho.Scenario(
        name="field",
        grid=rho.Grid(seconds / 8.0, 9),
        vehicles=tuple(
            rho.Vehicle(f"v{n}", rho.State(at), rho.State(at)) for n, at in enumerate(corner)
        ),
        limits=rho.Limits(
            position=box,
            velocity=box,
            acceleration=box,
            jerk=box,
            max_speed=4.0,
            max_jerk=9.0,
            max_tilt=0.5,
        ),
        obstacles=(
            rho.Sphere((2.0, 1.0, 0.0), 1.0),
            rho.Ellipsoid((-2.0, 0.0, 1.0), (0.5, 1.0, 2.0)),
            rho.Obstacle(rho.Box((-0.5, -0.3, -0.3), (0.5, 0.3, 0.3)), track=moving),
        ),
        separation=rho.Separation(0.5, downwash=2.0) if vehicles > 1 else None,
        requirements=(
            rho.KeepIn(rho.Ball((0.0, 0.0, 0.0), 7.0), name="ball"),
            rho.KeepIn(rho.Ball((0.0, 0.0, 0.0), 3.0), of="velocity", name="slow"),
        ),
    )


def random_pieces(rng: np.random.Generator, vehicles: int, pieces: int) -> tuple[Array, Array]:
    """Return instants (J + 1,) and coefficients (N, J, 3, D + 1) of pieces that do not join."""
    durations, degree = rng.uniform(0.1, 2.0, pieces), int(rng.integers(0, 8))
    instants = np.append(0.0, np.cumsum(durations))
    c = rng.normal(size=(vehicles, pieces, 3, degree + 1)) * rng.choice([0.1, 1.0, 3.0])
    return instants, c / durations[:, None, None] ** np.arange(degree + 1.0)


def dense_excess(scenario: rho.Scenario, instants: Array, c: Array) -> dict[tuple[str, str], Array]:
    """Return the largest excess of each vehicle at dense samples, by constraint, shape (N,)."""
    found: dict[tuple[str, str], Array] = {}
    times, p = values(instants, c, 0)
    for order, quantity in enumerate(("position", "velocity", "acceleration", "jerk")):
        x = values(instants, c, order)[1] if c.shape[-1] > order else np.zeros_like(p)
        found[quantity, "box"] = (np.abs(x) - 4.0).max(axis=(1, 2))
        if quantity == "velocity":
            found["max_speed", ""] = np.linalg.norm(x, axis=2).max(axis=1) - 4.0
            found["requirements", "slow"] = np.linalg.norm(x, axis=2).max(axis=1) - 3.0
    found["requirements", "ball"] = np.linalg.norm(p, axis=2).max(axis=1) - 7.0
    for number, body in enumerate(scenario.bodies, start=1):
        x = p - body.centers(times)
        found["obstacles", str(number)] = -body.shape.local_distance(x).min(axis=1)
    if scenario.separation is not None:
        scaled = p / [1.0, 1.0, scenario.separation.downwash]
        apart = np.linalg.norm(scaled[:, None] - scaled, axis=3)
        apart[np.arange(len(p)), np.arange(len(p))] = np.inf
        found["separation", ""] = 0.5 - apart.min(axis=(1, 2))
    return found


def wrong(scenario: rho.Scenario, instants: Array, c: Array) -> list[str]:
    """Return checks of random pieces that a dense sample exceeds, or that no instant attains."""
    named = {f"v{n}": drake(instants, each) for n, each in enumerate(c)}
    report = rho.verify(rho.Trajectories.of(named), scenario)
    dense, bad = dense_excess(scenario, instants, c), list[str]()
    for (kind, word), excess in dense.items():
        for n in range(len(c)):
            checks = [
                each
                for each in report.checks
                if each.kind == kind and word in each.what and each.vehicle == f"v{n}"
            ]
            worst = max(checks, key=lambda each: each.excess)
            size = 1.0 + abs(worst.value) + float(np.abs(c).max())
            below = excess[n] - worst.excess
            if not below <= 0.02 * worst.tolerance + ROUNDING * size:
                bad.append(f"{worst}: a sample exceeds it by {below}")
            # the largest of the samples is near the largest value
            if not -below <= 1e-3 * size * c.shape[-1] ** 2:
                bad.append(f"{worst}: no sample is near, by {below}")
    return bad
