"""Conflicts are proofs: named constraints cannot be met together, by separate linear programs.

Without obstacles the axes of a vehicle are independent, and each is a linear program in its
accelerations, straight from (1), (2) and (7).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

import drake_rho as rho
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.minimum_violation import minimum_violation
from tests.scenarios import acceleration_outside, box, random_scenario, single
from tests.tolerances import INDEX

Rows = list[tuple[str, np.ndarray, float]]
"""Quantity, row and bound of each: row @ a >= bound."""

BACK_AND_FORTH = single(
    start=rho.State([0, 0, 0], [4, 0, 0]),
    goal=rho.State([0, 0, 0], [4, 0, 0]),
    limits=rho.Limits(position=box(1.0), acceleration=box(3.0)),
)
"""Scenario too fast to stop before the upper wall, with too little run-up before the lower one."""


def _states(scenario: rho.Scenario, vehicle: rho.Vehicle, axis: int) -> dict[str, Any]:
    """Return M and r of each quantity along an axis: at the knots it is M @ a + r."""
    h, n = scenario.grid.step, scenario.grid.knots - 1
    before = np.arange(n + 1)[:, None] - np.arange(n)
    p, v = vehicle.start.position[axis], vehicle.start.velocity[axis]
    jerk = (np.eye(n + 1, n) - np.eye(n + 1, n, k=-1)) / h
    outside = np.zeros(n + 1)
    outside[0] = -acceleration_outside(vehicle.start)[axis] / h
    outside[-1] = acceleration_outside(vehicle.goal)[axis] / h
    return {
        "position": (h**2 * np.maximum(before - 0.5, 0.0), p + h * np.arange(n + 1) * v),
        "velocity": (h * (before > 0), np.full(n + 1, v)),
        "acceleration": (np.eye(n), np.zeros(n)),
        "jerk": (jerk, outside),
    }


def _goal_rows(scenario: rho.Scenario, vehicle: rho.Vehicle, axis: int) -> Rows:
    states = _states(scenario, vehicle, axis)
    rows: Rows = []
    for kind in ("position", "velocity"):
        matrix, rest = states[kind]
        missing = getattr(vehicle.goal, kind)[axis] - rest[-1]
        rows += [(kind, sign * matrix[-1], sign * missing) for sign in (1.0, -1.0)]
    return rows


def _box_rows(
    scenario: rho.Scenario, vehicle: rho.Vehicle, axis: int, kind: str, first: float, last: float
) -> Rows:
    """Return both sides of a box at the knots from one time to another [s]."""
    matrix, rest = _states(scenario, vehicle, axis)[kind]
    bounds, h = getattr(scenario.limits_of(vehicle), kind), scenario.grid.step
    inner = kind in ("position", "velocity")
    rows: Rows = []
    for k in range(int(inner), scenario.grid.knots - (kind != "jerk")):
        if first - h / 2 < h * k < last + h / 2 and not np.isnan(rest[k]):
            rows.append((kind, matrix[k], bounds.lower[axis] - rest[k]))
            rows.append((kind, -matrix[k], rest[k] - bounds.upper[axis]))
    return rows


def _least_violation_of_rows(rows: Rows) -> float:
    """Return the least possible violation of the worst unit row, over the largest bound."""
    if not rows:
        return 0.0
    matrix, bounds = np.array([row for _, row, _ in rows]), np.array([b for _, _, b in rows])
    lengths = np.linalg.norm(matrix, axis=1)
    bounds = bounds / lengths
    bounds = bounds / (np.abs(bounds).max() or 1.0)
    program = np.column_stack([-matrix / lengths[:, None], -np.ones(len(rows))])
    cost = np.append(np.zeros(matrix.shape[1]), 1.0)
    found = linprog(
        cost, A_ub=program, b_ub=-bounds, bounds=[(None, None)] * matrix.shape[1] + [(0, None)]
    )
    assert found.status == 0
    return float(found.fun)


def _contradict(scenario: rho.Scenario, name: str, described: Collection[str]) -> bool:
    """Return whether the described constraints of one vehicle cannot be met together."""
    vehicle = scenario.vehicles[scenario.index_of(name)]
    for axis, letter in enumerate("xyz"):
        rows: Rows = []
        for words in described:
            if words == f"goal {letter}":
                rows += _goal_rows(scenario, vehicle, axis)
            elif not words.startswith("goal"):
                found = re.fullmatch(
                    r"(\w+) box ([xyz/]+) (?:at|from) (\S+) s(?: to (\S+) s)?", words
                )
                assert found, words
                kind, axes, first, last = found.groups()
                if letter in axes:
                    span = float(first), float(last or first)
                    rows += _box_rows(scenario, vehicle, axis, kind, *span)
        if _least_violation_of_rows(rows) > 1e-9:
            return True
    return False


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=2)
def test_named_constraints_cannot_be_met_together(seed: int) -> None:
    """Conflicts are those of a planner's error and of its subset, which is irreducible."""
    scenario = random_scenario(seed, tight=True).without_obstacles()
    try:
        rho.plan_convex(scenario)
    except rho.InfeasibleError as caught:
        error = caught
    else:
        assume(False)
    name, named = next(iter(error.conflicts.items()))
    assert _contradict(scenario, name, named)
    alone = rho.InfeasibleError({name: named}, scenario=scenario)
    subset = rho.infeasible_subset(alone)[name]
    assert _contradict(scenario, name, subset)
    for box_named in (words for words in subset if not words.startswith("goal")):
        assert not _contradict(scenario, name, set(subset) - {box_named})


