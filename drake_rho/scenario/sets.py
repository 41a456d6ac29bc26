"""Convex sets that a quantity stays in: shapes, half-spaces, cones, and a user's own sets.

A convex set is any object with three functions, in absolute coordinates in the quantity's unit.
Nothing else of it is used. `check_set` tests that the three agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import Discriminator, PlainSerializer, PlainValidator, Tag
from pydantic.json_schema import SkipJsonSchema

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError, shortened
from drake_rho.scenario.fields import LARGEST, FloatArray, Vector, record_kind
from drake_rho.scenario.shapes.base import Shape
from drake_rho.scenario.shapes.posed import KINDS, POSE, AnyConvex
from drake_rho.scenario.shapes.unbounded import KINDS as UNBOUNDED
from drake_rho.scenario.shapes.unbounded import AnyUnbounded, Unbounded


@runtime_checkable
class ConvexSet(Protocol):
    """Convex set of positions, velocities, accelerations or jerks x, given by three functions.

    All three take arrays of any leading shape (..., 3) and agree with each other (`check_set`).
    """

    def support(self, n: FloatArray, /) -> FloatArray:
        """Return the largest n · x of all x in the set, shape (...); may be infinite.

        Args:
            n: unit vectors, shape (..., 3).
        """
        ...

    def signed_distance(self, x: FloatArray, /) -> FloatArray:
        """Return distances from the boundary, at most 0 for x in the set, shape (...)."""
        ...

    def outward(self, x: FloatArray, /) -> FloatArray:
        """Return unit vectors that point away from the set, shape (..., 3).

        Outside, they point from the nearest point of the set to x; inside, from x to the nearest
        point of the boundary, or to any one of several such points.
        """
        ...


_POINTS = 240
"""Number of points at which the functions of a set are compared."""

_AGREE = 1e-6
"""Largest disagreement of a set's functions, relative to the lengths they are computed from."""


