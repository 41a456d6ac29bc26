"""Shows: formations, assignments, whole flights, lights, and what is refused."""

from __future__ import annotations

import base64
import dataclasses
import itertools
import json
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.test_cli import run
from tests.tolerances import ROUNDING

Captured = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch
forms = rho.formations

LIMITS = rho.Limits(max_speed=5.0, max_acceleration=3.0)
APART = rho.Separation(1.0, downwash=2.0)
PADS = forms.Grid(3, 2, spacing=2.0)
UP = np.array([0.0, 0.0, 3.0])


def show(*scenes: rho.Scene, **changes: Any) -> rho.Show:
    """Return a show of six vehicles that rise by 3 m two by two."""
    given_: dict[str, Any] = {
        "take_off": rho.TakeOff(3.0, at_once=2, every=0.6),
        "limits": LIMITS,
        "separation": APART,
        "pads": PADS,
    }
    return rho.Show("six", scenes=scenes, **given_ | changes)


def ring(count: int = 6, radius: float = 4.0, **changes: Any) -> rho.Scene:
    """Return the scene of a horizontal ring 9 m above the pads."""
    given_: dict[str, Any] = {"formation": forms.Ring(count, radius, center=[0, 0, 9]), "hold": 2.0}
    return rho.Scene("ring", **given_ | changes)


def random_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return points 10 to 20 m above the pads that keep the separation with room."""
    points = list[np.ndarray]()
    while len(points) < count:
        point = rng.uniform([-6, -6, 10], [6, 6, 20])
        apart = [np.linalg.norm((point - other) / [1, 1, 2.0]) for other in points]
        if min(apart, default=9.0) > 1.3:
            points.append(point)
    return np.array(points)


def flown(shown: rho.Show) -> rho.Plan:
    return rho.plan_show(shown, solver=rho.Daqp())


# formations


def test_a_ring_a_grid_and_a_sphere_have_their_sizes() -> None:
    ringed = forms.Ring(12, 3.0, center=[1, 2, 3]).positions
    assert np.allclose(np.linalg.norm(ringed - [1, 2, 3], axis=1), 3.0)
    sides = np.linalg.norm(np.roll(ringed, 1, axis=0) - ringed, axis=1)
    assert np.allclose(sides, 6.0 * np.sin(np.pi / 12))
    grid = forms.Grid(4, 3, layers=2, spacing=0.5).positions
    assert (len(grid), np.ptp(grid, axis=0).tolist()) == (24, [1.5, 1.0, 0.5])
    assert np.allclose(grid.mean(axis=0), 0.0)
    sphere = forms.Sphere(200, 2.0).positions
    assert np.allclose(np.linalg.norm(sphere, axis=1), 2.0)
    nearest = [np.sort(np.linalg.norm(sphere - each, axis=1))[1] for each in sphere]
    assert min(nearest) > 0.6 * max(nearest)  # evenly


def test_formations_are_scaled_turned_and_moved() -> None:
    one = forms.Table(
        [[1, 0, 0], [0, 2, 0]], scale=3.0, rotation=[0, 0, np.pi / 2], center=[5, 0, 1]
    )
    assert np.allclose(one.positions, [[5, 3, 1], [-1, 0, 1]])


@pytest.mark.parametrize("header", ["", "x,y,z\n"])
def test_tables_are_read_from_csv_and_npy(tmp_path: Path, header: str) -> None:
    points = np.random.default_rng(1).normal(size=(5, 3))
    rows = "\n".join(",".join(map(repr, row)) for row in points.tolist())
    (tmp_path / "points.csv").write_text(header + rows)
    np.save(tmp_path / "points.npy", points)
    for name in ("points.csv", "points.npy"):
        assert np.array_equal(forms.Table(path=str(tmp_path / name)).positions, points)


def test_letters_are_equidistant_on_their_outlines_upright_and_as_high_as_asked() -> None:
    points = forms.Letters("I", 40, 10.0).positions
    assert np.array_equal(points[:, 1], np.zeros(40))
    assert np.ptp(points[:, 2]) == pytest.approx(10.0, rel=0.1)
    # the letter I is a rectangle, so that its points are on four lines
    low, high = points.min(axis=0), points.max(axis=0)
    on_side = np.isclose(points[:, [0, 2]], low[[0, 2]]) | np.isclose(
        points[:, [0, 2]], high[[0, 2]]
    )
    assert on_side.any(axis=1).mean() > 0.9
    assert len(forms.Letters("RHO", 60, 24.0).positions) == 60


def test_drawings_have_the_points_of_their_paths(tmp_path: Path) -> None:
    path = tmp_path / "disc.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><circle cx="5" cy="5" r="3"/>'
        '<path d="M 20 5 L 30 5"/></svg>'
    )
    points = forms.Drawing(str(path), 30, 6.0).positions
    centre = (points[:, 0].max() + points[:, 0].min()) / 2.0
    disc = points[points[:, 0] < centre - 2.0]
    middle = (disc.max(axis=0) + disc.min(axis=0)) / 2.0
    assert np.allclose(np.linalg.norm(disc - middle, axis=1), 3.0, atol=0.05)
    lengths = {len(disc): 6.0 * np.pi, len(points) - len(disc): 10.0}
    shares = [count / length for count, length in lengths.items()]
    assert shares[0] == pytest.approx(shares[1], rel=0.15)  # in proportion to the lengths


# assignments


def squares(plan: rho.Plan, above: np.ndarray) -> float:
    """Return the sum of the squared distances between scenes, by the plan's waypoints."""
    vehicles = plan.scenario.vehicles
    at = [
        np.array([each.waypoints[k].position for each in vehicles])
        for k in range(len(vehicles[0].waypoints))
    ]
    landing = plan.scenario.fleet.goal_positions + UP
    return sum(float(np.sum((b - a) ** 2)) for a, b in itertools.pairwise([above, *at, landing]))


