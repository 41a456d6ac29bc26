"""Obstacles and tracks: positions, refused input, and files that preserve them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import single
from tests.shapes import KINDS, random_shape
from tests.written import as_yaml, from_yaml, in_plan_file

seeds = st.integers(0, 2**32 - 1)
BALL = rho.Sphere([5.0, 5.0, 5.0], 1.0)
SCHEMA = jsonschema.Draft202012Validator(rho.scenario_schema())


def as_any(value: Any) -> Any:
    """Return the value with a type that lets mypy pass where it is wrong."""
    return value


def test_a_track_is_straight_between_its_times_and_at_rest_outside() -> None:
    track = rho.Track([1.0, 2.0, 4.0], [[0, 0, 0], [1, 0, 0], [1, 4, -2]])
    times = np.array([-9.0, 1.0, 1.5, 2.0, 3.0, 4.0, 99.0])
    places = [[0, 0, 0], [0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 2, -1], [1, 4, -2], [1, 4, -2]]
    np.testing.assert_array_equal(track.at(times), places)
    ways = [[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 2, -1], [0, 2, -1], [0, 0, 0], [0, 0, 0]]
    np.testing.assert_array_equal(track.velocities(times), ways)


@given(seed=seeds)
def test_the_velocity_of_a_track_is_the_derivative_of_its_position(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = np.cumsum(rng.uniform(0.1, 2.0, rng.integers(1, 6))) - 3.0
    track = rho.Track(corners, rng.normal(size=(len(corners), 3)))
    times = rng.uniform(-4.0, 10.0, 50)
    times = times[np.abs(times[:, None] - corners).min(axis=1) > 1e-3]
    slopes = (track.at(times + 1e-5) - track.at(times - 1e-5)) / 2e-5
    np.testing.assert_allclose(track.velocities(times), slopes, atol=1e-6)


def test_a_track_that_continues_keeps_its_last_velocity() -> None:
    track = rho.Track([0, 1, 3], [[0, 0, 0], [1, 0, 0], [1, 4, 0]], after="goes_on")
    times = np.array([-1.0, 2.0, 3.0, 5.0])
    np.testing.assert_allclose(track.at(times), [[0, 0, 0], [1, 2, 0], [1, 4, 0], [1, 8, 0]])
    np.testing.assert_allclose(track.velocities(times), [[0] * 3, [0, 2, 0], [0, 2, 0], [0, 2, 0]])
    with pytest.raises(rho.ScenarioError, match=r"track\.after: got 'goes_on'"):
        rho.Track([0], [[0, 0, 0]], after="goes_on")


@pytest.mark.parametrize("after", [None, "rests", "goes_on"])
def test_a_report_mentions_a_track_that_ends_in_motion(after: Any) -> None:
    track = rho.Track([0, 3], [[5, -9, 0], [5, -3, 0]], after=after)
    ball = rho.Obstacle(rho.Sphere([0, 0, 0], 1.0), track=track, name="bird")
    asked = single(obstacles=[ball], between_knots=True)
    report = rho.verify(rho.plan(asked))
    reported = [
        note for note in report.notes if "obstacle 1 (bird) is assumed to be at rest" in note
    ]
    assert len(reported) == (after is None)
    assert all("from 3 s on" in note and "at 8 s" in note for note in reported)
    assert ("assumed to be at rest" in str(report)) == (after is None)
    if after == "goes_on":
        times = np.linspace(0.0, 8.0, 2001)
        p = rho.plan(asked).motion().at("position", times)[0]
        bird = np.stack([np.full(2001, 5.0), -9.0 + 2.0 * times, np.zeros(2001)], axis=-1)
        assert np.linalg.norm(p - bird, axis=1).min() > 1.0 - 1e-6
    assert from_yaml(as_yaml(asked)) == asked


def test_a_track_of_one_time_is_a_position() -> None:
    track = rho.Track([3.0], [[1, 2, 3]])
    times = np.array([0.0, 3.0, 9.0])
    np.testing.assert_array_equal(track.at(times), [[1, 2, 3]] * 3)
    np.testing.assert_array_equal(track.velocities(times), np.zeros((3, 3)))
    assert not rho.Obstacle(BALL, track=track).moves
    assert rho.Track.sampled(lambda time: [time, 0, 0], [3.0]).deviation == 0.0


def smooth(seed: int) -> tuple[Callable[[float], FloatArray], float]:
    """Return a random sum of oscillations, and a bound of the norm of its acceleration."""
    rng = np.random.default_rng(seed)
    amplitudes = rng.normal(size=(4, 3)) * 10 ** rng.uniform(-1, 1)
    rates, phases = rng.uniform(0.1, 4.0, 4), rng.uniform(0.0, 2 * np.pi, (4, 3))

    def function(time: float) -> FloatArray:
        position: FloatArray = np.sum(amplitudes * np.sin(rates[:, None] * time + phases), axis=0)
        return position

    most = np.sum(rates**2 * np.linalg.norm(amplitudes, axis=1))
    return function, float(most)


@given(seed=seeds)
def test_a_function_is_within_the_deviation_of_its_track(seed: int) -> None:
    """Between first and last sample it is, with a bound on its acceleration always, else nearly."""
    function, most = smooth(seed)
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(0.05, 0.8, 12))
    bounded = rho.Track.sampled(function, at, max_acceleration=most)
    estimated = rho.Track.sampled(function, at)
    assert bounded.deviation == pytest.approx(most * np.diff(at).max() ** 2 / 8.0)
    assert (bounded.deviation_is_estimated, estimated.deviation_is_estimated) == (False, True)
    times = np.linspace(at[0], at[-1], 4001)
    true = np.array([function(time) for time in times])
    for track in (bounded, estimated):
        np.testing.assert_allclose(track.at(at), [function(time) for time in at], atol=1e-12)
    apart = np.linalg.norm(true - bounded.at(times), axis=1).max()
    assert apart <= bounded.deviation
    assert 0.8 * apart <= estimated.deviation <= bounded.deviation


def test_the_bound_of_a_deviation_is_attained_by_constant_acceleration() -> None:
    track = rho.Track.sampled(lambda time: [2.0 * time**2, 0, 0], np.arange(5.0), 4.0)
    assert track.deviation == 0.5
    middle = np.array([1.5])
    assert abs(track.at(middle)[0, 0] - 2.0 * 1.5**2) == 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_the_position_of_an_obstacle_follows_its_motion(kind: str) -> None:
    rng = np.random.default_rng(7)
    shape = random_shape(rng, kind, np.array([1.0, 2.0, 3.0]), 1.0)
    times = np.array([-2.0, 0.0, 5.0])
    rest = rho.Obstacle(shape)
    assert (rest.moves, rest.deviation, len(rest.corners)) == (False, 0.0, 0)
    np.testing.assert_array_equal(rest.centers(times), [shape.center] * 3)
    np.testing.assert_array_equal(rest.velocities(times), np.zeros((3, 3)))
    flying = rho.Obstacle(shape, velocity=[1, 0, -1])
    assert flying.moves
    np.testing.assert_allclose(flying.centers(times)[1], shape.center)
    np.testing.assert_allclose(flying.centers(times)[2], shape.center + np.array([5, 0, -5]))
    np.testing.assert_array_equal(flying.velocities(times), [[1, 0, -1]] * 3)
    track = rho.Track([0.0, 5.0], [[0, 0, 0], [10, 0, 0]], deviation=0.2)
    led = rho.Obstacle(shape, track=track)
    assert (led.moves, led.deviation) == (True, 0.2)
    np.testing.assert_array_equal(led.centers(times), track.at(times))
    np.testing.assert_array_equal(led.corners, [0.0, 5.0])
    assert not rho.Obstacle(shape, velocity=[0, 0, 0]).moves


@pytest.mark.parametrize(
    ("make", "field", "words"),
    [
        (lambda: rho.Track([], np.zeros((0, 3))), "track.times", "at least one time"),
        (lambda: rho.Track([1, 1], [[0, 0, 0]] * 2), "track.times", "after the one before"),
        (lambda: rho.Track([2, 1], [[0, 0, 0]] * 2), "track.times", "after the one before"),
        (lambda: rho.Track([1, np.nan], [[0, 0, 0]] * 2), "track.times", "finite numbers"),
        (lambda: rho.Track([1, 2], [[0, 0, 0]]), "track.positions", "each of the 2 times, not 1"),
        (lambda: rho.Track([1], [[0, 0]]), "track.positions[0]", "three finite numbers"),
        (lambda: rho.Track([1], [[0, 0, 0]], -0.1), "track.deviation", "greater than or equal"),
        (lambda: rho.Track([1], [[0, 0, 0]], as_any(True)), "track.deviation", "a number"),
        (lambda: rho.Track.sampled(lambda _: [0, 0], [0, 1]), "track.positions[0]", "three"),
        (lambda: rho.Track.sampled(lambda _: [0, 0, 0], [1, 0]), "track.times", "after the one"),
        (lambda: rho.Track.sampled(lambda _: [0, 0, 0], as_any("x")), "track.times", "a list of"),
        (
            lambda: rho.Track.sampled(lambda t: [t, 0, np.nan if t == 0.5 else 0], [0, 1]),
            "track.positions[3]",
            "three finite numbers",
        ),
        (
            lambda: rho.Track.sampled(lambda _: [0, 0, 0], [0, 1], max_acceleration=-1.0),
            "track.max_acceleration",
            "at least 0",
        ),
        (
            lambda: rho.Track.sampled(lambda _: [0, 0, 0], [0, 1], max_acceleration=np.nan),
            "track.max_acceleration",
            "at least 0",
        ),
        (lambda: rho.Obstacle(rho.Box([0, 0, 0], [1, 1, 0])), "obstacle.shape", "no interior"),
        (lambda: rho.Obstacle(rho.Ellipsoid([0, 0, 0], [1, 1, 1e-5])), "obstacle.shape", "flat"),
        (lambda: rho.Obstacle(rho.Cylinder([0, 0, 0], 1.0, 1e-5)), "obstacle.shape", "flat"),
        (lambda: rho.Obstacle(rho.Cylinder([0, 0, 0], 1e-5, 1.0)), "obstacle.shape", "flat"),
        (lambda: rho.Obstacle(as_any(5)), "obstacle.shape", "Sphere(center=..., radius=...)"),
        (lambda: rho.Obstacle(BALL, velocity=[1, 0]), "obstacle.velocity", "three"),
        (
            lambda: rho.Obstacle(BALL, track=as_any([0, 1])),
            "obstacle.track",
            "Track(times=..., positions=...)",
        ),
        (
            lambda: rho.Obstacle(BALL, velocity=[1, 0, 0], track=rho.Track([0], [[0, 0, 0]])),
            "obstacle.velocity",
            "no velocity beside a track",
        ),
        (lambda: rho.Obstacle(BALL, known_from=np.inf), "obstacle.known_from", "finite"),
        (lambda: rho.Obstacle(BALL, known_from=as_any(True)), "obstacle.known_from", "a number"),
        (lambda: rho.Obstacle(BALL, name=""), "obstacle.name", "at least 1 character"),
        (lambda: rho.Cylinder([0, 0, 0], 1.0, 0.0), "cylinder.height", "greater than 0"),
        (lambda: rho.Cylinder([0, 0, 0], -1.0), "cylinder.radius", "greater than 0"),
        (lambda: rho.Cylinder([0, 0, 0], 1.0, axis=as_any("w")), "cylinder.axis", "'x', 'y' or"),
        (lambda: rho.Ellipsoid([0, 0, 0], [1, 0, 1]), "ellipsoid.semi_axes", "above 0"),
        (lambda: rho.Polytope([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), "polytope.vertices", "four"),
        (lambda: rho.Polytope([[0, 0, 0]] * 5), "polytope.vertices", "no interior"),
        (
            lambda: rho.Polytope([[0, 0, 0], [1, 0, 1], [0, 1, 1], [1, 1, 2]]),
            "polytope.vertices",
            "lie in a plane",
        ),
        (lambda: rho.Polytope([[0, 0, 0], [1, 0]]), "polytope.vertices[1]", "three"),
        (lambda: rho.Grid(1.0, 5, np.inf), "grid.start", "finite"),
        (lambda: rho.Grid(1.0, 5, 1e13), "grid.start", "less than or equal"),
        (lambda: rho.Grid(1.0, 5, as_any(True)), "grid.start", "a number"),
        *[
            (
                lambda radius=radius: rho.Vehicle(
                    "a", rho.State([0, 0, 0]), rho.State([1, 0, 0]), radius=as_any(radius)
                ),
                "vehicle.radius",
                words,
            )
            for radius, words in (
                (-0.1, "greater than or equal to 0"),
                (np.nan, "finite"),
                (1e7, "less than or equal to 1000000"),
                (True, "a number"),
            )
        ],
        *[
            (lambda obstacle=obstacle: single(obstacles=(BALL, obstacle)), field, words)
            for obstacle, field, words in (
                (rho.Box([5, 5, 5], [6, 6, 5]), "scenario.obstacles[1]", "no interior"),
                (rho.Cylinder([5, 5, 5], 1.0, 1e-5), "scenario.obstacles[1]", "no interior"),
                (rho.Obstacle(BALL, known_from=8.1), "scenario.obstacles[1].known_from", "8 s"),
            )
        ],
    ],
)
def test_bad_input_names_field_value_and_expectation(
    make: Callable[[], object], field: str, words: str
) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        make()
    assert caught.value.field == field
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def ends(obstacle: rho.Obstacle, radius: float = 0.0) -> rho.Scenario:
    """Return a flight from the origin at 2 s to [10, 0, 0] at 4 s, with an obstacle."""
    vehicle = rho.Vehicle("a", rho.State([0, 0, 0]), rho.State([10, 0, 0]), radius=radius)
    return rho.Scenario("ends", rho.Grid(0.5, 5, 2.0), (vehicle,), obstacles=(obstacle,))


@pytest.mark.parametrize("known_from", [0.0, 3.0, 4.0])
def test_starts_and_goals_are_outside_the_obstacles_of_their_times(known_from: float) -> None:
    """At 2 s a start has to be clear and at 4 s a goal, whenever the obstacle is known."""
    ball = rho.Sphere([-2.0, 0.0, 0.0], 0.5)  # at time 0, clear of both
    through = rho.Obstacle(ball, velocity=[1, 0, 0], known_from=known_from)
    with pytest.raises(rho.ScenarioError, match=r"0\.5 m in it at 2 s") as caught:
        ends(through)
    assert caught.value.field == "scenario.vehicles[0].start.position"
    ends(
        dataclasses.replace(through, velocity=np.array([2.0, 0, 0]))
    )  # it has passed the start, and continues
    there = rho.Obstacle(ball, velocity=[3, 0, 0], known_from=known_from)
    with pytest.raises(rho.ScenarioError, match=r"outside obstacle 1, not 0\.5 m in it at 4 s"):
        ends(there)
    track = rho.Track([2.0, 3.0, 4.0], [[0.0, 9.0, 0.0], [5.0, 0.0, 0.0], [10.0, 0.7, 0.0]])
    late = rho.Obstacle(ball, track=track, known_from=known_from, name="late")
    assert ends(late, radius=0.2).bodies == (late,)
    with pytest.raises(rho.ScenarioError, match=r"at least 0\.25 m from obstacle 1 \(late\)"):
        ends(late, radius=0.25)
    loose = dataclasses.replace(late, track=dataclasses.replace(track, deviation=0.1))
    with pytest.raises(rho.ScenarioError, match=r"at least 0\.3 m from .*, not 0\.2 m from it"):
        ends(loose, radius=0.2)


def test_an_obstacle_is_known_from_its_time_on() -> None:
    obstacles = (
        BALL,
        rho.Obstacle(BALL, known_from=2.5),
        rho.Obstacle(BALL, known_from=-1.0, name="old"),
        rho.Obstacle(BALL),
    )
    for start, numbers in ((0.0, [1, 3, 4]), (2.5, [1, 2, 3, 4]), (-9.0, [1, 3, 4])):
        asked = single(grid=rho.Grid(0.5, 41, start), obstacles=obstacles)
        assert [number for number, _ in asked.known] == numbers
    assert [asked.obstacle_name(number) for number in (1, 3)] == ["obstacle 1", "obstacle 3 (old)"]
    later = asked.grid.from_knot(23)  # at 2.5 s
    assert later.start == 2.5
    assert len(dataclasses.replace(asked, grid=later).known) == 4
    assert asked.spheres == (BALL, BALL, BALL)


def random_obstacle(rng: np.random.Generator) -> rho.Obstacle | Any:
    """Return any shape, moving or not, with numbers of full precision."""
    shape = random_shape(rng, str(rng.choice(list(KINDS))), rng.normal(size=3), 1.0)
    times = np.cumsum(rng.uniform(0.1, 1.0, 3))
    track = rho.Track(times, rng.normal(size=(3, 3)), rng.uniform(), bool(rng.integers(2)))
    match rng.integers(4):
        case 0:
            return shape
        case 1:
            return rho.Obstacle(shape, velocity=rng.normal(size=3), name="it")
        case 2:
            return rho.Obstacle(shape, track=track, known_from=float(rng.uniform()))
    return rho.Obstacle(shape)


@given(seed=seeds)
def test_files_preserve_every_number_and_match_the_schema(seed: int) -> None:
    rng = np.random.default_rng(seed)
    obstacles = [random_obstacle(rng) for _ in range(4)]
    vehicle = rho.Vehicle(
        "a", rho.State([99, 98, 97]), rho.State([-99, 98, -97]), radius=float(rng.uniform())
    )
    start = max(float(rng.normal()) + 1.0, -1.5)  # so that obstacles are known before the end
    grid = rho.Grid(0.7, 5, start)
    scenario = rho.Scenario("s", grid, (vehicle,), obstacles=obstacles)
    assert from_yaml(as_yaml(scenario)) == scenario
    text, read = in_plan_file(scenario)
    assert read == scenario
    SCHEMA.validate(json.loads(text))


def asked(obstacle: str = "{center: [5, 5, 5], radius: 1}", vehicle: str = "radius: 0.1") -> str:
    """Return a scenario file."""
    return f"""