@checked
def check_set(
    convex_set: ConvexSet, *, near: npt.ArrayLike = (0.0, 0.0, 0.0), size: float = 1.0
) -> None:
    """Check that the three functions of a convex set agree with each other.

    They are compared at random points, from a hundredth of `size` to a hundred times `size` from
    `near`, and at the points of the set nearest to these.

    Args:
        convex_set: an object with `support`, `signed_distance` and `outward`.
        near: where the quantity's values are expected, in its unit, shape (3,).
        size: how far values are expected to be from there, in the same unit, above 0.

    Raises:
        ScenarioError: the functions disagree, are those of an empty set or of one that is not
            convex, return arrays of another shape, or fail; the error names the function.

    Examples:
        >>> rho.check_set(rho.Cone([0, 0, 0], [0, 0, 1], 0.5))
    """
    centre = np.asarray(near, dtype=np.float64)
    if centre.shape != (3,) or not np.all(np.abs(centre) <= LARGEST):
        raise ScenarioError("near", near, "three finite numbers, x, y and z")
    if not 0.0 < size <= LARGEST:  # also true for NaN
        raise ScenarioError("size", size, "a number above 0")
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(_POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x = centre + size * 10.0 ** rng.uniform(-2.0, 2.0, (_POINTS, 1)) * directions
    distances = _values(convex_set, "signed_distance", x, ())
    normals = _values(convex_set, "outward", x, (3,))
    if np.max(np.abs(np.linalg.norm(normals, axis=1) - 1.0)) > _AGREE:
        k = int(np.argmax(np.abs(np.linalg.norm(normals, axis=1) - 1.0)))
        raise _disagreement("outward", normals[k], x[k], "a vector of length 1")
    _check_nearest(convex_set, x, distances, normals)
    _check_convexity(convex_set, x, distances)


def _check_nearest(
    convex_set: ConvexSet, x: FloatArray, distances: FloatArray, normals: FloatArray
) -> None:
    """Check that each nearest point is on the boundary, in a supporting plane of the whole set."""
    nearest = x - distances[:, None] * normals
    lengths = 1e-3 + np.abs(distances) + np.linalg.norm(x, axis=1)
    there = _values(convex_set, "signed_distance", nearest, ())
    if np.any(off := np.abs(there) > _AGREE * lengths):
        k = int(np.argmax(off))
        words = "0: x - signed_distance(x) outward(x) is on the boundary of a set that is not empty"
        raise _disagreement("signed_distance", there[k], nearest[k], words)
    supports = _values(convex_set, "support", normals, (), finite=False)
    along = np.vecdot(normals, nearest)
    if np.any(off := ~(np.abs(supports - along) <= _AGREE * lengths)):
        k = int(np.argmax(off))
        words = f"{along[k]:.7g}, n · y at the nearest point y of {x[k].tolist()}"
        raise _disagreement("support", supports[k], normals[k], words)
    beyond = normals @ nearest.T - supports[:, None]
    if np.any(off := beyond > _AGREE * (lengths[:, None] + lengths)):
        k, other = (int(index[0]) for index in np.nonzero(off))
        words = (
            f"at least {normals[k] @ nearest[other]:.7g}, n · y at y = {nearest[other].tolist()}"
        )
        raise _disagreement("support", supports[k], normals[k], words)


def _check_convexity(convex_set: ConvexSet, x: FloatArray, distances: FloatArray) -> None:
    """Check that the distance is convex, on the middles between pairs of points."""
    other = np.roll(x, 1, axis=0)
    middles = (x + other) / 2.0
    between = _values(convex_set, "signed_distance", middles, ())
    most = (distances + np.roll(distances, 1)) / 2.0
    lengths = 1e-3 + np.linalg.norm(x, axis=1) + np.linalg.norm(other, axis=1)
    if np.any(off := between > most + _AGREE * lengths):
        k = int(np.argmax(off))
        words = f"at most {most[k]:.7g}, the mean of two points of which it is the middle"
        raise _disagreement("signed_distance", between[k], middles[k], words)


def _values(
    convex_set: ConvexSet, name: str, at: FloatArray, rest: tuple[int, ...], *, finite: bool = True
) -> FloatArray:
    """Return the values of one of a set's functions, computed in two arrangements.

    Raises:
        ScenarioError: the function fails, or does not return an array of such numbers.
    """
    function: Callable[[FloatArray], Any] = getattr(convex_set, name)
    found = list[FloatArray]()
    for points in (at, at.reshape(2, -1, 3)):
        shape = (*points.shape[:-1], *rest)
        expected = f"numbers of shape {shape} for an argument of shape {points.shape}"
        try:
            values = np.asarray(function(points), dtype=np.float64)
        except Exception as error:  # a user's function may raise anything
            got = Description(f"{type(error).__name__} ({error})")
            raise ScenarioError(name, got, expected) from None
        if values.shape != shape:
            raise ScenarioError(name, Description(f"shape {values.shape}"), expected)
        if np.any(np.isnan(values)) or (finite and not np.all(np.isfinite(values))):
            raise ScenarioError(name, Description("NaN or infinity"), expected)
        found.append(values.reshape(-1, *rest))
    one, other = found
    if not np.allclose(one, other, rtol=1e-9, atol=1e-12):
        raise ScenarioError(name, Description("other values"), "the same for any leading shape")
    return one


def _disagreement(name: str, value: Any, at: FloatArray, expected: str) -> ScenarioError:
    plain = value.tolist() if isinstance(value, np.ndarray) else float(value)
    where = [float(f"{each:.6g}") for each in at]
    return ScenarioError(name, plain, f"at {where} {expected}")


_OWN = "ConvexSet"
"""Tag of a set that is none of the package's records."""

_KINDS = {"Posed": ("shape", *POSE), **UNBOUNDED, **KINDS}
"""Keys that identify the set that a mapping describes; of several, the first in this order."""


SET_KEYS = ("center", "radius", *(key for keys in _KINDS.values() for key in keys))
"""Keys of mappings that describe sets."""


def _kind(value: object) -> str:
    """Return the name of a set's type, or of the type that a mapping describes; else `_OWN`."""
    if isinstance(value, Mapping):
        return record_kind(value, _KINDS, "Sphere")
    ours = isinstance(value, Shape | Unbounded)  # others may have their names
    return type(value).__name__ if ours else _OWN


def _own_set(value: object) -> Any:
    if not isinstance(value, ConvexSet):
        words = "a set, or an object with the functions support, signed_distance and outward"
        raise ScenarioError("", value, words)
    check_set(value)
    return value


AnySet = Annotated[
    AnyConvex
    | AnyUnbounded
    | Annotated[
        SkipJsonSchema[
            Annotated[Any, PlainValidator(_own_set), PlainSerializer(lambda each: each)]
        ],
        Tag(_OWN),
    ],
    Discriminator(_kind),
]
"""One of the package's sets, identified by its keys in a file, or any object like `ConvexSet`."""


def _is_set(value: object) -> bool:
    return isinstance(value, Mapping | ConvexSet)


ValueOrSet = Annotated[
    Annotated[Vector, Tag("(value)")] | Annotated[AnySet, Tag("(set)")],
    Discriminator(lambda value: "(set)" if _is_set(value) else "(value)"),
]
"""A value of a quantity, a vector, or a convex set of values."""


PACKAGE_SET = "one of the package's sets: functions of one's own cannot be in a file"
"""What is expected of a set in a file."""


def is_own(convex_set: object) -> bool:
    """Return whether a set is a user's own, which no file can hold."""
    return convex_set is not None and _kind(convex_set) == _OWN


def set_text(convex_set: object) -> str:
    """Return a short text of a set: its own, or the name of its type."""
    own = type(convex_set).__str__ is object.__str__
    return type(convex_set).__name__ if own else shortened(str(convex_set), 80)
