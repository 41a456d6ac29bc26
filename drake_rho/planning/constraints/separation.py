"""Separation of pairs of vehicles: rows that couple both, or one each for half the distance.

The position of a vehicle relative to another one stays outside of the separation's ellipsoid.
Candidate pairs are found with k-d trees; the search never visits all pairs.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from functools import cached_property
from typing import Literal

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches, PairSearch
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import VIOLATED, GivenEnd, HalfSpaces, Quadratic
from drake_rho.planning.constraints.close_pairs import (
    max_pair_margin,
    pairs_within,
    violating_pairs,
)
from drake_rho.planning.constraints.keep_out import EvaluationPoints, KeepOut, side_of
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity, Separation
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.scenario.shapes.quadrics import Ellipsoid


@dataclasses.dataclass(frozen=True)
class Coupling:
    """Form of the rows for pairs of vehicles."""

    name: str
    """name of the coupling, for options and messages"""
    responsibility: float
    """responsibility of one row for the distance between the vehicles of a reference: 1 for a
    single row about their difference, 1/2 for two rows, one for each vehicle"""
    in_groups: bool = False
    """true if references are planned with groups of coupled vehicles"""

    @property
    def together(self) -> bool:
        """True if rows couple vehicles into one program."""
        return self.responsibility == 1.0

    def __repr__(self) -> str:
        return f"drake_rho.{self.name}"


coupled = Coupling("coupled", 1.0)
"""One row for each pair, about the difference of its vehicles, which thus share a program."""

decoupled = Coupling("decoupled", 0.5)
"""Two rows for each pair, one for each vehicle, so that every vehicle has its own program."""

grouped = Coupling("grouped", 0.5, in_groups=True)
"""Decoupled rows around references whose groups with the largest multiplier sums are coupled."""

CouplingName = Literal["coupled", "decoupled", "grouped"]
"""Names of the couplings."""

COUPLINGS = {each.name: each for each in (coupled, decoupled, grouped)}
"""Couplings by name."""


NAME = "separation"

NEAR = 1.3
"""Distance, as a multiple of the separation, within which pairs of the reference have rows at
knots. Other pairs that come close are found between rounds, and in the next linearisation."""

GRAZING = 1.1
"""Distance, as a multiple of the separation, within which closest approaches of the reference
between knots have rows. Soft rows are added for violating approaches only."""

SOFT_ENLARGEMENT = 1.02
"""Factor by which soft rows enlarge the separation, to make up for the slack of rows and for closer
approaches between knots."""

PAIRS = ("pairs",)
"""Key of the constraint of all pairs."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepApart(KeepOut):
    """Separation constraint of all pairs."""

    shape: Ellipsoid
    """ellipsoid S around the partner of a vehicle"""
    required: Separation
    """required separation; `shape` may be larger"""
    search: PairSearch
    """search for close pairs, by the required separation"""
    points: EvaluationPoints
    """points that always have rows, sorted by pair and time"""
    responsibility: float
    """responsibility s of one row for a pair's distance, 1 (coupled) or 1/2"""
    one_normal: bool = False
    """true if all rows of a close encounter of the reference have one normal"""

    @property
    def obstacles(self) -> frozenset[int]:
        """0, which stands for other vehicles."""
        return frozenset({0})

    def radius(self, times: FloatArray) -> FloatArray:
        """Return r, the sum of both margins [m], at times since the first knot [s], shape (R,)."""
        radii: FloatArray = 2.0 * self.margins.at("position", times)
        return radii

    def offsets(self, motion: Motion, points: EvaluationPoints) -> FloatArray:
        """Return positions of the vehicles relative to their partners [m], shape (R, 3)."""
        return self._difference(motion, "position", points)

    def relative_velocities(self, points: EvaluationPoints) -> FloatArray:
        """Return the reference's velocities relative to the partners [m/s], shape (R, 3)."""
        return self._difference(self.reference, "velocity", points)

    def _difference(
        self, motion: Motion, quantity: Quantity, points: EvaluationPoints
    ) -> FloatArray:
        one = motion.each_at(quantity, points.vehicles, points.times)
        other = motion.each_at(quantity, points.partners, points.times)
        difference: FloatArray = one - other
        return difference

    def penetrations(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return points of violating pairs that include at least one of the vehicles."""
        between = self.every_instant
        pairs = violating_pairs(
            self.search,
            motion,
            self.margins,
            between=between,
            of=vehicles,
            open_end=self.open_end,
        )
        return points_of(pairs)

    def violated_at_knots(self, motion: Motion, vehicles: IntArray, neighbours: int) -> HalfSpaces:
        """Return violated rows at `points`, without neighbours: coupling rows are expensive."""
        rows = self._required_rows
        if len(vehicles) < len(motion.positions) and len(rows) > 0:
            checked = np.zeros(len(motion.positions), dtype=bool)
            checked[vehicles] = True
            selected = checked[rows.vehicles]
            if self.coupled:
                selected |= checked[rows.partners]
            rows = rows.select(selected)
        if len(rows) == 0:
            return rows
        return rows.select(rows.margins(motion) < -VIOLATED * rows.tolerances)

    @cached_property
    def _required_rows(self) -> HalfSpaces:
        """Rows at `points`."""
        return self.rows(self.points)

    def directions(self, points: EvaluationPoints) -> FloatArray:
        """Return unit normals of rows, from S towards the offset from the partner, (R, 3).

        The direction is that of the offset in the space in which S is a ball. If the reference
        would violate such a row because of the margins, the normal points from the nearest point
        of S to the offset. The row then holds whenever the reference keeps the distance r.

        If both vehicles are at one position, the normal is orthogonal to their relative velocity.
        With `one_normal`, all rows of a close encounter have one such normal, because the offsets
        of a very close encounter need not separate the paths. It points to the side on which the
        vehicles pass. If they meet head-on, it depends on the relative velocity alone, so that
        two mirror images choose the same side.
        """
        x = self.shape.scaled(self.offsets(self.reference, points))
        distances = np.sqrt(np.einsum("ri,ri->r", x, x))
        directions: FloatArray = x / np.maximum(distances, 1e-300)[:, None]
        at_centre = np.flatnonzero(distances <= self.required.tolerance)
        if len(at_centre) > 0:
            relative = self.shape.scaled(self.relative_velocities(points.select(at_centre)))
            directions[at_centre] = side_of(np.zeros_like(relative), relative)
            x[at_centre] = 0.0  # where rounding errors would choose the side
        if self.one_normal:
            close = distances < self.required.distance
            rows, numbers = _encounters(points, close, self.reference.step)
            order = np.lexsort((distances[rows], numbers))
            nearest = rows[order[np.flatnonzero(np.diff(numbers[order], prepend=-1))]]
            relative = self.shape.scaled(self.relative_velocities(points.select(nearest)))
            directions[rows] = side_of(x[nearest], relative)[numbers]
        normals: FloatArray = directions * self.shape.scales
        normals /= np.sqrt(np.einsum("ri,ri->r", normals, normals))[:, None]
        if self.margins.largest > 0.0 and not (self.required.is_round or self.one_normal):
            offsets = self.offsets(self.reference, points)
            bounds = self.shape.local_support(normals) + self.radius(points.times)
            below = np.einsum("ri,ri->r", normals, offsets) < bounds
            below &= distances > self.shape.radius
            normals[below] = self.shape.local_outward(offsets[below])
        return normals

    def rows(self, points: EvaluationPoints) -> HalfSpaces:
        """Return one row for each point, or two if decoupled, sorted by vehicle, partner, time."""
        directions = self.directions(points)
        if self.coupled:
            return self._write(points, directions, np.zeros(3))
        one = self.reference.each_at("position", points.vehicles, points.times)
        other = self.reference.each_at("position", points.partners, points.times)
        between = self.responsibility * (other - one)
        rows = self._write(points, directions, one + between)
        swapped = EvaluationPoints(points.partners, points.vehicles, points.times)
        rows = rows.union(self._write(swapped, -directions, other - between))
        return rows.select(np.lexsort((rows.times, rows.partners, rows.vehicles)))

    def _write(
        self, points: EvaluationPoints, normals: FloatArray, anchors: FloatArray
    ) -> HalfSpaces:
        """Return rows with given normals.

        Args:
            points: the vehicles, partners and times of the rows.
            normals: the unit normals from `directions`, shape (R, 3).
            anchors: q - s x_q [m], shape (R, 3); zero for rows about a difference, shape (3,).
        """
        distances = self.shape.local_support(normals) + self.radius(points.times)
        supports = self.responsibility * distances
        return HalfSpaces(
            self,
            points.vehicles,
            points.partners,
            sides=np.zeros(len(points), dtype=int),
            times=points.times,
            normals=normals,
            bounds=supports + np.sum(normals * anchors, axis=1),
            tolerances=TOLERANCE * supports,
        )

    def quadratics(self, rows: HalfSpaces) -> Quadratic | None:
        """Return lower bounds on scaled distances of vehicles from their partners."""
        radii = self.radius(rows.times)
        axes = self.shape.semi_axes + radii[:, None]  # an ellipsoid inside of S enlarged by r
        sizes = axes[:, 0]
        return Quadratic(
            centers=np.zeros((len(rows), 3)),
            scales=sizes[:, None] / axes,
            sizes=sizes,
            lengths=sizes / np.linalg.norm(rows.normals * axes, axis=1),
        )

    def renewed(self, rows: HalfSpaces) -> HalfSpaces:
        """Return rows of the same pairs at the same or the nearest knots."""
        own = self._required_rows
        return own.select(np.isin(self._pairs_and_knots(own), self._pairs_and_knots(rows)))

    def _pairs_and_knots(self, rows: HalfSpaces) -> IntArray:
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
    search: PairSearch,
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
        scenario: a scenario with a separation.
        margins: the margins of plans.
        search: the search for close pairs, by the separation of the scenario.
        reference: the reference motion q of all vehicles.
        coupling: the form of the rows.
        penalty: the cost per metre of violation of a row; infinite if rows must hold.
        one_normal: whether all rows of a close encounter of the reference have one normal.
        rounds: the number of rounds that add violated rows at the knots.
        of: increasing indices of vehicles; each pair includes at least one of them. All if None.
        close: the violating approaches of the reference, if known. They suffice between knots if
            rows are soft. None to search for them.
    """
    separation, soft = search.separation, np.isfinite(penalty)
    reference = reference.subdivided(margins.inner.pieces)
    required = separation.distance + max_pair_margin(separation, margins.inner)
    open_end = scenario.fleet.open_end
    near = pairs_within(search, reference, NEAR * required, between=False, of=of, open_end=open_end)
    if close is None:
        within, between = required * (1.0 if soft else GRAZING), scenario.between_knots
        close = pairs_within(search, reference, within, between=between, of=of, open_end=open_end)
    shape = separation.shape
    if soft:
        shape = Ellipsoid(shape.center, SOFT_ENLARGEMENT * shape.semi_axes)
    return KeepApart(
        kind="separation",
        key=PAIRS,
        name=NAME,
        quantity="position",
        penalty=penalty,
        rounds=rounds,
        coupled=coupling.together,
        shape=shape,
        required=separation,
        search=search,
        margins=margins.inner,
        responsibility=coupling.responsibility,
        one_normal=one_normal,
        reference=reference,
        points=points_of(near.merged(close)),
        searches=1 if soft else sys.maxsize,
        every_instant=scenario.between_knots,
        open_end=open_end,
        given_end=GivenEnd.of(scenario, "position") if open_end else None,
    )


def points_of(found: CloseApproaches) -> EvaluationPoints:
    """Return the evaluation points of close approaches."""
    return EvaluationPoints(found.one, found.other, found.times)


def _encounters(
    points: EvaluationPoints, close: BoolArray, step: float
) -> tuple[IntArray, IntArray]:
    """Return the indices of the close points, and the number of each one's encounter.

    An encounter consists of successive close points of one pair.
    """
    rows = np.flatnonzero(close)
    follows = np.diff(points.vehicles[rows], prepend=-1) == 0
    follows &= np.diff(points.partners[rows], prepend=-1) == 0
    follows &= np.diff(points.times[rows], prepend=-np.inf) < 1.5 * step
    return rows, np.cumsum(~follows) - 1
