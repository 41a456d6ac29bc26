"""The working set of rows: equal rows have one key, and different rows have different keys."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint, HalfSpaces, about
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.reduced import rows_of
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from tests.scenarios import box, fleet, single
from tests.tolerances import ROUNDING

GRID = rho.Grid(0.5, 17)
COUNT = 7


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class OnVelocities(Constraint):
    """Constraint with irrelevant geometry."""

    def violated_rows(self, motion: Motion, vehicles: Any, **options: Any) -> HalfSpaces:
        """Return no rows."""
        return self.none


def constraint(number: int = 3, *, curved: bool = False) -> Constraint:
    """Return a constraint on velocities."""
    return OnVelocities(
        kind="velocity", key=number, name=f"constraint {number}", quantity="velocity", curved=curved
    )


def rows(
    of: Constraint,
    *,
    vehicles: Any = (0,),
    partners: Any = None,
    sides: Any = (0,),
    times: Any = (1.0,),
    normals: Any = ((1.0, 0.0, 0.0),),
    bounds: Any = (-1.0,),
) -> HalfSpaces:
    """Return rows of a constraint; a single value holds for all rows."""
    own = np.asarray(vehicles)
    given = own if partners is None else np.asarray(partners)
    arrays = np.broadcast_arrays(own, given, np.asarray(sides), np.asarray(times, float))
    size = len(arrays[0])
    return HalfSpaces(
        of,
        vehicles=arrays[0],
        partners=arrays[1],
        sides=arrays[2],
        times=arrays[3],
        normals=np.broadcast_to(normals, (size, 3)),
        bounds=np.broadcast_to(bounds, (size,)),
        tolerances=np.full(size, 1e-6),
    )


def moving(velocity: tuple[float, float, float]) -> Motion:
    """Return the motion of seven vehicles with constant velocity."""
    grid = rho.Grid(0.5, 17)
    alone = single(start=rho.State([0, 0, 0], velocity), grid=grid)
    coasting = rho.Plan.from_accelerations(alone, np.zeros((1, 16, 3))).motion()
    return coasting.of(np.zeros(COUNT, dtype=int))


MOTION = moving((0.0, 0.0, 0.0))


def working_set() -> WorkingSet:
    """Return an empty working set for seven vehicles."""
    return WorkingSet(RowKeys(COUNT, GRID))


whose = st.tuples(
    st.integers(0, COUNT - 1),
    st.integers(0, COUNT - 1),
    st.integers(0, 255),
    st.integers(0, 16 * 1000),
)


def key(parts: tuple[int, int, int, int], count: int = COUNT, grid: rho.Grid = GRID) -> int:
    """Return the key of one row: vehicle, partner, side, and time in 1/1000 steps."""
    vehicle, partner, side, moment = parts
    part = rows(
        constraint(),
        vehicles=[vehicle],
        partners=[partner],
        sides=[side],
        times=[grid.step * moment / 1000],
    )
    return int(RowKeys(count, grid).of(part)[0])


@given(one=whose, other=whose)
def test_rows_have_the_same_key_if_and_only_if_they_are_the_same(
    one: tuple[int, int, int, int], other: tuple[int, int, int, int]
) -> None:
    assert (key(one) == key(other)) == (one == other)


@given(parts=whose, data=st.data())
def test_a_row_that_differs_in_one_thing_has_another_key(
    parts: tuple[int, int, int, int], data: st.DataObject
) -> None:
    index = data.draw(st.integers(0, 3))
    most = (COUNT, COUNT, 256, 16001)[index]
    changed = list(parts)
    changed[index] = (parts[index] + data.draw(st.integers(1, most - 1))) % most
    assert key(parts) != key(tuple(changed))  # type: ignore[arg-type]  # four


def test_keys_of_a_thousand_vehicles_in_a_long_flight_do_not_overflow() -> None:
    grid = rho.Grid(0.01, 10_001)
    corners = [
        (vehicle, partner, side, moment)
        for vehicle in (0, 999)
        for partner in (0, 999)
        for side in (0, 255)
        for moment in (0, 500, 10_000 * 1000)
    ]
    keys = [key(corner, 1000, grid) for corner in corners]
    assert min(keys) >= 0
    assert len(set(keys)) == len(corners)


def test_a_time_that_differs_by_rounding_is_the_same_instant() -> None:
    times = 0.1 + 0.2, 0.3
    assert times[0] != times[1]
    one, other = RowKeys(COUNT, rho.Grid(0.1, 17)).of(
        rows(constraint(), vehicles=[0, 0], times=times)
    )
    assert one == other


def test_exactly_the_added_rows_are_known() -> None:
    working = working_set()
    every = rows(constraint(), vehicles=[5, 0, 3, 3, 2], times=[1.0, 2.0, 0.5, 4.0, 7.5])
    assert not working.known(every, MOTION).any()
    working.add(every.select(np.array([3, 0])))
    np.testing.assert_array_equal(working.known(every, MOTION), [True, False, False, True, False])
    working.add(every.select(np.array([1])))
    np.testing.assert_array_equal(working.known(every, MOTION), [True, True, False, True, False])
    assert len(working) == 3
    for number, known in ((3, True), (4, False)):  # rows of another constraint differ
        part = rows(constraint(number), vehicles=[5])
        working.add(rows(constraint(4), vehicles=[6]))
        assert working.known(part, MOTION).tolist() == [known]


def test_adding_no_rows_changes_nothing() -> None:
    working, own = working_set(), constraint()
    working.add(own.none)
    assert not working.known(rows(own), MOTION).any()
    assert len(working.enter(rows(own), MOTION)[0]) == 1


def test_a_curved_set_may_have_several_normals_at_one_instant() -> None:
    """At twice the speed its cuts allow, another cut counts as known if it is violated no more."""
    curved, working = constraint(curved=True), working_set()
    motion = moving((-2.0, 0.0, 0.0))
    turned = [np.cos(1.0), np.sin(1.0), 0.0]
    first = rows(curved, normals=[turned], bounds=[-1.0])
    working.add(first)
    assert working.known(first, motion).all()
    for different in (
        rows(curved, normals=[[1.0, 0.0, 0.0]], bounds=[-1.0]),
        rows(curved, normals=[turned], bounds=[-1.0], times=[1.5]),
        rows(curved, normals=[turned], bounds=[-1.0], vehicles=[1]),
    ):
        assert not working.known(different, motion).any()
    working.add(rows(curved, normals=[[1.0, 0.0, 0.0]], bounds=[-1.0]))
    assert working.known(first, motion).all()
    (kept,) = working.rows.values()
    assert kept.sides.min() >= 0
    assert len(set(RowKeys(COUNT, GRID).of(kept).tolist())) == 2


def test_selected_rows_belong_to_the_vehicles_and_keep_their_order() -> None:
    working = working_set()
    working.add(rows(constraint(2), vehicles=[4, 1, 4], times=[1.0, 2.0, 3.0]))
    working.add(rows(constraint(1), vehicles=[0]))
    assert working.of(np.arange(COUNT), COUNT) == list(working.rows.values())
    (own,) = working.of(np.array([2, 4]), COUNT)
    assert own.vehicles.tolist() == [4, 4]
    assert own.times.tolist() == [1.0, 3.0]
    assert [part.constraint.key for part in working.of(np.array([0, 1]), COUNT)] == [2, 1]


def test_active_rows_are_those_without_slack() -> None:
    """Rows v_x >= bound of a vehicle at 1 m/s have slack 0, slack 0.01, and a violation."""
    start = rho.State([0, 0, 0], [1, 0, 0])
    motion = rho.Plan.from_accelerations(single(start=start), np.zeros((1, 16, 3))).motion()
    working = working_set()
    working.add(rows(constraint(), vehicles=[0] * 3, times=[1, 2, 3], bounds=[1.0, 0.99, 1.5]))
    working.add(rows(constraint(4), bounds=[0.0]))
    (active,) = working.active(motion)
    np.testing.assert_allclose(active.margins(motion), [0.0, -0.5], atol=ROUNDING)


def _dual_gradient(planes: CuttingPlanes, vehicle: int) -> tuple[np.ndarray, np.ndarray]:
    """Return 2 u and M' y of the program of a vehicle's group, which are equal by KKT."""
    effort, group = planes.problem.effort, planes.working.group(vehicle)
    parts = planes.working.multipliers(vehicle)
    matrix, _, _ = rows_of(effort.changes, group, about(effort.motion, [part for part, _ in parts]))
    gradient = matrix.T @ np.concatenate([y for _, y in parts])
    inside = gradient.reshape(len(group), -1, 3)
    every = zip(group, inside, strict=True)
    inside = np.stack([effort.changes.space(i).projected(each.T).T for i, each in every])
    moved = planes.motion.accelerations[group] - effort.motion.accelerations[group]
    return 2.0 * moved / effort.changes.units[group].max(), inside


def test_multipliers_balance_the_cost() -> None:
    """By stationarity twice the change of accelerations is M' y, apart from the goals."""
    scenario = fleet(
        [[0, 0, 0], [0, 9, 0], [0, 18, 0]],
        [[10, 4, -2], [5, 9, 0], [9, 18, 3]],
        limits=rho.Limits(velocity=box(1.2)),
    ).without_separation()
    problem = Problem.of(scenario)
    planes = CuttingPlanes(problem)
    planes.keep_to(problem.convex)
    for vehicle, binding in ((0, True), (1, False), (2, True)):
        assert bool(planes.working.multipliers(vehicle)) == binding
        assert planes.working.group(vehicle).tolist() == [vehicle]
        if binding:
            changed, gradient = _dual_gradient(planes, vehicle)
            np.testing.assert_allclose(changed, gradient, atol=1e-6 * np.abs(changed).max())
            assert np.abs(changed).max() > 1e-3


def test_multipliers_of_a_coupled_group_balance_the_cost_of_all_of_it() -> None:
    """Two crossing vehicles share a program; a distant third one has none."""
    starts = np.array([[-5, 0.3, 0], [0, 50, 0], [0, -5, 0]])
    scenario = fleet(starts, np.array([[5, 0, 0], [9, 50, 0], [0, 5, 0.2]]))
    subproblem = Subproblem(Problem.of(scenario), rho.coupled)
    subproblem.solve_around(rho.plan_scp(scenario))
    planes = subproblem.planes
    assert planes is not None
    assert planes.working.group(0).tolist() == planes.working.group(2).tolist() == [0, 2]
    assert planes.working.group(1).tolist() == [1]
    changed, gradient = _dual_gradient(planes, 2)
    assert np.abs(changed).max() > 1e-3
    np.testing.assert_allclose(changed, gradient, atol=1e-5 * np.abs(changed).max())
    assert MinimumEffort.of(scenario).motion.accelerations[1] == pytest.approx(
        planes.motion.accelerations[1]
    )
