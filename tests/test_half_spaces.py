"""Rows of constraints: supporting half-spaces of convex sets where a motion violates them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.dynamics import Motion, sparse_response
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.boxes import boxes_of
from drake_rho.planning.constraints.goals import goals_of
from drake_rho.planning.constraints.keep_out import across, side_of
from drake_rho.planning.constraints.margins import margins_of
from drake_rho.planning.constraints.separation import Coupling
from drake_rho.planning.problem import Problem
from tests.scenarios import acceleration_outside, box, fleet, single
from tests.tolerances import ROUNDING

seeds = st.integers(0, 2**32 - 1)
SPHERE = rho.Sphere([1.0, 1.0, -1.0], 2.0)


def _three(**options: Any) -> rho.Scenario:
    """Return three vehicles in boxes of all kinds, the second with its own."""
    limits = rho.Limits(
        position=rho.Box([-12, -8, -6], [11, 7, 5]),
        velocity=rho.Box([-2, -1, -3], [3, 2, 1]),
        acceleration=rho.Box([-1, -0.5, -1.5], [1.5, 1, 0.5]),
        jerk=rho.Box([-1, -2, -3], [3, 2, 1]),
    )
    scenario = fleet(
        np.array([[-5, 0.3, 0], [0, -5, 0], [4, 4, 0.5]]),
        np.array([[5, 0, 0], [0, 5, 0.2], [-4, -4, 0]]),
        separation=rho.Separation(2.5, 2.0),
        limits=limits,
        obstacles=(SPHERE,),
        **options,
    )
    before = rho.State([0, -5, 0], acceleration=[0.3, 0.0, -0.2])
    second = rho.Vehicle("v1", before, scenario.vehicles[1].goal, rho.Limits(velocity=box(0.7)))
    first, _, third = scenario.vehicles
    return dataclasses.replace(scenario, vehicles=(first, second, third))


def _flown(scenario: rho.Scenario, seed: int, size: float = 1.0) -> Motion:
    """Return a motion of random accelerations of about `size`, on its way to the goals."""
    rng = np.random.default_rng(seed)
    free = dataclasses.replace(scenario, limits=rho.Limits(), obstacles=(), separation=None)
    vehicles = tuple(dataclasses.replace(each, limits=None) for each in scenario.vehicles)
    plan = rho.plan_convex(dataclasses.replace(free, vehicles=vehicles))
    noise = size * rng.normal(size=plan.accelerations.shape)
    return rho.Plan.from_accelerations(scenario, plan.accelerations + noise).motion()


def _places(rows: HalfSpaces) -> set[tuple[int, int, float]]:
    every = zip(rows.vehicles.tolist(), rows.sides.tolist(), rows.times.tolist(), strict=True)
    return {(vehicle, side, round(time, 9)) for vehicle, side, time in every}


def _limited_knots(scenario: rho.Scenario, vehicle: int, kind: Any) -> tuple[int, int]:
    """Return the first and the last knot at which a box limits a quantity."""
    first, last = int(kind in ("position", "velocity")), scenario.grid.knots - 2
    if kind == "jerk":
        own = scenario.vehicles[vehicle]
        first = int(np.isnan(acceleration_outside(own.start)[0]))
        last += int(not np.isnan(acceleration_outside(own.goal)[0]))
    return first, last


def _slow_box_rows(
    scenario: rho.Scenario, motion: Motion, kind: Any, vehicles: list[int]
) -> set[tuple[int, int, float]]:
    """Return the violated sides at the knots by loops over vehicles and knots."""
    found, h = set(), scenario.grid.step
    for vehicle in vehicles:
        bounds = getattr(scenario.limits_of(scenario.vehicles[vehicle]), kind)
        if bounds is None:
            continue
        first, last = _limited_knots(scenario, vehicle, kind)
        for k in range(first, last + 1):
            value = motion.values(kind)[vehicle, k]
            for axis in range(3):
                if value[axis] < bounds.lower[axis]:
                    found.add((vehicle, axis, round(h * k, 9)))
                if value[axis] > bounds.upper[axis]:
                    found.add((vehicle, 3 + axis, round(h * k, 9)))
    return found


@given(seed=seeds)
@settings(max_examples=6)
def test_a_box_gives_a_row_for_every_violated_side_and_knot(seed: int) -> None:
    scenario = _three()
    motion = _flown(scenario, seed)
    for constraint in boxes_of(scenario, margins_of(scenario)):
        for vehicles in ([0, 1, 2], [1], [0, 2]):
            rows = constraint.violated_rows(motion, np.array(vehicles))
            slow = _slow_box_rows(scenario, motion, constraint.quantity, vehicles)
            assert _places(rows) == slow
            assert len(rows) == len(slow)
            assert np.all(rows.margins(motion) < 0.0)


@given(seed=seeds)
@settings(max_examples=6)
def test_neighbours_of_a_violated_row_are_the_same_side_at_the_next_knots(seed: int) -> None:
    scenario = _three()
    motion, every = _flown(scenario, seed, 0.4), np.arange(3)
    for constraint in boxes_of(scenario, margins_of(scenario)):
        few = _places(constraint.violated_rows(motion, every))
        more = _places(constraint.violated_rows(motion, every, neighbours=1))
        h, wanted = scenario.grid.step, set()
        for vehicle, side, time in few:
            first, last = _limited_knots(scenario, vehicle, constraint.quantity)
            for k in range(round(time / h) - 1, round(time / h) + 2):
                if first <= k <= last:
                    wanted.add((vehicle, side, round(h * k, 9)))
        assert more == wanted


def test_a_motion_inside_its_boxes_gives_no_rows() -> None:
    scenario = _three()
    still = rho.Plan.from_accelerations(scenario, np.zeros((3, 20, 3))).motion()
    for constraint in boxes_of(scenario, margins_of(scenario))[:3]:
        assert len(constraint.violated_rows(still, np.arange(3))) == 0
        assert len(constraint.violated_rows(still, np.arange(3), neighbours=4)) == 0


@given(seed=seeds)
@settings(max_examples=6)
def test_between_knots_a_box_gives_a_row_where_a_coordinate_turns_beyond_it(seed: int) -> None:
    scenario = _three(between_knots=True)
    motion = _flown(scenario, seed, 6.0)
    position, *others = boxes_of(scenario, margins_of(scenario))
    assert position.searches > 0
    assert not any(each.searches for each in others)
    vehicles = np.array([0, 2])
    rows = position.violated_rows(motion, vehicles, between=True)
    assert np.all(rows.margins(motion) < 0.0)
    bounds = scenario.limits.position
    assert bounds is not None
    h, found = scenario.grid.step, _places(rows)
    for vehicle in vehicles.tolist():
        for k in range(scenario.grid.knots - 1):
            s = h * np.linspace(0.0, 1.0, 401)
            path = motion.at("position", h * k + s)[vehicle]
            for side in range(6):
                axis, upper = side % 3, side >= 3
                beyond = path[:, axis] - bounds.upper[axis]
                if not upper:
                    beyond = bounds.lower[axis] - path[:, axis]
                worst = int(np.argmax(beyond))
                if 0 < worst < 400 and beyond[worst] > 1e-5:
                    moment = h * k + s[worst]
                    times = [t for v, other, t in found if (v, other) == (vehicle, side)]
                    assert np.abs(np.array(times) - moment).min() < 0.01 * h


@pytest.mark.parametrize("coupling", [rho.coupled, rho.decoupled])
def test_margins_change_with_accelerations_by_the_responses(coupling: Coupling) -> None:
    """Rows are affine: accelerations that change by da change their margins by M da."""
    scenario = _three()
    motion, every = _flown(scenario, 1, 0.1), np.arange(3)
    other = _flown(scenario, 2, 2.0)
    constraints: list[Constraint] = [
        *boxes_of(scenario, margins_of(scenario)),
        *Problem.of(scenario).obstacles_around(motion),
        Problem.of(scenario).pairs_around(motion, coupling),
        *goals_of(scenario),
    ]
    kinds = set()
    for constraint in constraints:
        for between in (False, True):
            if between and not constraint.searches:
                continue
            rows = constraint.violated_rows(other, every, between=between)
            if len(rows) == 0:
                continue
            kinds.add((constraint.quantity, constraint.coupled))
            change = other.accelerations - motion.accelerations
            moved = change[rows.vehicles]
            if constraint.coupled:
                moved = moved - change[rows.partners]
            answer = np.einsum("rj,rjx,rx->r", rows.responses(scenario.grid), moved, rows.normals)
            np.testing.assert_allclose(
                rows.margins(other) - rows.margins(motion), answer, atol=1e-9
            )
            grid = scenario.grid
            sparse = sparse_response(constraint.quantity, grid.step, grid.knots, rows.times)
            np.testing.assert_allclose(sparse.toarray(), rows.responses(grid))
    quantities = {quantity for quantity, _ in kinds}
    assert quantities == {"position", "velocity", "acceleration", "jerk"}
    assert any(together for _, together in kinds) == coupling.together


@given(seed=seeds)
@settings(max_examples=6)
def test_rows_of_an_obstacle_support_it_and_hold_for_a_reference_outside(
    seed: int,
) -> None:
    scenario = _three()
    reference, other = _flown(scenario, seed, 0.5), _flown(scenario, seed + 1)
    (constraint,) = Problem.of(scenario).obstacles_around(reference)
    rows = constraint.violated_rows(other, np.arange(3), neighbours=scenario.grid.knots)
    np.testing.assert_allclose(np.linalg.norm(rows.normals, axis=1), 1.0, rtol=ROUNDING)
    # depth of the centre below the tangent plane
    depth = rows.bounds - rows.normals @ SPHERE.center
    np.testing.assert_allclose(depth, SPHERE.radius, rtol=ROUNDING)
    q = reference.each_at("position", rows.vehicles, rows.times) - SPHERE.center
    clearance = np.linalg.norm(q, axis=1) - SPHERE.radius
    np.testing.assert_allclose(rows.margins(reference), clearance, atol=ROUNDING * 100)


@given(seed=seeds)
@settings(max_examples=6)
def test_an_obstacle_gives_the_rows_violated_at_the_knots(seed: int) -> None:
    scenario = _three()
    reference, other = _flown(scenario, seed, 0.5), _flown(scenario, seed + 1)
    (constraint,) = Problem.of(scenario).obstacles_around(reference)
    for vehicles in ([0, 1, 2], [1], [0, 2]):
        rows = constraint.violated_rows(other, np.array(vehicles))
        slow = set()
        for vehicle in vehicles:
            for k in range(1, scenario.grid.knots - 1):
                q = reference.positions[vehicle, k] - SPHERE.center
                n = q / np.linalg.norm(q)
                if n @ (other.positions[vehicle, k] - SPHERE.center) < SPHERE.radius - 1e-7:
                    slow.add((vehicle, 0, round(0.5 * k, 9)))
        assert _places(rows) == slow
        assert np.all(rows.margins(other) < 0.0)
        knots = np.rint(rows.times / 0.5).astype(int)
        np.testing.assert_allclose(rows.margins_at(other, knots), rows.margins(other))


@pytest.mark.parametrize("between_knots", [False, True])
def test_a_motion_through_an_obstacle_gives_a_row_at_its_worst_instant(
    between_knots: bool,
) -> None:
    """Past the centre, rows are at the closest approach, or at the knots inside."""
    start, goal = rho.State([0, 0, 0], [1, 0, 0]), rho.State([10, 0, 0], [1, 0, 0])
    sphere = rho.Sphere([4.8, 0.5, 0.0], 1.0)
    scenario = single(
        start=start,
        goal=goal,
        obstacles=(sphere,),
        grid=rho.Grid(0.5, 21),
        between_knots=between_knots,
    )
    motion = rho.plan_convex(scenario.without_obstacles()).motion()
    (constraint,) = Problem.of(scenario).obstacles_around(motion)
    rows = constraint.violated_rows(motion, np.array([0]), between=True)
    if between_knots:
        worst = int(np.argmin(rows.margins(motion)))
        assert rows.times[worst] == pytest.approx(4.8)
        assert rows.normals[worst] == pytest.approx(np.array([0.0, -1.0, 0.0]))
        assert rows.margins(motion)[worst] == pytest.approx(-0.5)
        assert np.all(np.diff(rows.times) > 0.0)  # each instant once
    else:
        assert rows.times == pytest.approx([4.0, 4.5, 5.0, 5.5])
    assert bool(constraint.searches) == between_knots
    renewed = constraint.renewed(rows)
    np.testing.assert_array_equal(renewed.bounds, rows.bounds)
    np.testing.assert_array_equal(renewed.normals, rows.normals)


@pytest.mark.parametrize("downwash", [0.5, 1.0, 2.0])
def test_rows_about_differences_support_the_ellipsoid(downwash: float) -> None:
    scenario = dataclasses.replace(_three(), separation=rho.Separation(2.5, downwash))
    reference = _flown(scenario, 4, 0.2)
    pairs = Problem.of(scenario).pairs_around(reference, rho.coupled)
    rows = pairs.rows(pairs.points)
    assert len(rows) > 5
    ellipsoid = 2.5 * np.array([1.0, 1.0, downwash])
    np.testing.assert_allclose(
        rows.bounds, np.linalg.norm(rows.normals * ellipsoid, axis=1), rtol=ROUNDING
    )
    one = reference.each_at("position", rows.vehicles, rows.times)
    x = one - reference.each_at("position", rows.partners, rows.times)
    outside = np.linalg.norm(x / ellipsoid, axis=1) >= 1.0
    assert outside.any()
    assert not outside.all()
    assert np.all(rows.margins(reference)[outside] >= -ROUNDING)
    assert np.all(rows.margins(reference)[~outside] < 0.0)


@given(seed=seeds)
@settings(max_examples=6)
def test_two_vehicles_share_the_slack_of_the_reference(seed: int) -> None:
    """Their two rows add up to the row about their difference, and each has half of its slack."""
    scenario = _three()
    reference, other = _flown(scenario, seed, 0.2), _flown(scenario, seed + 1)
    whole, halves = (
        Problem.of(scenario).pairs_around(reference, each) for each in (rho.coupled, rho.decoupled)
    )
    one, two = whole.rows(whole.points), halves.rows(halves.points)
    assert len(two) == 2 * len(one)
    margins = {
        (i, j, round(t, 9)): (m, r)
        for i, j, t, m, r in zip(
            two.vehicles.tolist(),
            two.partners.tolist(),
            two.times.tolist(),
            two.margins(other),
            two.margins(reference),
            strict=True,
        )
    }
    of_whole = one.margins(other), one.margins(reference)
    for index, (i, j, t) in enumerate(zip(one.vehicles, one.partners, one.times, strict=True)):
        mine, its = margins[i, j, round(t, 9)], margins[j, i, round(t, 9)]
        assert mine[0] + its[0] == pytest.approx(of_whole[0][index], abs=1e-9)
        assert mine[1] == pytest.approx(of_whole[1][index] / 2, abs=1e-9)
        assert its[1] == pytest.approx(mine[1], abs=1e-9)


@pytest.mark.parametrize("coupling", [rho.coupled, rho.decoupled])
@pytest.mark.parametrize("of", [[0], [1], [2], [0, 2], [0, 1, 2]])
def test_pairs_with_a_checked_vehicle_give_their_violated_rows(
    coupling: Coupling, of: list[int]
) -> None:
    scenario = _three(between_knots=False)
    reference, other = _flown(scenario, 4, 0.2), _flown(scenario, 5, 0.3)
    pairs = Problem.of(scenario).pairs_around(reference, coupling)
    every = pairs.rows(pairs.points)
    broken = every.margins(other) < -1e-7
    looked_at = np.isin(every.vehicles, of)
    if coupling.together:
        looked_at |= np.isin(every.partners, of)
    expected = every.select(broken & looked_at)
    found = pairs.violated_rows(other, np.array(of))
    assert len(expected) > 0
    for name in ("vehicles", "partners", "times", "bounds"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_rows_of_pairs_are_given_at_near_inner_knots_of_the_reference() -> None:
    """Side by side at 1.2 m there are rows at every inner knot, and at 1.4 m there are none."""
    for gap, count in ((1.2, 19), (1.4, 0)):
        ends = np.array([[0, 0, 0], [0, gap, 0]])
        scenario = fleet(ends, ends + np.array([10, 0, 0]))
        motion = rho.plan_scp(scenario.without_separation()).motion()
        pairs = Problem.of(scenario).pairs_around(motion, rho.coupled)
        assert len(np.unique(pairs.rows(pairs.points).times)) == count
        assert len(pairs.violated_rows(motion, np.arange(2))) == 0


@pytest.mark.parametrize("downwash", [0.5, 1.0, 2.0])
def test_rows_are_linearisations_of_their_quadratics(downwash: float) -> None:
    """Around the reference, norm(scales (x - c))² - size² has the row as its linearisation."""
    scenario = dataclasses.replace(_three(), separation=rho.Separation(2.5, downwash))
    reference = _flown(scenario, 6, 0.2)
    pairs = Problem.of(scenario).pairs_around(reference, rho.coupled)
    (obstacle,) = Problem.of(scenario).obstacles_around(reference)
    for constraint, rows in (
        (pairs, pairs.rows(pairs.points)),
        (obstacle, obstacle.violated_rows(_flown(scenario, 7), np.arange(3))),
    ):
        quadratic = constraint.quadratics(rows)
        assert quadratic is not None
        x = reference.each_at("position", rows.vehicles, rows.times)
        if constraint.coupled:
            x = x - reference.each_at("position", rows.partners, rows.times)
        scaled = quadratic.scales * (x - quadratic.centers)
        directions = scaled / np.linalg.norm(scaled, axis=1)[:, None]
        # directions · scales (x - c) >= size, over the length of the scaled normal
        np.testing.assert_allclose(
            rows.normals * quadratic.lengths[:, None], directions * quadratic.scales, atol=ROUNDING
        )
        np.testing.assert_allclose(
            rows.bounds - np.sum(rows.normals * quadratic.centers, axis=1),
            quadratic.sizes / quadratic.lengths,
            rtol=ROUNDING,
        )
    assert boxes_of(scenario, margins_of(scenario))[0].quadratics(rows) is None


@given(seed=seeds)
def test_a_side_is_a_unit_vector_across_the_path_towards_the_offset(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way, offset = 10 ** rng.uniform(-3, 3) * rng.normal(size=3), rng.normal(size=3)
    side, rounding = side_of(offset, way), float(ROUNDING * np.linalg.norm(way))
    assert np.linalg.norm(side) == pytest.approx(1.0)
    assert side @ way == pytest.approx(0.0, abs=rounding)
    if np.linalg.norm(np.cross(offset, way)) > 2e-3 * np.linalg.norm(offset) * np.linalg.norm(way):
        assert side @ offset > 0.0  # an offset along the path, except for rounding, has no side
    for along in (way, -way, np.zeros(3)):
        head_on = side_of(3.0 * along, along)
        assert np.linalg.norm(head_on) == pytest.approx(1.0)
        assert head_on @ along == pytest.approx(0.0, abs=rounding)
        ahead = along / (np.linalg.norm(along) or 1.0)
        np.testing.assert_allclose(head_on, across(ahead), rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_a_goal_gives_a_row_for_the_side_on_which_it_is_missed(size: float) -> None:
    scenario = _three()
    motion = _flown(scenario, 8, size)
    goals = goals_of(scenario)
    assert len({each.key for each in goals}) == 6
    for axis in range(3):
        for quantity in ("position", "velocity"):
            (goal,) = [
                each
                for each in goals
                if each.quantity == quantity and each.name == f"goal {'xyz'[axis]}"
            ]
            rows = goal.violated_rows(motion, np.array([0, 2]))
            assert rows.vehicles.tolist() == [0, 2]
            np.testing.assert_allclose(rows.times, scenario.grid.duration)
            last = motion.values(goal.quantity)[[0, 2], -1, axis]
            wanted = np.array(
                [getattr(scenario.vehicles[index].goal, quantity)[axis] for index in (0, 2)]
            )
            np.testing.assert_allclose(rows.margins(motion), -np.abs(last - wanted), atol=1e-12)
            assert np.unique(rows.sides).size == np.unique(last > wanted).size
    reached = _flown(scenario, 0, 0.0)
    for goal in goals:
        assert len(goal.violated_rows(reached, np.arange(3))) == 0


def test_each_encounter_has_one_normal_on_request() -> None:
    """A hovering vehicle is passed on its right on the way out, and on its left on the way back."""
    there = single(start=rho.State([-5, 0.2, 0]), goal=rho.State([5, 0.2, 0]))
    back = single(start=rho.State([5, 0.2, 0]), goal=rho.State([-5, -0.6, 0]))
    legs = [rho.plan_convex(each).accelerations[0] for each in (there, back)]
    ends = np.array([[0, 0, 0], [-5, 0.2, 0]])
    goals = np.array([[0, 0, 0], [-5, -0.6, 0]])
    scenario = fleet(ends, goals, grid=rho.Grid(0.5, 33))
    flown = np.stack([np.zeros((32, 3)), np.concatenate(legs)])
    reference = rho.Plan.from_accelerations(scenario, flown).motion()
    pairs = Problem.of(scenario).pairs_around(reference, rho.coupled, penalty=1.0, one_normal=True)
    places = pairs.points
    close = np.linalg.norm(pairs.offsets(reference, places), axis=1) < 1.0
    for passing, y in ((places.times < 8.0, -1.0), (places.times > 8.0, 1.0)):
        directions = pairs.directions(places)[close & passing]
        assert len(directions) > 1
        np.testing.assert_array_equal(directions, np.tile(directions[0], (len(directions), 1)))
        assert directions[0] @ [0.0, y, 0.0] > 0.98
        way = pairs.relative_velocities(places)[close & passing]
        assert np.abs(way @ directions[0]).max() < 0.1 * np.linalg.norm(way, axis=1).max()
    plain = (
        Problem.of(scenario).pairs_around(reference, rho.coupled, penalty=1.0).directions(places)
    )
    x = pairs.offsets(reference, places)
    along = x / np.linalg.norm(x, axis=1)[:, None]
    np.testing.assert_allclose(plain, along, atol=ROUNDING)
    np.testing.assert_allclose(pairs.directions(places)[~close], along[~close], atol=ROUNDING)


def test_soft_rows_require_a_little_more_than_the_separation() -> None:
    scenario = _three()
    reference = _flown(scenario, 4, 0.2)
    hard, soft = (
        Problem.of(scenario).pairs_around(reference, rho.coupled, penalty=penalty)
        for penalty in (np.inf, 1.0)
    )
    one, two = hard.rows(soft.points), soft.rows(soft.points)
    np.testing.assert_allclose(two.bounds, 1.02 * one.bounds, rtol=ROUNDING)
    np.testing.assert_allclose(two.normals, one.normals, rtol=ROUNDING)
    assert soft.penalty == 1.0
    assert np.isinf(hard.penalty)


@pytest.mark.parametrize("coupling", [rho.coupled, rho.decoupled])
def test_rows_are_renewed_around_another_reference_at_the_same_places(coupling: Coupling) -> None:
    scenario = _three(between_knots=False)
    old, new = (
        Problem.of(scenario).pairs_around(_flown(scenario, 4, size), coupling)
        for size in (0.2, 0.21)
    )
    rows = old.rows(old.points).select(slice(None, None, 2))
    renewed = new.renewed(rows)
    assert renewed.constraint is new
    wanted = {  # a row of one vehicle of a pair implies that of the other, if each has its own
        (*pair, round(t, 6))
        for i, j, t in zip(rows.vehicles.tolist(), rows.partners.tolist(), rows.times, strict=True)
        for pair in ((i, j), (j, i))
    }
    every = new.rows(new.points)
    there = {
        (i, j, round(t, 6))
        for i, j, t in zip(
            every.vehicles.tolist(), every.partners.tolist(), every.times, strict=True
        )
    }
    found = {
        (i, j, round(t, 6))
        for i, j, t in zip(
            renewed.vehicles.tolist(), renewed.partners.tolist(), renewed.times, strict=True
        )
    }
    assert found == wanted & there
    assert len(found) > 3


def test_descriptions_of_rows_name_constraint_axes_or_partners_and_times() -> None:
    scenario = _three()
    names = ["v0", "v1", "v2"]
    _, velocity, *_ = boxes_of(scenario, margins_of(scenario))
    sides, times = np.array([0, 3, 2]), np.array([1.0, 2.5, 1.5])
    rows = velocity.rows(np.zeros(3, dtype=int), sides, times)
    assert velocity.describe(rows, names, 0.0) == "velocity box x/z from 1 s to 2.5 s"
    assert velocity.describe(rows.select(slice(1)), names, 0.0) == "velocity box x at 1 s"
    pairs = Problem.of(scenario).pairs_around(_flown(scenario, 4, 0.2), rho.coupled)
    every = pairs.rows(pairs.points)
    own = every.select((every.vehicles == 0) & (every.partners == 2))
    assert pairs.describe(own, names, 0.0).startswith("separation from v2 ")
    both = every.select(every.vehicles == 0)
    partners = sorted({names[index] for index in both.partners})
    assert pairs.describe(both, names, 0.0).startswith(f"separation from {', '.join(partners)} ")
