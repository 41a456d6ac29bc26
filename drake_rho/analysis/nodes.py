"""Nodes of branch and bound: sets of motions, each with a bound that its multipliers prove."""

from __future__ import annotations

import dataclasses
from typing import Self, TypeVar

import numpy as np

from drake_rho.analysis.lagrangian import Proposal
from drake_rho.analysis.sides import Branch, Multipliers, Where
from drake_rho.analysis.terms import AffineTerms, CurvedTerms
from drake_rho.scenario.fields import FloatArray, IntArray

_Terms = TypeVar("_Terms", CurvedTerms, AffineTerms)


@dataclasses.dataclass(frozen=True, eq=False)
class Node:
    """Set of motions on given sides, with a lower bound on their costs."""

    branch: Branch
    """sides of all its motions"""
    bound: float
    """lower bound on their costs [m²/s⁴]"""
    curved: CurvedTerms
    """terms of obstacles and separations in its Lagrangian; vehicles are numbered in the group"""
    affine: AffineTerms
    """terms of convex constraints and sides"""
    weights: FloatArray
    """multipliers λ of the former, shape (S,)"""
    multipliers: FloatArray
    """multipliers y of the latter, shape (R,)"""
    at: FloatArray
    """changes v of the relaxed problem's solution, shape (M, 3)"""
    unit: float
    """unit of the motions about which the terms are [m/s²]"""
    plans: tuple[FloatArray, ...] = ()
    """changes v of known plans among its motions, each of shape (M, 3)"""
    vain: bool = False
    """whether no plan was found on wider sides of the same places"""

    @classmethod
    def proposed(cls, proposal: Proposal) -> Self:
        """Return the node of all motions of a group, without a bound so far."""
        lagrangian = proposal.lagrangian
        group, given = lagrangian.changes.group, (proposal.weights, proposal.multipliers)
        curved, affine = _in(group, lagrangian.curved), _in(group, lagrangian.affine)
        at = proposal.solution
        return cls({}, 0.0, curved, affine, *given, at, lagrangian.changes.unit)

    @property
    def by_place(self) -> Multipliers:
        """Multipliers of obstacles, separations and sides, with their places."""
        curved, sides = self.curved, self.affine.select(self.affine.kept)
        weights = self.weights * curved.sizes
        sizes = np.concatenate([weights, self.multipliers[self.affine.kept]])
        return Multipliers(
            np.concatenate([curved.vehicles, sides.vehicles]),
            np.concatenate([curved.partners, sides.partners]),
            np.concatenate([curved.obstacles, np.full(len(sides), -1)]),
            np.concatenate([curved.times, sides.times]),
            sizes / max(float(sizes.sum()), np.finfo(float).tiny),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Split:
    """Result of splitting a node."""

    parts: tuple[Node, ...]
    """nodes that contain all its motions; none if nothing is left to split"""
    where: Where | None = None
    """where it was split; None if there are no parts, or one with the same motions"""
    time: float = 0.0
    """time of the split since the first knot [s]"""
    scales: FloatArray = dataclasses.field(default_factory=lambda: np.ones(3))
    """scales of the cones there [m], shape (3,)"""
    found: FloatArray | None = None
    """accelerations of a plan on its sides [m/s²], shape (G, K-1, 3); None if none was found"""


def _in(group: IntArray, terms: _Terms) -> _Terms:
    """Return terms whose vehicles are numbered in a group."""
    one, other = np.searchsorted(group, terms.vehicles), np.searchsorted(group, terms.partners)
    return dataclasses.replace(terms, vehicles=one, partners=other)
