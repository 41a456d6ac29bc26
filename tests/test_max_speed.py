"""The largest speed in any direction: velocities in a ball, by tangent planes."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.spatial.transform import Rotation

import drake_rho as rho
from drake_rho.analysis.trials import PRECISION, is_monotone
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.minimum_violation import minimum_violation
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from tests.arrays import FloatArray
from tests.cones import TWIN, integrals, twin_cost
from tests.scenarios import (
    box,
    examples,
    fleet,
    mapped,
    random_scenario,
    single,
    through_the_middle,
)
from tests.tolerances import INDEX, MOTION

CURVE = rho.State([0.0, 0.0, 0.0], [-1.0, 1.0, 0.5])
"""Start from which the motion to the goal turns, so that its velocity runs along the ball."""


def _speeds(plan: rho.Plan, per_step: int = 10) -> FloatArray:
    """Return sampled norms of the velocity, integrated by (1) and (2) alone; shape (N, S)."""
    h, v = plan.scenario.grid.step, plan.velocities[:, :-1, None]
    s = np.linspace(0.0, h, per_step + 1)[:, None]
    sampled = v + s * plan.accelerations[:, :, None]
    norms: FloatArray = np.linalg.norm(sampled, axis=-1).reshape(len(v), -1)
    return norms


@pytest.mark.parametrize("knots", [5, 17, 60])
@pytest.mark.parametrize("most", [1.5, 1.6, 1.9])
@pytest.mark.parametrize("start", [rho.State([0, 0, 0]), CURVE], ids=["straight", "curve"])
def test_the_cost_equals_that_of_the_program_with_cones(
    knots: int, most: float, start: rho.State
) -> None:
    grid = rho.Grid(8.0 / (knots - 1), knots)
    scenario = single(limits=rho.Limits(max_speed=most), grid=grid, start=start)
    known = twin_cost(scenario)
    if known is None:
        with pytest.raises(rho.InfeasibleError):
            rho.plan_convex(scenario)
        return
    plan = rho.plan_convex(scenario)
    assert plan.cost == pytest.approx(known, rel=TWIN)
    assert rho.verify(plan).ok
    assert _speeds(plan).max() <= most * (1.0 + 1e-6)
    assert plan.cost > rho.plan_convex(single(grid=grid, start=start)).cost * 1.001


def limited(seed: int, *, tight: bool = False) -> rho.Scenario | None:
    """Return a random scenario whose vehicles would be faster, or None if its ends are faster."""
    scenario = random_scenario(seed, tight=tight)
    free = dataclasses.replace(scenario, limits=rho.Limits()).without_obstacles()
    norms = np.linalg.norm(rho.plan_convex(free).velocities, axis=2)
    most = np.random.default_rng(seed).uniform(0.7, 0.95) * norms.max()
    if np.any(norms[:, [0, -1]] > most):
        return None
    limits = dataclasses.replace(scenario.limits, max_speed=float(most))
    return dataclasses.replace(scenario, limits=limits)


@given(seed=st.integers(0, 2**32 - 1), tight=st.booleans())
@examples(few=8, many=20)
def test_costs_of_random_scenarios_equal_those_of_the_programs_with_cones(
    seed: int, tight: bool
) -> None:
    """The scenarios have boxes, and obstacles linearised around the plan without them."""
    scenario = limited(seed, tight=tight)
    if scenario is None:
        return
    try:
        reference = rho.plan_convex(scenario.without_obstacles())
    except rho.InfeasibleError:
        assert twin_cost(scenario.without_obstacles()) is None
        return
    if any(
        np.linalg.norm(reference.positions - sphere.center, axis=2).min() < 1e-3 * sphere.radius
        for sphere in scenario.spheres
    ):
        return  # through a centre, where the planner chooses any direction
    known = twin_cost(scenario, reference)
    try:
        plan = rho.plan_convex(scenario, reference=reference)
    except rho.InfeasibleError:
        assert known is None
        return
    assert known is not None
    assert plan.cost == pytest.approx(known, rel=TWIN)


@pytest.mark.parametrize("knots", [100, 400])
@pytest.mark.parametrize("acceleration", [None, box(3.0)], ids=["", "weak"])
def test_a_long_active_stretch_takes_few_rounds(knots: int, acceleration: rho.Box | None) -> None:
    grid = rho.Grid(8.0 / (knots - 1), knots)
    limits = rho.Limits(acceleration=acceleration, max_speed=1.6)
    plan = rho.plan_convex(single(limits=limits, grid=grid, start=CURVE))
    assert rho.verify(plan).ok
    active = np.linalg.norm(plan.velocities[0], axis=1) > 1.6 * (1.0 - 1e-6)
    assert np.count_nonzero(active) > knots / 2
    assert plan.statistics.programs <= 15
    if acceleration is None and knots == 100:
        assert plan.cost == pytest.approx(twin_cost(plan.scenario), rel=TWIN)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_programs_are_few(seed: int) -> None:
    """Each round divides the excess by four: about fifteen reach the tolerance."""
    scenario = limited(seed)
    if scenario is None:
        return
    try:
        plan = rho.plan_convex(scenario.without_obstacles())
    except rho.InfeasibleError:
        return
    assert plan.statistics.programs <= 20 * len(scenario.vehicles)


@given(
    seed=st.integers(0, 2**32 - 1),
    obstacle=st.booleans(),
    length=st.floats(0.01, 100),
    time=st.floats(0.1, 10),
)
@settings(max_examples=10)
def test_turning_by_any_rotation_turns_the_plan(
    seed: int, obstacle: bool, length: float, time: float
) -> None:
    """A ball is invariant under any rotation, unlike a box."""
    turn = Rotation.random(random_state=seed % 2**31).as_matrix()
    spheres = (rho.Sphere([6.0, 2.0, -1.0], 0.8),) if obstacle else ()
    scenario = single(start=CURVE, limits=rho.Limits(max_speed=1.65), obstacles=spheres)
    plan = rho.plan_convex(scenario)
    other = rho.plan_convex(mapped(scenario, turn, np.array([3.0, -2.0, 1.0]), length, time))
    scale = length / time**2
    assert other.cost == pytest.approx(scale**2 * plan.cost, rel=INDEX)
    expected = scale * plan.accelerations @ turn.T
    largest = np.abs(expected).max()
    np.testing.assert_allclose(other.accelerations, expected, atol=100 * MOTION * largest)


def test_a_box_is_not_a_ball() -> None:
    """The bounds of each axis allow the corners of a box; the ball does not."""
    ball = rho.plan_convex(single(limits=rho.Limits(max_speed=1.6)))
    cube = rho.plan_convex(single(limits=rho.Limits(velocity=box(1.6))))
    assert np.abs(ball.velocities).max() < 1.6
    assert _speeds(cube).max() > 1.7
    both = rho.Limits(velocity=box(1.5), max_speed=1.6)
    assert rho.verify(rho.plan_convex(single(limits=both))).ok


def test_a_violation_is_reported_with_value_limit_excess_and_time() -> None:
    free = rho.plan_convex(single())
    norms = np.linalg.norm(free.velocities[0], axis=1)
    scenario = single(limits=rho.Limits(max_speed=1.5))
    report = rho.verify(rho.Plan.from_accelerations(scenario, free.accelerations))
    (violation,) = report.violations
    assert (violation.constraint, violation.part, violation.unit) == ("maximum speed", "", "m/s")
    assert violation.limit == 1.5
    assert violation.value == pytest.approx(norms.max(), rel=1e-12)
    assert violation.excess == pytest.approx(norms.max() - 1.5, rel=1e-12)
    assert violation.time == scenario.grid.times[np.argmax(norms)]
    (row,) = (row for row in str(report).splitlines() if "maximum speed" in row)
    assert row.endswith("VIOLATED")


@pytest.mark.parametrize(("beyond", "holds"), [(0.9, True), (1.1, False)])
def test_the_verifiers_tolerance_is_a_millionth(beyond: float, holds: bool) -> None:
    """One step reaches the speed, one loses it; the motion's scale is less than the limit."""
    goal = rho.State([1.0, 0.0, 0.0])
    scenario = single(goal=goal, grid=rho.Grid(1.0, 3), limits=rho.Limits(max_speed=1.0))
    scale = 0.5  # 1 m in 2 s
    speed = 1.0 + beyond * 1e-6 * scale
    a = speed * np.array([[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]])
    checks = rho.verify(rho.Plan.from_accelerations(scenario, a)).checks
    (check,) = (check for check in checks if check.constraint == "maximum speed")
    assert check.tolerance == pytest.approx(1e-6 * scale)
    assert check.holds == holds


