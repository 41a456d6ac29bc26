"""The quadratic program (16) in the span of its rows, or in a sparse form if that is cheaper.

Let u be the accelerations of a vehicle, or of several that rows couple, minus those of least cost,
and z = R u, which is u unless the scenario has an `Objective` (`planning/minimum_effort.py`):

    minimise    norm(z)² + sum of penalties · slacks        (13), (14)
    subject to  G u = 0                                      (12), with (1)-(3): same final state
                M u + slack >= b, slack >= 0                 (4)-(7), (15) and pairs, as rows

Rows are affine in u by (10)-(11). Accelerations are in a unit of the scenario's scale, and rows are
scaled to length one (in the sparse form, to entries of about one), so that programs depend neither
on the scale nor on the origin of coordinates. Only soft rows have slacks. There are two exact
forms; the cheaper one is used:

- reduced space: z lies in the span of the rows of M, projected onto the null space of G, because a
  component orthogonal to all rows only adds cost. There is one variable for each row instead of
  3 (K - 1), and there are no equalities.
- sparse (`drake_rho.planning.programs.sparse`): velocities and positions are variables too, with
  (1) and (2) as equalities, so that every row has a few entries.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import scipy  # its parts load when first used
from pydrake.solvers import MathematicalProgram

from drake_rho.motion.dynamics import sparse_response
from drake_rho.planning.constraints.rows import Rows, each_of, groups_of, slacks_of
from drake_rho.planning.minimum_effort import Changes
from drake_rho.planning.programs.program import DenseProgram, Program, Solution, add_rows
from drake_rho.planning.programs.sparse import SparseRows, without_rows
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_FEW = 32
"""Number of rows up to which programs are always written in the reduced space."""

_SPARSE = 2000
"""Operations per nonzero entry of a sparse program, measured from 50 to 5000 knots within a factor
of two. A program of R rows in the reduced space needs about R² (3 K + 5 R) operations."""

_DENSE = 8.0
"""Speed of a solver of dense programs, as a multiple of Clarabel's in these operations."""

Templates = dict[tuple[int, ...], tuple[MathematicalProgram, np.ndarray]]
"""Sparse programs without rows, and their variables, by the vehicles' classes and the number of
variables."""


@dataclasses.dataclass(frozen=True)
class Batch:
    """Programs of groups with equal numbers of vehicles and of rows, one for each group.

    A group is one vehicle, or several that rows couple.
    """

    groups: IntArray
    """indices of the vehicles in the scenario, shape (B, G)"""
    programs: Sequence[Program]
    """program of each group; its linear constraints are M and b, in the order of the half-spaces"""
    basis: FloatArray | None
    """matrix with z = basis @ variables, shape (B, 3 G (K-1), V); None if z are the first
    variables"""
    lengths: FloatArray
    """factors by which multipliers become those of rows of length one, shape (B, R)"""
    changes: Changes | None = None
    """the changes, of which the program has coordinates z; None if it has accelerations u"""

    def accelerations(self, solutions: Sequence[Solution], steps: int) -> FloatArray:
        """Return the accelerations u, in units, shape (B, G, K-1, 3).

        Args:
            solutions: the solution of each program.
            steps: the number of steps, K - 1.
        """
        (count, vehicles), basis = self.groups.shape, self.basis
        size = 3 * steps * vehicles if basis is None else basis.shape[2]
        x = np.array([solution.x[:size] for solution in solutions])
        z = (x if basis is None else np.matvec(basis, x)).reshape(-1, steps, 3)
        if self.changes is not None:
            z = self.changes.accelerations(z, self.groups.reshape(-1))
        return z.reshape(count, vehicles, steps, 3)


def programs_of(
    changes: Changes,
    rows: Sequence[Rows],
    *,
    dense: bool = False,
) -> Iterator[Batch]:
    """Yield the programs of all vehicles with rows, the largest first, each written when needed.

    Args:
        changes: the changes of minimum-effort motions that rows refer to.
        rows: the rows, constraint by constraint; their order within a group remains.
        dense: whether the solver is for dense programs, such as `Daqp`. It needs no basis of the
            rows' span, and the sparse form pays off for more rows only.
    """
    groups = groups_of(len(changes.units), [part for part in rows if part.form.coupled])
    count = np.bincount(np.concatenate([groups[part.vehicles] for part in rows]))
    size = np.bincount(groups)[: len(count)]
    in_sparse = _cheaper_sparse(changes.grid.knots - 1, size, count, _DENSE if dense else 1.0)
    single = ~in_sparse & (size == 1)
    if not single.all():
        templates: Templates = {}
        for group, own in each_of(np.flatnonzero(~single & (count > 0)), groups, rows):
            vehicles = np.flatnonzero(groups == group)
            if in_sparse[group]:
                yield _sparse(changes, vehicles, own, templates)
            else:
                yield _reduced_group(changes, vehicles, own, dense)
        rows = [part.select(single[groups[part.vehicles]]) for part in rows]
    yield from _reduced(changes, [part for part in rows if len(part) > 0], dense)