@given(seed=st.integers(0, 10**6))
@settings(max_examples=4)
def test_no_assignment_of_one_scene_is_cheaper(seed: int) -> None:
    """All 720 orders of six places, back to own pads: the sum is least, and times have bounds."""
    points = random_points(np.random.default_rng(seed), 6)
    shown = show(rho.Scene("points", forms.Table(points), hold=1.0))
    plan, above = flown(shown), PADS.positions + UP
    orders = [points[list(order)] for order in itertools.permutations(range(6))]
    sums = [2.0 * np.sum((order - above) ** 2) for order in orders]
    certificate = rho.certify_show(shown, plan)
    assert certificate.squares == pytest.approx(squares(plan, above), rel=ROUNDING)
    times = [least_time(order - above).max() for order in orders]
    chosen = certificate.transitions[0]
    assert chosen.any_assignment == pytest.approx(min(times), rel=ROUNDING)
    assert certificate.squares_bound == pytest.approx(min(sums), rel=ROUNDING)
    # exchanges shorten flights at the cost of the sum, so either is least
    assert certificate.gap <= 1e-9 or chosen.bound < times[int(np.argmin(sums))] - 1e-9


def least_time(ways: np.ndarray) -> np.ndarray:
    """Return the least times of straight flights from rest to rest at 5 m/s and 3 m/s² [s]."""
    d = np.linalg.norm(ways, axis=-1)
    return np.asarray(np.where(d > 25.0 / 3.0, d / 5.0 + 5.0 / 3.0, 2.0 * np.sqrt(d / 3.0)))


def test_waiting_vehicles_are_those_for_which_the_sum_is_least() -> None:
    points = random_points(np.random.default_rng(3), 3)
    shown = show(rho.Scene("three", forms.Table(points), hold=1.0), landing="own")
    above = PADS.positions + UP
    least = min(
        2.0 * np.sum((points - above[list(chosen)]) ** 2)
        for chosen in itertools.permutations(range(6), 3)
    )
    assert rho.certify_show(shown, flown(shown)).squares == pytest.approx(least, rel=ROUNDING)


