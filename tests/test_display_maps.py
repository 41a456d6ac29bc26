"""Maps in figures and in the scene: exact surfaces, colours by height, flights not hidden."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d.art3d import Line3D, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from pydrake.geometry import Meshcat

import drake_rho as rho
from drake_rho.display.common import map_faces as module
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.hidden import hidden
from drake_rho.display.common.map_faces import map_faces
from drake_rho.display.common.obstacle_snapshots import Snapshot, as_obstacles
from drake_rho.display.common.style import HIGHEST, LOWEST, STEEP_ELEVATION, height_colours, view
from drake_rho.display.meshcat.animation import Stage, draw, start_meshcat
from drake_rho.display.meshcat.obstacles import add_obstacles
from drake_rho.display.meshcat.tree import Tree
from drake_rho.display.plots.figures import write_figures
from drake_rho.display.plots.lines3d import FAINT, draw_line
from drake_rho.display.plots.maps import map_figure
from drake_rho.display.viewer.payload import payload
from drake_rho.motion.obstacle_clearances import closest, distances
from drake_rho.planning.path_search.continuation import piecewise_linear
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.maps.map import Map
from tests.arrays import FloatArray
from tests.browser import open_page
from tests.scenarios import slow

EXACT = 1e-9
"""Tolerance of areas and volumes, relative."""
SIDE = 0.5
"""Side of the cells in these tests [m]."""


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return start_meshcat()


def _random(seed: int = 0, **place: Any) -> rho.Voxels:
    """Return 60 of 216 cells, some of which touch at edges only."""
    cells = np.random.default_rng(seed).permutation(list(product(range(6), repeat=3)))[:60]
    return rho.Voxels(cells, SIDE, **place)


def _walls() -> rho.Voxels:
    """Return four walls, 4 m high, around a courtyard of 9 m x 9 m, with a roof over a corner."""
    border = [(i, j) for i, j in product(range(20), repeat=2) if {i, j} & {0, 19}]
    roof = [(i, j, 7) for i, j in product(range(1, 5), repeat=2)]
    return rho.Voxels([(*each, k) for each in border for k in range(8)] + roof, SIDE)


def _block(lower: tuple[float, ...], upper: tuple[float, ...]) -> rho.Mesh:
    """Return a box as a watertight mesh."""
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [each for a, b, c, d in squares for each in ((a, b, c), (a, c, d))]
    return rho.Mesh(corners, triangles)


def _through(
    obstacles: tuple[Map | rho.Sphere | rho.Obstacle, ...], height: float = 1.0
) -> rho.Plan:
    """Return two straight flights across 10 m at a height, whatever is in their way."""
    vehicles = [
        rho.Vehicle(name, rho.State([1, y, height]), rho.State([9, y + 1, height]), radius=0.1)
        for name, y in (("one", 3.0), ("other", 6.0))
    ]
    free = rho.Scenario("through", rho.Grid(0.5, 17), vehicles)
    # unchecked: these tests do not care about obstacles at a start
    scenario = unchecked(free, obstacles=obstacles, bodies=as_obstacles(obstacles))
    ends = np.array([[each.start.position, each.goal.position] for each in vehicles])
    parts = np.linspace(0.0, 1.0, 17)[:, None]
    return piecewise_linear(scenario, ends[:, :1] + parts * (ends[:, 1:] - ends[:, :1]))


def _area(corners: FloatArray) -> float:
    """Return the area of rectangles or triangles, from their sides."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0]
    whole = np.linalg.norm(np.cross(one, other), axis=1).sum()
    return float(whole if corners.shape[1] == 4 else whole / 2.0)


def _volume(corners: FloatArray) -> float:
    """Return the volume inside a closed surface, by the divergence theorem."""
    fans = [corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)]
    return float(np.linalg.det(np.concatenate(fans)).sum() / 6.0)


PLACES = [{}, {"origin": [3.0, -2.0, 1.0]}, {"origin": [3, -2, 1], "rotation": [0.3, -0.5, 2.0]}]


