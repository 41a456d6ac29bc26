"""Every shape compared with Drake's geometry engine, and properties of all convex sets."""

from __future__ import annotations

from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryInstance,
    ProximityProperties,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix

import drake_rho as rho
from tests.arrays import FloatArray
from tests.shapes import KINDS, Shape, random_shape
from tests.tolerances import ROUNDING

every_kind = pytest.mark.parametrize("kind", KINDS)
seeds = st.integers(0, 2**32 - 1)

LONG = 1e4
"""Length of Drake's cylinder that stands for an infinite one, in radii."""


def engine(shape: Shape, turn: RotationMatrix | None = None) -> tuple[SceneGraph, Any]:
    """Return a scene with the shape around the origin, turned, and its context."""
    solid, pose = in_drake(shape)
    turned = RigidTransform(turn or RotationMatrix(), np.zeros(3)) @ pose
    placed = GeometryInstance(turned, solid, "shape")
    placed.set_proximity_properties(ProximityProperties())
    graph = SceneGraph()
    graph.RegisterAnchoredGeometry(graph.RegisterSource("test"), placed)
    return graph, graph.CreateDefaultContext()  # the scene has to outlive the context


def in_drake(shape: Shape) -> tuple[Any, RigidTransform]:
    """Return Drake's shape, and its pose relative to the centre of the bounding box."""
    solid: Any
    pose = RigidTransform()
    match shape:
        case rho.Sphere():
            solid = Sphere(shape.radius)
        case rho.Box():
            solid = Box(*(2.0 * shape.extent))
        case rho.Ellipsoid():
            solid = Ellipsoid(*shape.semi_axes)
        case rho.Cylinder():
            solid = Cylinder(shape.radius, shape.height or LONG * shape.radius)
        case rho.Polytope():
            solid = Convex((shape.vertices - shape.center).T, "polytope")
        case rho.Capsule():
            solid = Capsule(shape.radius, float(np.linalg.norm(shape.end - shape.start)))
            pose = RigidTransform(RotationMatrix.MakeFromOneVector(shape.half, 2), np.zeros(3))
        case rho.Posed():
            solid, inner = in_drake(shape.shape)
            middle = shape.rotation @ shape.shape.center + shape.translation - shape.center
            pose = RigidTransform(RotationMatrix(shape.rotation), middle) @ inner
    turns = {
        "x": RotationMatrix.MakeYRotation(np.pi / 2),
        "y": RotationMatrix.MakeXRotation(np.pi / 2),
    }
    if (axis := getattr(shape, "axis", "z")) in turns:
        pose = RigidTransform(turns[axis], np.zeros(3))
    return solid, pose


