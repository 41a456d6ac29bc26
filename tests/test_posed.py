"""Shapes in other poses: the same distances as before they were posed, in files and in plans."""

from __future__ import annotations

from itertools import product
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw

import drake_rho as rho
from drake_rho.display.common.obstacle_snapshots import truncated
from drake_rho.display.common.shape_faces import surface
from tests.arrays import FloatArray
from tests.shapes import KINDS, random_shape
from tests.written import as_yaml, from_yaml, in_plan_file

seeds = st.integers(0, 2**32 - 1)
SCHEMA = jsonschema.Draft202012Validator(rho.scenario_schema())
YAML = """name: yard
grid: {step: 0.5, knots: 21}
vehicles: [{name: u, radius: 0.1, start: {position: [0, 0, 1]}, goal: {position: [10, 0, 1]}}]
obstacles:
  - %s
"""


def read(obstacle: str) -> rho.Scenario:
    return from_yaml(YAML % obstacle)


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds)
@settings(max_examples=15)
def test_distances_are_those_of_the_shape_seen_from_its_own_axes(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = random_shape(rng, kind, rng.normal(size=3), 1.0)
    angles, shift = rng.uniform(-3.0, 3.0, 3), rng.normal(size=3)
    posed = rho.Posed(shape, angles, shift)
    turn = RollPitchYaw(angles).ToRotationMatrix().matrix()
    x = 2.0 * rng.normal(size=(100, 3))
    there = x @ turn.T + shift
    expected = shape.signed_distance(x)
    np.testing.assert_allclose(posed.signed_distance(there), expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(posed.outward(there), shape.outward(x) @ turn.T, atol=1e-9)
    n = shape.outward(x)
    np.testing.assert_allclose(
        posed.support(n @ turn.T), shape.support(n) + (n @ turn.T) @ shift, atol=1e-10
    )
    assert (posed.thickness, posed.has_corners) == (shape.thickness, shape.has_corners)


@given(seed=seeds)
def test_the_bounding_box_is_exact_also_where_its_centre_does_not_turn_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(8, 3))
    posed = rho.Posed(rho.Polytope(corners), rng.uniform(-3.0, 3.0, 3), rng.normal(size=3))
    moved = corners @ posed.rotation.T + posed.translation
    twin = rho.Polytope(moved)
    np.testing.assert_allclose(posed.center, twin.center, atol=1e-12)
    np.testing.assert_allclose(posed.extent, twin.extent, atol=1e-12)
    x = 2.0 * rng.normal(size=(50, 3))
    np.testing.assert_allclose(posed.local_distance(x), twin.local_distance(x), atol=1e-9)


def test_an_endless_cylinder_stays_endless_and_its_centre_finite() -> None:
    pole = rho.Cylinder([1, 0, 5], 0.5)
    lying = rho.Posed(pole, [np.pi / 2, 0, 0])
    np.testing.assert_allclose(lying.extent, [0.5, np.inf, 0.5])
    np.testing.assert_allclose(lying.center, [1, -5, 0], atol=1e-12)
    leaning = rho.Posed(pole, [0.3, 0.4, 0.0], [0, 0, 2])
    assert np.isinf(leaning.extent).all()
    assert np.isfinite(leaning.center).all()
    assert (leaning.size, leaning.thickness) == (0.5, 0.5)
    lower, upper = np.full(3, -4.0), np.full(3, 6.0)
    cut, center = truncated(leaning, leaning.center, lower, upper)
    assert np.isfinite(cut.extent).all()
    assert leaning.signed_distance(center) == pytest.approx(-0.5)
    assert np.linalg.norm(center - 1.0) < np.linalg.norm(leaning.center - 1.0)


def test_only_a_ball_stays_a_quadric() -> None:
    ball = rho.Posed(rho.Sphere([1, 0, 0], 0.5), [0, 0, np.pi / 2]).quadric_inside(0.2)
    assert isinstance(ball, rho.Sphere)
    np.testing.assert_allclose([*ball.center, ball.radius], [0, 1, 0, 0.7], atol=1e-15)
    assert rho.Posed(rho.Ellipsoid([0, 0, 0], [1, 2, 3]), [0, 0, 1]).quadric_inside(0.0) is None


@pytest.mark.parametrize("kind", [each for each in KINDS if each != "endless cylinder"])
def test_drawn_faces_are_on_the_surface_and_look_outwards(kind: str) -> None:
    rng = np.random.default_rng(3)
    for posed in (False, True):
        shape = random_shape(rng, kind, rng.normal(size=3), 1.0)
        if posed:
            shape = rho.Posed(shape, [0.3, 0.2, 1.0], [1, 2, 3])
        drawn = surface(shape)
        corners = np.concatenate(drawn.faces + drawn.edges)
        np.testing.assert_allclose(shape.local_distance(corners), 0.0, atol=1e-6)
        middle = np.mean([face.mean(axis=0) for face in drawn.faces], axis=0)
        for face in drawn.faces:
            normal = np.cross(face[2] - face[0], face[3 % len(face)] - face[1])
            assert normal @ (face.mean(axis=0) - middle) > -1e-9


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("{shape: {lower: [4, 3, 0], upper: [5, 4, 2]}, rotation: [0, 0, 0.5]}", rho.Posed),
        ("{shape: {center: [5, 4, 0], radius: 1}, translation: [0, 1, 0]}", rho.Posed),
        ("{shape: {shape: {lower: [4, 3, 0], upper: [5, 4, 2]}, rotation: [0, 0, 0.1]},"
         " translation: [0, 1, 0]}", rho.Posed),
        ("{shape: {shape: {lower: [4, 3, 0], upper: [5, 4, 2]}, rotation: [0, 0, 0.1]},"
         " velocity: [0, 1, 0]}", rho.Obstacle),
        ("{shape: {shape: {lower: [4, 3, 0], upper: [5, 4, 2]}, rotation: [0, 0, 0.1]}}",
         rho.Obstacle),
        ("{shape: {start: [4, 3, 0], end: [5, 4, 2], radius: 0.5}, name: branch}", rho.Obstacle),
        ("{start: [4, 3, 0], end: [5, 4, 2], radius: 0.5}", rho.Capsule),
        ("{occupied: [[4, 3, 0]], resolution: 0.5}", rho.Voxels),
    ],
)  # fmt: skip
def test_keys_tell_a_posed_shape_from_an_obstacle(text: str, kind: type) -> None:
    scenario = read(text)
    assert type(scenario.obstacles[0]) is kind
    assert from_yaml(as_yaml(scenario)) == scenario
    assert in_plan_file(scenario)[1] == scenario
    SCHEMA.validate(yaml.safe_load(as_yaml(scenario)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{semi_axes: [1, 2, 3], center: [5, 5, 5], rotation: [0, 0, 1]}",
         r"obstacles\[0\]: .* expected the shape in a mapping of its own, shape, beside rotation"),
        ("{shape: {center: [5, 5, 5], radius: 1}, rotation: [0, 1]}",
         r"obstacles\[0\]\.rotation: got \[0, 1\], expected roll, pitch and yaw"),
        ("{shape: {center: [5, 5, 5], radius: -1}, rotation: [0, 0, 1]}",
         r"obstacles\[0\]\.shape\.radius: got -1"),
        ("{shape: {center: [5, 5, 5], radius: 1}, rotatoin: [0, 0, 1]}",
         r"obstacles\[0\]\.rotatoin: .*did you mean rotation\?"),
        ("{shape: {center: [5, 5, 5], radius: 1}, rotation: [0, 0, 1], velocity: [1, 0, 0]}",
         r"obstacles\[0\]\.rotation: .*expected no field of this name"),
        ("{shape: {lower: [1, 5, 5], upper: [2, 6, 5]}, rotation: [0, 0, 1]}",
         r"obstacles\[0\].*a flat shape has no interior"),
        ("{shape: {lower: [4, -1, 0], upper: [5, 1, 2]}, translation: [-4, 0, 0]}",
         r"vehicles\[0\]\.start\.position: .*obstacle 1"),
    ],
)  # fmt: skip
def test_errors_name_what_is_wrong(text: str, words: str) -> None:
    with pytest.raises(rho.ScenarioError, match=words):
        read(text)


