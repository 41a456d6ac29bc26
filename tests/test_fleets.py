"""Separation of vehicles: it holds, it has an effect, and known optima are found."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.optimize import minimize

import drake_rho as rho
from drake_rho.motion.close_pairs import PairSearch
from drake_rho.motion.dynamics import Motion, response
from drake_rho.planning.constraints.base import about
from drake_rho.planning.constraints.close_pairs import pairs_within
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs import reduced as program
from drake_rho.planning.programs import solve
from drake_rho.planning.programs.reduced import programs_of
from drake_rho.planning.scp.restoration import SoftRows
from drake_rho.planning.scp.subproblem import Subproblem
from tests.scenarios import (
    box,
    examples,
    fleet,
    mapped,
    random_fleet,
    sampled_separation,
    single,
    slow,
    through_the_middle,
)
from tests.test_invariance import SIGNED_PERMUTATIONS
from tests.tolerances import INDEX, MOTION, ROUNDING

Planner = Callable[[rho.Scenario], rho.Plan]

PLANNERS: dict[str, Planner] = {
    "convex": rho.plan_convex,
    "coupled": partial(rho.plan_scp, coupling=rho.coupled),
    "decoupled": partial(rho.plan_scp, coupling=rho.decoupled),
    "rho": lambda scenario: rho.plan_rho(scenario, planner=rho.plan_scp).plan,
}

CROSSING = (
    np.array([[-5, 0.3, 0], [0, -5, 0], [4, 4, 0.5]]),
    np.array([[5, 0, 0], [0, 5, 0.2], [-4, -4, 0]]),
)
"""Starts and goals of three vehicles that come close to each other in the middle."""

TOUCHED = 1 - 2e-6
"""Least distance over the separation's that counts as satisfied: twice the verifier's tolerance."""


@pytest.mark.parametrize("planner", PLANNERS.values(), ids=PLANNERS)
@pytest.mark.parametrize("downwash", [1.0, 2.0, 0.5])
@pytest.mark.parametrize("between_knots", [True, False])
def test_the_separation_holds_and_has_an_effect(
    planner: Planner, downwash: float, between_knots: bool
) -> None:
    separation = rho.Separation(0.8, downwash)
    scenario = fleet(*CROSSING, separation=separation, between_knots=between_knots)
    independent = dataclasses.replace(
        rho.plan_scp(scenario.without_separation()), scenario=scenario
    )
    assert sampled_separation(independent) < 0.9
    plan = planner(scenario)
    assert rho.verify(plan).ok
    assert not rho.verify(independent).ok
    assert sampled_separation(plan) >= TOUCHED
    assert plan.cost > independent.cost


def test_only_the_knots_are_constrained_where_only_they_are_required() -> None:
    """On a coarse grid they may swap between two knots, unless every instant is constrained."""
    starts, goals = np.array([[-5, 0.1, 0], [5, 0, 0]]), np.array([[5, 0, 0], [-5, 0.1, 0]])
    scenario = fleet(starts, goals, grid=rho.Grid(2.0, 6))
    knots = rho.plan_scp(dataclasses.replace(scenario, between_knots=False))
    assert rho.verify(knots).ok
    assert sampled_separation(dataclasses.replace(knots, scenario=scenario)) < 0.5
    plan = rho.plan_scp(scenario)
    assert sampled_separation(plan) >= TOUCHED
    assert plan.cost > knots.cost


@pytest.mark.parametrize(
    "planner",
    [PLANNERS["decoupled"], *slow(PLANNERS["coupled"], PLANNERS["rho"])],
    ids=["decoupled", "coupled", "rho"],
)
def test_obstacles_boxes_and_own_limits_hold_beside_the_separation(planner: Planner) -> None:
    limits = rho.Limits(position=box(5.2), velocity=box(2.5))
    sphere = rho.Sphere([0.0, 0.0, 0.5], 1.5)
    scenario = through_the_middle(
        4, separation=rho.Separation(1.0, 2.0), limits=limits, obstacles=(sphere,)
    )
    weak = dataclasses.replace(scenario.vehicles[1], limits=rho.Limits(acceleration=box(0.52)))
    level = rho.Limits(position=rho.Box([-5.2, -5.2, -0.2], [5.2, 5.2, 0.2]))
    flat = dataclasses.replace(scenario.vehicles[2], limits=level)
    scenario = dataclasses.replace(
        scenario, vehicles=(scenario.vehicles[0], weak, flat, scenario.vehicles[3])
    )
    plan = planner(scenario)
    assert rho.verify(plan).ok
    assert sampled_separation(plan) >= TOUCHED
    assert np.abs(plan.accelerations[1]).max() <= 0.52 * (1 + INDEX)
    assert np.abs(plan.accelerations[0]).max() > 0.52
    dense = plan.motion().at("position", np.linspace(0.0, 10.0, 5001))
    assert np.linalg.norm(dense - sphere.center, axis=2).min() >= 1.5 * (1 - INDEX)
    assert np.abs(dense[2, :, 2]).max() <= 0.2 + 1e-5
    alone = rho.plan_scp(scenario.without_separation())
    assert sampled_separation(dataclasses.replace(alone, scenario=scenario)) < 1.0
    for spared in (
        scenario.without_obstacles(),
        dataclasses.replace(scenario, vehicles=_without_limits_of_their_own(scenario)),
    ):
        assert not rho.verify(dataclasses.replace(planner(spared), scenario=scenario)).ok


def _without_limits_of_their_own(scenario: rho.Scenario) -> tuple[rho.Vehicle, ...]:
    """Return the vehicles without limits of their own."""
    return tuple(dataclasses.replace(each, limits=None) for each in scenario.vehicles)


@given(seed=st.integers(0, 2**32 - 1), between_knots=st.booleans())
@examples(few=4, many=13)
def test_random_fleets_are_separated_at_dense_samples(seed: int, between_knots: bool) -> None:
    scenario = random_fleet(seed, between_knots=between_knots)
    for coupling in (rho.coupled, rho.decoupled):
        try:
            plan = rho.plan_scp(scenario, coupling=coupling)
        except rho.InfeasibleError:
            continue
        assert rho.verify(plan).ok
        assert sampled_separation(plan) >= TOUCHED


@pytest.mark.parametrize("count", [2, 3, 4, 8])
@pytest.mark.parametrize("coupling", [rho.coupled, rho.decoupled])
@pytest.mark.parametrize("level", [False, True])
def test_vehicles_that_all_meet_in_one_point_are_planned(
    count: int, coupling: object, level: bool
) -> None:
    """References coincide in the middle, where no direction leads from one to the other."""
    limits = rho.Limits(position=rho.Box([-9, -9, -0.1], [9, 9, 0.1]) if level else None)
    scenario = through_the_middle(count, limits=limits)
    plan = rho.plan_scp(scenario, coupling=coupling)  # type: ignore[arg-type]  # one of the two
    assert rho.verify(plan).ok
    assert sampled_separation(plan) >= TOUCHED
    again = rho.plan_scp(scenario, coupling=coupling)  # type: ignore[arg-type]  # one of the two
    np.testing.assert_array_equal(plan.accelerations, again.accelerations)


@pytest.mark.parametrize(
    ("starts", "goals"),
    [
        ([[-5, 0, 0], [5, 0, 0]], [[5, 0, 0], [-5, 0, 0]]),  # head-on
        ([[0, 0, -5], [0, 0, 5]], [[0, 0, 5], [0, 0, -5]]),  # above each other
        ([[-5, 0, 0], [0, -5, 0]], [[5, 0, 0], [0, 5, 0]]),  # crossing
        ([[-5, 0, 0], [5, 0, 0], [0, 0, 0]], [[5, 0, 0], [-5, 0, 0], [0, 0, 0]]),  # one hovers
        ([[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [0, 0, 0]]),  # touching, and swapping places
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 0, 0], [1, 0, 0], [2, 0, 0]]),  # none moves
    ],
)
@pytest.mark.parametrize("downwash", [1.0, 2.0])
def test_mirror_symmetric_meetings_are_planned(
    starts: list[list[float]], goals: list[list[float]], downwash: float
) -> None:
    scenario = fleet(starts, goals, separation=rho.Separation(1.0, downwash))
    for planner in (PLANNERS["coupled"], PLANNERS["decoupled"]):
        plan = planner(scenario)
        assert rho.verify(plan).ok
        assert sampled_separation(plan) >= TOUCHED


def test_directions_of_coinciding_references_do_not_depend_on_their_order() -> None:
    scenario = through_the_middle(2)
    swapped = dataclasses.replace(scenario, vehicles=scenario.vehicles[::-1])
    found = []
    for each in (scenario, swapped):
        free = rho.plan_scp(each.without_separation()).motion()
        pairs = Problem.of(each).pairs_around(free, rho.coupled, penalty=1.0, one_normal=True)
        assert len(pairs.points) > 0
        x = pairs.offsets(free, pairs.points)
        n = pairs.directions(pairs.points)[np.linalg.norm(x, axis=1) < 1.0]
        assert len(n) > 0
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=ROUNDING)
        np.testing.assert_allclose(n[:, 0], 0.0, atol=ROUNDING)  # across the path
        found.append(n)
    np.testing.assert_allclose(np.abs(found[0]), np.abs(found[1]), atol=ROUNDING)


@pytest.mark.parametrize("name", ["coupled", "decoupled"])
def test_relabelling_the_vehicles_permutes_the_plan(name: str) -> None:
    scenario = fleet(*CROSSING)
    order = [2, 0, 1]
    vehicles = tuple(scenario.vehicles[index] for index in order)
    plan = PLANNERS[name](scenario)
    other = PLANNERS[name](dataclasses.replace(scenario, vehicles=vehicles))
    assert other.cost == pytest.approx(plan.cost, rel=1e-5)
    largest = np.abs(plan.accelerations).max()
    np.testing.assert_allclose(other.accelerations, plan.accelerations[order], atol=1e-3 * largest)


@given(
    seed=st.integers(0, 2**32 - 1),
    turn=st.sampled_from(SIGNED_PERMUTATIONS),
    shift=st.tuples(*[st.floats(-2, 2)] * 3),
    length=st.floats(0.01, 100),
    time=st.floats(0.1, 10),
)
@settings(max_examples=8)
def test_mirroring_turning_shifting_and_changing_units(
    seed: int, turn: np.ndarray, shift: tuple[float, float, float], length: float, time: float
) -> None:
    """One linearisation is the same in all coordinates; iterations may differ at a fork."""
    scenario = random_fleet(seed)
    assert scenario.separation is not None
    if scenario.separation.downwash != 1.0 and abs(turn[2, 2]) != 1.0:
        turn = np.diag([1.0, -1.0, -1.0])
    size = max(np.abs(vehicle.start.position).max() for vehicle in scenario.vehicles)
    other = mapped(scenario, turn, size * np.array(shift), length, time)
    costs = []
    for each, scale in ((scenario, 1.0), (other, (length / time**2) ** 2)):
        try:
            costs.append(rho.plan_convex(each).cost / scale)
        except rho.InfeasibleError:
            costs.append(np.inf)
    met = pairs_within(PairSearch(scenario.separation), _free(scenario), 1e-3 * size, between=True)
    if np.isfinite(costs[0]) and len(met) == 0:
        assert costs[1] == pytest.approx(costs[0], rel=10 * INDEX)


def _free(scenario: rho.Scenario) -> Motion:
    return rho.plan_convex(scenario.without_separation()).motion()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_a_coupled_plan_never_costs_more_than_its_decoupled_reference(seed: int) -> None:
    scenario = random_fleet(seed, most=5)
    try:
        split = rho.plan_scp(scenario, coupling=rho.decoupled)
    except rho.InfeasibleError:
        return
    together = rho.plan_scp(scenario, reference=split, coupling=rho.coupled)
    assert rho.verify(together).ok
    assert together.cost <= split.cost * (1 + INDEX)


def test_iterates_are_separated_and_the_index_does_not_increase() -> None:
    plans = [rho.plan_scp(through_the_middle(6), coupling=rho.decoupled)]
    for _ in range(8):
        plans.append(rho.scp_step(plans[-1]))
    for plan in plans:
        assert rho.verify(plan).ok
        assert sampled_separation(plan) >= TOUCHED
    for before, after in pairwise(plans):
        assert after.cost <= before.cost * (1 + INDEX)
    assert plans[-1].cost < 0.998 * plans[0].cost


def test_every_window_of_a_fleet_has_a_separated_plan() -> None:
    scenario = through_the_middle(4)
    flight = rho.plan_rho(scenario, planner=rho.plan_scp, replan_every=3)
    assert rho.verify(flight).ok
    assert sampled_separation(flight.plan) >= TOUCHED
    assert flight.cost <= flight.windows[0].plan.cost * (1 + 10 * INDEX)


def _linearised(scenario: rho.Scenario, at: rho.Plan) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the row n · (p0 - p1) >= d of each inner knot as pairs (n, value of p0 - p1)."""
    rows = []
    for k in range(1, scenario.grid.knots - 1):
        gap = at.positions[0, k] - at.positions[1, k]
        pull = response(
            "position", scenario.grid.step, scenario.grid.knots, [k * scenario.grid.step]
        )[0]
        rows.append((gap / np.linalg.norm(gap), pull))
    return rows