def test_bounds_of_several_scenes_hold_and_any_pad_is_no_dearer() -> None:
    rng = np.random.default_rng(5)
    scenes = [rho.Scene(f"{k}", forms.Table(random_points(rng, 6)), hold=0.5) for k in range(3)]
    own, any_ = (show(*scenes, landing=landing) for landing in ("own", "any"))
    certificates = [rho.certify_show(each, flown(each)) for each in (own, any_)]
    assert all(each.squares >= each.squares_bound * (1 - ROUNDING) for each in certificates)
    assert certificates[1].gap == pytest.approx(0.0, abs=1e-12)
    for each in certificates[0].transitions:
        assert each.any_assignment <= each.bound * (1 + ROUNDING) <= each.duration * (1 + ROUNDING)
    assert "to 0: " in str(certificates[0])


# whole flights


def separations(plan: rho.Plan, every: float) -> float:
    """Return the least scaled distance of two vehicles at dense samples [m]."""
    times = np.append(np.arange(0.0, plan.times[-1], every), plan.times[-1])
    positions = plan.at(times).positions / [1.0, 1.0, 2.0]
    pairs = itertools.combinations(range(len(positions)), 2)
    return min(float(np.linalg.norm(positions[i] - positions[j], axis=1).min()) for i, j in pairs)


@given(seed=st.integers(0, 10**6), count=st.integers(2, 6), landing=st.sampled_from(["own", "any"]))
@settings(max_examples=4)
def test_random_shows_hold_everything(seed: int, count: int, landing: str) -> None:
    rng = np.random.default_rng(seed)
    scenes = [
        rho.Scene(f"scene {k}", forms.Table(random_points(rng, count)), hold=rng.uniform(0, 2))
        for k in range(2)
    ]
    shown = show(*scenes, landing=landing)
    plan = flown(shown)
    assert rho.verify(plan).ok
    assert separations(plan, 0.01) >= 1.0 - 1e-6
    pads = {tuple(pad) for pad in PADS.positions.tolist()}
    goals = plan.scenario.fleet.goal_positions
    assert {tuple(goal) for goal in goals.tolist()} == pads
    if landing == "own":
        assert np.array_equal(goals, PADS.positions)
    for index, scene in enumerate(scenes):
        stops = [vehicle.waypoints[index] for vehicle in plan.scenario.vehicles]
        (begin,) = {stop.time or 0.0 for stop in stops}
        there = {tuple(stop.position.tolist()) for stop in stops}
        assert {tuple(each) for each in scene.formation.positions.tolist()} <= there
        held = plan.at(np.linspace(begin, begin + scene.hold, 7))
        assert (
            np.abs(held.positions - np.array([stop.position for stop in stops])[:, None]).max()
            < 1e-6
        )


def test_twenty_four_crazyflies_fly_a_show_in_a_room() -> None:
    """Formations fill the room; the separation of 0.4 m is 1 m vertically."""
    tilted = forms.Ring(24, 2.4, center=[0, 0, 1.6], rotation=[0.4, 0, 0])
    rings = [
        forms.Ring(n, r, center=[0, 0, z]).positions for n, r, z in ((14, 2.4, 0.8), (10, 1, 2))
    ]
    block = forms.Grid(4, 3, 2, spacing=1.05, center=[0, 0, 1.5])
    room, apart = rho.Box([-3, -3, 0], [3, 3, 3]), rho.Separation(0.4, downwash=2.5)
    shapes: dict[str, Any] = {
        "tilted": tilted,
        "rings": forms.Table(np.concatenate(rings)),
        "block": block,
    }
    plan = flown(
        rho.Show(
            "room",
            forms.Grid(6, 4, spacing=0.5),
            [rho.Scene(name, each, 1.0) for name, each in shapes.items()],
            rho.Limits(room, max_speed=1.5, max_acceleration=3.0),
            apart,
            step=0.2,
            take_off=rho.TakeOff(1.0),
        )
    )
    assert rho.verify(plan).ok
    times = np.linspace(0.0, plan.times[-1], 2000)
    positions = plan.at(times).positions
    assert (np.abs(positions - [0, 0, 1.5]) <= np.array([3, 3, 1.5]) + 1e-6).all()
    scaled = positions / [1.0, 1.0, 2.5]
    pairs = itertools.combinations(range(24), 2)
    least = min(np.linalg.norm(scaled[i] - scaled[j], axis=1).min() for i, j in pairs)
    assert 0.4 - 1e-6 <= least < 0.41  # the separation is kept, and has an effect
    at_rest = np.abs(np.diff(positions[:, [0, -1]], axis=1)).max()
    assert at_rest < 1e-6  # all are back on their own pads


