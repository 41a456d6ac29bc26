"""Random worlds: documented distributions, reproducible, with free starts and goals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.scenarios import box
from tests.tolerances import ROUNDING


def swap(boxes: int, seed: int = 0, **options: float) -> rho.Scenario:
    """Return a trefoil swap of a seed."""
    return rho.trefoil_swap(boxes, np.random.default_rng(seed), **options)  # type: ignore[arg-type]


def field(obstacles: int, seed: int = 0, **options: float) -> rho.Scenario:
    """Return a random field of a seed."""
    rng = np.random.default_rng(seed)
    return rho.random_field(obstacles, rng, **options)  # type: ignore[arg-type]


def tracks(scenario: rho.Scenario) -> list[rho.Track]:
    """Return the tracks of the obstacles, all of which have one."""
    return [obstacle.track for obstacle in scenario.bodies if obstacle.track is not None]


def knot(middle: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return points of a trefoil around `middle` [m], shape (M, 3), at parameters t, shape (M,)."""
    x, y, z = middle
    return np.stack(
        [x + np.sin(t) + 2 * np.sin(2 * t), y + np.cos(t) - 2 * np.cos(2 * t), z - np.sin(3 * t)],
        axis=1,
    )


def drawn(seed: int) -> tuple[np.ndarray, float]:
    """Return the centre [m] and phase of a seed's first box, if it is not drawn again."""
    x, y, phase = np.random.default_rng(seed).uniform(size=3)
    return np.array([11 * x - 5.5, 11 * y - 5.5, 1.0]), 4 * np.pi * phase - 2 * np.pi


def test_the_swap_is_that_of_the_benchmark() -> None:
    scenario = swap(20)
    assert scenario.grid == rho.Grid(0.1, 51)
    assert scenario.separation == rho.Separation(0.25)
    room = scenario.limits.position
    assert room is not None
    assert scenario.limits == rho.Limits(room, box(10.0), box(20.0), box(30.0))
    assert [vehicle.radius for vehicle in scenario.vehicles] == [0.125] * 10
    starts, goals = scenario.fleet.start_positions, scenario.fleet.goal_positions
    np.testing.assert_allclose(np.hypot(*starts[:, :2].T), 10.0, rtol=ROUNDING)
    np.testing.assert_allclose(starts + goals, np.tile([0.0, 0.0, 2.0], (10, 1)), atol=1e-12)
    assert np.all((room.lower + 1.0 <= starts) & (starts <= room.upper - 4.0))
    assert len(tracks(scenario)) == 20
    for obstacle in scenario.bodies:
        np.testing.assert_allclose(obstacle.shape.extent, 0.25, rtol=ROUNDING)


@pytest.mark.parametrize("seed", range(8))
def test_a_box_stays_within_the_deviation_of_its_track_on_a_trefoil(seed: int) -> None:
    track = tracks(swap(1, seed, step=0.5))[0]
    middle, phase = drawn(seed)
    np.testing.assert_allclose(track.positions, knot(middle, track.times / 5.2 + phase), atol=1e-12)
    times = np.linspace(0.0, 5.0, 2001)
    away = np.linalg.norm(knot(middle, times / 5.2 + phase) - track.at(times), axis=1)
    assert away.max() <= track.deviation
    assert not track.deviation_is_estimated


def test_the_deviation_is_no_larger_than_the_sharpest_turn_requires() -> None:
    t, h = np.linspace(0.0, 2.0 * np.pi, 200_001), 1e-3
    bend = (knot(np.zeros(3), t + h) - 2 * knot(np.zeros(3), t) + knot(np.zeros(3), t - h)) / h**2
    sharpest = np.linalg.norm(bend, axis=1).max() / 5.2**2
    assert tracks(swap(1, step=0.5))[0].deviation == pytest.approx(sharpest * 0.5**2 / 8, rel=1e-5)


def test_centres_and_phases_are_uniform() -> None:
    """With few vehicles, few boxes are drawn again; centres are means over a whole turn."""
    scenario = swap(400, vehicles=1, duration=5.2 * 2 * np.pi, step=5.2 * 2 * np.pi / 12)
    middles = np.array([track.positions[:-1].mean(axis=0) for track in tracks(scenario)])
    assert np.all(np.abs(middles[:, :2]) <= 5.5)
    np.testing.assert_allclose(middles[:, 2], 1.0, atol=1e-12)
    np.testing.assert_allclose(middles[:, :2].mean(axis=0), 0.0, atol=5 * 5.5 / np.sqrt(3 * 400))
    np.testing.assert_allclose(middles[:, :2].var(axis=0), 5.5**2 / 3, rtol=0.25)
    first = np.array([track.positions[0] for track in tracks(scenario)]) - middles
    assert abs(first[:, 2].mean()) < 5 * np.sqrt(0.5 / 400)  # mean of - sin 3 φ, φ uniform


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), boxes=st.integers(0, 60))
def test_starts_and_goals_of_a_swap_are_free(seed: int, boxes: int) -> None:
    scenario = swap(boxes, seed)  # a scenario with blocked ends is refused; deviations count
    ends = ((scenario.fleet.start_positions, 0), (scenario.fleet.goal_positions, -1))
    for track in tracks(scenario):
        for positions, at in ends:
            beyond = np.abs(positions - track.positions[at]) - 0.25
            distances = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
            assert np.all(distances >= 0.125 + track.deviation - 1e-12)