@pytest.fixture
def two() -> tuple[rho.Scenario, rho.Plan]:
    """Return two crossing vehicles, constrained at the knots, and a plan to linearise around."""
    scenario = fleet(CROSSING[0][:2], CROSSING[1][:2], between_knots=False)
    return scenario, rho.plan_scp(scenario, coupling=rho.decoupled)


@np.errstate(invalid="ignore")  # numpy warns of Drake's symbols, without a cause
def test_one_linearisation_equals_the_program_written_out(
    two: tuple[rho.Scenario, rho.Plan],
) -> None:
    """The program has every row of the one pair at every knot, in Drake's symbols."""
    scenario, at = two
    h, steps = scenario.grid.step, scenario.grid.knots - 1
    twin = MathematicalProgram()
    a = [twin.NewContinuousVariables(steps, 3) for _ in scenario.vehicles]
    for vehicle, own in zip(scenario.vehicles, a, strict=True):
        p, v = vehicle.start.position, vehicle.start.velocity
        for k in range(steps):
            p, v = p + h * v + h**2 / 2 * own[k], v + h * own[k]
        twin.AddLinearEqualityConstraint(p, vehicle.goal.position)
        twin.AddLinearEqualityConstraint(v, vehicle.goal.velocity)
        twin.AddQuadraticCost((own**2).sum())
    between = scenario.vehicles[0].start.position - scenario.vehicles[1].start.position
    for n, pull in _linearised(scenario, at):
        gap = between + pull @ (a[0] - a[1])
        twin.AddLinearConstraint(n @ gap >= 1.0)
    result = ClarabelSolver().Solve(twin)
    assert result.is_success()
    plan = rho.scp_step(at)
    assert plan.cost == pytest.approx(result.get_optimal_cost(), rel=INDEX)
    largest = np.abs(plan.accelerations).max()
    for own, found in zip(a, plan.accelerations, strict=True):
        np.testing.assert_allclose(found, result.GetSolution(own), atol=1e-4 * largest)