def test_vehicles_take_off_two_by_two_and_land_as_the_mirror_image() -> None:
    plan = flown(show(ring()))
    moving = np.linalg.norm(plan.positions - plan.positions[:, :1], axis=2) > 1e-9
    first = moving.argmax(axis=1)
    assert (first - first[0]).tolist() == [0, 0, 3, 3, 6, 6]  # 0.6 s are three steps of 0.25 s
    assert np.abs(np.diff(plan.positions[:, : first[0] + 8, :2], axis=1)).max() < 1e-9  # vertical
    still = np.linalg.norm(plan.positions - plan.positions[:, -1:], axis=2) <= 1e-6
    landed = still.shape[1] - np.argmin(still[:, ::-1], axis=1)
    assert (landed.max() - landed).tolist() == [0, 0, 3, 3, 6, 6]


def test_without_a_take_off_vehicles_wait_on_their_pads() -> None:
    plan = flown(show(ring(4), take_off=None))
    assert rho.verify(plan).ok
    on_pads = np.isclose(np.ptp(plan.positions, axis=1), 0.0).all(axis=1)
    assert on_pads.sum() == 2


def test_given_times_and_obstacles_are_kept_to() -> None:
    tower = rho.Cylinder([0, 3.2, 5], 0.8, 10.0)
    shown = show(ring(transition=8.1), obstacles=[tower], radius=0.3)
    plan = flown(shown)
    assert rho.verify(plan).ok
    transition = rho.certify_show(shown, plan).transitions[0]
    assert transition.duration == pytest.approx(8.0)  # whole steps
    centres = plan.at(np.arange(0.0, plan.times[-1], 0.01)).positions
    away = np.linalg.norm(centres[..., :2] - [0, 3.2], axis=-1)
    assert away[centres[..., 2] < 10.0].min() >= 0.8 + 0.3 - 1e-6


@given(seed=st.integers(0, 10**6))
@settings(max_examples=6)
def test_shows_with_limits_of_every_kind_hold_them(seed: int) -> None:
    """Where jerks are limited, motions that follow each other at once have no jump between."""
    rng = np.random.default_rng(seed)
    kinds: dict[str, Any] = {
        "velocity": rho.Box([-4, -4, -2], [4, 4, 3]),
        "acceleration": rho.Box([-3, -3, -2], [3, 3, 2]),
        "jerk": rho.Box([-9] * 3, [9] * 3),
        "max_jerk": 9.0,
        "max_thrust": 12.0,
        "max_tilt": 0.3,
        "max_speed": 4.0,
    }
    chosen = [name for name in kinds if rng.random() < 0.5]
    scene = rho.Scene("two", forms.Table(random_points(rng, 6)))
    plan = flown(show(ring(hold=0.0), scene, limits=rho.Limits(**{k: kinds[k] for k in chosen})))
    assert rho.verify(plan).ok, chosen