def test_a_posed_set_is_kept_in_and_found_in_files() -> None:
    corridor = rho.Posed(rho.Box([-1, -0.5, -9], [11, 0.5, 9]), [0, 0, 0.1])
    flight = rho.Vehicle("u", rho.State([0, 0, 0]), rho.State([9.0, 0.9, 0.0]))
    kept = [rho.KeepIn(corridor, name="corridor")]
    asked = rho.Scenario("s", rho.Grid.lasting(8.0, step=0.5), [flight], requirements=kept)
    assert rho.verify(rho.plan(asked)).ok
    back = from_yaml(as_yaml(asked))
    assert back == asked
    text = as_yaml(asked)
    assert from_yaml(text.replace("translation: [0.0, 0.0, 0.0]", "")) == asked


def _flight(turn: FloatArray) -> rho.Scenario:
    """Return a flight past two leaning obstacles, in a world that is turned."""
    posed = [
        rho.Posed(rho.Box([-0.6, -3, -0.4], [0.6, 3, 0.4]), [0.3, 0.2, 0.5], [4.0, 0.3, 1.0]),
        rho.Posed(rho.Cylinder([0, 0, 0], 0.7, 4.0), [0.8, 0.0, 0.0], [7.0, -0.4, 1.0]),
    ]
    obstacles = [rho.Posed(each.shape, turn @ each.rotation, turn @ each.translation)
                 for each in posed]  # fmt: skip
    start, goal = (rho.State(turn @ [float(x), 0.0, 1.0]) for x in (0, 10))
    return rho.Scenario(
        "turned",
        rho.Grid.lasting(8.0, step=0.5),
        [rho.Vehicle("u", start, goal, radius=0.2)],
        obstacles=obstacles,
    )


