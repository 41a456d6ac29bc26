"""Motions of least cost to the goals, without other constraints.

The unknowns of programs are changes u of these motions that leave the goals reached. The cost of a
vehicle is norm(A a - b)² (`planning/cost_terms.py`), so that of a change is norm(A u)² more. With
the triangular factor R of A, programs have z = R u as unknowns: the cost is norm(z)², and a row
r · u is (R⁻ᵀ r) · z. With squared accelerations alone R is the identity, and the motions are those
of minimum effort.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy  # its parts load when first used

from drake_rho.motion.dynamics import Motion, response
from drake_rho.planning.cost_terms import CostTerms, terms_by_class
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.objective import Weights
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import TOLERANCE

_COSINES = 4
"""Number of slow accelerations from which the unit of a cost is taken: linear ones cost no snap."""

_EFFORT = Weights(1.0, *(0.0,) * 6)


@dataclasses.dataclass(frozen=True)
class Goals:
    """Terminal equalities (12) of each axis: rows @ accelerations = values."""

    rows: tuple[FloatArray, ...]
    """orthonormal rows of each class of vehicles, shape (2, 1 or 0, K-1); none if goals are not
    required"""
    classes: IntArray
    """index of each vehicle's class, shape (N,)"""
    values: FloatArray
    """right-hand sides [m/s²], shape (N, 2, 1 or 0, 3); zero after the rows of a vehicle's class"""

    def of(self, vehicle: int) -> tuple[FloatArray, FloatArray]:
        """Return the rows and the right-hand sides of one vehicle."""
        rows = self.rows[self.classes[vehicle]]
        return rows, self.values[vehicle, : len(rows)]

    def met_by(self, accelerations: FloatArray, vehicles: IntArray) -> FloatArray:
        """Return the accelerations of an inexact solution projected onto (12).

        Args:
            accelerations: accelerations of `vehicles` [m/s²], shape (P, K-1, 3).
            vehicles: the indices of the vehicles, shape (P,).
        """
        if len(self.rows) == 1:
            residual = self.rows[0] @ accelerations - self.values[vehicles]
            return np.asarray(accelerations - self.rows[0].T @ residual)
        nearest, classes = np.array(accelerations), self.classes[vehicles]
        for number, rows in enumerate(self.rows):
            own = classes == number
            residual = rows @ accelerations[own] - self.values[vehicles[own], : len(rows)]
            nearest[own] -= rows.T @ residual
        return nearest


@dataclasses.dataclass(frozen=True)
class Space:
    """Changes of the vehicles of one class in coordinates z in which their cost is norm(z)²."""

    rows: FloatArray
    """orthonormal rows of (12) about u, shape (2, 1 or 0, K-1)"""
    goals: FloatArray
    """orthonormal rows of (12) about z, of the same shape"""
    back: FloatArray | None = None
    """matrix with u = back @ z, shape (K-1, K-1); None for the identity"""
    unit: float = 1.0
    """cost of a change with norm(z) = 1: z is scaled so that it is about as large as u"""
    terms: CostTerms | None = None
    """terms of the cost; None for squared accelerations (13)"""

    @classmethod
    def of(cls, terms: CostTerms, rows: FloatArray) -> Space:
        """Return the space of the changes of vehicles with given terms and rows of (12)."""
        if terms.weights == _EFFORT:
            return cls(rows, rows)
        matrix, steps = terms.matrix, terms.knots - 1
        # the goals' rows make the factor regular where these only determine the motion
        held = np.linalg.norm(matrix) / np.sqrt(steps) * rows
        unit = _smooth_cost(matrix)
        back = np.sqrt(unit) * _inverse_factor(np.concatenate([matrix, held]))
        goals = np.linalg.qr((rows @ back).T)[0].T
        return cls(rows, goals, back, unit, terms)

    @property
    def counted(self) -> frozenset[Quantity]:
        """States at knots that have a cost."""
        return frozenset() if self.terms is None else self.terms.counted

    def whitened(self, rows: FloatArray) -> FloatArray:
        """Return rows (R, K-1) about u as rows about z."""
        return rows if self.back is None else rows @ self.back

    def projected(self, rows: FloatArray) -> FloatArray:
        """Return rows (R, K-1) about z projected onto the null space of the goals."""
        for _ in range(2):  # the second projection removes rounding errors
            rows = rows - (rows @ self.goals.T) @ self.goals
        return rows

    def changes(self, z: FloatArray) -> FloatArray:
        """Return the changes u of accelerations for z, both of shape (..., K-1, 3)."""
        return z if self.back is None else self.back @ z

    def coordinates(self, changes: FloatArray) -> FloatArray:
        """Return z of changes u of accelerations, both of shape (..., K-1, 3)."""
        return changes if self.back is None else np.asarray(np.linalg.solve(self.back, changes))

    def least(self, values: FloatArray, reaching: FloatArray) -> FloatArray:
        """Return the accelerations of least cost that reach the goals.

        Args:
            values: b of each vehicle (`CostTerms.values`), shape (P, M, 3).
            reaching: shortest accelerations that reach the goals [m/s²], shape (P, K-1, 3).
        """
        if self.terms is None:
            return reaching  # the shortest accelerations already
        matrix = self.terms.matrix
        descent = self.whitened(matrix).T @ (values - matrix @ reaching) / self.unit
        axes = descent.swapaxes(1, 2).reshape(-1, descent.shape[1])
        z = self.projected(axes).reshape(len(descent), 3, -1).swapaxes(1, 2)
        return np.asarray(reaching + self.changes(z))