def test_paths_in_a_show_file_are_beside_it(tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text("1,0,8\n-1.5,0,8\n")
    (tmp_path / "show.yaml").write_text("""
name: pair
pads: {kind: grid, columns: 2, rows: 1, spacing: 2}
limits: {max_speed: 4, max_acceleration: 3}
separation: {distance: 1}
scenes: [{name: two, formation: {kind: table, path: two.csv}}]
obstacles: [{mesh: tower.obj}]
radius: 0.2
""")
    corners = "v 9 0 0\nv 10 0 0\nv 9 1 0\nv 9 0 5\n"
    (tmp_path / "tower.obj").write_text(corners + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    shown = rho.load_show(tmp_path / "show.yaml")
    assert shown.scenes[0].formation.positions.tolist() == [[1, 0, 8], [-1.5, 0, 8]]
    assert rho.verify(flown(shown)).ok
    with pytest.raises(rho.ScenarioError, match=r"radius: got 0\.0, expected at least"):
        flown(dataclasses.replace(shown, radius=0.0))


def test_the_show_is_the_same_for_any_number_of_workers() -> None:
    shown = show(
        ring(), rho.Scene("wall", forms.Grid(3, 1, layers=2, spacing=2.5, center=[0, 0, 9]))
    )
    alone = flown(shown)
    for workers in (1, 3):
        with ThreadPoolExecutor(workers) as executor:
            plan = rho.plan_show(shown, solver=rho.Daqp(), executor=executor)
        assert np.array_equal(plan.accelerations, alone.accelerations)


def test_a_show_is_planned_with_the_default_solver_and_told_step_by_step() -> None:
    told = list[str]()
    plan = rho.plan_show(show(ring()), progress=told.append)
    assert rho.verify(plan).ok
    assert [each for each in told if each.startswith("transition")] == [
        "transition 1 of 2, to ring",
        "transition 2 of 2, to landing",
    ]


def test_a_show_that_takes_too_long_to_plan_is_stopped() -> None:
    limit = rho.Options(time_limit=1e-6)
    with ThreadPoolExecutor(2) as executor:
        for given_ in (None, executor):
            with pytest.raises(rho.OutOfTimeError, match="time limit of 1e-06 s"):
                rho.plan_show(show(ring()), options=limit, executor=given_)


# lights


def lights_at(program: bytes, time: float) -> list[float]:
    """Return the colour that a light program shows at a time [s], by an interpreter of its own."""
    at, colour, place = 0.0, np.zeros(3), 0
    while program[place] != 0:
        command, target = program[place], np.array(list(program[place + 1 : place + 4]), float)
        place += 4
        count, shift = 0, 0
        while True:
            byte = program[place]
            count |= (byte & 127) << shift
            place, shift = place + 1, shift + 7
            if byte < 128:
                break
        lasting = 0.02 * count
        if time < at + lasting:
            share = 1.0 if command == 4 else (time - at) / lasting
            return list(colour + (target - colour) * share)
        at, colour = at + lasting, target
    return list(colour)


def test_lights_fade_between_the_colours_of_scenes(tmp_path: Path) -> None:
    colours = tuple(f"#{k:02x}0080" for k in range(0, 120, 20))
    red = rho.Scene("red", forms.Ring(4, 3.0, center=[0, 0, 14]), 1.0, colours=("#ff0000",))
    plan = flown(show(ring(colours=colours), red))
    rho.save(plan, tmp_path / "show.npz")
    rho.export(rho.load(tmp_path / "show.npz"), tmp_path / "show.skyc")
    archive = zipfile.ZipFile(tmp_path / "show.skyc")
    for number, vehicle in enumerate(plan.scenario.vehicles, start=1):
        program = json.loads(archive.read(f"drones/{number}/lights.json"))["data"]
        first, second = vehicle.waypoints
        assert first.time is not None
        assert second.time is not None
        own = [int(first.colour[k : k + 2], 16) for k in (1, 3, 5)]  # type: ignore[index]
        other = [255, 0, 0] if second.colour == "#ff0000" else [0, 0, 0]
        code = base64.b64decode(program)
        assert lights_at(code, first.time + 1.0) == own
        assert lights_at(code, second.time + 0.5) == other
        between = (first.time + first.dwell + second.time) / 2.0
        assert np.allclose(lights_at(code, between), np.add(own, other) / 2.0, atol=2.0)
        assert np.allclose(lights_at(code, plan.times[-1] + 1.0), 0.0)
    assert {vehicle.waypoints[1].colour for vehicle in plan.scenario.vehicles} == {
        "#ff0000",
        "#000000",
    }


def test_the_figure_of_scenes_is_that_of_shows_only() -> None:
    assert len(rho.scenes_figure(flown(show(ring()))).axes) == 1
    gate = rho.Waypoint(2.0, [3, 1, 0], name="gate")
    racer = rho.Vehicle("racer", rho.State([0, 0, 0]), rho.State([6, 0, 0]), waypoints=[gate])
    for other in (rho.load_scenario("paper"), rho.Scenario("race", rho.Grid(0.5, 9), [racer])):
        with pytest.raises(ValueError, match="flown: got a flight without scenes"):
            rho.scenes_figure(rho.plan_convex(other))


def test_drawings_without_their_extra_name_it(monkeypatch: Patch) -> None:
    monkeypatch.setitem(sys.modules, "svgelements", None)
    with pytest.raises(rho.ScenarioError, match="expected the extra shows: pip install"):
        _ = forms.Drawing("any.svg", 5, 1.0).positions


# what is refused


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        (lambda: ring(radius=0.9), r"show.scenes\[0\].formation: got points \d and \d at 0.9 m"),
        (lambda: ring(7), r"scenes\[0\].formation: got 7 points, expected at most 6"),
        (lambda: ring(colours=("#fff",)), "colours"),
        (lambda: ring(colours=("#ffffff",) * 2), "got 2 colours, expected one, or one for each of"),
        (lambda: ring(hold=-1.0), "hold"),
    ],
)
def test_scenes_that_cannot_be_are_refused(changed: Any, expected: str) -> None:
    with pytest.raises(rho.ScenarioError, match=expected):
        show(changed())


