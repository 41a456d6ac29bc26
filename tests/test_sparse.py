"""Both forms of a program's rows agree with the half-spaces evaluated on a motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces, about
from drake_rho.planning.constraints.boxes import KeepInBox, boxes_of
from drake_rho.planning.constraints.margins import margins_of
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.reduced import rows_of
from drake_rho.planning.programs.sparse import SparseRows
from tests.scenarios import box, fleet
from tests.tolerances import ROUNDING

GROUP = np.array([0, 2])


@pytest.fixture
def scenario() -> rho.Scenario:
    """Return three vehicles with limits of every kind, at every instant."""
    return fleet(
        np.array([[-5, 0.3, 0], [0, -5, 0], [4, 4, 0.5]]),
        np.array([[5, 0, 0], [0, 5, 0.2], [-4, -4, 0]]),
        separation=rho.Separation(2.5, 2.0),
        limits=rho.Limits(box(9), box(2), box(1), box(2)),
        obstacles=(rho.Sphere([1, 1, -1], 2.0),),
    )


def _flown(scenario: rho.Scenario, seed: int, size: float) -> Motion:
    rng = np.random.default_rng(seed)
    a = MinimumEffort.of(scenario).motion.accelerations
    plan = rho.Plan.from_accelerations(scenario, a + size * rng.normal(size=a.shape))
    return plan.motion()


def _rows(scenario: rho.Scenario, kinds: set[str]) -> list[HalfSpaces]:
    """Return rows of the group that a random motion violates, at knots and between them."""
    reference, wild = _flown(scenario, 1, 0.1), _flown(scenario, 2, 5.0)
    constraints = [
        *boxes_of(scenario, margins_of(scenario)),
        *Problem.of(scenario).obstacles_around(reference),
        Problem.of(scenario).pairs_around(reference, rho.coupled),
    ]
    found = []
    for place, constraint in enumerate(constraints):
        if constraint.quantity not in kinds:
            continue
        each = dataclasses.replace(constraint, penalty=3.0 + place)
        for between in {False, constraint.searches > 0}:
            rows = each.violated_rows(wild, np.arange(3), between=between)
            own = np.isin(rows.vehicles, GROUP) & np.isin(rows.partners, GROUP)
            if own.any():
                found.append(rows.select(own))
    return found


ALL = {"position", "velocity", "acceleration", "jerk"}
KINDS = [ALL, {"velocity"}, {"velocity", "jerk"}, {"acceleration"}, {"position"}]


@pytest.mark.parametrize("kinds", KINDS, ids=lambda kinds: "-".join(sorted(kinds)))
def test_sparse_rows_are_the_margins_of_the_only_motion_of_the_dynamics(
    scenario: rho.Scenario, kinds: set[str]
) -> None:
    rows, effort = _rows(scenario, kinds), MinimumEffort.of(scenario)
    sparse = SparseRows(effort.changes, GROUP, about(effort.motion, rows))
    motion = _flown(scenario, 3, 1.0)
    unit, h = effort.changes.units[GROUP].max(), scenario.grid.step
    free = effort.motion
    states = [(motion.accelerations - free.accelerations)[GROUP] / unit]
    if kinds & {"position", "velocity"}:
        states.append((motion.velocities - free.velocities)[GROUP, 1:] / (unit * h))
    if "position" in kinds:
        states.append((motion.positions - free.positions)[GROUP, 1:] / (unit * h**2))
    x = np.concatenate([each.reshape(-1) for each in states])
    assert sparse.columns == len(x)
    equations = list(sparse.dynamics())
    assert len(equations) == len(states) - 1
    for each in equations:
        np.testing.assert_allclose(each @ x, 0.0, atol=ROUNDING * np.abs(x).max())
        moved = x + np.random.default_rng(0).normal(size=len(x))
        assert np.abs(each @ moved).max() > 0.1  # and no other motion
    matrix, needed, penalties, lengths = sparse.matrix()
    margins = np.concatenate([part.margins(motion) for part in rows])
    worth = np.repeat([part.constraint.penalty for part in rows], [len(part) for part in rows])
    scaled = penalties / worth * unit  # the unit of each row, relative to that of the accelerations
    found = (matrix @ x - needed) * scaled
    np.testing.assert_allclose(found * unit, margins, atol=1e-8 * np.abs(margins).max())
    dense, _, _ = rows_of(effort.changes, GROUP, about(effort.motion, rows))
    assert dense.shape == (len(margins), 3 * sparse.steps * len(GROUP))
    sizes = np.concatenate(
        [
            np.linalg.norm(part.responses(scenario.grid), axis=1)
            * (np.sqrt(2.0) if part.constraint.coupled else 1.0)
            for part in rows
        ]
    )
    np.testing.assert_allclose(lengths * scaled, sizes, rtol=ROUNDING)
    assert matrix.nnz <= 8 * 3 * len(margins)  # sparse, however long the flight


def test_dense_rows_have_length_one_and_are_the_margins(scenario: rho.Scenario) -> None:
    rows, effort = _rows(scenario, ALL), MinimumEffort.of(scenario)
    assert {part.constraint.quantity for part in rows} == ALL
    assert {part.constraint.coupled for part in rows} == {False, True}
    matrix, needed, penalties = rows_of(effort.changes, GROUP, about(effort.motion, rows))
    np.testing.assert_allclose(np.sqrt(matrix.power(2).sum(axis=1)), 1.0, rtol=ROUNDING)
    motion, unit = _flown(scenario, 4, 1.0), effort.changes.units[GROUP].max()
    u = (motion.accelerations - effort.motion.accelerations)[GROUP].reshape(-1) / unit
    margins = np.concatenate([part.margins(motion) for part in rows])
    worth = np.repeat([part.constraint.penalty for part in rows], [len(part) for part in rows])
    # a violation of one unit costs the penalty: margins are rows times penalties over it
    found = (matrix @ u - needed) * penalties / worth
    np.testing.assert_allclose(found * unit**2, margins, atol=1e-8 * np.abs(margins).max())


@pytest.mark.parametrize("quantity", ["position", "velocity", "acceleration", "jerk"])
def test_sparse_rows_hold_at_any_time_from_the_first_step_to_the_last(
    scenario: rho.Scenario, quantity: str
) -> None:
    (constraint,) = [
        each for each in boxes_of(scenario, margins_of(scenario)) if each.quantity == quantity
    ]
    assert isinstance(constraint, KeepInBox)
    h, steps = scenario.grid.step, scenario.grid.knots - 1
    times = h * np.array([0.3, 0.5, 1.0, 1.5, 7.25, steps - 0.25, steps])
    if quantity == "acceleration":  # in the steps
        times = times[2:-1]
    if quantity == "jerk":
        times = h * np.arange(steps + 1.0)
    every = [np.repeat(each, 6 * len(times)) for each in GROUP]
    sides = np.tile(np.repeat(np.arange(6), len(times)), len(GROUP))
    rows = constraint.rows(np.concatenate(every), sides, np.tile(times, 6 * len(GROUP)))
    effort, motion = MinimumEffort.of(scenario), _flown(scenario, 5, 1.0)
    sparse = SparseRows(effort.changes, GROUP, about(effort.motion, [rows]))
    unit = effort.changes.units[GROUP].max()
    moved = [
        (getattr(motion, kind) - getattr(effort.motion, kind))[GROUP] / unit
        for kind in ("accelerations", "velocities", "positions")
    ]
    blocks = [moved[0], moved[1][:, 1:] / h, moved[2][:, 1:] / h**2]
    x = np.concatenate([each.reshape(-1) for each in blocks])[: sparse.columns]
    matrix, needed, _, _ = sparse.matrix()
    worth = {"position": h**2, "velocity": h, "acceleration": 1.0, "jerk": 1.0 / h}[quantity]
    margins = rows.margins(motion)
    found = (matrix @ x - needed) * unit * worth
    np.testing.assert_allclose(found, margins, atol=1e-8 * np.abs(margins).max())
