"""Sets in absolute coordinates, those without a bound, a user's own, and the check of all."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

import drake_rho as rho
from tests.arrays import FloatArray
from tests.requirements import Egg, random_set
from tests.scenarios import single
from tests.tolerances import ROUNDING
from tests.written import as_yaml, from_yaml

SETS: dict[str, rho.ConvexSet] = {
    "ball": rho.Ball([1, 2, 3], 2.0),
    "box": rho.Box([0, 0, 0], [1, 2, 3]),
    "ellipsoid": rho.Ellipsoid([4, 1, 0], [3, 2, 1]),
    "cylinder": rho.Cylinder([1, 0, 2], 1.0, 3.0),
    "endless cylinder": rho.Cylinder([1, 0, 2], 1.0, axis="y"),
    "polytope": rho.Polytope([[1, 0, 0], [3, 0, 0], [1, 2, 0], [1, 0, 2]]),
    "half-space": rho.HalfSpace([1, 2, -2], 4.0),
    "cone": rho.Cone([1, 2, 3], [1, -1, 1], 0.6),
    "own": Egg([1, 0, -1], 1.5),
}
each_set = pytest.mark.parametrize("convex_set", SETS.values(), ids=SETS)


@each_set
def test_the_functions_of_every_set_agree(convex_set: rho.ConvexSet) -> None:
    for near, size in (((0.0, 0.0, 0.0), 1.0), ((50.0, -20.0, 7.0), 30.0), ((1, 2, 3), 1e-2)):
        rho.check_set(convex_set, near=near, size=size)


@given(seed=st.integers(0, 10**6))
def test_the_functions_of_random_sets_agree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rho.check_set(random_set(rng, 5.0 * rng.normal(size=3), float(rng.uniform(0.5, 3.0))))


@each_set
def test_the_distance_outside_is_that_of_the_nearest_point(convex_set: rho.ConvexSet) -> None:
    """A search for the nearest point uses membership alone."""
    rng = np.random.default_rng(3)
    x = rng.uniform(-8.0, 8.0, (40, 3))
    x = x[convex_set.signed_distance(x) > 0.1][:4]
    for point in x:
        found = minimize(
            lambda y, point=point: float(np.sum((y - point) ** 2)),
            point - convex_set.signed_distance(point) * convex_set.outward(point),
            method="SLSQP",
            constraints={"type": "ineq", "fun": lambda y: -convex_set.signed_distance(y)},
            options={"ftol": 1e-12, "maxiter": 200},
        )
        distance = float(np.sqrt(found.fun))
        assert float(convex_set.signed_distance(point)) == pytest.approx(distance, abs=1e-4)


@pytest.mark.parametrize("name", [each for each in SETS if each not in ("half-space", "cone")])
def test_shapes_in_absolute_coordinates_move_with_their_centres(name: str) -> None:
    shape: Any = SETS[name]
    if name == "own":
        return
    x, n = np.random.default_rng(0).normal(size=(2, 50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    at = x + shape.center
    np.testing.assert_allclose(shape.signed_distance(at), shape.local_distance(x), atol=ROUNDING)
    np.testing.assert_allclose(shape.outward(at), shape.local_outward(x), atol=1e-6)
    moved = shape.local_support(n) + n @ shape.center
    np.testing.assert_allclose(shape.support(n), moved, atol=ROUNDING)


def test_a_half_space_is_bounded_along_its_normal_only() -> None:
    floor = rho.HalfSpace([0, 0, -4], -8.0)
    assert floor.support(np.array([0.0, 0.0, -1.0])) == -2.0
    assert floor.support(np.array([0.0, 1.0, 0.0])) == np.inf
    assert floor.signed_distance(np.array([7.0, 1.0, 5.0])) == -3.0


@pytest.mark.parametrize("half_angle", [0.1, 0.7, 1.5])
def test_a_cone_contains_the_directions_within_its_angle(half_angle: float) -> None:
    rng = np.random.default_rng(1)
    apex, axis = rng.normal(size=(2, 3))
    cone = rho.Cone(apex, axis, half_angle)
    x = apex + rng.normal(size=(2000, 3))
    cosines = (x - apex) @ axis / np.linalg.norm(x - apex, axis=1) / np.linalg.norm(axis)
    within = np.arccos(np.clip(cosines, -1.0, 1.0)) <= half_angle
    np.testing.assert_array_equal(cone.signed_distance(x) <= 0.0, within)
    outside = ~within
    nearest = x[outside] - (cone.signed_distance(x[outside])[:, None] * cone.outward(x[outside]))
    assert np.abs(cone.signed_distance(nearest)).max() < 1e-9


class _Shifted(Egg):
    def support(self, n: FloatArray) -> FloatArray:
        return super().support(n) + 0.1


class _Empty(Egg):
    def signed_distance(self, x: FloatArray) -> FloatArray:
        return np.abs(super().signed_distance(x)) + 1.0


class _Long(Egg):
    def outward(self, x: FloatArray) -> FloatArray:
        return 2.0 * super().outward(x)


class _Inward(Egg):
    def outward(self, x: FloatArray) -> FloatArray:
        return -super().outward(x)


class _One(Egg):
    def signed_distance(self, x: FloatArray) -> FloatArray:
        return np.asarray(float(np.linalg.norm(x)))


class _Broken(Egg):
    def support(self, n: FloatArray) -> FloatArray:
        raise RuntimeError("out of order")


class _Nan(Egg):
    def signed_distance(self, x: FloatArray) -> FloatArray:
        return np.full(x.shape[:-1], np.nan)


class _Hollow(Egg):
    """The outside of a ball, which is not convex."""

    def signed_distance(self, x: FloatArray) -> FloatArray:
        return -super().signed_distance(x)

    def outward(self, x: FloatArray) -> FloatArray:
        return -super().outward(x)

    def support(self, n: FloatArray) -> FloatArray:
        return -Egg(-self.centre, self.radius).support(-n)


WRONG: list[tuple[Callable[..., Any], str]] = [
    (_Shifted, "support"),
    (_Empty, "signed_distance"),
    (_Long, "outward"),
    (_Inward, "signed_distance"),
    (_One, "signed_distance"),
    (_Broken, "support"),
    (_Nan, "signed_distance"),
    (_Hollow, ""),
]


@pytest.mark.parametrize(("kind", "field"), WRONG, ids=[kind.__name__ for kind, _ in WRONG])
def test_sets_whose_functions_disagree_are_refused(kind: Callable[..., Any], field: str) -> None:
    with pytest.raises(rho.ScenarioError) as found:
        rho.check_set(kind([0.5, 0.2, 0.1], 1.0))
    assert field in found.value.field
    with pytest.raises(rho.ScenarioError) as found:
        rho.KeepIn(kind([0.5, 0.2, 0.1], 1.0))
    assert found.value.field.startswith("keepin.set." + field)
    assert "ConvexSet" not in found.value.field


def test_an_object_without_the_functions_is_no_set() -> None:
    with pytest.raises(rho.ScenarioError, match="signed_distance and outward"):
        rho.KeepIn(object())  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="convex_set"):
        rho.check_set(object())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"near": [1, 2]}, "near"),
        ({"near": [np.nan, 0, 0]}, "near"),
        ({"size": 0.0}, "size"),
        ({"size": -1.0}, "size"),
    ],
)
def test_bad_arguments_of_the_check_are_named(arguments: dict[str, Any], field: str) -> None:
    with pytest.raises(rho.ScenarioError) as found:
        rho.check_set(SETS["ball"], **arguments)
    assert found.value.field == field


@pytest.mark.parametrize("name", [each for each in SETS if each != "own"])
def test_every_set_of_the_package_is_in_files(name: str) -> None:
    asked = rho.KeepIn(SETS[name], of="velocity", active=(1.0, 2.0), name="kept")
    scenario = dataclasses.replace(single(), requirements=(asked,))
    assert from_yaml(as_yaml(scenario)) == scenario


def test_no_file_holds_a_users_own_set(tmp_path: Any) -> None:
    asked = rho.KeepIn(Egg([5, 1, 0], 20.0))
    scenario = dataclasses.replace(single(), requirements=(asked,))
    with pytest.raises(rho.ScenarioError, match="functions of one's own cannot be in a file"):
        rho.save_scenario(scenario, tmp_path / "scenario.yaml")
    with pytest.raises(rho.ScenarioError, match=r"requirements\[0\].set"):
        rho.save(rho.plan(scenario), tmp_path / "plan.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: rho.HalfSpace([0, 0, 0], 1.0), "halfspace.normal"),
        (lambda: rho.HalfSpace([0, 0, 1], np.inf), "halfspace.offset"),
        (lambda: rho.Cone([0, 0, 0], [0, 0, 0], 0.5), "cone.axis"),
        (lambda: rho.Cone([0, 0, 0], [0, 0, 1], 2.0), "cone.half_angle"),
        (lambda: rho.Cone([0, 0, 0], [0, 0, 1], 0.0), "cone.half_angle"),
    ],
)
def test_bad_sets_are_named(make: Callable[[], object], field: str) -> None:
    with pytest.raises(rho.ScenarioError) as found:
        make()
    assert found.value.field == field


def test_a_users_set_may_have_the_name_of_a_shape() -> None:
    class Capsule:
        def support(self, n: FloatArray) -> FloatArray:
            return np.ones(n.shape[:-1])

        def signed_distance(self, x: FloatArray) -> FloatArray:
            return np.asarray(np.linalg.norm(x, axis=-1) - 1.0)

        def outward(self, x: FloatArray) -> FloatArray:
            return np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True))

    own = Capsule()
    assert rho.KeepIn(own, of="velocity").set is own
