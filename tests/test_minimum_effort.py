"""The motions of least effort in closed form, and the subspace in which goals are preserved."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.dynamics import response
from drake_rho.planning.minimum_effort import MinimumEffort
from tests.scenarios import random_scenario, single
from tests.tolerances import ROUNDING

seeds = st.integers(0, 2**32 - 1)


def _goal_rows(scenario: rho.Scenario) -> np.ndarray:
    """Return the rows of velocity and position at the last knot in the accelerations, (2, K-1)."""
    grid = scenario.grid
    kinds = ("velocity", "position")
    rows = [response(kind, grid.step, grid.knots, [grid.duration])[0] for kind in kinds]  # type: ignore[arg-type]  # literals
    return np.array([row / np.linalg.norm(row) for row in rows])


@given(seed=seeds)
def test_the_motion_of_least_effort_is_the_least_norm_solution_of_the_goals(seed: int) -> None:
    """Numpy's least squares solve it, straight from (10) and (11)."""
    scenario = random_scenario(seed)
    effort, T = MinimumEffort.of(scenario), scenario.grid.duration
    grid = scenario.grid
    velocity = response("velocity", grid.step, grid.knots, [T])[0] / T
    position = response("position", grid.step, grid.knots, [T])[0] / T**2
    matrix = np.stack([velocity, position])
    for index, vehicle in enumerate(scenario.vehicles):
        faster = vehicle.goal.velocity - vehicle.start.velocity
        way = vehicle.goal.position - vehicle.start.position - T * vehicle.start.velocity
        least, *_ = np.linalg.lstsq(matrix, np.stack([faster / T, way / T**2]), rcond=None)
        found = effort.motion.accelerations[index]
        np.testing.assert_allclose(found, least, atol=1e-8 * np.abs(least).max())
    assert not effort.unreachable.any()


@given(seed=seeds)
def test_goals_are_closed_by_the_least_change(seed: int) -> None:
    scenario = random_scenario(seed)
    effort, rng = MinimumEffort.of(scenario), np.random.default_rng(seed)
    vehicles = np.flatnonzero(rng.integers(0, 2, len(scenario.vehicles)))
    free = effort.motion.accelerations[vehicles]
    scale = np.abs(effort.motion.accelerations).max()
    noisy = free + scale * rng.normal(size=free.shape)
    closed = effort.goals.met_by(noisy, vehicles)
    rows = _goal_rows(scenario)
    np.testing.assert_allclose(
        np.einsum("gj,pjx->pgx", rows, closed - free), 0.0, atol=1e-9 * scale
    )
    change = closed - noisy  # orthogonal to all changes that preserve the goals
    inside = np.linalg.svd(rows)[2][2:]
    np.testing.assert_allclose(np.einsum("cj,pjx->pcx", inside, change), 0.0, atol=1e-9 * scale)
    again = effort.goals.met_by(closed, vehicles)
    np.testing.assert_allclose(again, closed, atol=1e-9 * scale)


@given(seed=seeds)
def test_rows_without_the_goals_are_their_projection(seed: int) -> None:
    scenario, rng = random_scenario(seed), np.random.default_rng(seed)
    changes, goal_rows = MinimumEffort.of(scenario).changes, _goal_rows(scenario)
    rows = rng.normal(size=(4, scenario.grid.knots - 1))
    inside = changes.spaces[0].projected(rows)
    np.testing.assert_allclose(inside @ goal_rows.T, 0.0, atol=ROUNDING)
    taken = np.linalg.svd(goal_rows)[2][2:]
    np.testing.assert_allclose(inside, rows @ taken.T @ taken, atol=ROUNDING)


def test_without_goals_a_motion_starts_the_same_and_everything_is_reachable() -> None:
    one_step = single(grid=rho.Grid(2.0, 2))
    effort = MinimumEffort.of(one_step)
    assert effort.unreachable.tolist() == [True]
    free = effort.without_goals(one_step.fleet.units)
    assert free.unreachable.tolist() == [False]
    assert [each.shape for each in free.goals.rows] == [(0, 1)]
    np.testing.assert_array_equal(free.motion.positions, effort.motion.positions)
    noisy = np.ones((1, 1, 3))
    np.testing.assert_array_equal(free.goals.met_by(noisy, np.array([0])), noisy)
    np.testing.assert_array_equal(
        free.changes.spaces[0].projected(np.ones((3, 1))), np.ones((3, 1))
    )


@pytest.mark.parametrize("off", [0.0, 0.5e-6, 2e-6])
def test_a_single_step_reaches_goals_within_the_tolerance(off: float) -> None:
    """The goal is 10 m away and may be missed by a millionth of that."""
    goal = rho.State([10.0 * (1 + off), 0, 0], [10.0, 0, 0])
    scenario = single(grid=rho.Grid(2.0, 2), goal=goal)
    assert MinimumEffort.of(scenario).unreachable.tolist() == [off > 1e-6]