def test_only_vehicles_with_a_limit_are_checked_for_it() -> None:
    scenario = fleet([[0, 0, 0], [0, 5, 0]], [[9, 0, 0], [9, 5, 0]])
    slow = dataclasses.replace(scenario.vehicles[0], limits=rho.Limits(max_speed=1.1))
    plan = rho.plan_convex(dataclasses.replace(scenario, vehicles=(slow, scenario.vehicles[1])))
    report = rho.verify(plan)
    assert report.ok
    (check,) = (check for check in report.checks if check.constraint == "maximum speed")
    assert (check.vehicle, check.limit) == ("v0", 1.1)
    assert _speeds(plan)[1].max() > 1.3


@pytest.mark.parametrize("coupling", [rho.coupled, rho.decoupled])
def test_fleets_satisfy_the_limit(coupling: object) -> None:
    scenario = through_the_middle(4, limits=rho.Limits(max_speed=1.3))
    plan = rho.plan_scp(scenario, coupling=coupling)  # type: ignore[arg-type]  # a coupling
    assert rho.verify(plan).ok
    free = rho.plan_scp(dataclasses.replace(scenario, limits=rho.Limits()))
    unlimited = rho.Plan.from_accelerations(scenario, free.accelerations)
    assert {each.constraint for each in rho.verify(unlimited).violations} == {"maximum speed"}