name: s
grid: {{step: 0.5, knots: 5, start: 2}}
vehicles:
- {{name: a, {vehicle}, start: {{position: [0, 0, 0]}}, goal: {{position: [10, 0, 0]}}}}
obstacles:
- {obstacle}
"""


@pytest.mark.parametrize(
    ("obstacle", "shape"),
    [
        ("{center: [7, 1, 1.5], radius: 1}", rho.Sphere([7, 1, 1.5], 1.0)),
        ("{lower: [2, -1, 1], upper: [3, 1, 2.5]}", rho.Box([2, -1, 1], [3, 1, 2.5])),
        ("{center: [5, 0, 1], radius: 0.4, height: 2}", rho.Cylinder([5, 0, 1], 0.4, 2.0)),
        ("{center: [9, 0, 0], radius: 0.4, axis: z}", rho.Cylinder([9, 0, 0], 0.4)),
        ("{center: [9, 2, 9], radius: 0.4, axis: x}", rho.Cylinder([9, 2, 9], 0.4, axis="x")),
        ("{center: [5, 3, 1], semi_axes: [1, 1, 0.4]}", rho.Ellipsoid([5, 3, 1], [1, 1, 0.4])),
        (
            "{vertices: [[5, 5, 5], [6, 5, 5], [5, 6, 5], [5, 5, 6]]}",
            rho.Polytope([[5, 5, 5], [6, 5, 5], [5, 6, 5], [5, 5, 6]]),
        ),
    ],
)
def test_keys_identify_the_shape(obstacle: str, shape: Any) -> None:
    assert from_yaml(asked(obstacle)).obstacles == (shape,)
    late = f"{{shape: {obstacle}, known_from: 3, name: it}}"
    (found,) = from_yaml(asked(late)).obstacles
    assert found == rho.Obstacle(shape, known_from=3.0, name="it")


@pytest.mark.parametrize(
    ("obstacle", "field", "words"),
    [
        ("{center: [5, 5, 5], raduis: 1}", ".raduis", "did you mean radius?"),
        ("{centre: [5, 5, 5], radius: 1}", ".centre", "did you mean center?"),
        ("{center: [5, 5, 5], radius: 1, hieght: 2}", ".hieght", "did you mean height?"),
        ("{center: [5, 5, 5], semi_axis: [1, 1, 1]}", ".semi_axis", "did you mean semi_axes?"),
        ("{lower: [5, 5, 5], uper: [6, 6, 6]}", ".uper", "did you mean upper?"),
        ("{vertexes: [[5, 5, 5]]}", ".vertexes", "did you mean vertices?"),
        ("{shape: {center: [5, 5, 5], raduis: 1}}", ".shape.raduis", "did you mean radius?"),
        ("{shape: {center: [5, 5, 5], radius: 1}, velocty: [1, 0, 0]}", ".velocty", "velocity?"),
        ("{shape: {center: [5, 5, 5], radius: 1}, known: 3}", ".known", "mean known_from?"),
        (
            "{shape: {center: [5, 5, 5], radius: 1}, track: {time: [0], positions: [[5, 5, 5]]}}",
            ".track.time",
            "did you mean times?",
        ),
        ("{center: [5, 5, 5], radius: 1, name: x}", "", "a mapping of its own, shape, beside name"),
        ("{center: [5, 5, 5], radius: 1, velocity: [1, 0, 0]}", "", "beside velocity"),
        ("{colour: red}", ".colour", "no field of this name"),
        ("5", "", "a mapping"),
        ("{shape: {lower: [5, 5, 5], upper: [6, 6, 5]}}", ".shape", "no interior"),
        ("{lower: [5, 5, 5], upper: [6, 6, 5]}", "", "no interior"),
    ],
)
def test_the_error_of_a_mistyped_obstacle_suggests_the_key(
    obstacle: str, field: str, words: str
) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        from_yaml(asked(obstacle))
    assert caught.value.field == "obstacles[0]" + field
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "field", "meant"),
    [
        ("radius: 0.1", "raduis: 0.1", "vehicles[0].raduis", "radius"),
        ("start: 2", "strat: 2", "grid.strat", "start"),
        ("position: [0, 0, 0]", "positon: [0, 0, 0]", "vehicles[0].start.positon", "position"),
        ("obstacles:", "obstacle:", "obstacle", "obstacles"),
    ],
)
def test_the_error_of_a_mistyped_key_at_any_level_suggests_the_key(
    old: str, new: str, field: str, meant: str
) -> None:
    with pytest.raises(rho.ScenarioError, match=rf"did you mean {meant}\?") as caught:
        from_yaml(asked().replace(old, new))
    assert caught.value.field == field


def test_the_schema_has_bounds_and_distinguishes_shapes() -> None:
    schema = rho.scenario_schema()
    content = json.loads(in_plan_file(from_yaml(asked()))[0])
    jsonschema.validate(content, schema)
    bad: list[tuple[str, Any]] = [
        ("obstacles", [{"center": [0, 0, 0], "radius": -1.0}]),
        ("obstacles", [{"center": [0, 0, 0], "radius": 1.0, "colour": "red"}]),
        ("obstacles", [{"shape": {"center": [0, 0, 0], "radius": 1.0}, "known": 3.0}]),
        ("grid", {"step": 1.0, "knots": 1}),
        ("grid", {"step": 1.0, "knots": 5, "start": 1e13}),
        ("separation", {"distance": 1.0, "downwash": 0.0}),
    ]
    for key, value in bad:
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**content, key: value}, schema)
    described = json.dumps(schema)
    for bound in ("ge", "le", "gt", "lt"):  # pydantic's names, which no editor knows
        assert f'"{bound}":' not in described