def test_posed_obstacles_are_avoided_and_a_turned_world_costs_the_same() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    plans = [rho.plan(_flight(turn)) for turn in (np.eye(3), quarter)]
    for plan in plans:
        assert rho.verify(plan).ok
        times = np.linspace(0.0, 8.0, 2001)
        x = plan.motion().at("position", times)[0]
        for body in plan.scenario.bodies:
            assert body.distances(x, times).min() > 0.2 - 1e-6
    assert plans[1].cost == pytest.approx(plans[0].cost, rel=1e-5)
    free = rho.plan(_flight(np.eye(3)).without_obstacles())
    assert plans[0].cost > 1.01 * free.cost


def test_poses_are_given_by_angles_matrices_or_those_of_drake() -> None:
    box = rho.Box([0, 0, 0], [1, 2, 3])
    angles: Any = RollPitchYaw(0.1, 0.2, 0.3)
    given = [angles.vector(), angles.ToRotationMatrix().matrix(), angles.ToRotationMatrix()]
    corners = np.array(list(product([-1.0, 1.0], repeat=3)))
    for each in given:
        posed = rho.Posed(box, each)
        np.testing.assert_allclose(
            posed.support(corners), rho.Posed(box, given[0]).support(corners), atol=1e-12
        )


def test_refused_arguments_are_errors_of_the_package_and_shapes_can_be_posed_twice() -> None:
    ball = rho.Sphere([1, 0, 0], 0.5)
    twice = rho.Posed(rho.Posed(ball, [0, 0, np.pi / 2]), translation=[0, 0, 3])
    np.testing.assert_allclose(twice.center, [0, 1, 3], atol=1e-15)
    assert twice.quadric_inside(0.0) is not None
    wrong: Any
    for wrong in (3, rho.Voxels([[0, 0, 0]], 1.0), rho.HalfSpace([0, 0, 1], 0.0), {"radius": 1}):
        with pytest.raises(rho.ScenarioError, match=r"posed\.shape"):
            rho.Posed(wrong)
    with pytest.raises(rho.ScenarioError, match=r"posed\.rotation: got \[0, 1\]"):
        rho.Posed(ball, [0, 1])
