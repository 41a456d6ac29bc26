"""The drawn surface of a shape has the shape's own size, and its corners are on the shape."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.display.common.shape_faces import Surface, surface
from tests.shapes import Shape

_CUBE = np.array(list(np.ndindex(2, 2, 2)), dtype=np.float64)
SHAPES = [
    rho.Sphere([1, 2, 3], 2.0),
    rho.Ellipsoid([1, 2, 3], [3.0, 1.0, 0.5]),
    rho.Box([-1, 2, 3], [4, 3, 5]),
    *(rho.Cylinder([1, 2, 3], 0.5, 4.0, axis) for axis in ("x", "y", "z")),
    rho.Polytope(_CUBE * [1, 2, 3] + 5.0),
    rho.Polytope([*_CUBE.tolist(), [0.5, 0.5, 2.0]]),
    rho.Polytope(np.random.default_rng(0).normal(size=(30, 3))),
]


def _volume(drawn: Surface) -> float:
    """Return the volume, by cones from the centre to the faces; negative if faces look inwards."""
    fans = [
        np.linalg.det(np.stack([face[0], one, other]))
        for face in drawn.faces
        for one, other in pairwise(face[1:])
    ]
    return float(np.sum(fans)) / 6.0


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_corners_lie_on_the_surface_and_faces_look_outwards(shape: Shape) -> None:
    drawn = surface(shape)
    corners = np.concatenate([*drawn.faces, *drawn.edges])
    np.testing.assert_allclose(shape.local_distance(corners), 0.0, atol=1e-9 * shape.size)
    np.testing.assert_allclose(np.abs(corners).max(axis=0), shape.extent, rtol=0.01)
    for face in drawn.faces:
        middle, around = face.mean(axis=0), np.roll(face, -1, axis=0)
        area = np.cross(face - middle, around - middle).sum(axis=0) / 2.0
        # faces cut curved surfaces, so their middles lie inside
        assert np.abs(shape.local_distance(middle[None])[0]) <= 0.02 * shape.size
        assert area @ middle > 0.0


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (SHAPES[0], 4 / 3 * np.pi * 8),
        (SHAPES[1], 4 / 3 * np.pi * 1.5),
        (SHAPES[2], 10.0),
        (SHAPES[3], np.pi),
        (SHAPES[4], np.pi),
        (SHAPES[5], np.pi),
        (SHAPES[6], 6.0),
        (SHAPES[7], 1.0 + 1.0 / 3.0),
    ],
    ids=str,
)
def test_volumes_are_those_of_closed_forms(shape: Shape, volume: float) -> None:
    assert _volume(surface(shape)) == pytest.approx(volume, rel=0.02)


@pytest.mark.parametrize("shape", SHAPES[:2] + SHAPES[3:6], ids=str)
def test_a_shape_without_faces_of_its_own_is_drawn_from_its_distance(shape: Shape) -> None:
    drawn, own = surface.dispatch(object)(shape), surface(shape)
    corners = np.concatenate(drawn.faces)
    np.testing.assert_allclose(shape.local_distance(corners), 0.0, atol=1e-8 * shape.size)
    assert _volume(drawn) == pytest.approx(_volume(own), rel=0.05)


def test_flat_faces_and_edges_are_complete() -> None:
    for shape in (SHAPES[2], SHAPES[6]):
        drawn = surface(shape)
        assert [len(face) for face in drawn.faces] == [4] * 6
        lengths = sorted(np.linalg.norm(edge[1] - edge[0]) for edge in drawn.edges)
        np.testing.assert_allclose(lengths, np.repeat(np.sort(2 * shape.extent), 4))
    house = surface(SHAPES[7])
    assert sorted(len(face) for face in house.faces) == [3] * 4 + [4] * 5
    assert len(house.edges) == 16
    assert surface(SHAPES[0]).edges == []


def test_an_infinite_cylinder_is_cut_first() -> None:
    with pytest.raises(ValueError, match="infinite cylinder"):
        surface(rho.Cylinder([0, 0, 0], 1.0))