@pytest.mark.parametrize("replan_every", [1, 5])
def test_windows_satisfy_the_limit(replan_every: int) -> None:
    """The limit holds in the state in which a window begins, too, which is at the limit."""
    sphere = rho.Sphere([6.0, 2.0, -1.0], 0.8)
    limits = rho.Limits(acceleration=box(3.0), max_speed=1.7)
    scenario = single(start=CURVE, limits=limits, obstacles=(sphere,), between_knots=True)
    flight = rho.plan_rho(scenario, replan_every=replan_every)
    assert rho.verify(flight).ok
    assert not any(window.infeasible for window in flight.windows)
    starts = [window.plan.scenario.vehicles[0].start.velocity for window in flight.windows]
    norms = np.linalg.norm(starts, axis=1)
    assert 1.7 * (1.0 - 1e-6) < norms.max() <= 1.7 * (1.0 + 1e-15)


def test_the_limit_holds_at_every_instant_past_an_obstacle() -> None:
    sphere = rho.Sphere([5.0, 2.3, -1.0], 1.0)
    limits = rho.Limits(max_speed=1.7)
    plan = rho.plan_scp(single(limits=limits, obstacles=(sphere,), between_knots=True))
    assert rho.verify(plan).ok
    assert _speeds(plan, 100).max() == pytest.approx(1.7, rel=1e-6)


def _infeasible(scenario: rho.Scenario) -> rho.InfeasibleError:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    return caught.value


def test_a_conflicting_speed_limit_is_named() -> None:
    error = _infeasible(single(limits=rho.Limits(max_speed=1.3)))
    (names,) = error.conflicts.values()
    assert "maximum speed from 0.5 s to 7.5 s" in names
    (names,) = rho.infeasible_subset(error).values()
    # at most 9.75 m in any direction, so that x alone is out of reach
    assert names == ("goal x", "maximum speed from 0.5 s to 7.5 s")


def test_no_single_axis_is_named_where_only_the_total_distance_is_too_far() -> None:
    error = _infeasible(single(limits=rho.Limits(max_speed=1.0), goal=rho.State([5.0, 5.0, 5.0])))
    (names,) = rho.infeasible_subset(error).values()
    assert names == ("goal x", "goal y", "goal z", "maximum speed from 0.5 s to 7.5 s")


