"""Bézier curves of least index through convex regions, one after another."""

from __future__ import annotations

import dataclasses
from math import comb

import numpy as np
from pydrake.geometry.optimization import HPolyhedron
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.interpolate import BPoly
from scipy.optimize import minimize

import drake_rho as rho
from benchmarks.field import Field
from drake_rho.scenario.fields import FloatArray

ORDER = 5
"""Order of the Bézier curve of every piece."""

TIMINGS, SHORTEST = 15, 1e-3
"""Number of durations tried afterwards, for each piece, and the shortest of a piece, over T."""

Limits = tuple[rho.Box | None, rho.Box | None]
"""Limits of velocities and accelerations."""


@dataclasses.dataclass(frozen=True)
class Curve:
    """Piecewise polynomial motion."""

    durations: FloatArray
    """durations of the pieces [s], shape (P,)"""
    points: FloatArray
    """control points of the pieces [m], shape (P, ORDER + 1, 3)"""

    def at(self, times: FloatArray, derivative: int = 0) -> FloatArray:
        """Return positions [m] or a derivative of them by time, shape (M, 3)."""
        ends = np.concatenate([[0.0], np.cumsum(self.durations)])
        curve = BPoly(np.moveaxis(self.points, 1, 0), ends)
        found: FloatArray = (curve.derivative(derivative) if derivative else curve)(times)
        return found

    def cost(self, step: float) -> float:
        """Return the integral of the squared acceleration over `step` [s]: the index f [m²/s⁴]."""
        pieces = zip(self.points, self.durations, strict=True)
        bends = [(_derivation(2) @ points, duration) for points, duration in pieces]
        squares = [np.sum(bend * (_gram() @ bend)) / duration**3 for bend, duration in bends]
        return float(sum(squares)) / step


def durations_by(field: Field, shares: FloatArray) -> FloatArray:
    """Return the durations of the pieces, whose sum is that of the flight [s], shape (P,)."""
    durations: FloatArray = shares * field.duration / shares.sum()
    return durations


def curve(
    field: Field,
    through: list[HPolyhedron],
    durations: FloatArray,
    limits: Limits,
) -> Curve | None:
    """Return the curve of least index through the regions in order, within the limits."""
    program, count = MathematicalProgram(), ORDER + 1
    points = [program.NewContinuousVariables(count, 3) for _ in through]
    for piece, region, duration in zip(points, through, durations, strict=True):
        for point in piece:
            below = np.full(len(region.b()), -np.inf)
            program.AddLinearConstraint(region.A(), below, region.b(), point)
        for order, box in enumerate(limits, start=1):
            if box is not None:
                _keep_in(program, piece, order, duration, box)
        bend = _derivation(2)
        weight = 2.0 / (duration**3 * field.step) * bend.T @ _gram() @ bend
        for axis in piece.T:
            program.AddQuadraticCost(weight, np.zeros(count), axis, is_convex=True)
    _join(program, points, durations)
    for piece, end in ((points[0][:2], field.start), (points[-1][-2:], field.goal)):
        for point in piece:  # two equal control points: at rest
            program.AddLinearEqualityConstraint(np.eye(3), end, point)
    result = ClarabelSolver().Solve(program)
    if not result.is_success():
        return None
    return Curve(durations, np.array([result.GetSolution(piece) for piece in points]))


def _keep_in(
    program: MathematicalProgram, piece: np.ndarray, order: int, duration: float, box: rho.Box
) -> None:
    """Keep the control points of a derivative of a piece in a box, and so all of it."""
    derived = _derivation(order) / duration**order
    ones = np.ones(len(derived))
    for axis, least, most in zip(piece.T, box.lower, box.upper, strict=True):
        program.AddLinearConstraint(derived, least * ones, most * ones, axis)


def _join(program: MathematicalProgram, points: list[np.ndarray], durations: FloatArray) -> None:
    """Add continuity of position and velocity between pieces."""
    for i in range(len(points) - 1):
        first, second = 1.0 / durations[i], 1.0 / durations[i + 1]
        rows = np.array([[0.0, 1.0, -1.0, 0.0], [-first, first, second, -second]])
        for axis in range(3):
            joined = np.concatenate([points[i][-2:, axis], points[i + 1][:2, axis]])
            program.AddLinearEqualityConstraint(rows, np.zeros(2), joined)


def _derivation(order: int) -> FloatArray:
    """Return the map from control points of a piece of 1 s to those of its derivative."""
    matrix = np.eye(ORDER + 1)
    for degree in range(ORDER, ORDER - order, -1):
        matrix = degree * np.diff(matrix, axis=0)
    return matrix


def _gram() -> FloatArray:
    """Return integrals over [0, 1] of products of the Bernstein polynomials of degree ORDER - 2."""
    n = ORDER - 2
    return np.array(
        [
            [comb(n, i) * comb(n, j) / (comb(2 * n, i + j) * (2 * n + 1)) for j in range(n + 1)]
            for i in range(n + 1)
        ]
    )


def retimed(field: Field, through: list[HPolyhedron], first: Curve, limits: Limits) -> Curve:
    """Return a cheaper curve through the same regions with other durations of its pieces."""
    best = first

    def cost(logarithms: FloatArray) -> float:
        nonlocal best
        durations = durations_by(field, np.exp(logarithms))
        if durations.min() < SHORTEST * field.duration:
            return np.inf
        found = curve(field, through, durations, limits)
        if found is None:
            return np.inf
        if found.cost(field.step) < best.cost(field.step):
            best = found
        return float(np.log(found.cost(field.step)))

    if len(through) > 1:
        options = {"maxfev": TIMINGS * len(through), "xtol": 0.02, "ftol": 1e-3}
        with np.errstate(invalid="ignore"):  # where it compares two infinite values
            minimize(cost, np.log(first.durations), method="Powell", options=options)
    return best
