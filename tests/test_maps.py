"""Maps: unions of cells and triangles, their distances, trees and covers."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.scenario.maps.box_tree import BoxTree
from drake_rho.scenario.maps.cells import covering_boxes, difference, free_neighbours
from drake_rho.scenario.maps.parts import Boxes, Triangles
from drake_rho.scenario.rotations import from_angles, rotation_of
from tests.maps import box_distances, cloud_of_cells, grid_of, l_mesh, triangle_distances, turned

seeds = st.integers(0, 2**31)


@given(seeds)
def test_a_tree_finds_just_the_boxes_within_a_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-5.0, 5.0, (int(rng.integers(1, 80)), 3))
    upper = lower + rng.exponential(1.0, lower.shape)
    low = rng.uniform(-6.0, 6.0, (20, 3))
    high, within = low + rng.exponential(0.5, low.shape), rng.exponential(1.0, 20)
    gaps = np.maximum(np.maximum(lower - high[:, None], low[:, None] - upper), 0.0)
    near = np.linalg.norm(gaps, axis=2) <= within[:, None]
    queries, boxes = BoxTree(lower, upper).pairs(low, high, within)
    assert set(zip(queries.tolist(), boxes.tolist(), strict=True)) == set(
        zip(*(each.tolist() for each in np.nonzero(near)), strict=True)
    )
    assert np.all(np.diff(queries) >= 0)


@given(seeds)
def test_boxes_cover_cells_exactly_and_do_not_overlap(seed: int) -> None:
    cells = cloud_of_cells(np.random.default_rng(seed))
    lower, upper = covering_boxes(cells)
    covered = [
        cell
        for low, high in zip(lower, upper, strict=True)
        for cell in product(*map(range, low.tolist(), high.tolist()))
    ]
    assert len(covered) == len(set(covered)) == len(cells)
    assert set(covered) == set(map(tuple, cells.tolist()))


def test_a_full_block_is_one_box() -> None:
    block = np.array(list(product(range(-2, 3), range(4), range(7))))
    lower, upper = covering_boxes(block)
    assert lower.tolist() == [[-2, 0, 0]]
    assert upper.tolist() == [[3, 4, 7]]


@given(seeds)
def test_free_neighbours_are_the_free_cells_that_share_a_face(seed: int) -> None:
    cells = cloud_of_cells(np.random.default_rng(seed))
    occupied = set(map(tuple, cells.tolist()))
    steps = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    around = {tuple(np.add(cell, step).tolist()) for cell in occupied for step in steps}
    assert set(map(tuple, free_neighbours(cells).tolist())) == around - occupied
    kept = difference(cells, cells[::2])
    assert sorted(map(tuple, kept.tolist())) == sorted(map(tuple, cells[1::2].tolist()))


@given(seeds)
def test_distances_from_cells_are_exact_outside_and_inside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells, h, origin = cloud_of_cells(rng), float(rng.uniform(0.1, 2.0)), rng.normal(size=3)
    angles = rng.uniform(-3.0, 3.0, 3) if seed % 2 else None
    voxels = rho.Voxels(cells, h, origin, angles)
    grid = rng.uniform(-3.0, 9.0, (200, 3))  # in cells
    R = np.eye(3) if angles is None else from_angles(angles)
    x = h * grid @ R.T + origin
    outside = h * box_distances(grid, cells, cells + 1)
    free = np.argwhere(np.pad(grid_of(cells), 1) == 0) - 1
    inside = -h * box_distances(grid, free, free + 1)
    expected = np.where(outside > 0.0, outside, inside)
    assert voxels.signed_distance(x) == pytest.approx(expected, abs=1e-9)
    assert voxels.cover.signed_distance(x).clip(0.0) == pytest.approx(outside, abs=1e-9)
    assert voxels.parts.distance_up_to(x - voxels.center, h).clip(0.0) == pytest.approx(
        np.minimum(outside, h), abs=1e-9
    )
    out = voxels.outward(x)
    on_surface = x - voxels.signed_distance(x)[:, None] * out
    assert voxels.signed_distance(on_surface) == pytest.approx(np.zeros(200), abs=1e-6)


@given(seeds)
def test_parts_lie_behind_the_half_spaces_of_their_nearest_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-2.0, 2.0, (10, 3))
    boxes = Boxes(lower, lower + rng.exponential(1.0, lower.shape))
    triangles = Triangles(rng.normal(size=(10, 3, 3)))
    for union in (boxes, triangles):
        numbers, x = np.arange(10), 4.0 * rng.normal(size=(10, 3))
        d, n = union.measured(numbers, x)
        assert union.distances_of(numbers, x) == pytest.approx(d, abs=1e-12)
        nearest = x - d[:, None] * n
        assert np.linalg.norm(n, axis=1) == pytest.approx(np.ones(10))
        assert union.supports(numbers, n) == pytest.approx(
            np.einsum("pi,pi->p", n, nearest), abs=1e-9
        )


@given(seeds)
def test_distances_from_triangles_are_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(12, 3, 3))
    corners[0, 2] = corners[0, 1]  # a segment
    corners[1, :] = corners[1, 0]  # a point
    mesh = rho.Mesh(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    x = 2.0 * rng.normal(size=(50, 3))
    assert not mesh.is_watertight
    assert mesh.signed_distance(x) == pytest.approx(triangle_distances(x, corners), abs=1e-7)


def test_the_notch_of_an_l_is_outside_and_its_arms_are_inside() -> None:
    mesh = l_mesh()
    assert mesh.is_watertight
    notch, arm, beyond = [1.5, 0.5, 2.0], [0.25, 0.5, 2.0], [-1.0, 0.5, 2.0]
    assert mesh.signed_distance(np.array([notch, arm, beyond])) == pytest.approx(
        [1.0, -0.25, 1.0], abs=1e-12
    )
    assert mesh.outward(np.array([[0.2, 0.5, 2.0]])) == pytest.approx(np.array([[-1.0, 0.0, 0.0]]))


@given(seeds)
def test_a_watertight_mesh_has_the_distances_of_its_solid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = rho.Box([-1.0, -0.5, 0.0], [1.0, 0.5, 2.0])
    corners = np.array(list(product((-1.0, 1.0), (-0.5, 0.5), (0.0, 2.0))))
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]]
    faces += [[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    mesh = rho.Mesh(corners, np.array(faces))
    x = rng.uniform(-3.0, 3.0, (200, 3))
    x[:4] = np.round(x[:4])  # above edges and corners
    assert mesh.signed_distance(x) == pytest.approx(box.signed_distance(x), abs=1e-9)


def test_records_of_maps_refuse_what_they_cannot_hold() -> None:
    with pytest.raises(rho.ScenarioError, match="occupied"):
        rho.Voxels(np.zeros((0, 3)), 0.1)
    with pytest.raises(rho.ScenarioError, match="resolution"):
        rho.Voxels([[0, 0, 0]], 0.0)
    with pytest.raises(rho.ScenarioError, match="whole numbers"):
        rho.Voxels([[0.5, 0, 0]], 0.1)
    with pytest.raises(rho.ScenarioError, match="at least one triangle"):
        rho.Mesh(np.zeros((3, 3)), np.zeros((0, 3)))
    with pytest.raises(rho.ScenarioError, match=r"triangles\[0\]"):
        rho.Mesh(np.eye(3), np.array([[0, 1, 3]]))
    with pytest.raises(rho.ScenarioError, match=r"vertices\[1\]"):
        rho.Mesh(np.array([[0, 0, 0], [np.nan, 0, 0], [0, 1, 0]]), [[0, 1, 2]])
    with pytest.raises(rho.ScenarioError, match="rotation"):
        rho.Voxels([[0, 0, 0]], 0.1, rotation=2.0 * np.eye(3))
    assert rotation_of([0.0, 0.0, np.pi / 2.0]) @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])


def test_equal_cells_count_once_and_maps_are_equal_by_value() -> None:
    twice = rho.Voxels([[1, 0, 0], [0, 0, 0], [1, 0, 0]], 0.5)
    assert len(twice.occupied) == 2
    assert twice == rho.Voxels([[0, 0, 0], [1, 0, 0]], 0.5)
    assert turned(twice) != twice