def test_pads_that_are_too_close_and_names_twice_are_refused() -> None:
    with pytest.raises(rho.ScenarioError, match=r"show.pads: got points 1 and 2 at 0.8 m"):
        show(ring(), pads=forms.Grid(3, 2, spacing=0.8))
    with pytest.raises(rho.ScenarioError, match=r"scenes\[1\].name: got 'ring', expected"):
        show(ring(), ring())
    moving = rho.Obstacle(rho.Sphere([0, 0, 5], 1.0), velocity=[1, 0, 0])
    with pytest.raises(rho.ScenarioError, match=r"obstacles\[0\]"):
        show(ring(), obstacles=[moving])


def test_formations_among_waiting_vehicles_are_refused() -> None:
    low = rho.Scene("low", forms.Table([[-1, 0, 3], [1, 0, 3]]))
    with pytest.raises(rho.ScenarioError, match="pads above which enough vehicles can wait"):
        show(low, separation=rho.Separation(1.9))


def test_times_that_are_too_short_are_refused_with_the_least() -> None:
    shown = show(ring(transition=1.0))
    with pytest.raises(rho.ScenarioError, match=r"scenes\[0\].transition: got 1.0, expected at l"):
        flown(shown)
    shown = show(ring(), duration=7.0)
    with pytest.raises(rho.ScenarioError, match=r"duration: got 7.0, expected at least [\d.]+ s"):
        flown(shown)
    needed = flown(show(ring())).times[-1]
    assert flown(show(ring(), duration=needed)).times[-1] == needed
    with pytest.raises(rho.ScenarioError, match=rf"at least {needed:g} s, the shortest that was f"):
        flown(show(ring(), duration=needed - 0.1))