def _cheaper_sparse(steps: int, vehicles: IntArray, rows: IntArray, operations: float) -> BoolArray:
    """Return flags of the groups for which the sparse form is cheaper.

    Args:
        steps: the number of steps, K - 1.
        vehicles: the number of vehicles of each group.
        rows: the number of rows of each group.
        operations: number of reduced-space operations in the time of one with Clarabel.
    """
    many: BoolArray = rows > _FEW
    if not many.any():
        return many
    width = 3 * vehicles * steps
    entries = 4 * rows + 9 * width  # of the rows, and of dynamics and accelerations
    return many & (rows**2 * (width + 5 * rows) > operations * _SPARSE * entries)


def _reduced(changes: Changes, rows: Sequence[Rows], dense: bool) -> Iterator[Batch]:
    """Yield programs of single vehicles in the reduced space, in batches of equal size.

    Large arrays are computed for one batch at a time, so that they fit into caches.
    """
    if not rows:
        return
    every = Rows.joined(rows)
    vehicles = every.vehicles
    sizes = np.bincount(vehicles)[vehicles]
    order = np.lexsort((vehicles, sizes))  # by size, then by vehicle, and stable
    responses, whose, which = _responses(changes, rows)
    which, lengths = which[order], np.sqrt(np.vecdot(responses, responses))
    responses, lengths = responses / lengths[:, None], lengths[which]
    if changes.alike is not None:
        responses = changes.alike.projected(responses)
    else:
        responses = changes.projected(responses, whose)
    normals, needed = every.normals[order], every.bounds[order]
    penalties = np.concatenate([part.penalties for part in rows])[order]
    slacks = slacks_of(rows)[order]
    vehicles, sizes = vehicles[order], sizes[order]
    units, lengths = changes.units[vehicles], lengths * changes.factors[vehicles]
    needed, penalties = needed / (lengths * units), penalties * lengths / units
    for size in np.bincount(sizes).nonzero()[0][::-1].tolist():
        own = slice(*sizes.searchsorted([size, size + 1]))
        inside = responses[which[own]]
        matrix = inside[:, :, None] * normals[own, None, :]
        yield _in_span(
            vehicles[own][::size, None],
            matrix.reshape(-1, size, 3 * inside.shape[1]),
            needed[own].reshape(-1, size),
            penalties[own].reshape(-1, size),
            slacks[own].reshape(-1, size),
            changes,
            dense,
        )


def _responses(changes: Changes, rows: Sequence[Rows]) -> tuple[FloatArray, IntArray, IntArray]:
    """Return the different responses about z, shape (U, K-1), and the index of each row's, (R,).

    Many rows of different vehicles refer to the same knots and so share a response.

    Returns:
        The responses, a vehicle with each of them, shape (U,), and the indices.
    """
    responses, whose = list[FloatArray](), list[IntArray]()
    which, first = list[IntArray](), 0
    for part in rows:
        own = np.arange(len(part))
        if len(part) > changes.grid.knots:
            keys = part.times if changes.alike else part.times + 1j * changes.classes[part.vehicles]
            _, representative, own = np.unique(keys, return_index=True, return_inverse=True)
            part = part.select(representative)
        own_responses = part.responses(changes.grid)
        if not changes.plain:
            own_responses = changes.whitened(own_responses, part.vehicles)
        responses.append(own_responses)
        whose.append(part.vehicles)
        which.append(first + own)
        first += len(part)
    owners = which[0] if changes.alike else np.concatenate(whose)  # not asked for if alike
    return np.concatenate(responses), owners, np.concatenate(which)


def _reduced_group(changes: Changes, group: IntArray, rows: Sequence[Rows], dense: bool) -> Batch:
    """Return the program of one group in the reduced space."""
    matrix, needed, penalties = rows_of(changes, group, rows)
    entries = matrix.toarray().reshape(len(needed) * len(group), -1, 3)
    whose = np.tile(group, len(needed))
    axes = [changes.projected(entries[:, :, axis], whose) for axis in range(3)]
    stack = np.stack(axes, axis=2).reshape(1, len(needed), -1)
    slacks = slacks_of(rows)[None]
    return _in_span(group[None], stack, needed[None], penalties[None], slacks, changes, dense)


def _sparse_responses(changes: Changes, rows: Rows, vehicles: IntArray) -> scipy.sparse.csr_array:
    """Return the responses of rows about z of vehicles (R,) as a sparse array, shape (R, K-1)."""
    grid = changes.grid
    if not changes.plain:
        return scipy.sparse.csr_array(changes.whitened(rows.responses(grid), vehicles))
    if rows.form.averaged is not None:
        return scipy.sparse.csr_array(rows.responses(grid))
    return sparse_response(rows.form.quantity, grid.step, grid.knots, rows.times)


