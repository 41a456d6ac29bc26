"""Keep out of each other: pairs of vehicles, linearised around a reference of all of them.

The way from one vehicle of a pair to the other keeps out of the separation's ellipsoid. Which
pairs come close is asked of k-d trees, never of all pairs.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import VIOLATED, HalfSpaces, Quadratic
from drake_rho.planning.constraints.close_pairs import (
    most_beside,
    pairs_within,
    separation_of,
    too_close,
)
from drake_rho.planning.constraints.coupling import Coupling
from drake_rho.planning.constraints.keep_out import EvaluationPoints, KeepOut, side_of
from drake_rho.planning.constraints.margins import Margins, PlanMargins
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity, Separation
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.scenario.shapes.quadrics import Ellipsoid

NAME = "separation"

NEAR = 1.3
"""Pairs within so many times the separation at a knot of the reference have rows there. Who comes
nearer to others than that is found between rounds, and in the next linearisation."""

GRAZING = 1.1
"""Times the separation within which closest approaches of the reference between its knots have
rows; where these may be broken at a cost, only those that are too close."""

ROOM = 1.02
"""Times the separation that rows ask for while they may be broken: room for what a slack gives
away, and for what comes closer between knots."""


PAIRS = ("pairs",)
"""Key of the constraint of all pairs."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepApart(KeepOut):
    """The separation of all pairs."""

    shape: Ellipsoid
    """S"""
    kept: Separation
    """what is judged; `shape` may ask for more"""
    points: EvaluationPoints
    """where its rows are asked for in any case, each vehicle's neighbours in time together"""
    responsibility: float
    """s, 1 or 1/2: part of what the reference leaves between two that a row gives to one of them"""
    margins: Margins
    """what both vehicles of a pair keep from the shape beside, each for itself: half of r"""
    one_normal: bool = False
    """whether each close encounter of the reference gets one direction all along"""

    def radius(self, times: FloatArray) -> FloatArray:
        """Return the sum of both margins [m], at times since the first knot [s], shape (R,)."""
        radii: FloatArray = 2.0 * self.margins.at("position", times)
        return radii

    def offsets(self, motion: Motion, points: EvaluationPoints) -> FloatArray:
        """Return positions of the vehicles relative to their partners."""
        return self._difference(motion, "position", points)

    def ways(self, points: EvaluationPoints) -> FloatArray:
        """Return the reference's velocities of the vehicles relative to their partners."""
        return self._difference(self.reference, "velocity", points)

    def _difference(
        self, motion: Motion, quantity: Quantity, points: EvaluationPoints
    ) -> FloatArray:
        one = motion.each_at(quantity, points.vehicles, points.times)
        other = motion.each_at(quantity, points.partners, points.times)
        difference: FloatArray = one - other
        return difference

    def penetrations(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return points where a pair, one of it among `vehicles`, is closer than the separation."""
        between = self.every_instant
        return points_of(too_close(self.kept, motion, self.margins, between=between, of=vehicles))

    def violated_at_knots(self, motion: Motion, vehicles: IntArray, reach: int) -> HalfSpaces:
        """Return violated rows at `points`, without neighbours: rows that couple are expensive."""
        rows = self._asked
        if len(vehicles) < len(motion.positions) and len(rows) > 0:
            asked = np.zeros(len(motion.positions), dtype=bool)
            asked[vehicles] = True
            due = asked[rows.vehicles]
            if self.coupled:
                due |= asked[rows.partners]
            rows = rows.select(due)
        if len(rows) == 0:
            return rows
        return rows.select(rows.margins(motion) < -VIOLATED * rows.tolerances)

    @cached_property
    def _asked(self) -> HalfSpaces:
        """The rows at `points`."""
        return self.rows(self.points)

    def directions(self, points: EvaluationPoints) -> FloatArray:
        """Return unit normals of rows, from S towards the offset from the partner, (R, 3).

        Along that way in the space in which S is a ball. Where something is added to S, and the
        reference would not keep such a row, from the nearest point of S, so that it does if it
        keeps r.

        Where the two are in one place, across their relative way. Where they meet too closely for
        that to be a way past each other, it can be one direction all along an encounter instead:
        across their relative way, on the side on which they pass anyway or, where they meet
        head-on, on one that depends on that way alone, so that two mirror images choose the same.
        """
        x = self.shape.scaled(self.offsets(self.reference, points))
        distances = np.sqrt(np.einsum("ri,ri->r", x, x))
        directions: FloatArray = x / np.maximum(distances, 1e-300)[:, None]
        at_centre = np.flatnonzero(distances <= self.kept.tolerance)
        if len(at_centre) > 0:
            ways = self.shape.scaled(self.ways(points.select(at_centre)))
            directions[at_centre] = side_of(np.zeros_like(ways), ways)
        if self.one_normal:
            close = distances < self.kept.distance
            rows, numbers = _encounters(points, close, self.reference.step)
            order = np.lexsort((distances[rows], numbers))
            nearest = rows[order[np.flatnonzero(np.diff(numbers[order], prepend=-1))]]
            ways = self.shape.scaled(self.ways(points.select(nearest)))
            directions[rows] = side_of(x[nearest], ways)[numbers]
        normals: FloatArray = directions * self.shape.scales
        normals /= np.sqrt(np.einsum("ri,ri->r", normals, normals))[:, None]
        if self.margins.most > 0.0 and not (self.kept.is_round or self.one_normal):
            offsets = self.offsets(self.reference, points)
            reach = self.shape.support(normals) + self.radius(points.times)
            short = np.einsum("ri,ri->r", normals, offsets) < reach
            short &= distances > self.shape.radius
            normals[short] = self.shape.outward(offsets[short])
        return normals

    def rows(self, points: EvaluationPoints) -> HalfSpaces:
        """One row for each pair, or two, sorted by vehicle, partner and time."""
        directions = self.directions(points)
        if self.coupled:
            return self._write(points, directions, None)
        one = self.reference.each_at("position", points.vehicles, points.times)
        other = self.reference.each_at("position", points.partners, points.times)
        between = self.responsibility * (other - one)
        rows = self._write(points, directions, one + between)
        swapped = EvaluationPoints(points.partners, points.vehicles, points.times)
        rows = rows.union(self._write(swapped, -directions, other - between))
        return rows.select(np.lexsort((rows.times, rows.partners, rows.vehicles)))

    def _write(
        self, points: EvaluationPoints, normals: FloatArray, anchors: FloatArray | None
    ) -> HalfSpaces:
        """Rows with given normals.

        Args:
            points: where.
            normals: as from `directions`, shape (R, 3).
            anchors: q - s x_q [m], shape (R, 3); None for rows about a difference.
        """
        reach = self.shape.support(normals) + self.radius(points.times)
        bounds = supports = self.responsibility * reach
        if anchors is not None:
            bounds = supports + np.sum(normals * anchors, axis=1)
        return HalfSpaces(
            self,
            points.vehicles,
            points.partners,
            sides=np.zeros(len(points), dtype=int),
            times=points.times,
            normals=normals,
            bounds=bounds,
            tolerances=TOLERANCE * supports,
        )

    def quadratics(self, rows: HalfSpaces) -> Quadratic | None:
        """Scaled distances of vehicles from their partners, at least the separation."""
        radii = self.radius(rows.times)
        axes = self.shape.semi_axes + radii[:, None]  # inside of the set that is kept out of
        sizes = axes[:, 0]
        return Quadratic(
            centers=np.zeros((len(rows), 3)),
            scales=sizes[:, None] / axes,
            sizes=sizes,
            lengths=sizes / np.linalg.norm(rows.normals * axes, axis=1),
        )

    def renewed(self, rows: HalfSpaces) -> HalfSpaces:
        """Rows of the same pairs at the same knots, or closest approaches next to them."""
        own = self._asked
        return own.select(np.isin(self._by_knot(own), self._by_knot(rows)))

    def _by_knot(self, rows: HalfSpaces) -> IntArray:
        count, knots = self.reference.positions.shape[:2]
        k = np.rint(rows.times / self.reference.step).astype(int)
        one, other = np.sort([rows.vehicles, rows.partners], axis=0)
        numbers: IntArray = (one * count + other) * knots + k
        return numbers

    def detail(self, rows: HalfSpaces, names: Sequence[str]) -> str:
        """Return the partners, as in ' from v1, v2'."""
        others = np.unique(np.concatenate([rows.partners, rows.vehicles]))
        own = rows.vehicles[0]
        return f" from {', '.join(names[other] for other in others if other != own)}"


def pairs_of(
    scenario: Scenario,
    margins: PlanMargins,
    reference: Motion,
    coupling: Coupling,
    *,
    penalty: float = np.inf,
    one_normal: bool = False,
    rounds: int = sys.maxsize,
    of: IntArray | None = None,
    close: CloseApproaches | None = None,
) -> KeepApart:
    """Return the constraint of all pairs, linearised around a motion of the vehicles.

    Args:
        scenario: what is asked.
        margins: how far inside of it plans keep.
        reference: q.
        coupling: how rows are written.
        penalty: cost of each metre by which a row is broken.
        one_normal: whether each close encounter of the reference gets one direction all along.
        rounds: in how many rounds broken rows at the knots are added.
        of: vehicles of which each pair has one or two, rising indices; all if not given.
        close: those of the reference that are too close, where that is known and all that counts
            between its knots, since rows may be broken.
    """
    separation, soft = separation_of(scenario), np.isfinite(penalty)
    reference = reference.subdivided(margins.pieces)
    kept = separation.distance + most_beside(separation, margins.inner)
    near = pairs_within(separation, reference, NEAR * kept, between=False, of=of)
    if close is None:
        within, between = kept * (1.0 if soft else GRAZING), scenario.between_knots
        close = pairs_within(separation, reference, within, between=between, of=of)
    shape = separation.shape
    if soft:
        shape = Ellipsoid(shape.center, ROOM * shape.semi_axes)
    return KeepApart(
        kind="separation",
        key=PAIRS,
        obstacle_number=0,
        name=NAME,
        quantity="position",
        penalty=penalty,
        rounds=rounds,
        coupled=coupling.together,
        shape=shape,
        kept=separation,
        margins=margins.inner,
        pieces=margins.pieces,
        responsibility=coupling.responsibility,
        one_normal=one_normal,
        reference=reference,
        points=points_of(near.union(close)),
        searches=1 if soft else sys.maxsize,
        every_instant=scenario.between_knots,
    )


def points_of(found: CloseApproaches) -> EvaluationPoints:
    """Return the points where pairs are close."""
    return EvaluationPoints(found.one, found.other, found.times)


def _encounters(
    points: EvaluationPoints, close: BoolArray, step: float
) -> tuple[IntArray, IntArray]:
    """Return the close points, as indices, and the number of the encounter of each.

    Close points of a pair that follow each other are one encounter.
    """
    rows = np.flatnonzero(close)
    follows = np.diff(points.vehicles[rows], prepend=-1) == 0
    follows &= np.diff(points.partners[rows], prepend=-1) == 0
    follows &= np.diff(points.times[rows], prepend=-np.inf) < 1.5 * step
    return rows, np.cumsum(~follows) - 1