def test_the_converged_plan_equals_that_of_a_nonlinear_solver(
    two: tuple[rho.Scenario, rho.Plan],
) -> None:
    """SLSQP minimises with the true distances, in coordinates that satisfy the goals."""
    scenario, at = two
    effort = MinimumEffort.of(scenario)
    steps = scenario.grid.knots - 1
    _, _, rows = np.linalg.svd(effort.goals.rows[0])
    inside = rows[len(effort.goals.rows[0]) :]  # accelerations that change no goal
    free = effort.motion.accelerations

    def flown(x: np.ndarray) -> np.ndarray:
        moved: np.ndarray = free + np.einsum("cj,icx->ijx", inside, x.reshape(2, -1, 3))
        return moved

    knots = scenario.grid.times[1:-1]
    responses = response("position", scenario.grid.step, scenario.grid.knots, knots)
    ends = np.array([vehicle.start.position for vehicle in scenario.vehicles])

    def gaps(x: np.ndarray) -> np.ndarray:
        a = flown(x)
        apart: np.ndarray = ends[0] - ends[1] + responses @ (a[0] - a[1])
        return apart

    pull = responses @ inside.T

    def slopes(x: np.ndarray) -> np.ndarray:
        rows = 2 * gaps(x)[:, None, :] * pull[:, :, None]
        flat = rows.reshape(len(knots), -1)
        return np.hstack([flat, -flat])

    start = np.einsum("cj,ijx->icx", inside, at.accelerations - free).reshape(-1)
    found = minimize(
        lambda x: x @ x,
        start,
        jac=lambda x: 2 * x,
        method="SLSQP",
        constraints={
            "type": "ineq",
            "fun": lambda x: np.sum(gaps(x) ** 2, axis=1) - 1.0,
            "jac": slopes,
        },
        options={"maxiter": 500, "ftol": 1e-13},
    )
    assert found.success
    assert steps == flown(found.x).shape[1]
    best = float(np.sum(flown(found.x) ** 2))
    assert rho.plan_scp(scenario, reference=at, coupling=rho.coupled).cost == pytest.approx(
        best, rel=1e-5
    )