def rows_of(
    changes: Changes, group: IntArray, rows: Sequence[Rows]
) -> tuple[scipy.sparse.csc_array, FloatArray, FloatArray]:
    """Return rows as M @ z >= b of length one, for the coordinates z of a group in its unit.

    Returns:
        M, shape (R, 3 G (K-1)), b, shape (R,), and penalties of a violation by one, shape (R,).
    """
    knots, unit = changes.grid.knots, changes.units[group].max()
    place = np.zeros(len(changes.units), dtype=int)
    place[group] = np.arange(len(group))
    entries, where, needed, penalties = [np.zeros(0)], [np.zeros((2, 0), dtype=int)], [], []
    first = 0
    for part in rows:
        terms = [(part.vehicles, 1.0)]
        if part.form.coupled:
            terms.append((part.partners, -1.0))
        sides = [_sparse_responses(changes, part, vehicles) for vehicles, _ in terms]
        lengths = _lengths(changes, part, sides)
        for (vehicles, sign), side in zip(terms, sides, strict=True):
            responses = side.tocoo()
            r, j = responses.coords
            vectors = place[vehicles[r]] * (knots - 1) + j
            factors = sign * changes.factors[vehicles[r]]
            values = (factors * responses.data / lengths[r])[:, None] * part.normals[r]
            entries.append(values.reshape(-1))
            columns = (3 * vectors[:, None] + np.arange(3)).reshape(-1)
            where.append(np.stack([np.repeat(first + r, 3), columns]))
        needed.append(part.bounds / (lengths * unit))
        penalties.append(part.penalties * lengths / unit)
        first += len(part)
    shape = (first, 3 * (knots - 1) * len(group))
    matrix = scipy.sparse.coo_array(
        (np.concatenate(entries), tuple(np.concatenate(where, axis=1))), shape=shape
    )
    return matrix.tocsc(), np.concatenate(needed), np.concatenate(penalties)


def _lengths(changes: Changes, rows: Rows, sides: Sequence[scipy.sparse.csr_array]) -> FloatArray:
    """Return the lengths of rows, shape (R,), with the responses of their one or two sides."""
    sizes = [np.sqrt(each.power(2).sum(axis=1)) for each in sides]
    if len(sides) == 1:
        return np.asarray(changes.factors_of(rows.vehicles) * sizes[0])
    if changes.alike is not None:
        return np.asarray(changes.factors_of(rows.vehicles, rows.partners) * sizes[0])
    one, other = changes.factors[rows.vehicles], changes.factors[rows.partners]
    return np.asarray(np.hypot(one * sizes[0], other * sizes[1]))


def _in_span(
    groups: IntArray,
    matrices: FloatArray,
    needed: FloatArray,
    penalties: FloatArray,
    slacks: IntArray,
    changes: Changes,
    dense: bool,
) -> Batch:
    """Return programs in coordinates of an orthonormal basis of the span of their rows.

    DAQP gets no basis, because computing one would take longer than solving without it.

    Args:
        groups: the vehicles of each group, shape (B, G).
        matrices: rows projected onto the null space of G, shape (B, R, 3 G (K-1)).
        needed: b, shape (B, R).
        penalties: penalties of a violation by one, shape (B, R).
        slacks: the index of each row's slack, shape (B, R).
        changes: the changes of which the programs have coordinates.
        dense: as in `programs_of`.
    """
    basis: FloatArray | None = None
    if not dense:
        basis, triangles = np.linalg.qr(matrices.swapaxes(1, 2))
        matrices = triangles.swapaxes(1, 2)
    rows = zip(matrices, needed, penalties, slacks, strict=True)
    programs = [DenseProgram(*each, changes.free) for each in rows]
    return Batch(groups, programs, basis, np.ones(needed.shape), None if changes.plain else changes)


def _sparse(changes: Changes, group: IntArray, rows: Sequence[Rows], templates: Templates) -> Batch:
    """Return the program in accelerations and the states that rows refer to.

    Variables, cost and dynamics take longer to write than rows and are the same in many programs:
    they are copied from `templates`, to which new ones are added.
    """
    sparse = SparseRows(changes, group, rows)
    form = *changes.classes[group].tolist(), sparse.columns
    if form not in templates:
        templates[form] = without_rows(sparse)
    common, x = templates[form]
    program = common.Clone()
    matrix, needed, penalties, lengths = sparse.matrix()
    add_rows(program, matrix, needed, penalties, slacks_of(rows), x)
    return Batch(sparse.group[None], [program], None, lengths[None])