def _smooth_cost(matrix: FloatArray) -> float:
    """Return the mean cost norm(A c)² of a few slow cosines c of norm 1, as plans mostly are."""
    steps = matrix.shape[1]
    phases = np.pi / steps * (np.arange(steps) + 0.5)
    cosines = np.cos(np.arange(min(_COSINES, steps))[:, None] * phases)
    cosines /= np.linalg.norm(cosines, axis=1, keepdims=True)
    return float(np.mean(np.sum((cosines @ matrix.T) ** 2, axis=1)))


def _inverse_factor(matrix: FloatArray) -> FloatArray:
    """Return the inverse of the triangular factor of a matrix, (K-1, K-1)."""
    factor = np.linalg.qr(matrix, mode="r")
    inverse: FloatArray = scipy.linalg.solve_triangular(factor, np.eye(len(factor)))
    return inverse


@lru_cache(maxsize=12)
def _space(terms: CostTerms, position: bool, velocity: bool) -> Space:
    grid = Grid(terms.step, terms.knots)
    return Space.of(terms, TerminalState(grid, position=position, velocity=velocity).rows)


@dataclasses.dataclass(frozen=True)
class Changes:
    """Changes of motions in the null space of the goals: the unknowns of programs."""

    grid: Grid
    """grid of the scenario"""
    spaces: tuple[Space, ...]
    """spaces of the classes of vehicles"""
    classes: IntArray
    """index of each vehicle's class, shape (N,)"""
    units: FloatArray
    """unit of each vehicle's unknowns in programs, a cost's root [m/s²], shape (N,)"""
    factors: FloatArray
    """z of each vehicle for an unknown of one unit, so that the cost is the sum of squared
    unknowns: one over the root of its weight, in the unit of its space, shape (N,)"""
    free: bool = False
    """whether changes have no cost: goals may then be missed, and only violations have a cost"""

    @cached_property
    def alike(self) -> Space | None:
        """The space of all vehicles; None if they are in several."""
        return self.spaces[0] if len(self.spaces) == 1 else None

    @cached_property
    def plain(self) -> bool:
        """Whether z is u for all vehicles: the cost is that of accelerations (13)."""
        return all(space.back is None for space in self.spaces)

    def space(self, vehicle: int) -> Space:
        """Return the space of one vehicle's changes."""
        space: Space = self.spaces[self.classes[vehicle]]
        return space

    def factors_of(self, vehicles: IntArray, partners: IntArray | None = None) -> FloatArray:
        """Return factors on row lengths: of each vehicle, or the root sum of squares of two.

        Args:
            vehicles: indices of vehicles, shape (R,).
            partners: indices of the vehicles whose values are subtracted, if any, shape (R,).
        """
        one = self.factors[vehicles]
        return one if partners is None else np.hypot(one, self.factors[partners])

    def whitened(self, rows: FloatArray, vehicles: IntArray) -> FloatArray:
        """Return rows (R, K-1) about changes u of vehicles (R,) as rows about z."""
        return rows if self.plain else self._by_class(Space.whitened, rows, vehicles)

    def projected(self, rows: FloatArray, vehicles: IntArray) -> FloatArray:
        """Return rows (R, K-1) about z of vehicles (R,), projected onto the goals' null space."""
        return self._by_class(Space.projected, rows, vehicles)

    def accelerations(self, z: FloatArray, vehicles: IntArray) -> FloatArray:
        """Return the changes of accelerations of vehicles (P,) for z, (P, K-1, 3) each."""
        return z if self.plain else self._by_class(Space.changes, z, vehicles)

    def coordinates(self, changes: FloatArray, vehicles: IntArray) -> FloatArray:
        """Return z of changes of accelerations of vehicles (P,), (P, K-1, 3) each."""
        return self._by_class(Space.coordinates, changes, vehicles)

    def _by_class(
        self,
        change: Callable[[Space, FloatArray], FloatArray],
        values: FloatArray,
        vehicles: IntArray,
    ) -> FloatArray:
        if self.alike is not None:
            return change(self.alike, values)
        found, classes = np.empty(values.shape), self.classes[vehicles]
        for number, space in enumerate(self.spaces):
            own = classes == number
            found[own] = change(space, values[own])
        return found

    def lengths_of(
        self, responses: FloatArray, vehicles: IntArray, partners: IntArray | None = None
    ) -> FloatArray:
        """Return the lengths of rows about unknowns of one unit, shape (R,).

        Args:
            responses: rows about u, shape (R, K-1).
            vehicles: the vehicles, shape (R,).
            partners: the vehicles whose values are subtracted, if any, shape (R,).
        """
        one = self._sizes(responses, vehicles)
        return one if partners is None else np.hypot(one, self._sizes(responses, partners))

    def _sizes(self, responses: FloatArray, vehicles: IntArray) -> FloatArray:
        sizes = np.linalg.norm(self.whitened(responses, vehicles), axis=1)
        return np.asarray(self.factors[vehicles] * sizes)