def test_both_sides_of_a_box_are_violated_where_necessary() -> None:
    plan = minimum_violation(Problem.of(BACK_AND_FORTH))
    x = plan.positions[0, :, 0]
    assert x.max() > 1.0 + 1.0
    assert x.min() < -1.0 - 0.01


def _penalty(scenario: rho.Scenario, kind: str) -> float:
    """Return the cost of violating a row by one unit of a quantity."""
    scales = scenario.fleet.scale
    unit = float(scales("acceleration").max())
    return unit**2 / float(scales(kind).max())  # type: ignore[arg-type]  # one of the four


def _least_violation(scenario: rho.Scenario, vehicle: rho.Vehicle) -> float:
    """Return the least sum of penalties and violations, by linear programs with every row."""
    total, n = 0.0, scenario.grid.knots - 1
    limits = scenario.limits_of(vehicle)
    for axis in range(3):
        rows = _goal_rows(scenario, vehicle, axis)
        for kind in ("position", "velocity", "jerk"):
            if getattr(limits, kind) is not None:
                rows += _box_rows(scenario, vehicle, axis, kind, 0.0, np.inf)
        most: Any = [(None, None)] * n
        if (force := limits.acceleration) is not None:
            most = [(force.lower[axis], force.upper[axis])] * n
        unit = float(scenario.fleet.scale("acceleration").max())
        sizes = np.array([_penalty(scenario, kind) / unit**2 for kind, _, _ in rows])
        matrix = sizes[:, None] * np.array([row for _, row, _ in rows]) * unit
        bounds = sizes * np.array([bound for _, _, bound in rows])
        found = linprog(
            np.append(np.zeros(n), np.ones(len(rows))),
            A_ub=-np.column_stack([matrix, np.eye(len(rows))]),
            b_ub=-bounds,
            bounds=[
                (None if low is None else low / unit, None if high is None else high / unit)
                for low, high in most
            ]
            + [(0.0, None)] * len(rows),
        )
        assert found.status == 0
        total += found.fun * unit**2
    return total


def _violation(scenario: rho.Scenario, plan: rho.Plan) -> float:
    """Return the cost of a plan's violations."""
    total = 0.0
    for vehicle, accelerations in zip(scenario.vehicles, plan.accelerations, strict=True):
        limits = scenario.limits_of(vehicle)
        for axis in range(3):
            rows = _goal_rows(scenario, vehicle, axis)
            for kind in ("position", "velocity", "jerk"):
                if getattr(limits, kind) is not None:
                    rows += _box_rows(scenario, vehicle, axis, kind, 0.0, np.inf)
            for kind, row, bound in rows:
                missing = max(0.0, bound - row @ accelerations[:, axis])
                total += _penalty(scenario, kind) * missing
    return total


@pytest.mark.parametrize("seed", [None, *range(8)])
def test_no_plan_violates_less_than_the_minimum_violation_solution(seed: int | None) -> None:
    """Programs that rows enter one by one are compared with linear programs with all rows."""
    scenario = BACK_AND_FORTH
    if seed is not None:
        scenario = random_scenario(seed, tight=True).without_obstacles()
    known = sum(_least_violation(scenario, vehicle) for vehicle in scenario.vehicles)
    found = _violation(scenario, minimum_violation(Problem.of(scenario)))
    unit = float(scenario.fleet.scale("acceleration").max())
    # each of many rows may stay violated by a hundredth of a tolerance
    assert found == pytest.approx(known, rel=10 * INDEX, abs=10 * INDEX * unit**2)