@pytest.mark.parametrize(("seed", "taken"), [(363, True), (1067, True), (0, False), (1, False)])
def test_a_box_that_blocks_an_end_is_drawn_again(seed: int, taken: bool) -> None:
    """Two of the few seeds whose first draw blocks an end, and two others."""
    scenario = swap(1, seed, vehicles=80)
    middle, phase = drawn(seed)
    first, last = knot(middle, np.array([phase, 5.0 / 5.2 + phase]))
    beyond = np.stack(
        [
            np.abs(scenario.fleet.start_positions - first) - 0.25,
            np.abs(scenario.fleet.goal_positions - last) - 0.25,
        ]
    )
    assert (np.linalg.norm(np.maximum(beyond, 0.0), axis=2).min() < 0.125) == taken
    assert np.allclose(tracks(scenario)[0].positions[0], first) != taken


def test_a_field_is_that_of_the_benchmark() -> None:
    scenario = field(40)
    room = rho.Box([0.0, 0.0, 0.0], [10.0, 10.0, 5.0])
    assert scenario.limits == rho.Limits(position=room, velocity=box(3.0), acceleration=box(3.0))
    assert scenario.separation is None
    (vehicle,) = scenario.vehicles
    assert vehicle.radius == 0.15
    assert (vehicle.start.position[0], vehicle.goal.position[0]) == (0.0, 10.0)
    # 10 m at 3 m/s, and one second more to reach that speed and to stop
    assert scenario.grid.duration == pytest.approx(2.0 * (10.0 / 3.0 + 1.0))
    assert 0.19 < scenario.grid.step <= 0.2
    assert len(scenario.obstacles) == 40


def test_the_time_of_a_field_is_twice_the_least() -> None:
    """The flight is bang-bang below the speed limit: full acceleration for half of the distance."""
    scenario = field(0, max_velocity=100.0, max_acceleration=0.4)
    assert scenario.grid.duration == pytest.approx(2.0 * 2.0 * np.sqrt(10.0 / 0.4))
    twice = rho.random_field(0, np.random.default_rng(0), room=rho.Box([0, 0, 0], [2, 30, 1]))
    across = np.max(np.abs(twice.vehicles[0].goal.position - twice.vehicles[0].start.position))
    assert across > 3.0
    assert twice.grid.duration == pytest.approx(2.0 * (across / 3.0 + 1.0))


def test_positions_and_sizes_of_obstacles_of_a_field_are_uniform() -> None:
    shapes = field(2000).obstacles
    spheres = [each for each in shapes if isinstance(each, rho.Sphere)]
    boxes = [each for each in shapes if isinstance(each, rho.Box)]
    assert len(spheres) == len(boxes) == 1000
    radii = np.array([each.radius for each in spheres])
    sides = np.array([each.upper - each.lower for each in boxes])
    for values, least, most in ((radii, 0.4, 1.2), (sides, 0.4, 2.0)):
        assert np.all((least - 1e-12 <= values) & (values <= most + 1e-12))
        # obstacles at an end are drawn again: large ones a little more often
        np.testing.assert_allclose(values.mean(axis=0), (least + most) / 2, rtol=0.05)
        np.testing.assert_allclose(values.var(axis=0), (most - least) ** 2 / 12, rtol=0.15)
    middles = np.array([each.center for each in (*spheres, *boxes)])
    assert np.all((middles >= 0.0) & (middles <= [10.0, 10.0, 5.0]))
    np.testing.assert_allclose(middles.mean(axis=0), [5.0, 5.0, 2.5], rtol=0.05)
    np.testing.assert_allclose(middles.var(axis=0), np.square([10, 10, 5]) / 12, rtol=0.1)


@settings(max_examples=16)
@given(seed=st.integers(0, 2**32 - 1), obstacles=st.integers(0, 80))
def test_start_and_goal_of_a_field_are_free(seed: int, obstacles: int) -> None:
    scenario = field(obstacles, seed, radius=0.3)
    (vehicle,) = scenario.vehicles
    for position in (vehicle.start.position, vehicle.goal.position):
        for shape in scenario.obstacles:
            assert isinstance(shape, rho.Sphere | rho.Box)
            if isinstance(shape, rho.Sphere):
                distance = np.linalg.norm(position - shape.center) - shape.radius
            else:
                inside = np.clip(position, shape.lower, shape.upper)
                distance = np.linalg.norm(position - inside)
            assert distance >= 0.3 - 1e-12


@pytest.mark.parametrize("make", [swap, field])
def test_the_same_seed_draws_the_same_and_more_obstacles_extend_it(
    make: Callable[..., rho.Scenario],
) -> None:
    assert make(12, 3) == make(12, 3) != make(12, 4)
    assert make(20, 3).obstacles[:12] == make(12, 3).obstacles
    generator = rho.trefoil_swap if make is swap else rho.random_field
    rng = np.random.default_rng(3)
    first, second = generator(12, rng), generator(12, rng)
    assert first == make(12, 3) != second


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: swap(-1), "boxes"),
        (lambda: swap(2.5), "boxes"),  # type: ignore[arg-type]  # what is tested
        (lambda: swap(1, vehicles=0), "vehicles"),
        (lambda: swap(1, step=0.3), "step"),
        (lambda: swap(1, vehicles=300), "scenario.vehicles"),
        (lambda: field(-1), "obstacles"),
        (lambda: field(1, max_velocity=0.0), "max_velocity"),
        (lambda: field(1, max_acceleration=float("nan")), "max_acceleration"),
        (lambda: field(1, max_step=-1.0), "max_step"),
        (lambda: field(1, radius=-1.0), "vehicle.radius"),
        (lambda: field(1, radius=20.0), "obstacles"),
    ],
)
def test_invalid_arguments_are_refused(make: Callable[[], object], name: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        make()
    assert caught.value.field.startswith(name)
    assert "\n" not in str(caught.value)