@pytest.mark.parametrize("place", PLACES)
def test_merged_faces_are_the_open_sides_of_the_cells(place: dict[str, Any]) -> None:
    solid = _random(**place)
    faces = map_faces(solid)
    cells = {tuple(each) for each in solid.occupied.tolist()}
    steps = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    open_sides = sum(tuple(each + step) not in cells for each in solid.occupied for step in steps)
    assert _area(faces.corners) == pytest.approx(open_sides * SIDE**2, rel=EXACT)
    assert np.linalg.norm(faces.normals, axis=1).sum() == pytest.approx(_area(faces.corners))
    assert len(faces.corners) < open_sides  # some were joined
    # closed, and oriented outwards:
    assert _volume(faces.corners) == pytest.approx(len(cells) * SIDE**3, rel=EXACT)
    assert np.allclose(faces.normals.sum(axis=0), 0.0)
    middles = faces.corners.mean(axis=1) + solid.center
    assert np.allclose(solid.signed_distance(faces.corners.reshape(-1, 3) + solid.center), 0.0)
    outward = faces.normals / np.linalg.norm(faces.normals, axis=1, keepdims=True)
    assert np.allclose(solid.signed_distance(middles + 1e-3 * outward), 1e-3)


def test_a_wall_is_six_rectangles_and_keeps_its_height_range() -> None:
    wall = rho.Voxels(list(product(range(7), range(2), range(5))), SIDE)
    faces = map_faces(wall)
    assert len(faces.corners) == 6
    assert (faces.lowest, faces.highest) == (-1.25, 1.25)
    vertices, triangles = faces.mesh()
    assert (len(vertices), len(triangles)) == (8, 12)
    assert _volume(vertices[triangles]) == pytest.approx(7 * 2 * 5 * SIDE**3)
    banded = faces.in_bands()
    assert len(banded) == 2 + 4 * 12
    assert _area(banded) == pytest.approx(_area(faces.corners))
    assert _volume(banded) == pytest.approx(_volume(faces.corners))


def test_slices_are_cells_at_heights_and_triangles_cut_off() -> None:
    slice_ = map_faces(_walls(), (-0.9, 0.4))  # of cells from -2 to 2: those from -1 to 0.5
    assert np.ptp(slice_.corners[..., 2]) == pytest.approx(1.5)
    assert _volume(slice_.corners) == pytest.approx(76 * 3 * SIDE**3)
    assert (slice_.lowest, slice_.highest) == (-2.0, 2.0)  # colours do not change
    block = map_faces(_block((0, 0, 0), (2, 3, 4)), (-1.0, 0.5))
    assert _area(block.corners) == pytest.approx(10.0 * 1.5 + 2 * 3, rel=0.01)  # filled above
    assert np.all(block.normals[np.ptp(block.corners[..., 2], axis=1) == 0.0] @ [0, 0, 1] > 0.0)
    assert block.corners[..., 2].min() == pytest.approx(-1.0)
    assert block.corners[..., 2].max() == pytest.approx(0.5)
    assert len(map_faces(_walls(), (5.0, 6.0)).corners) == 0


def test_larger_maps_are_drawn_with_merged_cells_and_vertices(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    exact = map_faces(_random())
    assert exact.merged == 0.0
    monkeypatch.setattr(module, "_MOST_FACES", 60)
    coarse = map_faces(_random())
    assert len(coarse.corners) <= 60
    assert coarse.merged == 2 * SIDE
    assert _volume(coarse.corners) >= _volume(exact.corners)
    grid = np.array(list(product(range(9), repeat=2)))
    heights = np.sin(grid).sum(axis=1)
    first = np.array([9 * i + j for i, j in product(range(8), repeat=2)])
    triangles = np.concatenate([first[:, None] + [0, 9, 1], first[:, None] + [1, 9, 10]])
    hills = rho.Mesh(np.column_stack([grid, heights]), triangles)
    merged = map_faces(hills)
    assert len(merged.corners) <= 60
    assert merged.merged > 0.0
    assert _area(merged.corners) > 0.3 * _area(hills.corners)


def test_colours_grow_paler_with_height() -> None:
    heights = np.linspace(-3.0, 5.0, 30)
    light = height_colours(heights, -3.0, 5.0) @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(light) > 0.01)
    ends = height_colours(heights[[0, -1]], -3.0, 5.0)
    assert np.allclose(ends, [to_rgb(LOWEST), to_rgb(HIGHEST)])
    flat = rho.Mesh([[0, 0, 2], [1, 0, 2], [0, 1, 2]], [[0, 1, 2]])
    corners = map_faces(flat).corners
    assert np.allclose(map_faces(flat).colours(corners), np.add(*ends) / 2.0)  # one height


