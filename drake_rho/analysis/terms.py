"""Terms of a Lagrangian: constraints as quadratic and linear functions of a group's changes.

Changes u of the motion of least cost are in coordinates of order one (`Changes`). Those that leave
the final states unchanged are u = F v with orthonormal columns F, so the cost is norm(v)² more.
Rows of convex constraints are linear in v. Sets to keep out of have quadratic terms: of the balls
or ellipsoids themselves, or of balls inside other shapes (`Constraint.quadratics`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, get_args

import numpy as np
from scipy.linalg import block_diag, null_space

from drake_rho.analysis.shared_multipliers import Slacks
from drake_rho.motion.costs import costs_of
from drake_rho.planning.constraints.base import HalfSpaces, Quadratic, about
from drake_rho.planning.constraints.margins import Margins
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.reduced import rows_of
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.system.table import Table

QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
"""Quantities that rows bound."""


@dataclasses.dataclass(frozen=True, eq=False)
class CurvedTerms(Table):
    """Terms λ_s (R_s² - norm(p_s(v) - c_s)²) / (2 R_s), of obstacles and separations."""

    responses: FloatArray
    """position at each instant as a linear map of v on each axis [m], shape (S, M)"""
    offsets: FloatArray
    """position for v = 0, relative to the centre or the partner [m], shape (S, 3)"""
    scales: FloatArray
    """factor on each axis: 1, except for ellipsoids, shape (S, 3)"""
    radii: FloatArray
    """radius R of the ball, or the separation [m], shape (S,)"""
    sizes: FloatArray
    """multiplier of a row of length one for λ = 1; infinite where there is no term: of sets without
    an interior, and of vehicles outside of the group, shape (S,)"""
    slacks: IntArray
    """number of the slack of soft limits, -1 for hard limits, shape (S,)"""
    parts: FloatArray
    """part of the price for λ = 1, shape (S,)"""
    obstacles: IntArray
    """number of the obstacle, from 1; 0 for a separation, shape (S,)"""
    vehicles: IntArray
    """index of the vehicle in the scenario, shape (S,)"""
    partners: IntArray
    """index of the other vehicle, or of the same one, shape (S,)"""
    sides: IntArray
    """number of the part of a map, shape (S,)"""
    times: FloatArray
    """time since the first knot [s], shape (S,)"""
    centers: FloatArray
    """centre of the ball [m], shape (S, 3); zero for a separation"""


@dataclasses.dataclass(frozen=True, eq=False)
class AffineTerms(Table):
    """Terms y_r (b_r - A_r · v), of convex constraints, with rows of length one."""

    matrix: FloatArray
    """rows A, shape (R, M, 3)"""
    lower: FloatArray
    """bounds b, shape (R,)"""
    slacks: IntArray
    """number of the slack of soft limits, -1 for hard limits, shape (R,)"""
    parts: FloatArray
    """part of the price for y = 1, shape (R,)"""
    kept: BoolArray
    """whether the term stays where its multiplier is zero, shape (R,)"""
    quantities: IntArray
    """index of the quantity that the row bounds in `QUANTITIES`, shape (R,)"""
    vehicles: IntArray
    """index of the vehicle in the scenario, shape (R,)"""
    partners: IntArray
    """index of the other vehicle, or of the same one, shape (R,)"""
    times: FloatArray
    """time since the first knot [s], shape (R,)"""
    normals: FloatArray
    """unit normal of the half-space, shape (R, 3)"""
    bounds: FloatArray
    """least value along the normal, in the quantity's unit, shape (R,)"""


