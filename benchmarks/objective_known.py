"""Costs with known solutions: least jerk from rest to rest, and tracking by Riccati's recursion."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

import drake_rho as rho
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

KNOTS = (26, 51, 101, 201)

PAIRS = 31
"""Interleaved pairs of Example 4 with least effort and with least jerk."""

COLUMNS = ("work", "knots", "places", "cost")


def run() -> Table:
    """Compare plans with closed forms, and the times of Example 4."""
    quintic = [(knots, *_from_quintic(knots)) for knots in KNOTS]
    tracking, ratio = _from_riccati(), _example_4()
    rows: list[tuple[Cell, ...]] = [
        ("least jerk from rest to rest, beside the quintic", *each) for each in quintic
    ]
    rows += [
        ("tracking without limits, beside Riccati's recursion", 41, tracking, None),
        ("Example 4, time of least jerk over least effort", 50, None, ratio),
    ]
    falls = [one[1] / other[1] for one, other in pairwise(quintic)]
    return Table(
        name="objective_known",
        title="Costs with known solutions, and the time of least jerk",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_WORK,),
        goals=(
            Goal("least jerk on 201 knots, places over the distance", 1e-4, quintic[-1][1]),
            Goal("least jerk on 201 knots, cost", 5e-4, quintic[-1][2]),
            Goal(
                "fall of its error with twice the steps, from 4",
                0.4,
                max(abs(f - 4) for f in falls),
            ),
            Goal("tracking, accelerations", 1e-8, tracking),
            Goal("Example 4 with least jerk, time over least effort", 1.3, ratio),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy"),
    )


def _one(objective: rho.Objective, knots: int) -> rho.Scenario:
    ends = rho.State([0.0, 0.0, 0.0]), rho.State([10.0, 4.0, -2.0])
    grid = rho.Grid(8.0 / (knots - 1), knots)
    return rho.Scenario("one", grid, [rho.Vehicle("solo", *ends)], objective=objective)


def _from_quintic(knots: int) -> tuple[float, float]:
    """Return the largest distance of places, over the flown one, and the difference of costs."""
    plan = rho.plan(_one(rho.Objective(effort=0.0, jerk=1.0), knots))
    s, way = plan.times / 8.0, plan.positions[0, -1]
    quintic = np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, way)
    length = float(np.linalg.norm(way))
    away = float(np.linalg.norm(plan.positions[0] - quintic, axis=1).max())
    integral = 720.0 * length**2 / 8.0**5
    return away / length, abs(plan.cost * plan.scenario.grid.step / integral - 1.0)


def _from_riccati() -> float:
    """Return the largest difference of accelerations, over the largest one."""
    q, v, r, ends = 0.7, 0.3, 0.2, np.diag([5.0, 3.0])
    path = np.random.default_rng(3).normal(size=(1, 41, 3)).cumsum(axis=1)
    objective = rho.Objective(r, 0, 0, q, v, path, ends[0, 0], ends[1, 1])
    plan = rho.plan(_one(objective, 41))
    h = plan.scenario.grid.step
    A, B, Q = np.array([[1.0, h], [0.0, 1.0]]), np.array([h**2 / 2, h]), np.diag([q, v])
    wanted = np.stack([path[0], np.gradient(path[0], h, axis=0)], axis=1)  # (K, 2, 3)
    found = np.empty((40, 3))
    for axis in range(3):
        target = np.array([plan.scenario.vehicles[0].goal.position[axis], 0.0])
        P, s = Q + ends, Q @ wanted[-1, :, axis] + ends @ target
        gains = list[tuple[FloatArray, float]]()
        for k in range(39, -1, -1):
            inverse = 1.0 / (r + B @ P @ B)
            gains.append((inverse * (B @ P @ A), float(inverse * (B @ s))))
            closed = A - np.outer(B, gains[-1][0])
            s, P = closed.T @ s, A.T @ P @ closed
            if k > 0:
                P, s = P + Q, s + Q @ wanted[k, :, axis]
        x = np.zeros(2)
        for k, (feedback, forward) in enumerate(reversed(gains)):
            found[k, axis] = forward - feedback @ x
            x = A @ x + B * found[k, axis]
    return float(np.abs(plan.accelerations[0] - found).max() / np.abs(found).max())


def _example_4() -> float:
    """Return the median ratio of the times of Example 4 with least jerk and with least effort."""
    effort = rho.load_scenario("paper")
    h = effort.grid.step
    jerk = dataclasses.replace(effort, objective=rho.Objective(effort=0.0, jerk=h**2))
    for each in (effort, jerk):
        rho.plan_rho(each, replan_every=5)
    ratios = [
        _seconds(lambda: rho.plan_rho(jerk, replan_every=5))
        / _seconds(lambda: rho.plan_rho(effort, replan_every=5))
        for _ in range(PAIRS)
    ]
    return statistics.median(ratios)


def _seconds(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


_WORK = f"""\
Least jerk: 11 m in 8 s from rest to rest; the integral of the quintic's squared jerk is
720 d² / T⁵, and the cost times the step approximates it. Tracking: a random path, costs of effort,
position, velocity and a missed goal, without limits. Example 4: `plan_rho` of the paper's scenario,
windows of five steps, processor time, median of {PAIRS} interleaved pairs."""
