"""Lower bounds of least times: no motion undercuts one, and they are as good as documented."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import drake_rho as rho
from drake_rho.analysis.outside import OCTANTS, Forbidden, Region, forbidden_by
from drake_rho.analysis.time_bounds import TimeBound
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.time_relaxation import Passage, Place, TimeRelaxations
from drake_rho.planning.scp.least_time import ROUGH
from drake_rho.scenario.maps.parts import Boxes, Triangles
from tests.scenarios import box, single, slow
from tests.shapes import KINDS, random_shape
from tests.test_cli import run
from tests.test_cli_json import read

TRIANGLES = [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[2, 2, 2], [3, 2, 2], [2, 3, 3]]]
SURFACE = Triangles(np.array(TRIANGLES, dtype=float))
TURN = Rotation.from_euler("zyx", [0.4, -0.7, 1.1]).as_matrix()
TURNED = Boxes(np.array([[-2.0, -2, -2], [0, 0, 0]]), np.array([[-1.0, -1, -1], [2, 0.5, 1]]), TURN)


@pytest.mark.parametrize("kind", [*KINDS, "triangles", "turned boxes"])
def test_no_point_outside_of_a_set_is_cut_off(kind: str) -> None:
    """Each is in one of the regions, and in one half of a region, with its half-spaces."""
    rng = np.random.default_rng(0)
    parts = {"triangles": SURFACE, "turned boxes": TURNED}
    drawn = parts.get(kind) or random_shape(rng, kind, np.zeros(3), 1.0)
    kept = forbidden_by(drawn, 1 if kind in parts else 0, 0.25)
    assert kept.has_middle
    x = rng.normal(size=(8000, 3)) * 1.5 * np.minimum(kept.scales, 3.0)
    x = x[kept.distance(x) >= 0.25]
    assert len(x) > 20
    for chosen in kept.regions:
        regions, left = list(kept.regions), x
        for depth in range(4):
            inside = [_is_in(kept, each, left) for each in regions]
            assert np.all(np.any(inside, axis=0)), depth
            one = chosen if depth == 0 else regions[int(np.argmax(np.sum(inside, axis=1)))]
            left = left[_is_in(kept, one, left)]
            if not (regions := one.halves()):
                break
    assert (kept.regions == OCTANTS) == (kind not in ("box", "polytope", "turned boxes"))


def _is_in(kept: Forbidden, region: Region, x: np.ndarray) -> np.ndarray:
    ((normals, bounds),) = kept.half_spaces([region])
    return np.asarray(np.all(x @ normals.T >= bounds - 1e-9, axis=1))


def test_small_cones_come_close_to_the_surface() -> None:
    kept = forbidden_by(rho.Sphere([1, 0, 0], 0.7), 0, 0.3)
    region = kept.regions[3]
    for _ in range(12):
        region = region.halves()[0]
    ((normals, bounds),) = kept.half_spaces([region])
    assert 0.99 < bounds[3] <= 1.0  # the radius is 0.7 + 0.3
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


@pytest.mark.parametrize("kind", ["sphere", "polytope", "box"])
def test_halves_become_narrow_in_every_direction(kind: str) -> None:
    rng = np.random.default_rng(4)
    kept = forbidden_by(random_shape(rng, kind, np.zeros(3), 1.0), 0, 0.25)
    for region in kept.regions:
        one = region
        for _ in range(12):
            halves = one.halves() or [one, one]
            one = halves[int(rng.integers(2))]
        assert one.bulge < 0.03


@pytest.mark.parametrize("signs", [[0, 1, 0], [-1, 0, 1], [1, 1, -1]])
def test_regions_beside_a_box_come_as_close_as_they_are_narrow(signs: list[int]) -> None:
    """Beside a side the plane touches; else it is below the surface by what a chord is."""
    kept = forbidden_by(rho.Box([-1, -2, -3], [1, 2, 3]), 0, 0.5)
    region = next(each for each in kept.regions if each.signs.tolist() == signs)
    for _ in range(5):
        ((normals, bounds),) = kept.half_spaces([region])
        toward = region.edges.sum(axis=0)
        corner = np.array(signs) * [1.0, 2.0, 3.0]
        surface = corner + 0.5 * toward / np.linalg.norm(toward)
        above = normals[-1] @ surface - bounds[-1]
        assert -1e-12 <= above <= kept.bulge(region) + 1e-12
        halves = region.halves()
        assert (len(halves) == 0) == (sum(map(abs, signs)) == 1)
        region = halves[0] if halves else region


LIMITS = {
    "norms": rho.Limits(max_acceleration=3.0, max_speed=4.0),
    "boxes": rho.Limits(acceleration=box(2.0), velocity=box(3.0), jerk=box(9.0)),
    "thrust": rho.Limits(max_thrust=13.0, max_tilt=0.6, max_jerk=15.0),
}


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_every_motion_is_one_of_its_relaxations(name: str, seed: int) -> None:
    """Whatever the interval around its time, the cones that it is in, and the balls it passes."""
    rng = np.random.default_rng(seed)
    start = rho.State([0, 0, 2], 0.5 * rng.normal(size=3), 0.3 * rng.normal(size=3))
    goal = rho.State([7, 1, 2.5], 0.5 * rng.normal(size=3))
    scenario = single(start=start, goal=goal, limits=LIMITS[name], grid=rho.Grid(0.3, 21))
    plan = rho.plan(scenario)
    T, unsolved = scenario.grid.duration, 0
    for longest in (T, 1.1 * T, 1.7 * T):
        for shortest in (0.2 * T, 0.9 * T, T):
            places = [_place(plan.motion(), T, longest, rng) for _ in range(3)]
            passages = [_passage(plan.motion(), T, rng) for _ in range(2)]
            grid = rho.Grid(longest / 20, 21)
            programs = TimeRelaxations(Problem.of(scenario.ending_with(grid)), ROUGH)
            try:
                relaxed = programs.least(shortest, places, passages)
            except rho.SolverError:  # a solution of low accuracy is none
                unsolved += 1
                continue
            assert relaxed is not None
            assert relaxed.duration <= T * (1.0 + 1e-6)
    assert unsolved <= 1


def _place(motion: Motion, T: float, longest: float, rng: np.random.Generator) -> Place:
    """Return half-spaces of a moving obstacle on whose surface a motion is."""
    part, velocity = rng.uniform(0.1, 0.9), 0.3 * rng.normal(size=3)
    at = motion.at("position", [part * T])[0, 0]
    away = rng.normal(size=3)
    kept = forbidden_by(rho.Sphere([0, 0, 0], 0.9 * float(np.linalg.norm(away))), 0, 0.0)
    center = at - away + part * (longest - T) * velocity
    region = next(each for each in kept.regions if _is_in(kept, each, away[None])[0])
    ((normals, bounds),) = kept.half_spaces([region])
    return Place(part, center, velocity, normals, bounds)


def _passage(motion: Motion, T: float, rng: np.random.Generator) -> Passage:
    """Return a ball that a motion touches in a window, with the lengths of its path there."""
    window = np.sort(rng.uniform(0.0, 1.0, 2))
    first, last = window.tolist()
    x = motion.at("position", T * np.linspace(first, last, 401))[0]
    away = 0.3 * rng.normal(size=3)
    lengths = np.linalg.norm(np.diff(x, axis=0), axis=1) * (1.0 + 1e-4)  # of chords
    half = max(lengths[:200].sum(), lengths[200:].sum())
    center = x[rng.integers(401)] + away
    return Passage(window, center, float(np.linalg.norm(away)), float(lengths.sum()), float(half))


def _has_motion(scenario: rho.Scenario, T: float) -> bool:
    """Return whether CVXPY finds a motion in a given time, with accelerations as unknowns."""
    cp = pytest.importorskip("cvxpy")  # of the bench extra, which tests do without
    vehicle, limits = scenario.vehicles[0], scenario.limits
    n = scenario.grid.knots - 1
    h, a = T / n, cp.Variable((n, 3))
    v = [vehicle.start.velocity]
    p = [vehicle.start.position]
    for k in range(n):
        p.append(p[-1] + h * v[-1] + h**2 / 2 * a[k])
        v.append(v[-1] + h * a[k])
    same = [p[-1] == vehicle.goal.position, v[-1] == vehicle.goal.velocity]
    fast = [cp.norm(each) <= limits.max_speed for each in v[1:-1]]
    hard = [cp.norm(a[k]) <= limits.max_acceleration for k in range(n)]
    program = cp.Problem(cp.Minimize(0), [*same, *fast, *hard])
    program.solve(solver=cp.CLARABEL)
    return bool(program.status == cp.OPTIMAL)


@pytest.mark.parametrize("seed", [0, *slow(1, 4, 5)])
def test_from_a_moving_start_no_shorter_time_has_a_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, goal = (
        rho.State([0, 0, 1], rng.uniform(-1, 1, 3)),
        rho.State([4, 1, 1], rng.uniform(-1, 1, 3)),
    )
    limits = rho.Limits(max_acceleration=3.0, max_speed=3.0)
    scenario = single(start=start, goal=goal, limits=limits, grid=rho.Grid(0.3, 13))
    certificate = rho.certify_time(rho.plan_minimum_time(scenario), gap=0.0)
    assert certificate.is_globally_optimal
    for part in (0.5, 0.8, 0.95, 0.999):
        assert not _has_motion(scenario, part * certificate.bound)
    assert _has_motion(scenario, (1.0 + 1e-4) * certificate.bound)


def blocked(radius: float = 0.8, **changes: object) -> rho.Scenario:
    """Return a vehicle with a ball in its way."""
    vehicle = rho.Vehicle("scout", rho.State([0, 0, 1]), rho.State([5, 0, 1]), radius=0.2)
    ball = rho.Sphere([2.5, 0.1, 1.0], radius)
    scenario = rho.Scenario(
        "ball", rho.Grid(0.25, 13), [vehicle], rho.Limits(max_acceleration=4.0), obstacles=[ball]
    )
    return dataclasses.replace(scenario, **changes)  # type: ignore[arg-type]


def test_behind_an_obstacle_the_bound_is_that_of_going_around_it() -> None:
    plan = rho.plan_minimum_time(blocked())
    assert rho.verify(plan).ok
    alone = plan.statistics.time_bound
    certificate = rho.certify_time(plan)
    assert alone is not None
    assert 1.05 * alone < plan.scenario.grid.duration
    assert 0.0 <= certificate.gap <= 0.01
    assert certificate.holds
    assert not certificate.cut


@pytest.mark.parametrize("seed", slow(*range(6)))
def test_no_plan_that_is_found_takes_less_time_than_the_bound(seed: int) -> None:
    """Slow plans give bounds too, which those of the least time do not undercut."""
    rng = np.random.default_rng(seed)
    balls = [
        rho.Obstacle(
            rho.Sphere(rng.uniform([1.5, -1, 0], [6.5, 1, 2]), rng.uniform(0.5, 0.9)),
            velocity=0.2 * (seed % 2) * rng.normal(size=3),
        )
        for _ in "ab"
    ]
    vehicle = rho.Vehicle("a", rho.State([0, 0, 1], [0, seed % 3 * 0.3, 0]), rho.State([8, 0, 1]))
    scenario = rho.Scenario("field", rho.Grid(0.3, 21), [vehicle], LIMITS["norms"], obstacles=balls)
    least = rho.plan_minimum_time(scenario).scenario.grid.duration
    bound = rho.certify_time(rho.plan(scenario), gap=0.0, time_limit=10.0).bound
    assert 0.9 * least <= bound <= least


def test_a_box_of_a_map_is_gone_around_like_any_other() -> None:
    block = rho.Box([2.0, -0.7, 0.2], [3.0, 0.9, 1.8])
    cells = rho.Voxels.from_grid(
        np.ones((5, 8, 8), dtype=bool), resolution=0.2, origin=[2.0, -0.7, 0.2]
    )
    bounds = []
    for obstacle in (block, cells):
        found = TimeBound(blocked(obstacles=[obstacle]), 4.0)
        for _ in range(8):
            found.improve()
        bounds.append(found.bound)
    assert bounds[1] == pytest.approx(bounds[0], rel=1e-3)
    assert bounds[0] > 1.001 * 2.0 * np.sqrt(5.0 / 4.0)


def test_every_part_of_a_map_is_gone_around_like_a_box() -> None:
    """Six blocks of a map, the nearest of which is neither the first nor alone on the way."""
    corners = np.array([[x, y, 0.2] for x in (1.2, 2.4, 3.6) for y in (-0.6, 0.4)])
    inside = np.array(list(np.ndindex(2, 4, 8)))
    cells = np.concatenate([np.round(corner / 0.2).astype(int) + inside for corner in corners])
    voxels = rho.Voxels(cells, 0.2)
    blocks = [rho.Box(c, np.add(c, [0.4, 0.8, 1.6])) for c in corners]
    bounds = []
    for obstacles in (blocks, [voxels]):
        found = TimeBound(blocked(obstacles=obstacles), 4.0)
        while found.relaxations < 150 and found.improve():
            pass
        bounds.append(found.bound)
        assert not found.left_out
    assert bounds[1] == pytest.approx(bounds[0], rel=2e-2)
    assert min(bounds) > 1.01 * 2.0 * np.sqrt(5.0 / 4.0)


def test_an_obstacle_bounds_times_at_which_it_is_there() -> None:
    """A plan of 5 s may wait for its end, and a faster one would have to go around it."""
    ball = rho.Sphere([2.5, 0.1, 1.0], 0.8)
    always, early, late = (
        TimeBound(blocked(obstacles=[rho.Obstacle(ball, active=active)]), 5.0)
        for active in (None, (-1.0, 4.0), (4.0, 9.0))
    )
    free = late.bound
    assert not late.improve()
    for _ in range(12):
        always.improve()
        early.improve()
    assert always.bound > 1.01 * free
    assert early.bound > 1.01 * free


@pytest.mark.slow
def test_an_uncertain_obstacle_is_as_large_as_what_it_may_be_off() -> None:
    large, small = rho.Sphere([2.5, 0.1, 1.0], 0.8), rho.Sphere([2.5, 0.1, 1.0], 0.6)
    growing = rho.Obstacle(small, position_error=0.2, velocity_error=0.05, seen_at=0.0)
    certain, fixed, grows = (
        rho.certify_time(rho.plan_minimum_time(blocked(obstacles=[each])))
        for each in (large, rho.Obstacle(small, position_error=0.2), growing)
    )
    assert fixed.bound == pytest.approx(certain.bound, rel=1e-6)
    assert fixed.left_out == ()
    assert certain.bound * 0.99 <= grows.bound <= grows.duration
    assert grows.left_out == ("the growth of errors of obstacles",)


def test_one_gate_on_the_way_is_bounded_within_a_hundredth() -> None:
    gate = rho.Waypoint(None, [3.0, 2.0, 1.0], 0.1)
    limits = rho.Limits(max_acceleration=4.0, max_speed=3.0)
    start, goal = rho.State([0, 0, 1]), rho.State([6, 0, 1])
    scenario = single(
        start=start, goal=goal, limits=limits, waypoints=[gate], grid=rho.Grid(0.2, 21)
    )
    certificate = rho.certify_time(rho.plan_minimum_time(scenario))
    assert 0.0 <= certificate.gap <= 0.01
    assert "with waypoints at any times" in str(certificate)


@pytest.mark.slow
def test_past_a_gate_a_vehicle_may_arrive_in_motion() -> None:
    gate, start = rho.Waypoint(None, [9.0, 0.5, 0.0]), rho.State([0.0, 0.0, 0.0])
    racer = rho.Vehicle("racer", start, rho.State([10.0, 0.0, 0.0], None), waypoints=[gate])
    limits, grid = rho.Limits(max_acceleration=2.0), rho.Grid(0.2, 31)
    fast = rho.plan_minimum_time(rho.Scenario("race", grid, [racer], limits))
    least = fast.scenario.grid
    slower = rho.Scenario("race", rho.Grid(1.04 * least.step, 31), [racer], limits)
    proof = rho.certify_time(rho.plan(slower), gap=0.036, time_limit=5.0)
    assert 0.97 * least.duration < proof.bound <= least.duration * (1 + 1e-6)


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_no_motion_flies_farther_between_two_times(seed: int, fixed: bool) -> None:
    rng = np.random.default_rng([seed, 3])
    moving = rho.State(rng.uniform(-1.0, 1.0, 3), rng.uniform(-1.0, 1.0, 3))
    arriving = rng.uniform(-1.0, 1.0, 3) if fixed else None
    goal = rho.State(rng.uniform(4.0, 6.0, 3), arriving)
    racer = rho.Vehicle("racer", moving, goal)
    limits = rho.Limits(max_acceleration=3.0, max_speed=4.0 if seed % 2 else None)
    fast = rho.plan_minimum_time(rho.Scenario("race", rho.Grid(0.2, 21), [racer], limits))
    duration = fast.scenario.grid.duration
    bound = TimeBound(fast.scenario, duration)
    times = np.linspace(0.0, duration, 2001)
    speeds = np.linalg.norm(fast.motion().at("velocity", times)[0], axis=1)
    flown = np.concatenate([[0.0], np.cumsum((speeds[1:] + speeds[:-1]) / 2 * np.diff(times))])
    for first, last in [(0, 2000), *np.sort(rng.integers(0, 2001, (30, 2)), axis=1).tolist()]:
        farthest = bound.farthest(duration, first / 2000, last / 2000)
        assert flown[last] - flown[first] <= farthest * (1 + 1e-6) + 1e-9


def test_of_several_vehicles_the_slowest_counts() -> None:
    scenario = blocked()
    far = rho.Vehicle("far", rho.State([0, 3, 1]), rho.State([7, 3, 1]), radius=0.2)
    scenario = dataclasses.replace(
        scenario, vehicles=(*scenario.vehicles, far), separation=rho.Separation(0.5)
    )
    certificate = rho.certify_time(rho.plan_minimum_time(scenario))
    assert certificate.bound == pytest.approx(2.0 * np.sqrt(7.0 / 4.0), rel=1e-5)
    assert certificate.is_globally_optimal
    assert certificate.left_out == ("the separation",)
    assert [each.vehicle for each in certificate.vehicles] == ["scout", "far"]
    assert "far" in certificate._repr_html_()


def test_a_search_that_is_cut_short_keeps_its_bound() -> None:
    plan = rho.plan(dataclasses.replace(blocked(), grid=rho.Grid(0.5, 13)))
    said = list[str]()
    certificate = rho.certify_time(plan, gap=0.0, time_limit=0.3, progress=said.append)
    assert certificate.cut
    assert certificate.bound > 2.0
    assert "the search was cut short" in str(certificate)
    assert said
    with pytest.raises(ValueError, match="got -0\\.1, expected a number of at least 0"):
        rho.certify_time(plan, gap=-0.1)


def test_the_command_prints_the_certificate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = rho.plan_minimum_time(blocked(obstacles=[]))
    rho.save(plan, "plan.npz")
    certificate = rho.certify_time(plan)
    status, out, _ = run(capsys, monkeypatch, "certify", "plan.npz", "--time")
    assert (status, out) == (0, f"{certificate}\n")
    _, out, _ = run(capsys, monkeypatch, "certify", "plan.npz", "--time", "--json")
    found = read(out, "certify --time")
    assert found["bound_s"] == certificate.bound
    assert found["is_globally_optimal"]
    assert found["premise"] == "plans on 13 knots"