def test_places_in_obstacles_or_outside_the_geofence_are_named() -> None:
    low = dataclasses.replace(LIMITS, position=rho.Box([-9, -9, 0], [9, 9, 8]))
    narrow = dataclasses.replace(LIMITS, position=rho.Box([-1, -9, 0], [9, 9, 20]))
    above_the_fourth_pad = rho.Sphere([-2, 1, 1.5], 0.5)
    wrong: dict[str, rho.Show] = {
        r"scenes\[0\].formation: got .* expected a position within": show(ring(), limits=low),
        "pads: got .* expected a position within": show(ring(), limits=narrow),
        r"scenes\[0\].formation: got .* outside obstacle 1": show(
            ring(), obstacles=[rho.Sphere([4, 0, 9], 0.5)]
        ),
        "take_off: .* clear way up and down above every pad; drone 4: obstacle 1": show(
            ring(), obstacles=[above_the_fourth_pad]
        ),
    }
    for words, shown in wrong.items():
        with pytest.raises(rho.ScenarioError, match=words):
            flown(shown)


def test_files_that_are_missing_or_wrong_are_refused(tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text("1,2\n3,4\n")
    (tmp_path / "nan.csv").write_text("1,2,3\n3,4,nan\n")
    (tmp_path / "empty.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    (tmp_path / "bomb.svg").write_text('<!DOCTYPE x [<!ENTITY a "b">]><svg>&a;</svg>')
    wrong: dict[str, Any] = {
        "No such file": forms.Table(path=str(tmp_path / "none.csv")),
        "it has shape": forms.Table(path=str(tmp_path / "two.csv")),
        "row 2 has others": forms.Table(path=str(tmp_path / "nan.csv")),
        "with paths or shapes": forms.Drawing(str(tmp_path / "empty.svg"), 5, 1.0),
        "without entities": forms.Drawing(str(tmp_path / "bomb.svg"), 5, 1.0),
        "at least 2, one for each": forms.Letters("O", 1, 5.0),
        "at least one letter": forms.Letters(" ", 5, 5.0),
        "file of a TrueType": forms.Letters("A", 5, 5.0, font=str(tmp_path / "two.csv")),
    }
    for words, formation in wrong.items():
        with pytest.raises(rho.ScenarioError, match=words):
            _ = formation.positions
    with pytest.raises(rho.ScenarioError, match="either coordinates or a path"):
        forms.Table()


def test_a_plan_of_another_show_has_no_certificate() -> None:
    plan = flown(show(ring()))
    other = show(dataclasses.replace(ring(), name="other"))
    with pytest.raises(ValueError, match="plan: got one of 'six', expected one of the show"):
        rho.certify_show(other, plan)


# the command line


def test_the_example_is_planned_at_the_command_line(
    tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    status, printed, _ = run(capsys, monkeypatch, "storyboard", "--example")
    (tmp_path / "show.yaml").write_text(printed)
    shown = rho.load_show(tmp_path / "show.yaml")
    words = ["--solver", "daqp", "-o", str(tmp_path / "show.npz"), "--json"]
    status, printed, _ = run(capsys, monkeypatch, "storyboard", str(tmp_path / "show.yaml"), *words)
    document = json.loads(printed)
    plan = rho.load(tmp_path / "show.npz").plan
    assert (status, document["ok"], document["vehicles"]) == (0, True, len(shown.pads.positions))
    found = rho.certify_show(shown, plan)
    assert document["certificate"]["gap"] == pytest.approx(found.gap)
    assert [each["scene"] for each in document["certificate"]["transitions"]] == [
        *(scene.name for scene in shown.scenes),
        "landing",
    ]


def test_shows_describe_themselves_and_refuse_in_one_line(
    tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    status, printed, _ = run(capsys, monkeypatch, "storyboard", "--schema")
    assert (status, json.loads(printed)["title"]) == (0, "Show")
    path = tmp_path / "show.yaml"
    path.write_text("name: x\npads: {kind: hexagon}\n")
    status, _, errors = run(capsys, monkeypatch, "storyboard", str(path))
    assert status == 2
    assert "pads" in errors
    assert len(errors.splitlines()) == 1
    for words in ([], [str(tmp_path / "none.yaml")], [str(path), "--workers", "2"]):
        status, _, errors = run(capsys, monkeypatch, "storyboard", *words)
        assert (status, len(errors.splitlines())) == (2, 1)
