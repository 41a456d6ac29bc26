"""Programs in blocks of vehicles, solved here and in other processes."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver

import drake_rho as rho
from drake_rho.planning.constraints.base import about
from drake_rho.planning.constraints.rows import Rows, groups_of
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs import backend
from drake_rho.planning.programs import solve as blocks
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.solve import solve_all


class Sent(Executor):
    """Executor that runs tasks here on pickled copies, and records the sizes of the pickles."""

    def __init__(self) -> None:
        self.sizes: list[int] = []

    def submit(self, task: Any, /, *args: Any, **options: Any) -> Future[Any]:
        """Run the task at once."""
        sent = pickle.dumps((task, args, options))
        self.sizes.append(len(sent))
        there, given, named = pickle.loads(sent)  # noqa: S301  # own
        future: Future[Any] = Future()
        future.set_result(pickle.loads(pickle.dumps(there(*given, **named))))  # noqa: S301
        return future


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make blocks so small that small fleets have several."""
    monkeypatch.setattr(blocks, "_BLOCK", 5)


@pytest.fixture(scope="module")
def processes() -> Iterator[ProcessPoolExecutor]:
    """Return two other processes, which have inherited nothing."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as workers:
        yield workers


def fleet(seed: int = 0, vehicles: int = 20) -> rho.Scenario:
    """Return transitions with a cubic metre for each vehicle."""
    volume, rng = rho.flight_cube(float(vehicles)), np.random.default_rng(seed)
    return rho.random_transitions(vehicles, rng, volume=volume, duration=12.0)


@pytest.mark.parametrize("solver", [None, rho.Daqp()], ids=["default", "daqp"])
def test_processes_give_the_same_plan_to_the_last_digit(
    solver: rho.Daqp | None, processes: ProcessPoolExecutor
) -> None:
    if solver is None and backend.DEFAULT is not ClarabelSolver:
        pytest.skip("other processes use the usual default solver")
    here = rho.plan(fleet(), solver=solver)
    there = rho.plan(fleet(), solver=solver, executor=processes)
    np.testing.assert_array_equal(there.accelerations, here.accelerations)
    assert there.statistics.programs == here.statistics.programs
    assert rho.verify(there).ok


def test_any_number_of_threads_gives_the_same_plan_by_the_name_of_the_method() -> None:
    here = rho.plan_scp(fleet(1))
    for count in (1, 3):
        with ThreadPoolExecutor(count) as threads:
            there = rho.plan_scp(fleet(1), executor=threads)
        np.testing.assert_array_equal(there.accelerations, here.accelerations)


def test_messages_to_processes_grow_with_the_rows_and_not_with_the_fleet() -> None:
    sizes = []
    for vehicles in (20, 60):
        workers = Sent()
        rho.plan(fleet(2, vehicles), executor=workers)
        assert len(workers.sizes) > vehicles // 5  # several blocks at a time
        sizes.append(max(workers.sizes))
    assert sizes[1] < 2.5 * sizes[0]  # blocks of five vehicles in both fleets


def test_infeasibility_found_in_other_processes_has_the_same_reasons() -> None:
    scenario = rho.Scenario(
        name="too fast",
        vehicles=[
            rho.Vehicle(f"v{i}", rho.State([3.0 * i, 0, 0]), rho.State([3.0 * i, 50, 0]))
            for i in range(12)
        ],
        grid=rho.Grid(0.2, 26),
        limits=rho.Limits(velocity=rho.Box([-5, -5, -5], [5, 5, 5])),
    )
    errors = []
    for executor in (None, Sent()):
        with pytest.raises(rho.InfeasibleError) as caught:
            rho.plan(scenario, executor=executor)
        errors.append(caught.value)
    assert errors[0].conflicts == errors[1].conflicts
    assert len(errors[0].conflicts) == 12


def test_blocks_hold_every_row_once_and_keep_groups_together() -> None:
    scenario = fleet(3, 40)
    effort = MinimumEffort.of(scenario)
    pairs = Problem.of(scenario).pairs_around(effort.motion, rho.coupled)
    rows = about(effort.motion, [pairs.violated_rows(effort.motion, np.arange(40))])
    assert len(rows[0]) > 50
    groups = groups_of(40, rows)
    seen = list(blocks._in_blocks(40, rows))
    held = [np.unique(groups[part.vehicles]) for own in seen for part in own]
    assert len(np.unique(np.concatenate(held))) == sum(map(len, held))
    times = np.concatenate([part.times for own in seen for part in own])
    np.testing.assert_array_equal(np.sort(times), np.sort(rows[0].times))


@pytest.mark.slow
def test_multipliers_come_back_with_the_answers() -> None:
    scenario = fleet(4)
    effort = MinimumEffort.of(scenario)
    pairs = Problem.of(scenario).pairs_around(effort.motion, rho.decoupled)
    rows: list[Rows] = about(
        effort.motion, [pairs.softened(1e3).violated_rows(effort.motion, np.arange(20))]
    )
    here = solve_all(effort.changes, rows)
    there = solve_all(effort.changes, rows, Backend(executor=Sent()))
    assert len(here) == len(there) > 1
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.groups, other.groups)
        np.testing.assert_array_equal(one.accelerations, other.accelerations)
        for index in range(len(one.groups)):
            np.testing.assert_array_equal(one.multipliers(index), other.multipliers(index))
