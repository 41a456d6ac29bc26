"""Soft limits: an exact penalty of the worst excess of each vehicle."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver

import drake_rho as rho
from tests.arrays import FloatArray
from tests.cones import PRECISE, integrals
from tests.disturbed import disturbed
from tests.scenarios import fleet, random_fleet, random_scenario, single, slow
from tests.test_cli import run
from tests.test_user_program import CURVED, FLAT

SAME = 1e-7
"""Relative, for costs of two programs: the accuracy of the solver."""

EXACT = 1e-6
"""Absolute, in metres, for an excess that is zero: the tolerance of motions of ten metres."""

LANE = rho.KeepIn(rho.HalfSpace([0, 1, 0], 0.5), active=(1.0, 5.0), name="lane")
ZONE = rho.Sphere([5.0, 1.6, -1.0], 1.4)


def soft(scenario: rho.Scenario, penalty: float | None) -> rho.Scenario:
    """Return a scenario in which all waypoints, obstacles and requirements are soft."""

    def priced(each: Any) -> Any:
        return dataclasses.replace(each, penalty=penalty)

    obstacles = (o if isinstance(o, rho.Obstacle) else rho.Obstacle(o) for o in scenario.obstacles)
    vehicles = (
        dataclasses.replace(each, waypoints=tuple(map(priced, each.waypoints)))
        for each in scenario.vehicles
    )
    return dataclasses.replace(
        scenario,
        vehicles=tuple(vehicles),
        obstacles=tuple(map(priced, obstacles)),
        requirements=tuple(map(priced, scenario.requirements)),
    )


def in_lane(penalty: float | None, **fields: Any) -> rho.Scenario:
    """Return a flight to the side of a lane that it is to keep in for some time."""
    lane = dataclasses.replace(LANE, penalty=penalty)
    return dataclasses.replace(single(), requirements=(lane,), **fields)


def past(penalty: float | None, **fields: Any) -> rho.Scenario:
    """Return a flight through a ball."""
    zone = rho.Obstacle(ZONE, penalty=penalty, name="zone")
    return dataclasses.replace(single(obstacles=[zone], between_knots=True), **fields)


def total(plan: rho.Plan | rho.Flight) -> float:
    """Return the cost with the price that `verify` reports."""
    return plan.cost + rho.verify(plan).price


def densely(plan: rho.Plan, vehicle: int = 0, samples: int = 4001) -> tuple[FloatArray, FloatArray]:
    """Return times since the first knot and positions of a vehicle, from its accelerations."""
    a, h, state = plan.accelerations[vehicle], plan.scenario.grid.step, plan.scenario.vehicles
    times = np.linspace(0.0, h * len(a), samples)
    step = np.minimum((times / h).astype(int), len(a) - 1)
    velocity, position = integrals(plan.scenario)
    v = np.vstack([np.zeros(3), velocity @ a]) + state[vehicle].start.velocity
    p = np.vstack([np.zeros(3), position @ a]) + state[vehicle].start.position
    p += h * np.arange(len(a) + 1)[:, None] * state[vehicle].start.velocity
    s = (times - h * step)[:, None]
    return times, p[step] + s * v[step] + s**2 / 2.0 * a[step]


KINDS = {
    name: scenario
    for name, scenario in (CURVED | FLAT).items()
    if (scenario.requirements or scenario.vehicles[0].waypoints) and name != "moving point"
}


@pytest.mark.parametrize("penalty", [0.3, *slow(3.0), 300.0])
@pytest.mark.parametrize("name", KINDS)
def test_the_optimum_is_that_of_the_program_written_out_in_drake(name: str, penalty: float) -> None:
    scenario = soft(KINDS[name], penalty)
    plan, program = rho.plan_convex(scenario), rho.program(scenario)
    result = ClarabelSolver().Solve(program.prog, None, PRECISE)
    assert total(plan) == pytest.approx(result.get_optimal_cost(), rel=SAME)
    assert total(program.plan(result)) == pytest.approx(result.get_optimal_cost(), rel=1e-6)
    assert {"effort", "goal", "penalties"} < set(program.bindings)


@pytest.mark.parametrize("penalty", [0.5, 2.0, 50.0])
def test_one_slack_is_priced_at_the_worst_knot(penalty: float) -> None:
    """The program without the lane, with one variable above all excesses, is the same."""
    scenario = in_lane(penalty)
    own = rho.program(dataclasses.replace(scenario, requirements=()))
    t = own.prog.NewContinuousVariables(1)
    own.prog.AddBoundingBoxConstraint(0.0, np.inf, t)
    own.prog.AddLinearCost(np.array([penalty]), t)
    for knot in range(2, 11):
        A, b = own.coefficients("position", "solo", knot)
        row, x = np.append(A[1], -1.0)[None], np.append(own.accelerations.ravel(), t)
        own.prog.AddLinearConstraint(row, [-np.inf], [0.5 - b[1]], x)
    result = ClarabelSolver().Solve(own.prog, None, PRECISE)
    plan = rho.plan_convex(scenario)
    excess = max(0.0, float(plan.positions[0, 2:11, 1].max()) - 0.5)
    assert plan.cost + penalty * excess == pytest.approx(result.get_optimal_cost(), rel=SAME)
    assert rho.verify(plan).price == pytest.approx(penalty * excess, abs=EXACT * penalty)


def test_above_the_sum_of_its_multipliers_a_limit_is_hard() -> None:
    program = rho.program(in_lane(None))
    result = ClarabelSolver().Solve(program.prog, None, PRECISE)
    multipliers = [
        result.GetDualSolution(each) for each in program.bindings["requirement 1 (lane)"]
    ]
    needed = float(np.abs(np.concatenate(multipliers)).sum())
    hard = rho.plan_convex(in_lane(None))
    for above in (1.001, 10.0, 1e6, 1e11):
        plan = rho.plan_convex(in_lane(above * needed))
        assert plan.cost == pytest.approx(hard.cost, rel=SAME)
        assert plan.positions == pytest.approx(hard.positions, abs=1e-4)
        assert rho.verify(plan).price == 0.0
    below = rho.verify(rho.plan_convex(in_lane(0.99 * needed)))
    assert below.ok
    assert below.exceeded
    assert below.exceeded[0].excess > 1e-4


@pytest.mark.parametrize("scene", [in_lane, past], ids=["lane", "zone"])
def test_the_excess_falls_and_the_cost_rises_with_the_penalty(scene: Any) -> None:
    plans = [rho.plan(scene(penalty)) for penalty in (0.01, 0.1, 0.4, 1.0, 3.0, 30.0)]
    reports = list(map(rho.verify, plans))
    excesses = [max((each.excess for each in report.exceeded), default=0.0) for report in reports]
    assert all(report.ok for report in reports)
    assert np.all(np.diff(excesses) <= EXACT)
    assert np.all(np.diff([plan.cost for plan in plans]) >= -EXACT)
    assert np.all(np.diff([total(plan) for plan in plans]) >= -EXACT)
    assert excesses[0] > 0.1 > excesses[-1] == 0.0
    assert plans[-1].cost == pytest.approx(rho.plan(scene(None)).cost, rel=1e-6)


def test_a_waypoint_is_missed_by_what_the_closed_form_says() -> None:
    """The cost of passing closer is quadratic in the distance gained: c0 + c (D - miss)²."""
    place = np.array([5.0, 6.0, -1.0])
    free, hard = (rho.plan(single(waypoints=w)) for w in ((), (rho.Waypoint(4.0, place),)))
    distance = float(np.linalg.norm(free.positions[0, 8] - place))
    c = (hard.cost - free.cost) / distance**2
    for within in (0.0, 0.7):
        for penalty in (0.3 * c * distance, 1.2 * c * distance, 3.0 * c * distance):
            waypoint = rho.Waypoint(4.0, place, within, penalty=penalty)
            plan = rho.plan(single(waypoints=[waypoint]))
            missed = max(0.0, distance - within - penalty / (2.0 * c))
            (check,) = (each for each in rho.verify(plan).checks if each.kind == "waypoints")
            assert max(0.0, check.excess) == pytest.approx(missed, abs=2e-5)
            cost = free.cost + c * (distance - missed - within) ** 2
            assert plan.cost == pytest.approx(cost, rel=1e-5)


def test_outside_a_box_the_excess_is_the_distance_from_its_corner() -> None:
    room = rho.Box([-1.0, -1.0, -5.0], [6.0, 1.0, 5.0])
    kept = rho.KeepIn(room, active=(3.0, 5.0), penalty=0.4)
    scenario = dataclasses.replace(single(between_knots=True), requirements=(kept,))
    plan = rho.plan(scenario)
    times, x = densely(plan)
    beyond = np.maximum(np.maximum(x - room.upper, room.lower - x), 0.0)
    distances = np.linalg.norm(beyond, axis=1)[(times >= 3.0) & (times <= 5.0)]
    assert (beyond[np.argmax(distances)] > 0.0).sum() <= 3
    report = rho.verify(plan)
    assert report.price == pytest.approx(0.4 * distances.max(), abs=1e-4)
    assert report.exceeded[0].excess >= distances.max() - EXACT


def test_prices_are_times_the_weight_and_of_pairs_the_mean_weight() -> None:
    ends = [[0, 0, 0], [0, 2, 0]], [[10, 0, 0], [10, 9, 0]]
    pair = fleet(*ends, between_knots=True)
    heavy = dataclasses.replace(pair.vehicles[1], weight=3.0)
    link = rho.KeepIn(rho.Ball([0, 0, 0], 4.0), vehicles="v1", relative_to="v0", active=(1, 6))
    for requirement, weight in ((LANE, 3.0), (link, 2.0)):
        kept = dataclasses.replace(requirement, vehicles=("v1",), penalty=0.7)
        scenario = dataclasses.replace(
            pair, vehicles=(pair.vehicles[0], heavy), requirements=(kept,), separation=None
        )
        plan = rho.plan(scenario)
        (check,) = rho.verify(plan).exceeded
        assert check.penalty == pytest.approx(0.7 * weight)
        assert check.price == pytest.approx(0.7 * weight * check.excess)
        times, x = densely(plan, 1)
        outside = x[:, 1] - 0.5
        if requirement is link:
            outside = np.linalg.norm(x - densely(plan, 0)[1], axis=1) - 4.0
        first, last = requirement.active or (0.0, 0.0)
        worst = outside[(times >= first) & (times <= last)].max()
        assert check.excess == pytest.approx(worst, abs=1e-4)
        # twice the weights and the penalty: the same motion
        lighter = dataclasses.replace(kept, penalty=0.35)
        twice = tuple(dataclasses.replace(v, weight=2.0 * v.weight) for v in scenario.vehicles)
        other = dataclasses.replace(scenario, vehicles=twice, requirements=(kept,))
        assert rho.plan(other).positions == pytest.approx(plan.positions, abs=1e-5)
        other = dataclasses.replace(scenario, requirements=(lighter,))
        assert rho.verify(rho.plan(other)).exceeded[0].excess > check.excess


@pytest.mark.parametrize("seed", [0, *slow(*range(2, 12))])
def test_soft_obstacles_cost_no_more_than_hard_ones(seed: int) -> None:
    scenario = dataclasses.replace(random_scenario(seed), between_knots=True)
    try:
        hard = rho.plan(scenario)
    except rho.InfeasibleError:
        return
    for penalty in (0.01 * hard.cost, hard.cost, 1e3 * hard.cost):
        plan = rho.plan(soft(scenario, penalty))
        assert rho.verify(plan).ok
        assert total(plan) <= hard.cost * (1.0 + 1e-3)


def test_the_depth_in_an_obstacle_is_what_sampling_finds() -> None:
    plan = rho.plan(past(0.3))
    _, x = densely(plan)
    depth = (ZONE.radius - np.linalg.norm(x - ZONE.center, axis=1)).max()
    (check,) = rho.verify(plan).exceeded
    assert check.excess == pytest.approx(depth, abs=1e-5)
    assert 0.1 < depth < ZONE.radius
    assert plan.statistics.converged
    assert rho.scp_step(plan).cost + 0.3 * depth >= total(plan) * (1.0 - 1e-3)


def test_a_map_is_one_soft_limit() -> None:
    cells = rho.Voxels.from_grid(np.ones((2, 8, 8), dtype=bool), 0.5, [4.5, -1.0, -3.0])
    free = single(between_knots=True)
    free = dataclasses.replace(free, vehicles=(dataclasses.replace(free.vehicles[0], radius=0.2),))
    hard = rho.plan(dataclasses.replace(free, obstacles=(cells,)))
    for penalty in (0.1, 0.2, 50.0):
        wall = rho.Obstacle(cells, penalty=penalty)
        plan = rho.plan(dataclasses.replace(free, obstacles=(wall,)))
        report = rho.verify(plan)
        assert report.ok
        assert len(report.exceeded) <= 1
        assert total(plan) <= hard.cost * (1.0 + 1e-3)


@pytest.mark.parametrize("coupling", ["coupled", "grouped", "decoupled"])
def test_fleets_keep_apart_beside_soft_obstacles(coupling: Any) -> None:
    scenario = random_fleet(3)
    center = np.mean([v.start.position + v.goal.position for v in scenario.vehicles], axis=0) / 2.0
    zone = rho.Obstacle(rho.Sphere(center, 0.05), penalty=1e-3)
    scenario = dataclasses.replace(scenario, obstacles=(zone,))
    plan = rho.plan(scenario, coupling=coupling)
    assert rho.verify(plan).ok
    assert plan.cost > 0.0


@pytest.mark.parametrize("wind", [None, 0.05])
def test_windows_plan_with_penalties(wind: float | None) -> None:
    scenario = past(0.3, limits=rho.Limits(max_acceleration=3.0))
    if wind is not None:
        scenario = dataclasses.replace(scenario, disturbance=rho.Disturbance(wind))
    flight = rho.plan_rho(scenario, planner=rho.plan, contingencies=True)
    assert not any(window.infeasible for window in flight.windows)
    report = rho.verify(flight)
    assert report.ok
    assert report.exceeded[0].constraint == "obstacle 1 (zone)"
    assert rho.verify(rho.simulate(scenario)).ok


def test_with_a_disturbance_the_tightened_limit_is_soft() -> None:
    calm = past(0.3, limits=rho.Limits(max_acceleration=3.0))
    windy = dataclasses.replace(calm, disturbance=rho.Disturbance(0.2))
    plan = rho.plan(windy)
    (check,) = rho.verify(plan).exceeded
    _, x = densely(plan)
    depth = (ZONE.radius - np.linalg.norm(x - ZONE.center, axis=1)).max()
    assert check.errors > 0.0
    assert check.excess == pytest.approx(depth + check.errors, abs=1e-3)
    lane = dataclasses.replace(in_lane(0.3), disturbance=rho.Disturbance(0.2), between_knots=True)
    (check,) = rho.verify(rho.plan(lane)).exceeded
    assert check.excess == pytest.approx(check.value + check.errors)
    # no room for the errors is no reason against a plan
    assert rho.verify(rho.plan(soft(disturbed(0), 1.0))).ok
    narrow = rho.KeepIn(rho.Ball([5.0, 2.0, -1.0], 1e-3), active=(4.0, 4.0), penalty=2.0)
    tight = dataclasses.replace(lane, requirements=(narrow,))
    assert rho.verify(rho.plan(tight)).price > 0.0
    with pytest.raises(rho.InfeasibleError, match="no room for the errors"):
        rho.plan(soft(tight, None))


@pytest.mark.parametrize("penalty", [0.1, 1.0, 100.0])
@pytest.mark.parametrize("scene", [in_lane, past], ids=["lane", "zone"])
def test_certificates_bound_the_cost_with_the_prices(scene: Any, penalty: float) -> None:
    plan = rho.plan(scene(penalty))
    certificate = rho.certify(plan)
    assert certificate.holds
    assert certificate.cost == pytest.approx(total(plan))
    assert certificate.lower_bound <= total(plan) * (1.0 + 1e-6)
    if scene is in_lane:
        assert certificate.is_globally_optimal
    else:  # some other motions pay more or cost more
        for other in (0.3, None):
            known = rho.plan(scene(other))
            as_asked = rho.Plan.from_accelerations(scene(penalty), known.accelerations)
            assert certificate.lower_bound <= total(as_asked) * (1.0 + 1e-6)
        assert certificate.gap < 0.2


def test_a_soft_limit_is_never_the_reason() -> None:
    """Where hard limits conflict, no message names a soft one or asks to change it."""
    tight = past(0.3, limits=rho.Limits(max_speed=1.0))
    tight = dataclasses.replace(tight, requirements=(dataclasses.replace(LANE, penalty=1.0),))
    with pytest.raises(rho.InfeasibleError) as found:
        rho.plan(tight)
    for text in (
        str(found.value),
        str(rho.infeasible_subset(found.value)),
        str(rho.diagnose(tight)),
    ):
        assert "maximum speed" in text or "max_speed" in text
        assert "obstacle" not in text
        assert "requirement" not in text
    # and a limit that cannot hold otherwise has a plan
    beyond = rho.KeepIn(rho.HalfSpace([0, 1, 0], 0.5), active=(3.9, 4.1), penalty=1.0)
    waypoint = [rho.Waypoint(4.0, [5.0, 4.0, -1.0])]
    scenario = dataclasses.replace(single(waypoints=waypoint), requirements=(beyond,))
    assert rho.verify(rho.plan(scenario)).price == pytest.approx(3.5, rel=1e-2)


def test_soft_waypoints_may_be_out_of_reach() -> None:
    scenario = single(
        limits=rho.Limits(position=rho.Box([-20, -20, -20], [20, 20, 20])),
        obstacles=[ZONE],
        waypoints=[
            rho.Waypoint(3.0, [5, 1.6, -1], penalty=0.2),
            rho.Waypoint(5.0, [5, 90, -1], penalty=0.2),
        ],
    )
    report = rho.verify(rho.plan(scenario))
    assert report.ok
    assert {each.constraint for each in report.exceeded} == {"waypoint 1", "waypoint 2"}


def test_reports_and_documents_name_what_is_exceeded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = rho.plan(past(0.3))
    report = rho.verify(plan)
    (check,) = report.exceeded
    assert not check.asked
    assert report.violations == ()
    words = f"soft: obstacle 1 (zone) at all times, exceeded for solo by {check.excess:.4g} m"
    assert words in str(report)
    assert f"penalties  {report.price:.6g} m²/s⁴" in str(report)
    assert "all constraints hold, but for soft limits" in str(report)
    rho.save(plan, tmp_path / "plan.npz")
    status, out, _ = run(capsys, monkeypatch, "verify", str(tmp_path / "plan.npz"), "--json")
    assert status == 0
    document = json.loads(out)
    (row,) = (each for each in document["tightest"] if "price" in each)
    assert row["price"] == pytest.approx(check.price)
    assert row["penalty"] == pytest.approx(0.3)
    assert document["ok"] is True
    assert "soft, 0.3 m²/s⁴ per m" in str(plan.scenario)
    plain = rho.verify(rho.plan(past(None)))
    assert plain.price == 0.0
    assert "soft" not in str(plain)
    assert all(each.penalty is None and each.price is None for each in plain.checks)


def test_files_keep_penalties(tmp_path: Path) -> None:
    scenario = soft(dataclasses.replace(CURVED["link"], obstacles=(ZONE,)), 0.25)
    waypoint = rho.Waypoint(2.0, [3.0, 0.0, 0.0], penalty=2.5)
    first = dataclasses.replace(scenario.vehicles[0], waypoints=(waypoint,))
    scenario = dataclasses.replace(scenario, vehicles=(first, *scenario.vehicles[1:]))
    rho.save_scenario(scenario, tmp_path / "soft.yaml")
    assert rho.load_scenario(tmp_path / "soft.yaml") == scenario
    assert "penalty: 2.5" in (tmp_path / "soft.yaml").read_text()
    plan = rho.plan(scenario)
    rho.save(plan, tmp_path / "plan.npz")
    assert rho.load(tmp_path / "plan.npz").scenario == scenario
    rho.export(plan, tmp_path / "plan.json", format="json")
    assert rho.load(tmp_path / "plan.json").scenario == scenario
    assert json.dumps(rho.scenario_schema()).count('"penalty"') >= 3


@pytest.mark.parametrize("penalty", [0.0, -1.0, np.inf, np.nan, True, "much"])
@pytest.mark.parametrize(
    ("record", "make"),
    [
        ("keepin", lambda penalty: rho.KeepIn(ZONE, penalty=penalty)),
        ("obstacle", lambda penalty: rho.Obstacle(ZONE, penalty=penalty)),
        ("waypoint", lambda penalty: rho.Waypoint(1.0, [0, 0, 0], penalty=penalty)),
    ],
)
def test_penalties_are_positive_numbers(
    record: str, make: Callable[[Any], object], penalty: object
) -> None:
    with pytest.raises(rho.ScenarioError, match=rf"^{record}\.penalty: got "):
        make(penalty)


def test_penalties_are_refused_where_nothing_weighs_them() -> None:
    scenario = past(0.3, limits=rho.Limits(max_acceleration=3.0))
    plan = rho.plan(scenario)
    calls: list[Callable[[], object]] = [
        lambda: rho.plan_minimum_time(scenario),
        lambda: rho.certify_time(plan),
        lambda: rho.plan_rho(scenario, bounded_cost=True),
        lambda: rho.plan_rho(scenario, free_final_time=True),
    ]
    for call in calls:
        with pytest.raises(rho.ScenarioError, match=r"^obstacles\[0\]\.penalty: got 0\.3, "):
            call()
    with pytest.raises(rho.ScenarioError, match=r"^waypoint\.penalty: got 1\.0, .* without a time"):
        rho.Waypoint(None, [0, 0, 0], penalty=1.0)
    free = dataclasses.replace(scenario.vehicles[0], waypoints=(rho.Waypoint(None, [5, 3, -1]),))
    with pytest.raises(rho.ScenarioError, match=r"^obstacles\[0\]\.penalty: "):
        rho.plan(dataclasses.replace(scenario, vehicles=(free,)))


def test_daqp_and_osqp_plan_with_penalties() -> None:
    expected = total(rho.plan_convex(in_lane(1.0)))
    solvers: tuple[Any, ...] = ("daqp", "osqp")
    for solver in solvers:
        plan = rho.plan_convex(in_lane(1.0), solver=solver)
        assert total(plan) == pytest.approx(expected, rel=1e-5)


def test_smooth_motions_have_soft_limits_too() -> None:
    scenario = past(0.3, limits=rho.Limits(max_acceleration=2.0), smoothing=rho.Smoothing(0.5, 2))
    plan = rho.plan(scenario)
    report = rho.verify(plan)
    assert report.ok
    assert report.price > 0.0
    assert rho.certify(plan).lower_bound <= total(plan)


def test_studies_fly_with_penalties(tmp_path: Path) -> None:
    rho.save_scenario(past(0.3), tmp_path / "past.yaml")
    (tmp_path / "study.yaml").write_text(
        "name: soft\nscenarios: [{name: past, file: past.yaml}]\n"
        "methods: [{name: once, planner: plan}, {name: windows, planner: plan_rho}]\n"
    )
    results = rho.campaign(rho.load_study(tmp_path / "study.yaml"), tmp_path / "runs.sqlite")
    assert len(results) == 2
    assert all(results.frame()["verified"])