@dataclasses.dataclass(frozen=True)
class MinimumEffort:
    """Motions of least cost of all vehicles of a scenario."""

    grid: Grid
    """grid of the scenario"""
    goals: Goals
    """terminal equalities of accelerations"""
    motion: Motion
    """motions of least cost of all vehicles to the goals, without other constraints"""
    changes: Changes
    """changes of these motions, the unknowns of programs"""
    unreachable: BoolArray
    """flags of vehicles whose goals cannot be reached in a single step, shape (N,)"""

    @classmethod
    def of(cls, scenario: Scenario) -> MinimumEffort:
        """Return the motions of least cost of a scenario."""
        fleet, grid = scenario.fleet, scenario.grid
        least = _Least.of(scenario)
        roots = np.sqrt([each.unit for each in least.spaces])[least.goals.classes]
        return cls(
            grid,
            least.goals,
            Motion.from_starts(fleet, least.accelerations, grid.step),
            Changes(
                grid,
                least.spaces,
                least.goals.classes,
                fleet.units * roots,
                1.0 / (np.sqrt(fleet.weights) * roots),
            ),
            np.abs(least.missed).max(axis=1) > TOLERANCE * fleet.lengths,
        )

    def without_goals(self, units: FloatArray) -> MinimumEffort:
        """Return these motions with goals that need not be reached, and changes without a cost.

        Args:
            units: of accelerations in programs [m/s²], shape (N,).
        """
        changes, nobody = self.changes, np.zeros_like(self.changes.classes)
        rows = self.goals.rows[0][:0]
        roots = np.sqrt([each.unit for each in changes.spaces])[changes.classes]
        return dataclasses.replace(
            self,
            goals=Goals((rows,), nobody, self.goals.values[:, :0]),
            changes=dataclasses.replace(
                changes,
                spaces=(Space(rows, rows),),
                classes=nobody,
                units=units,
                factors=changes.factors * roots,
                free=True,
            ),
            unreachable=np.zeros_like(self.unreachable),
        )


def least_accelerations(scenario: Scenario) -> FloatArray:
    """Return the accelerations of least cost to the goals, shape (N, K-1, 3), without programs."""
    return _Least.of(scenario).accelerations