def test_positions_behind_maps_are_those_whose_line_of_sight_is_blocked() -> None:
    solid = _random(seed=3)
    shown = [Snapshot(solid, solid.center, 1)]
    x = np.random.default_rng(1).uniform(solid.center - 3.0, solid.center + 3.0, (100, 3))
    free = x[solid.signed_distance(x) > 0.02]
    sight = free[:, None] + np.linspace(0.0, 8.0, 2000)[:, None] * view()[2]
    deepest = solid.signed_distance(sight).min(axis=1)
    behind = hidden(free, shown)
    assert 0.1 < behind.mean() < 0.9
    assert np.all(behind[deepest < -1e-2])
    assert not np.any(behind[deepest > 1e-2])
    assert not np.any(hidden(free, [Snapshot(solid, solid.center, 1, faint=True)]))


def test_lines_behind_a_map_are_faint() -> None:
    ax = map_figure(_block((0, 0, 0), (1, 1, 1))).axes[0]
    assert isinstance(ax, Axes3D)
    solid = _block((4, 4, 0), (6, 6, 4))
    shown = [Snapshot(solid, solid.center, 1)]
    points = np.linspace([0.0, 10.0, 1.0], [10.0, 10.0, 1.0], 201)
    lines = draw_line(ax, points, shown, color="red")
    assert [line.get_alpha() for line in lines] == [None, FAINT]
    before, behind = (np.array(line.get_data_3d()).T for line in lines)
    np.testing.assert_array_equal(np.where(np.isnan(before), behind, before), points)
    np.testing.assert_array_equal(~np.isnan(behind[:, 0]), hidden(points, shown))


@pytest.mark.parametrize("ending", ["png", *slow("pdf", "svg")])
def test_a_figure_of_a_map_shows_it_twice(ending: str, tmp_path: Path) -> None:
    solid = _random(origin=[3.0, -2.0, 1.0])
    figure = map_figure(solid)
    scene, above, bar = figure.axes
    (body,) = [each for each in scene.collections if isinstance(each, Poly3DCollection)]
    (seen,) = [each for each in above.collections if isinstance(each, PolyCollection)]
    assert len(seen.get_paths()) == len(map_faces(solid).corners)
    assert body is not None
    assert "60 cells of 0.5 m, 3 x 3 x 3 m" in figure.get_suptitle()
    assert bar.get_ylim() == (1.0, 4.0)
    low, high = above.get_xlim()
    assert 2.5 < low < 3.0
    assert 6.0 < high < 6.5
    assert rho.save_figure(figure, tmp_path / f"map.{ending}").stat().st_size < 1e6


def test_a_figure_of_a_mesh_says_what_it_is() -> None:
    figure = map_figure(_block((0, 0, 0), (2, 3, 4)))
    assert figure.get_suptitle() == "watertight mesh of 12 triangles, 2 x 3 x 4 m"
    sheet = rho.Mesh([[0, 0, 2], [1, 0, 2], [0, 1, 2]], [[0, 1, 2]])
    assert map_figure(sheet).get_suptitle() == "surface of 1 triangles, 1 x 1 x 0 m"


def test_a_building_is_shown_from_above_and_a_pillar_from_the_side() -> None:
    inside = rho.paths_figure(_through((_walls(),)))
    ax = inside.axes[0]
    assert isinstance(ax, Axes3D)
    assert (ax.elev, ax.azim) == (90.0, -90.0)
    notes = " ".join(text.get_text() for text in inside.texts)
    assert "seen from above" in notes
    assert "0.90 to 1.10 m" in notes
    lines = [line for line in ax.lines if isinstance(line, Line3D)]
    assert not any(line.get_alpha() == FAINT for line in lines)
    pillar = rho.Voxels([(8, 8, k) for k in range(8)], SIDE)
    outside = rho.paths_figure(_through((pillar,)))
    assert isinstance(outside.axes[0], Axes3D)
    assert outside.axes[0].elev < 45.0
    assert "paler the higher" in " ".join(text.get_text() for text in outside.texts)


@pytest.mark.slow
def test_all_figures_and_numbers_of_a_plan_among_maps(tmp_path: Path) -> None:
    moving = rho.Obstacle(_block((0, 0, 0), (1, 1, 1)), velocity=[0.5, 0.2, 0.0], name="cart")
    late = rho.Obstacle(_random(origin=[4.0, 6.0, 0.0]), known_from=2.0)
    pillar = rho.Voxels([(12, 18, k) for k in range(8)], SIDE)
    plan = _through((pillar, moving, late, rho.Sphere([5, 1, 1], 0.4)))
    with_figures = tmp_path / "figures"
    names = {path.stem for path in write_figures(plan, with_figures)}
    assert names == {"paths", "distances", "velocities", "accelerations"}
    data: dict[str, Any] = payload(Stage.of(plan))
    legend = [entry["sign"] for entry in data["legend"]]
    assert "map" in legend
    assert "obstacle" in legend
    layers = [entry["title"] for entry in data["layers"]]
    assert "Obstacles" in layers