def by_drake(
    scene: tuple[SceneGraph, Any], x: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return signed distances, their gradients, and nearest points of the surface."""
    graph, context = scene
    query = graph.get_query_output_port().Eval(context)
    found = [query.ComputeSignedDistanceToPoint(point)[0] for point in x]
    distances = np.array([each.distance for each in found])
    gradients = np.array([each.grad_W for each in found])
    return distances, gradients, x - distances[:, None] * gradients


def around(rng: np.random.Generator, shape: Shape, count: int) -> FloatArray:
    """Return positions inside, near and outside; near the middle of infinite shapes."""
    extent = np.where(np.isfinite(shape.extent), shape.extent, shape.size)
    reach = 10 ** rng.uniform(-1.0, 1.0, (count, 1))
    points: FloatArray = rng.uniform(-1.0, 1.0, (count, 3)) * extent * np.minimum(reach, 3.0)
    return points


def seeded(kind: str, seed: int) -> tuple[np.random.Generator, Shape]:
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-2, 3)
    return rng, random_shape(rng, kind, size * rng.normal(size=3), size)


@every_kind
@given(seed=seeds)
@settings(max_examples=20)
def test_signed_distance_and_outward_are_those_of_drake(kind: str, seed: int) -> None:
    rng, shape = seeded(kind, seed)
    x = around(rng, shape, 40)
    distances, gradients, nearest = by_drake(engine(shape), x)
    own = shape.local_distance(x)
    if kind == "ellipsoid":
        # Drake stops its search early, at few points a tenth of the size off and of the wrong sign;
        # tests/test_shapes.py searches all of the surface
        assert np.sort(np.abs(own - distances))[-4] <= 1e-2 * shape.size
        return
    np.testing.assert_allclose(own, distances, rtol=0.0, atol=1e-12 * shape.size)
    n = shape.local_outward(x)
    np.testing.assert_allclose(x - own[:, None] * n, nearest, rtol=0.0, atol=1e-9 * shape.size)
    clear = np.abs(own) > 1e-6 * shape.size
    np.testing.assert_allclose(n[clear], gradients[clear], rtol=0.0, atol=1e-6)


@every_kind
@given(seed=seeds)
@settings(max_examples=20)
def test_the_support_is_reached_at_the_point_nearest_to_one_far_away(kind: str, seed: int) -> None:
    rng, shape = seeded(kind, seed)
    n = rng.normal(size=(20, 3))
    n[:, np.isinf(shape.extent)] = 0.0
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    if kind == "ellipsoid":
        # Drake's distance is not precise enough there: any point of its surface
        nearest = shape.size * n
        nearest /= np.linalg.norm(nearest / shape.extent, axis=1, keepdims=True)
        assert np.all(nearest @ n.T <= shape.local_support(n) * (1.0 + ROUNDING))
        return
    _, _, nearest = by_drake(engine(shape), 1e7 * shape.size * n)
    attained = np.einsum("ri,ri->r", n, nearest)
    np.testing.assert_allclose(shape.local_support(n), attained, rtol=0.0, atol=1e-5 * shape.size)
    assert np.all((nearest @ n.T).max(axis=0) <= shape.local_support(n) + 1e-8 * shape.size)


@every_kind
@given(seed=seeds)
def test_a_position_is_as_far_from_its_half_space_as_from_the_shape(kind: str, seed: int) -> None:
    """By duality n · x - h(n) is at most the signed distance, with equality at n = outward(x)."""
    rng, shape = seeded(kind, seed)
    x = np.concatenate([around(rng, shape, 60), special_points(shape)])
    n, distances = shape.local_outward(x), shape.local_distance(x)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-12)
    own = np.einsum("ri,ri->r", n, x) - shape.local_support(n)
    np.testing.assert_allclose(own, distances, rtol=0.0, atol=ROUNDING * shape.size)
    every = x @ n.T - shape.local_support(n)
    assert np.all(every <= distances[:, None] + ROUNDING * shape.size)


def special_points(shape: Shape) -> FloatArray:
    """Return the centre, and points on axes, planes, faces, edges, corners and beyond."""
    extent = np.where(np.isfinite(shape.extent), shape.extent, shape.size)
    parts = np.array(list(product([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0], repeat=3)))
    points = [parts * extent]
    if isinstance(shape, rho.Polytope):
        corners = shape.vertices - shape.center
        points += [corners, (corners[:1] + corners) / 2.0, 2.0 * corners]
    return np.concatenate(points)


@every_kind
@given(seed=seeds)
def test_the_signed_distance_is_convex_and_lipschitz_continuous(kind: str, seed: int) -> None:
    """The verifier's bound between samples relies on both."""
    rng, shape = seeded(kind, seed)
    x, y = around(rng, shape, 200), around(rng, shape, 200)
    one, other = shape.local_distance(x), shape.local_distance(y)
    rounding = 1e-12 * shape.size
    part = rng.uniform(size=200)
    between = shape.local_distance(x + part[:, None] * (y - x))
    assert np.all(between <= one + part * (other - one) + rounding)
    assert np.all(np.abs(other - one) <= np.linalg.norm(y - x, axis=1) + rounding)


def mapped(shape: Shape, order: list[int], signs: FloatArray, scale: float) -> Shape:
    """Return the shape with its axes permuted, mirrored, and scaled."""
    center = scale * (signs * shape.center)[order]
    match shape:
        case rho.Sphere():
            return rho.Sphere(center, scale * shape.radius)
        case rho.Box():
            extent = scale * shape.extent[order]
            return rho.Box(center - extent, center + extent)
        case rho.Ellipsoid():
            return rho.Ellipsoid(center, scale * shape.semi_axes[order])
        case rho.Cylinder():
            height = None if shape.height is None else scale * shape.height
            axis = "xyz"[order.index("xyz".index(shape.axis))]
            return rho.Cylinder(center, scale * shape.radius, height, axis)  # type: ignore[arg-type]
        case rho.Polytope():
            return rho.Polytope(scale * (signs * shape.vertices)[:, order])
        case rho.Capsule():
            start, end = (scale * (signs * each)[order] for each in (shape.start, shape.end))
            return rho.Capsule(start, end, scale * shape.radius)
        case rho.Posed():
            turn = (np.diag(signs) @ shape.rotation)[order]
            mirror = np.array([np.sign(np.linalg.det(turn)), 1.0, 1.0])  # none is a rotation
            inner = mapped(shape.shape, [0, 1, 2], mirror, scale)
            return rho.Posed(inner, turn * mirror, scale * (signs * shape.translation)[order])
    raise AssertionError(shape)


@every_kind
@given(
    seed=seeds,
    order=st.sampled_from([list(each) for each in permutations(range(3))]),
    signs=st.tuples(*[st.sampled_from([-1.0, 1.0])] * 3),
    scale=st.floats(1e-3, 1e3),
)
def test_other_axes_and_units_change_results_accordingly(
    kind: str, seed: int, order: list[int], signs: tuple[float, ...], scale: float
) -> None:
    rng, shape = seeded(kind, seed)
    mirror = np.array(signs)
    other = mapped(shape, order, mirror, scale)
    x = around(rng, shape, 60)
    there = scale * (mirror * x)[:, order]
    rounding = 1e-9 * scale * shape.size
    np.testing.assert_allclose(
        other.local_distance(there), scale * shape.local_distance(x), rtol=0.0, atol=rounding
    )
    n = shape.local_outward(x)
    np.testing.assert_allclose(
        other.local_outward(there), (mirror * n)[:, order], rtol=0.0, atol=1e-6
    )
    n[:, np.isinf(shape.extent)] = 0.0
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    np.testing.assert_allclose(
        other.local_support((mirror * n)[:, order]),
        scale * shape.local_support(n),
        rtol=0.0,
        atol=rounding,
    )
    np.testing.assert_allclose(other.extent, scale * shape.extent[order], rtol=1e-9)


@given(seed=seeds)
@settings(max_examples=13)
def test_a_polytope_can_be_turned_any_way(seed: int) -> None:
    rng, shape = seeded("polytope", seed)
    assert isinstance(shape, rho.Polytope)
    turn = _turn(rng)
    turned = rho.Polytope(shape.vertices @ turn.matrix().T)
    x = around(rng, shape, 40)
    # bounding boxes do not turn with the shape
    middle = turned.center - turn.matrix() @ shape.center
    distances = turned.local_distance(x @ turn.matrix().T - middle)
    np.testing.assert_allclose(distances, shape.local_distance(x), atol=1e-9 * shape.size)
    found, _, _ = by_drake(engine(shape, turn), x @ turn.matrix().T)
    np.testing.assert_allclose(distances, found, rtol=0.0, atol=1e-9 * shape.size)


def _turn(rng: np.random.Generator) -> RotationMatrix:
    matrix, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix[:, 0] *= np.sign(np.linalg.det(matrix))
    return RotationMatrix(matrix)


def same(one: Shape, other: Shape, x: FloatArray) -> None:
    """Check that two descriptions give the same shape."""
    np.testing.assert_allclose(one.center, other.center, atol=1e-12 * one.size)
    rounding = 1e-10 * one.size
    n = one.local_outward(x)
    distances = one.local_distance(x)
    np.testing.assert_allclose(distances, other.local_distance(x), rtol=0.0, atol=rounding)
    np.testing.assert_allclose(n, other.local_outward(x), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(
        one.local_support(n), other.local_support(n), rtol=0.0, atol=rounding
    )


@given(seed=seeds)
def test_a_box_given_by_its_corners_is_the_same(seed: int) -> None:
    rng, shape = seeded("box", seed)
    assert isinstance(shape, rho.Box)
    corners = np.array(list(product(*zip(shape.lower, shape.upper, strict=True))))
    inside = rng.uniform(shape.lower, shape.upper, (5, 3))
    for vertices in (corners, rng.permutation(np.concatenate([corners, inside, corners]))):
        same(shape, rho.Polytope(vertices), around(rng, shape, 60))


@given(seed=seeds)
def test_a_sphere_is_an_ellipsoid_of_equal_axes(seed: int) -> None:
    rng, shape = seeded("sphere", seed)
    assert isinstance(shape, rho.Sphere)
    same(shape, rho.Ellipsoid(shape.center, [shape.radius] * 3), around(rng, shape, 60))


@given(seed=seeds)
def test_an_infinite_cylinder_is_a_long_one_near_its_middle(seed: int) -> None:
    rng, shape = seeded("endless cylinder", seed)
    assert isinstance(shape, rho.Cylinder)
    long = rho.Cylinder(shape.center, shape.radius, 1e3 * shape.radius, shape.axis)
    x = around(rng, shape, 60)
    along = "xyz".index(shape.axis)
    assert np.all(shape.local_outward(x)[:, along] == 0.0)
    same(shape, long, x)
    moved = np.array(x)
    moved[:, along] += 1e5 * shape.radius
    np.testing.assert_array_equal(shape.local_distance(moved), shape.local_distance(x))
    assert shape.local_support(np.eye(3)[along]) == np.inf
    assert np.isinf(shape.extent[along])
    assert shape.size == shape.radius


@every_kind
def test_shapes_are_measured_in_arrays_of_any_leading_shape(kind: str) -> None:
    rng, shape = seeded(kind, 1)
    x = around(rng, shape, 30)
    n = shape.local_outward(x)
    for leading in ((), (0,), (4,), (2, 3), (2, 1, 5)):
        many = int(np.prod(leading))
        points, ways = x[:many].reshape(*leading, 3), n[:many].reshape(*leading, 3)
        assert np.shape(shape.local_distance(points)) == leading
        assert np.shape(shape.local_support(ways)) == leading
        assert shape.local_outward(points).shape == points.shape
        np.testing.assert_allclose(
            np.ravel(shape.local_distance(points)), shape.local_distance(x)[:many], rtol=1e-12
        )


@pytest.mark.parametrize("thickness", [1e-9, 1e-6, 2e-5])
@pytest.mark.parametrize("turned", [False, True])
def test_a_flat_sheet_is_no_polytope_in_any_orientation(thickness: float, turned: bool) -> None:
    corners = np.array(list(product([-1.0, 1.0], [-1.0, 1.0], [-thickness, thickness])))
    turn = _turn(np.random.default_rng(2)).matrix() if turned else np.eye(3)
    with pytest.raises(rho.ScenarioError, match=r"flat|plane") as caught:
        rho.Polytope(corners @ turn.T)
    assert caught.value.field == "polytope.vertices"


def test_a_thin_wedge_is_measured_at_its_sharp_edge() -> None:
    """Beyond the edge of two almost equal planes, no height above a plane is the distance."""
    low, high = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[-1.0, 0.0, 1e-3], [-1.0, 1.0, 1e-3]]
    wedge = rho.Polytope([*low, *high, [-1.0, 0.0, 0.0], [-1.0, 1.0, 0.0]])
    for far in 10.0 ** np.arange(-9.0, 1.0):
        beyond = np.array([far, 0.5, 0.0]) - wedge.center
        assert wedge.local_distance(beyond) == pytest.approx(far, rel=1e-6, abs=1e-10)