def test_lack_of_acceleration_and_of_speed_are_distinguished() -> None:
    # each would be infeasible without the other
    limits = rho.Limits(acceleration=box(0.8), max_speed=1.5)
    for field in ("acceleration", "max_speed"):
        rho.plan_convex(single(limits=dataclasses.replace(limits, **{field: None})))
    (names,) = rho.infeasible_subset(_infeasible(single(limits=limits))).values()
    kinds = [name.split(" from ")[0] for name in names]
    assert kinds == ["goal x", "acceleration box x", "maximum speed"]


@pytest.mark.parametrize(("knots", "precision"), [(9, 0.01), (17, 0.02), (40, 0.15)])
@pytest.mark.parametrize("most", [0.6, 1.2])
def test_the_least_violation_is_about_that_of_the_program_with_cones(
    knots: int, precision: float, most: float
) -> None:
    """Each instant counts once, by its excess speed, whatever the number of planes that cut it.

    The rounds are bounded, and many knots have not converged by then.
    """
    grid = rho.Grid(8.0 / (knots - 1), knots)
    scenario = single(limits=rho.Limits(max_speed=most), grid=grid, start=rho.State([0, 0, 0]))
    least = _least_violation(scenario)
    assert (
        least * (1.0 - 1e-6)
        <= _violation(minimum_violation(Problem.of(scenario)))
        <= least * (1.0 + precision)
    )


def _violation(plan: rho.Plan) -> float:
    """Return the violations of goals and speed by a plan, each over its scale."""
    (length,), T = plan.scenario.fleet.lengths, plan.scenario.grid.duration
    goal, most = plan.scenario.vehicles[0].goal, plan.scenario.limits.max_speed
    missed = np.abs(plan.positions[0, -1] - goal.position).sum() / length
    missed += np.abs(plan.velocities[0, -1] - goal.velocity).sum() * T / length
    over = np.linalg.norm(plan.velocities[0, 1:-1], axis=1) - most
    return float(missed + np.maximum(0.0, over).sum() * T / length)


def _least_violation(scenario: rho.Scenario) -> float:
    (length,), T = scenario.fleet.lengths, scenario.grid.duration
    goal, most, n = scenario.vehicles[0].goal, scenario.limits.max_speed, scenario.grid.knots - 1
    velocity, position = (length / T**2 * each for each in integrals(scenario))
    program = MathematicalProgram()
    a = program.NewContinuousVariables(n, 3, "a")
    for quantity, value, scale in (
        (position[-1], goal.position, length),
        (velocity[-1], goal.velocity, length / T),
    ):
        slack = program.NewContinuousVariables(3, "goal")
        for x in range(3):
            variables = [*a[:, x], slack[x]]
            for sign in (1.0, -1.0):
                row = np.append(sign * quantity / scale, 1.0)[None]
                program.AddLinearConstraint(row, [sign * value[x] / scale], [np.inf], variables)
        program.AddLinearCost(np.ones(3), slack)
    for row in velocity[:-1]:
        slack = program.NewContinuousVariables(1, "speed")
        program.AddBoundingBoxConstraint(0.0, np.inf, slack)
        program.AddLinearCost(np.ones(1), slack)
        cone = np.zeros((4, 3 * n + 1))
        cone[0, -1] = 1.0
        cone[1:, :-1] = np.kron(row, np.eye(3)) * T / length
        ends = np.array([most, 0.0, 0.0, 0.0]) * T / length
        program.AddLorentzConeConstraint(cone, ends, [*a.reshape(-1), *slack])
    result = ClarabelSolver().Solve(program)
    assert result.is_success()
    return float(result.get_optimal_cost())


def test_the_shortest_duration_is_known() -> None:
    """Full speed after the first step, rest after the last: D = (K - 2) h v."""
    scenario = single(limits=rho.Limits(max_speed=1.3))
    assert is_monotone(scenario)
    far = float(np.linalg.norm([10.0, 4.0, -2.0]))
    known = 16 * far / (15 * 1.3)
    reason = rho.diagnose(scenario)
    assert not reason.feasible
    assert reason.is_monotone
    assert reason.shortest_duration is not None
    assert reason.shortest_duration == pytest.approx(known, rel=2 * PRECISION)
    assert reason.shortest_duration >= known * (1.0 - 1e-6)
    assert reason.acceleration_factor is None
    assert "maximum speed" in str(reason)
    assert "  by" not in str(reason)
    assert rho.shortest_plan(scenario).scenario.grid.duration == pytest.approx(known, rel=1e-8)