def test_the_closest_approach_to_a_map_is_found_inside_and_outside() -> None:
    for solid in (_block((4, 2, 0), (6, 4, 3)), _walls(), _block((4, 8, 0), (6, 9, 3))):
        plan = _through((solid,))
        obstacle = plan.scenario.bodies[0]
        times = np.linspace(0.0, 8.0, 20_001)
        exact = distances(plan, obstacle, times).min(axis=1)
        found = closest(plan, obstacle)
        assert np.allclose(found.distances, exact, atol=0.01)  # one sample in 0.04 s, 1 m/s
        assert np.allclose(found.distances[exact > 0], exact[exact > 0], atol=1e-6)
        figure = rho.distances_figure(plan)
        legend = figure.axes[0].get_legend()
        assert legend is not None
        number = float(legend.get_texts()[0].get_text().split(" m ")[0].replace("\u2212", "-"))
        assert number == pytest.approx(exact.min(), abs=0.01)


def test_the_scene_has_one_mesh_for_each_map(meshcat: Meshcat) -> None:
    moving = rho.Obstacle(_block((0, 0, 0), (1, 1, 1)), velocity=[0.5, 0.0, 0.0])
    late = rho.Obstacle(_random(origin=[4.0, 6.0, 0.0]), known_from=2.0)
    plan = _through((_walls(), moving, late))
    stage = Stage.of(plan)
    assert stage.scene.elevation == STEEP_ELEVATION
    draw(meshcat, stage, trails=False)
    for number in (1, 2, 3):
        assert meshcat.HasPath(f"/flight/obstacles/{number}/known")
        assert not meshcat.HasPath(f"/flight/obstacles/{number}/edges")
    assert not meshcat.HasPath("/flight/obstacles/1/unknown")
    assert meshcat.HasPath("/flight/obstacles/3/unknown")
    error = rho.InfeasibleError({"one": ("obstacles",)}, obstacles={"one": frozenset({1})})
    plain = meshcat.StaticHtml()
    add_obstacles(Tree(meshcat, stage.playback), stage.scene, drawn(plan), error)
    assert meshcat.StaticHtml() != plain  # red
    figure = rho.paths_figure(plan, conflicts=error)
    assert "red: in conflict" in " ".join(text.get_text() for text in figure.texts)


def test_a_page_of_a_building_is_small(meshcat: Meshcat) -> None:
    empty = len(meshcat.StaticHtml())
    noise = np.random.default_rng(0).random((60, 60, 30)) < 0.04
    solid = rho.Voxels(np.argwhere(noise), 0.1)  # few cells touch: the worst case of merging
    stage = Stage.of(_through((solid,)))
    draw(meshcat, stage, trails=True)
    faces = len(map_faces(solid).corners)
    assert faces > 20_000
    assert len(meshcat.StaticHtml()) - empty < 110 * faces + 300_000


@pytest.mark.slow
def test_a_page_shows_and_hides_a_map(tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text(rho.viewer_page(_through((_walls(),))))
    with open_page(offline=True) as (page, said):
        page.goto(file.as_uri())
        page.wait_for_function("window.drakeRho", timeout=60_000)
        page.evaluate("drakeRho.play(false)")
        shown = """() => {
            let found = null;
            const known = viewer.scene_tree.find(["flight", "obstacles", "1", "known"]);
            known.object.traverse((each) => { if (each.isMesh) found = each; });
            const { geometry, material } = found;
            return [geometry.attributes.position.count, geometry.index.count / 3,
                    material.vertexColors, material.flatShading];
        }"""
        vertices, triangles = map_faces(_walls()).mesh()
        assert page.evaluate(shown) == [len(vertices), len(triangles), True, True]
        assert "map, paler the higher" in page.inner_text(".legend")
        page.evaluate("document.querySelector('[data-layer=Obstacles]').click()")
        visible = "viewer.scene_tree.find(['flight', 'obstacles']).object.visible"
        assert page.evaluate(visible) is False
        assert said == []