@pytest.mark.parametrize("between_knots", [True, False])
def test_the_reduced_form_of_coupled_rows_has_the_same_solution(between_knots: bool) -> None:
    """The same rows in all accelerations, with states beside them, have the same solution."""
    scenario = through_the_middle(
        4, limits=rho.Limits(velocity=box(2)), between_knots=between_knots
    )
    subproblem = Subproblem(Problem.of(scenario), rho.coupled)
    known = subproblem.solve_around(rho.plan_scp(scenario, coupling=rho.decoupled)).accelerations
    assert subproblem.planes is not None
    effort, steps = MinimumEffort.of(scenario), scenario.grid.knots - 1
    rows = list(subproblem.planes.working.rows.values())
    for sparse in (True, False):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(program, "_SPARSE", 0 if sparse else 10**12)
            patched.setattr(program, "_FEW", 0)
            batches = list(programs_of(effort.changes, about(effort.motion, rows)))
        (batch,) = [each for each in batches if each.groups.shape[1] == 4]
        assert (batch.basis is None) == sparse
        u = batch.accelerations(solve.solve(batch.programs), steps)[0]
        group = batch.groups[0]
        found = effort.motion.accelerations[group] + effort.changes.units[group].max() * u
        np.testing.assert_allclose(found, known[group], atol=MOTION * np.abs(known).max())


