"""Support, signed distance and outward direction of shapes, compared with brute force."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import slow
from tests.tolerances import ROUNDING

SEMI_AXES = [[3.0, 2.0, 1.0], [1.0, 1.0, 2.0], [2.0, 2.0, 1.0], [1.0, 1.0, 1.0], [20.0, 0.5, 0.5]]
Quadric = rho.Sphere | rho.Ellipsoid

SHAPES: list[Quadric] = [
    rho.Sphere([0, 0, 0], 1.7),
    *(rho.Ellipsoid([0, 0, 0], semi_axes) for semi_axes in SEMI_AXES),
]
named = pytest.mark.parametrize("shape", SHAPES, ids=str)


def semi_axes_of(shape: Quadric) -> FloatArray:
    """Return half the extents, by the definition of a quadric."""
    return shape.radius / shape.scales


def directions(count: int, seed: int = 0) -> FloatArray:
    """Return random unit vectors, shape (count, 3)."""
    n = np.random.default_rng(seed).normal(size=(count, 3))
    normed: FloatArray = n / np.linalg.norm(n, axis=1, keepdims=True)
    return normed


def special_points(shape: Quadric) -> FloatArray:
    """Return points on the axes and the coordinate planes, inside and outside, and the centre."""
    parts = np.array([-1.5, -1.0, -0.7, -0.1, -1e-9, 0.0, 1e-9, 0.1, 0.7, 1.0, 1.5])
    grid = np.stack(np.meshgrid(parts, parts, parts, indexing="ij"), axis=-1).reshape(-1, 3)
    on_planes = grid[np.count_nonzero(grid, axis=1) <= 2]
    points: FloatArray = on_planes * semi_axes_of(shape)
    return points


def random_points(shape: Quadric, seed: int = 1) -> FloatArray:
    """Return random points inside and outside."""
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (300, 3)) * semi_axes_of(shape)


@named
def test_the_support_is_the_maximum_over_the_surface(shape: Quadric) -> None:
    surface = directions(20_000) * semi_axes_of(shape)
    n = directions(50, seed=2)
    most = np.max(surface @ n.T, axis=0)
    support = shape.local_support(n)
    assert np.all(most <= support * (1.0 + ROUNDING))
    np.testing.assert_allclose(most, support, rtol=0.02)
    at = n * semi_axes_of(shape) ** 2 / support[:, None]  # where the support is attained
    np.testing.assert_allclose(np.einsum("ri,ri->r", n, at), support, rtol=ROUNDING)
    np.testing.assert_allclose(np.linalg.norm(at / semi_axes_of(shape), axis=1), 1.0)


@named
def test_the_half_space_beyond_the_support_is_outside(shape: Quadric) -> None:
    n, x = directions(40, seed=3), random_points(shape)
    beyond = x @ n.T >= shape.local_support(n)
    assert np.all(shape.local_distance(x)[np.any(beyond, axis=1)] >= 0.0)
    depth = np.max(
        x @ n.T - shape.local_support(n), axis=1
    )  # for a convex set, this is the distance
    assert np.all(depth <= shape.local_distance(x) + ROUNDING * shape.size)


@named
@pytest.mark.parametrize("points", [special_points, random_points])
def test_a_reference_outside_satisfies_its_own_row_by_its_distance(
    shape: Quadric, points: object
) -> None:
    x = points(shape)  # type: ignore[operator]  # one of the two
    distance = shape.local_distance(x)
    n = shape.local_outward(x)
    slack = np.einsum("ri,ri->r", n, x) - shape.local_support(n)
    scale = semi_axes_of(shape).max()
    outside = distance >= 0.0
    np.testing.assert_allclose(slack[outside], distance[outside], atol=ROUNDING * scale)


@named
@pytest.mark.parametrize("points", [special_points, random_points])
def test_the_nearest_point_is_on_the_surface_and_none_is_nearer(
    shape: Quadric, points: object
) -> None:
    x = points(shape)  # type: ignore[operator]  # one of the two
    distance, n, a = shape.local_distance(x), shape.local_outward(x), semi_axes_of(shape)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=ROUNDING)
    nearest = x - distance[:, None] * n
    np.testing.assert_allclose(np.linalg.norm(nearest / a, axis=1), 1.0, rtol=ROUNDING)
    inside = np.linalg.norm(x / a, axis=1) < 1.0
    assert np.all(distance[inside] < 0.0)
    assert np.all(distance[~inside] >= -ROUNDING * a.max())
    surface = directions(5_000, seed=4) * a
    gaps = np.linalg.norm(x[:, None] - surface, axis=2).min(axis=1)
    assert np.all(np.abs(distance) <= gaps + ROUNDING * a.max())


def brute_distance(shape: Quadric, x: FloatArray) -> float:
    """Return the distance from the surface, by local searches in angles from many starts."""
    a = semi_axes_of(shape)

    def gap(angles: FloatArray) -> float:
        u, w = angles
        point = a * np.array([np.cos(u) * np.cos(w), np.sin(u) * np.cos(w), np.sin(w)])
        return float(np.sum((x - point) ** 2))

    grid = np.stack(np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(-1.5, 1.5, 13)), axis=-1)
    starts = sorted(grid.reshape(-1, 2), key=gap)[:3]
    options = {"xatol": 1e-10, "fatol": 1e-16, "maxiter": 2000}
    found = [minimize(gap, s, method="Nelder-Mead", options=options).fun for s in starts]
    return float(np.sqrt(min(found)))


@pytest.mark.parametrize("count", [2, *slow(6)])
@named
def test_the_distance_equals_a_search_over_the_surface(shape: Quadric, count: int) -> None:
    rng = np.random.default_rng(5)
    some = rng.choice(special_points(shape), count), random_points(shape)[:count], np.zeros((1, 3))
    for x in np.concatenate(some):
        found = abs(float(shape.local_distance(x)))
        assert found == pytest.approx(brute_distance(shape, x), abs=1e-6 * shape.size)


@named
def test_outward_is_the_gradient_of_the_distance(shape: Quadric) -> None:
    a = semi_axes_of(shape)
    x = random_points(shape)
    x = x[np.linalg.norm(x / a, axis=1) > 0.05]
    step = 1e-5 * a.min()
    if len(set(a.tolist())) > 1:  # an edge where two points are equally near
        shortest = a == a.min()
        x = x[np.linalg.norm(x[:, shortest], axis=1) > 10 * step]
    gradient = np.stack(
        [
            (shape.local_distance(x + step * e) - shape.local_distance(x - step * e)) / (2 * step)
            for e in np.eye(3)
        ],
        axis=1,
    )
    np.testing.assert_allclose(gradient, shape.local_outward(x), atol=1e-5)


@named
def test_the_distance_is_lipschitz_continuous(shape: Quadric) -> None:
    """The bound holds across the plane where two points are equally near, however close to it."""
    x, way = special_points(shape), 1e-7 * semi_axes_of(shape).min() * directions(1)[0]
    change = shape.local_distance(x + way) - shape.local_distance(x - way)
    assert np.all(np.abs(change) <= 2.0 * np.linalg.norm(way) * (1.0 + 1e-6))


def test_an_ellipsoid_of_equal_axes_is_a_sphere() -> None:
    sphere, ellipsoid = rho.Sphere([0, 0, 0], 1.7), rho.Ellipsoid([0, 0, 0], [1.7, 1.7, 1.7])
    assert sphere.radius == ellipsoid.radius
    assert sphere.tolerance == ellipsoid.tolerance
    for x in (special_points(sphere), random_points(sphere)):
        for function in ("local_distance", "local_outward", "scaled"):
            one, other = (getattr(shape, function)(x) for shape in (sphere, ellipsoid))
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
    n = directions(20)
    np.testing.assert_allclose(sphere.local_support(n), ellipsoid.local_support(n))


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
@pytest.mark.parametrize("points", [special_points, random_points])
def test_permuting_the_axes_permutes_all_results(order: tuple[int, ...], points: object) -> None:
    turned = list(order)
    for semi_axes in SEMI_AXES:
        one = rho.Ellipsoid([0, 0, 0], semi_axes)
        other = rho.Ellipsoid([0, 0, 0], np.array(semi_axes)[turned])
        x = points(one)  # type: ignore[operator]  # one of the two
        # else either of two nearest points may be found after turning
        x = x[np.all(np.abs(x) > 0.0, axis=1)]
        n = directions(10)
        np.testing.assert_allclose(
            one.local_support(n), other.local_support(n[:, turned]), rtol=1e-12
        )
        distance = other.local_distance(x[:, turned])
        np.testing.assert_allclose(one.local_distance(x), distance, atol=1e-12 * max(semi_axes))
        np.testing.assert_allclose(
            one.local_outward(x)[:, turned], other.local_outward(x[:, turned]), atol=ROUNDING
        )


@named
@pytest.mark.parametrize("leading", [(), (0,), (4,), (2, 3), (2, 1, 5)], ids=str)
def test_arrays_of_any_leading_shape(shape: Quadric, leading: tuple[int, ...]) -> None:
    x = np.random.default_rng(6).normal(size=(*leading, 3))
    n = x / np.linalg.norm(x, axis=-1, keepdims=True)
    assert np.shape(shape.local_support(n)) == np.shape(shape.local_distance(x)) == leading
    flat = x.reshape(-1, 3)
    for function in (shape.local_outward, shape.scaled):
        assert function(x).shape == x.shape
        np.testing.assert_array_equal(function(x).reshape(-1, 3), function(flat))
    np.testing.assert_array_equal(np.ravel(shape.local_distance(x)), shape.local_distance(flat))


@pytest.mark.parametrize("above", [0.0, 1e-300, 1e-40, 1e-20, 1e-9, 1e-3])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_deep_inside_near_the_plane_of_the_shortest_axis(above: float, sign: float) -> None:
    """There y lies above x: x = (1 - (m / a)²) y gives the nearest point y and the distance."""
    shape, known = rho.Ellipsoid([0, 0, 0], [3.0, 2.0, 1.0]), np.array([0.5, 0.3, 0.0])
    x = known * (1.0 - 1.0 / np.array([9.0, 4.0, 1.0]))
    height = np.sqrt(1.0 - np.sum((known / [3.0, 2.0, 1.0]) ** 2))
    y = np.array([0.5, 0.3, height])
    x[2], y[2] = sign * above, sign * height
    n = shape.local_outward(x)
    wanted = y / np.array([9.0, 4.0, 1.0])
    side = sign if above > 0.0 else n[2]  # on the plane itself either side is correct
    wanted[2] = abs(wanted[2]) * np.sign(side)
    np.testing.assert_allclose(n, wanted / np.linalg.norm(wanted), atol=max(1e-12, 2 * above))
    distance = float(np.linalg.norm(y - x))
    assert shape.local_distance(x) == pytest.approx(-distance, abs=max(1e-12, above**2))


@pytest.mark.parametrize("semi_axes", SEMI_AXES, ids=str)
def test_at_the_centre_the_surface_is_as_near_as_the_shortest_axis(semi_axes: list[float]) -> None:
    shape = rho.Ellipsoid([0, 0, 0], semi_axes)
    n = shape.local_outward(np.zeros(3))
    assert shape.local_distance(np.zeros(3)) == -min(semi_axes)
    assert np.count_nonzero(n) == 1
    assert semi_axes[int(np.argmax(n))] == min(semi_axes)


def test_at_the_centre_of_a_sphere_any_direction_is_valid() -> None:
    sphere = rho.Sphere([0, 0, 0], 2.0)
    assert sphere.local_distance(np.zeros(3)) == -2.0
    assert np.linalg.norm(sphere.local_outward(np.zeros(3))) == 1.0


@given(
    logs=st.tuples(*[st.floats(-6.0, 6.0)] * 3),
    place=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
def test_flat_and_long_ellipsoids(logs: tuple[float, ...], place: tuple[float, ...]) -> None:
    """Semi-axes differ by up to twelve orders of magnitude."""
    a = 10.0 ** np.array(logs)
    shape = rho.Ellipsoid([0, 0, 0], a)
    x = a * np.array(place)
    distance, n = float(shape.local_distance(x)), shape.local_outward(x)
    assert np.isfinite(distance)
    assert np.linalg.norm(n) == pytest.approx(1.0)
    assert (distance < 0.0) == (np.linalg.norm(x / a) < 1.0)
    assert -distance <= a.min() * (1.0 + ROUNDING)
    if distance >= 0.0:
        slack = n @ x - shape.local_support(n)
        assert slack == pytest.approx(distance, abs=ROUNDING * max(a.max(), np.abs(x).max()))


@pytest.mark.parametrize("semi_axes", [[1, 1, 0], [1, -1, 1], [1, 1, 1e-16], [1, 1, np.inf]])
def test_semi_axes_without_extent_are_refused(semi_axes: list[float]) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Ellipsoid([0, 0, 0], semi_axes)
    assert caught.value.field == "ellipsoid.semi_axes"