class GroupChanges:
    """Changes v of a group of G vehicles, and the terms of rows about them.

    Args:
        problem: problem of the scenario.
        group: indices of the vehicles, shape (G,).
        as_planned: whether rows are tightened by the planners' margins, or by the error radii at
            their instants only, as for all plans.

    Attributes:
        group: indices of the vehicles, shape (G,).
        unit: unit of u [m/s²].
        free: basis F of changes that leave the final states unchanged, shape (G (K-1), M).
        least: cost of the motions of least cost, over unit².
    """

    def __init__(self, problem: Problem, group: IntArray, *, as_planned: bool = True) -> None:
        effort = problem.effort
        changes = effort.changes
        self.group, self.unit = group, float(changes.units[group].max())
        costs = costs_of(problem.scenario, effort.motion)[group]
        self.least = float(costs.sum()) / self.unit**2
        spaces = [changes.space(vehicle) for vehicle in group.tolist()]
        self.free = block_diag(*(null_space(each.goals) for each in spaces))
        self._problem, self._as_planned, self._slacks = problem, as_planned, Slacks()
        if problem.scenario.penalties:  # number their slacks in the same order in every process
            for each in (*problem.convex, *problem.obstacles_around(effort.motion)):
                if each.prices is not None:
                    self._slacks.number(each.key, len(problem))
        self._scale = self.unit * changes.factors_of(group)[:, None, None]

    def of(self, accelerations: FloatArray) -> FloatArray:
        """Return v of accelerations of the group [m/s²], shape (M, 3)."""
        effort = self._problem.effort
        added = accelerations - effort.motion.accelerations[self.group]
        u = (effort.changes.coordinates(added, self.group) / self._scale).reshape(-1, 3)
        return np.asarray(self.free.T @ u)

    def accelerations(self, v: FloatArray) -> FloatArray:
        """Return the accelerations of the group for v, shape (M, 3) [m/s²], (G, K-1, 3)."""
        effort = self._problem.effort
        u = self._scale * (self.free @ v).reshape(len(self.group), -1, 3)
        added = effort.changes.accelerations(u, self.group)
        return np.asarray(effort.motion.accelerations[self.group] + added)

    @property
    def nothing(self) -> tuple[CurvedTerms, AffineTerms]:
        """Empty terms."""
        width, none, whole = self.free.shape[1], np.zeros(0), np.zeros(0, dtype=int)
        vectors, rows = np.zeros((0, 3)), np.zeros((0, width))
        where = whole, whole, whole, whole
        curved = CurvedTerms(rows, vectors, vectors, none, none, whole, none, *where, none, vectors)
        of = whole, whole, whole, none, vectors, none
        affine = AffineTerms(np.zeros((0, width, 3)), none, whole, none, none.astype(bool), *of)
        return curved, affine

    def terms(self, found: Iterable[HalfSpaces]) -> tuple[CurvedTerms, AffineTerms]:
        """Return the terms of rows of some constraints."""
        curved, affine = self.nothing
        for planned in found:
            rows = planned if self._as_planned else _at_instants(planned)
            quadratic = rows.constraint.quadratics(rows)
            if quadratic is not None:
                curved = curved.union(self._curved(rows, quadratic))
            elif not rows.constraint.linearised:
                affine = affine.union(self.affine(rows))
        return curved, affine

    def affine(self, rows: HalfSpaces, *, kept: bool = False) -> AffineTerms:
        """Return the terms of rows that are linear in v without a linearisation.

        Args:
            rows: rows of one form.
            kept: whether the terms stay where their multipliers are zero.
        """
        effort = self._problem.effort
        about_effort = about(effort.motion, [rows])
        matrix, lower, penalties = rows_of(effort.changes, self.group, about_effort)
        by_axis = matrix.toarray().reshape(len(rows), -1, 3)
        reduced = np.einsum("rua,um->rma", by_axis, self.free)
        shared = self._slacks.of(rows, 1.0 / penalties)
        return AffineTerms(
            reduced,
            lower,
            shared.labels,
            shared.parts,
            np.full(len(rows), kept),
            np.full(len(rows), QUANTITIES.index(rows.form.quantity)),
            rows.vehicles,
            rows.partners,
            rows.times,
            rows.normals,
            rows.bounds,
        )

    def _curved(self, rows: HalfSpaces, quadratic: Quadratic) -> CurvedTerms:
        """Return the terms of rows of an obstacle or of a separation."""
        effort, group = self._problem.effort, self.group
        changes, motion = effort.changes, effort.motion
        place = np.full(len(changes.units), -1)
        place[group] = np.arange(len(group))
        responses = self.unit * rows.responses(effort.grid)
        offsets = motion.each_at("position", rows.vehicles, rows.times) - quadratic.centers
        blocks = np.zeros((len(rows), len(group), responses.shape[1]))
        own = changes.factors_of(rows.vehicles)[:, None]
        blocks[np.arange(len(rows)), place[rows.vehicles]] = own * changes.whitened(
            responses, rows.vehicles
        )
        if np.any(rows.partners != rows.vehicles):
            offsets -= motion.each_at("position", rows.partners, rows.times)
            other = changes.factors_of(rows.partners)[:, None]
            blocks[np.arange(len(rows)), place[rows.partners]] = -other * changes.whitened(
                responses, rows.partners
            )
        matrix = blocks.reshape(len(rows), -1)
        lengths = np.linalg.norm(matrix, axis=1) * quadratic.lengths
        # leaving out terms lowers the bound
        lengths[~np.isin(rows.partners, group) | (quadratic.sizes <= 0.0)] = np.inf
        parts = self.unit**2 * quadratic.scales.max(axis=1) / rows.penalties
        shared = self._slacks.of(rows, parts)
        numbers = rows.constraint.obstacles
        return CurvedTerms(
            matrix @ self.free,
            offsets,
            quadratic.scales,
            np.where(np.isfinite(lengths), quadratic.sizes, 1.0),
            lengths,
            shared.labels,
            shared.parts,
            np.full(len(rows), next(iter(numbers))),
            rows.vehicles,
            rows.partners,
            rows.sides,
            rows.times,
            quadratic.centers,
        )


def _at_instants(rows: HalfSpaces) -> HalfSpaces:
    """Return rows tightened by the error radii at their times, not by the planners' margins.

    Every plan that satisfies the tightened constraints keeps these rows.
    """
    constraint = rows.constraint
    margins = getattr(constraint, "margins", None)
    if not isinstance(margins, Margins) or margins.tube is None:
        return rows
    exact = margins.pointwise
    if constraint.linearised:  # its quadratics are computed from its margins
        changes: dict[str, Any] = {"margins": exact}  # not all constraints have such a field
        changed = dataclasses.replace(constraint, **changes)
        return dataclasses.replace(rows, form=changed)
    more = margins.at(constraint.quantity, rows.times) - exact.at(constraint.quantity, rows.times)
    vehicles = 2.0 if constraint.coupled else 1.0
    return dataclasses.replace(rows, bounds=rows.bounds - vehicles * more)