def test_the_plan_of_two_crossing_vehicles_is_proved_globally_optimal(
    two: tuple[rho.Scenario, rho.Plan],
) -> None:
    for downwash, between_knots in ((1.0, False), (1.0, True), (2.0, True)):
        scenario = dataclasses.replace(
            two[0], separation=rho.Separation(1.0, downwash), between_knots=between_knots
        )
        proof = rho.certify(rho.plan_scp(scenario))
        assert proof.is_globally_optimal
        assert proof.lower_bound > rho.plan_scp(scenario.without_separation()).cost
        for each in proof.vehicles:
            assert each.stationarity < 1e-4
            assert each.complementarity < 1e-5


def crowd(n: int = 48, duration: float = 6.8, distance: float = 0.32) -> rho.Scenario:
    """Vehicles that all meet in the middle of a circle, with little time to spare."""
    return rho.circle_swap(
        n,
        radius=0.22 * n,
        duration=duration,
        step=0.2,
        height=1.5,
        limits=rho.Limits(acceleration=rho.Box([-3] * 3, [3] * 3)),
        separation=rho.Separation(distance),
    )


def test_vehicles_that_meet_at_one_point_are_separated() -> None:
    scenario = crowd()
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    again = rho.plan(scenario)
    np.testing.assert_array_equal(plan.accelerations, again.accelerations)


@pytest.mark.slow
def test_no_plan_found_from_elsewhere_is_below_the_bound() -> None:
    """References that pass on all sides lead to plans that cost more or as much."""
    rng = np.random.default_rng(0)
    for scenario in (fleet(*CROSSING), through_the_middle(4)):
        plan = rho.plan_scp(scenario)
        proof = rho.certify(plan)
        assert proof.holds
        assert 0.0 < proof.lower_bound <= plan.cost * (1 + INDEX)
        costs = []
        for _ in range(6):
            noise = rng.normal(size=plan.accelerations.shape) * np.abs(plan.accelerations).max()
            elsewhere = rho.Plan.from_accelerations(scenario, plan.accelerations + 3 * noise)
            other = rho.plan_scp(scenario, reference=elsewhere)
            assert rho.verify(other).ok
            costs.append(other.cost)
        assert min(costs) * (1 + INDEX) >= proof.lower_bound
        ways = np.ptp(costs) / plan.cost
    assert ways > 1e-3  # where four meet, some took another path