def test_a_slower_flight_is_feasible_where_it_is_monotone() -> None:
    """A slowed-down plan satisfies the same largest speed."""
    limits = rho.Limits(max_speed=1.6, acceleration=box(1.5))
    scenario = single(limits=limits)
    assert is_monotone(scenario)
    plan = rho.plan_convex(scenario)
    for factor in (1.1, 3.0):
        grid = rho.Grid(0.5 * factor, 17)
        slower = rho.Plan.from_accelerations(
            single(limits=limits, grid=grid), plan.accelerations / factor**2
        )
        assert rho.verify(slower).ok
    assert not is_monotone(single(limits=limits, start=CURVE))


@pytest.mark.parametrize("most", [1.5, 1.65, 1.8])
@pytest.mark.parametrize("start", [rho.State([0, 0, 0]), CURVE], ids=["straight", "curve"])
def test_the_best_plan_is_certified_as_optimal(most: float, start: rho.State) -> None:
    scenario = single(limits=rho.Limits(max_speed=most), start=start)
    plan = rho.plan_convex(scenario)
    proof = rho.certify(plan)
    assert proof.is_globally_optimal
    assert proof.lower_bound <= plan.cost * (1.0 + INDEX)
    assert proof.lower_bound == pytest.approx(twin_cost(scenario), rel=TWIN)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_no_plan_is_below_the_bound(seed: int) -> None:
    """Plans around other references and for lower speeds are plans of the scenario too."""
    rng = np.random.default_rng(seed)
    spheres = (rho.Sphere(np.array([5.0, 2.0, -1.0]) + rng.uniform(-0.5, 0.5, 3), 0.9),)
    scenario = single(limits=rho.Limits(max_speed=1.75), obstacles=spheres, between_knots=True)
    plan = rho.plan_scp(scenario)
    bound = rho.certify(plan).lower_bound
    assert 0.9 * plan.cost < bound <= plan.cost * (1.0 + INDEX)
    for most in (1.75, 1.72, 1.7):
        slower = single(limits=rho.Limits(max_speed=most), obstacles=spheres, between_knots=True)
        side = rng.normal(size=(1, 16, 3))
        reference = rho.Plan.from_accelerations(slower, plan.accelerations + 0.2 * side)
        try:
            other = rho.plan_scp(slower, reference=reference)
        except rho.InfeasibleError:
            continue
        assert rho.verify(rho.Plan.from_accelerations(scenario, other.accelerations)).ok
        assert other.cost >= bound * (1.0 - INDEX)


def side_by_side(count: int, *, knots: int, most: float) -> rho.Scenario:
    """Return vehicles that fly 10 m in 10 s side by side, each in a direction of its own."""
    starts = np.stack([np.zeros(count), np.arange(count), np.zeros(count)], axis=1)
    angles = np.linspace(0.0, 1.0, count)
    ways = 10.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    ends = zip(starts, starts + ways, strict=True)
    vehicles = [
        rho.Vehicle(f"v{number}", rho.State(start), rho.State(goal))
        for number, (start, goal) in enumerate(ends)
    ]
    limits = rho.Limits(max_speed=most)
    return rho.Scenario("fast", rho.Grid(10.0 / (knots - 1), knots), vehicles, limits)


def test_lookup_of_tangent_planes_takes_memory_in_proportion() -> None:
    """A row is compared with those of its own instant only, not with all rows."""
    scenario = side_by_side(100, knots=101, most=1.01)
    (ball,) = Problem.of(scenario).convex
    motion = MinimumEffort.of(scenario).motion
    rows = ball.violated_rows(motion, np.arange(100))
    working = WorkingSet(RowKeys(100, scenario.grid))
    working.add(rows)
    faster = motion.with_accelerations(1.1 * motion.accelerations)
    working.add(ball.violated_rows(faster, np.arange(100)))
    tracemalloc.start()
    known = working.known(rows, motion)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert known.all()
    assert most < 1000 * len(rows)