class _Least(NamedTuple):
    """Accelerations of least cost of all vehicles to their goals."""

    goals: Goals
    """terminal equalities of accelerations"""
    spaces: tuple[Space, ...]
    """changes of accelerations that keep them, for each class of vehicles"""
    accelerations: FloatArray
    """accelerations, shape (N, K-1, 3)"""
    missed: FloatArray
    """distances by which goals are missed, in a single step [m], shape (N, 3)"""

    @classmethod
    def of(cls, scenario: Scenario) -> _Least:
        """Return the accelerations of a scenario."""
        fleet, grid = scenario.fleet, scenario.grid
        terms, classes, flags = _classes_of(scenario)
        conditions = [TerminalState(grid, position=p, velocity=v) for p, v in flags]
        rows = tuple(each.rows for each in conditions)
        values = np.zeros((len(classes), max(map(len, rows)), 3))
        missed = np.zeros((len(classes), 3))
        accelerations = np.zeros((len(classes), grid.knots - 1, 3))
        spaces = list[Space]()
        for number, terminal in enumerate(conditions):
            own = slice(None) if len(conditions) == 1 else classes == number  # a view is faster
            faster, further = terminal.changes(fleet)
            found, missed[own] = terminal.values(faster[own], further[own])
            values[own, : len(rows[number])] = found
            accelerations[own] = rows[number].T @ found
            space = _space(terms[number], *flags[number])
            if space.terms is not None:
                targets = space.terms.values(scenario, np.arange(len(classes))[own])
                accelerations[own] = space.least(targets, accelerations[own])
            spaces.append(space)
        return cls(Goals(rows, classes, values), tuple(spaces), accelerations, missed)


def _classes_of(scenario: Scenario) -> tuple[list[CostTerms], IntArray, list[tuple[bool, bool]]]:
    """Return the classes of vehicles with the same terms of cost and the same rows of (12).

    Returns:
        The terms of each class, the index of each vehicle's class, shape (N,), and whether
        vehicles of each class have to reach a position and a velocity.
    """
    fleet = scenario.fleet
    kinds, kind = terms_by_class(scenario)
    if len(kinds) == 1 and not fleet.open_end:  # the most frequent case
        return kinds, kind, [(True, True)]
    numbers = 4 * kind + 2 * fleet.fixed_positions + fleet.fixed_velocities
    used, classes = np.unique(numbers, return_inverse=True)
    flags = [(bool(each & 2), bool(each & 1)) for each in used.tolist()]
    return [kinds[each // 4] for each in used.tolist()], classes, flags


class TerminalState:
    """Terminal conditions on velocity and position as equations in accelerations, (10)-(11).

    Args:
        grid: the grid of the flight.
        position: whether the position is given.
        velocity: whether the velocity is given.

    Attributes:
        rows: orthonormal rows of the equations, shape (2, K-1); one if only one of the two is
            given, or for a single step; none if neither is.
    """

    def __init__(self, grid: Grid, *, position: bool = True, velocity: bool = True) -> None:
        self.grid = grid
        self._given = velocity, position
        self.rows, self._triangle = _factors(grid.step, grid.knots, velocity, position)

    def changes(self, fleet: Fleet) -> tuple[FloatArray, FloatArray]:
        """Return the required changes of velocity [m/s] and of position [m], (N, 3) each."""
        faster = fleet.goal_velocities - fleet.start_velocities
        further = fleet.goal_positions - fleet.start_positions
        return faster, further - self.grid.duration * fleet.start_velocities

    def values(self, faster: FloatArray, further: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (12) in terms of `rows`; linear in the required changes.

        Args:
            faster: required change of velocity [m/s], shape (N, 3).
            further: required change of position, in addition to that by the initial velocity [m],
                shape (N, 3).

        Returns:
            Products of the rows with the accelerations [m/s²], shape (N, 2, 1 or 0, 3), and the
            remainder of `further`: zero, except for a single step.
        """
        triangle, T = self._triangle, self.grid.duration
        if not all(self._given):
            given = np.stack([faster, further / T], axis=1)[:, list(self._given)]
            return given / triangle.reshape(-1, 1), np.zeros(further.shape)
        first = faster / triangle[0, 0]
        rest = further / T - triangle[1, 0] * first
        if triangle.shape[1] == 1:
            return first[:, None], T * rest
        values = np.concatenate([first[:, None], (rest / triangle[1, 1])[:, None]], axis=1)
        return values, np.zeros(rest.shape)


@lru_cache(maxsize=256)
def _factors(
    step: float, knots: int, velocity: bool, position: bool
) -> tuple[FloatArray, FloatArray]:
    """Return QR factors, orthonormal rows and a triangle, of the responses at the last knot."""
    T = step * (knots - 1)
    faster, further = (response(each, step, knots, [T])[0] for each in ("velocity", "position"))
    given = [*[faster] * velocity, *[further / T] * position]
    basis, triangle = np.linalg.qr(np.reshape(given, (-1, knots - 1)).T)
    return basis.T, triangle.T