TUBE = rho.Limits(position=rho.Box([-6, -0.3, -0.3], [6, 0.3, 0.3]))
HEAD_ON = ([[-5, 0, 0], [5, 0, 0]], [[5, 0, 0], [-5, 0, 0]])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["coupled", "decoupled", "rho"])
def test_two_vehicles_that_cannot_pass_in_a_corridor_are_named_with_the_time(name: str) -> None:
    scenario = fleet(*HEAD_ON, limits=TUBE)
    with pytest.raises(rho.InfeasibleError) as caught:
        PLANNERS[name](scenario)
    conflicts = caught.value.conflicts
    assert set(conflicts) == {"v0", "v1"}
    for vehicle, partner in (("v0", "v1"), ("v1", "v0")):
        reasons = [reason for reason in conflicts[vehicle] if reason.startswith("separation")]
        assert reasons
        for reason in reasons:
            assert reason.startswith(f"separation from {partner} at ")
            assert 0.0 < float(reason.split()[-2]) < 10.0
    assert "separation from v1" in str(caught.value)


@pytest.mark.slow
def test_solver_failures_at_large_penalties_end_in_the_names_of_the_pairs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step = SoftRows.__call__

    def numerical(self: SoftRows, reference: rho.Plan, penalty: float, number: int) -> rho.Plan:
        if penalty > 1e3:
            raise rho.SolverError("too large")
        return step(self, reference, penalty, number)

    monkeypatch.setattr(SoftRows, "__call__", numerical)
    with pytest.raises(rho.InfeasibleError, match="separation from v1 at"):
        rho.plan_scp(fleet(*HEAD_ON, limits=TUBE))


@pytest.mark.parametrize("seed", [4, 10, 11, 18, 40, 58])
def test_a_linearisation_without_a_solution_is_infeasible_and_no_solver_error(
    seed: int,
) -> None:
    """Vehicles without a solution leave their rows violated while others are still being solved."""
    scenario = random_fleet(seed)
    independent = rho.plan_convex(scenario.without_separation())
    with pytest.raises(rho.InfeasibleError, match="separation from v"):
        Subproblem(Problem.of(scenario), rho.decoupled).solve_around(independent)


def test_a_linear_program_that_clarabel_fails_on_goes_to_another_solver(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reasons are found with linear programs, which OSQP refuses."""
    for options in ("_CLARABEL", "_CLARABEL_AGAIN"):
        monkeypatch.setattr(solve, options, {"max_iter": 1})
    linear = MathematicalProgram()
    x = linear.NewContinuousVariables(2)
    linear.AddLinearCost(x[0] + x[1])
    linear.AddLinearConstraint(2 * x[0] + x[1] >= 1.0)
    linear.AddBoundingBoxConstraint(0.0, 1.0, x)
    (solution,) = solve.solve([linear])
    assert solution.feasible
    assert solution.solver == "Clp"
    assert solution.x.sum() == pytest.approx(0.5)


def test_a_fleet_without_joint_paths_is_planned_along_own_paths() -> None:
    """On the grids that are searched, each vehicle has a path, but not both together."""
    above, corner = (
        rho.Waypoint(time, [x, y, z]) for time, x, y, z in ((6, 0, 0, 10), (26, -42.5, 30, 15))
    )
    courier = rho.Vehicle(
        "courier", rho.State([0, 0, 0]), rho.State([-5, 30, 15]), waypoints=[above, corner]
    )
    scout = rho.Vehicle("scout", rho.State([-5, 0, 0]), rho.State([-5, 0, 5]))
    room = rho.KeepIn(rho.Box([-50, -5, -1], [7.5, 37.5, 65]))
    scenario = rho.Scenario(
        "notch",
        rho.Grid.lasting(44.0, step=2.0),
        [courier, scout],
        rho.Limits(max_speed=4.0, max_acceleration=4.0),
        [rho.Box([-30, 25, -5], [-20, 50, 70])],
        separation=rho.Separation(0.5),
        requirements=[room],
    )
    assert rho.verify(rho.plan(scenario)).ok


def test_a_reference_of_other_vehicles_is_refused() -> None:
    with pytest.raises(ValueError, match="reference: got 2 vehicles"):
        rho.plan_scp(through_the_middle(3), reference=rho.plan_scp(through_the_middle(2)))


def test_a_separation_does_not_affect_a_single_vehicle() -> None:
    scenario = dataclasses.replace(single(between_knots=True), separation=rho.Separation(1.0))
    alone = rho.plan_scp(scenario.without_separation())
    for planner in PLANNERS.values():
        plan = planner(scenario)
        assert rho.verify(plan).ok
        assert plan.cost == pytest.approx(alone.cost, rel=INDEX)
    assert rho.certify(alone).is_globally_optimal
