"""Published figures: files, widths, texts that overlap no other, distinguishable lines."""

from __future__ import annotations

import dataclasses
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.axes3d import Axes3D

import drake_rho as rho
from drake_rho.cli.failures import status_of
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.style import vehicle_colours, window_colours
from drake_rho.display.plots.distances import draw_distances
from drake_rho.display.plots.figures import write_figures
from drake_rho.display.plots.formats import DOUBLE_COLUMN, FORMATS, SINGLE_COLUMN
from drake_rho.display.plots.overlapping_curves import marks_every
from drake_rho.paper.figures import draw_figure
from drake_rho.scenario.fields import unchecked
from tests.conftest import Study
from tests.scenarios import slow, straight

NAMES = ("$x^$", "<b>&amp;</b>", "a_b_c", "'q\"uote & co", "w" * 80, "v")
"""Names that have a special meaning elsewhere."""


def _between(*ends: Any, names: tuple[str, ...] = ()) -> rho.Plan:
    """Return vehicles of ten seconds with these starts and goals and without separation."""
    vehicles = [
        rho.Vehicle(names[i] if names else f"v{i}", rho.State(start), rho.State(goal))
        for i, (start, goal) in enumerate(ends)
    ]
    return rho.plan_convex(rho.Scenario("scene", rho.Grid(0.5, 21), vehicles))


def _among(vehicles: int, obstacles: int, *, named: tuple[str, ...] | None = None) -> rho.Plan:
    """Return straight flights across a cube, through any obstacle; boxes have two kinds of name."""
    rng = np.random.default_rng(3)
    free = straight(vehicles, named)
    bodies = [
        rho.Obstacle(rho.Box(low, low + 0.5), name=None if i % 5 else f"tower {i} of the town hall")
        for i, low in enumerate(rng.uniform(0.0, 10.0, (obstacles, 3)))
    ]
    moving = rho.Obstacle(rho.Sphere([5, 5, 5], 0.5), velocity=[0.3, 0.1, 0.0], known_from=1.0)
    every = (*bodies, dataclasses.replace(moving, name="$x^$"))
    scenario = unchecked(free.scenario, obstacles=every, bodies=every)
    return rho.Plan.from_accelerations(scenario, free.accelerations)


SCENES: dict[str, Callable[[], rho.Plan]] = {
    "flat": lambda: _between([[0, 0, 1], [20, 3, 1]], [[0, 8, 1], [20, 0, 1]]),
    "tall": lambda: _between([[0, 0, 0], [3, 0, 20]], [[0, 2, 0], [0, 0, 20]]),
    "tiny": lambda: _between([[0, 0, 0], [3e-3, 0, 2e-3]], [[0, 2e-3, 0], [0, 0, 2e-3]]),
    "point": lambda: _between([[0, 0, 1], [0, 0, 1]]),
    "together": lambda: _between(*([[0, 0, 1 + 1e-4 * i], [20, 3, 1]] for i in range(6))),
    "long names": lambda: _between(
        *([[0, 0, 1 + 1e-4 * i], [20, 3, 1]] for i in range(6)), names=NAMES
    ),
    "few obstacles": lambda: _among(3, 2),
    "many obstacles": lambda: _among(12, 40),
    "many vehicles": lambda: _among(36, 12),
}


LARGE = ("many obstacles", "many vehicles")


def _flight(plan: rho.Plan) -> rho.Flight:
    """Return the plan, flown by windows from its first and its fifth knot."""
    windows = tuple(rho.Window(knot, plan.tail(knot), plan.tail(knot)) for knot in (0, 4))
    return rho.Flight(plan, windows)


def _texts(figure: Figure) -> list[Text]:
    """Return every visible text, those of a shared legend once."""
    found = [*figure.texts]
    for legend in [*figure.legends, *filter(None, (ax.get_legend() for ax in figure.axes))]:
        found += legend.get_texts()
    for ax in figure.axes:
        axes = [ax.xaxis, ax.yaxis, *([ax.zaxis] if isinstance(ax, Axes3D) else [])]
        found += [*ax.texts, ax.title]
        for axis in axes:
            low, high = sorted(axis.get_view_interval())
            found.append(axis.label)
            found += [t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
    return [text for text in found if text.get_visible() and text.get_text()]


@pytest.mark.slow
@pytest.mark.parametrize("width", [SINGLE_COLUMN, *slow(DOUBLE_COLUMN)])
@pytest.mark.parametrize(
    "scene",
    [each for name in SCENES for each in (slow(name) if name in LARGE else [name])],
)
def test_no_text_overlaps_another_or_leaves_the_figure(scene: str, width: float) -> None:
    plan = SCENES[scene]()
    figures = [
        rho.paths_figure(plan, width=width),
        rho.paths_figure(_flight(plan), width=width),
        rho.accelerations_figure(plan, width=width),
    ]
    if plan.scenario.bodies:
        figures.append(rho.distances_figure(plan, width=width))
    for figure in figures:
        assert figure.get_figwidth() == width
        renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
        figure.draw(renderer)
        texts = _texts(figure)
        assert all(float(text.get_fontsize()) >= 6.0 for text in texts)
        boxes = [text.get_window_extent(renderer) for text in texts]
        turned = [text.get_rotation() % 90.0 != 0.0 for text in texts]
        for box, text in zip(boxes, texts, strict=True):
            assert box.x0 >= -1, text
            assert box.y0 >= -1, text
            assert box.x1 <= figure.bbox.width + 1, text
            assert box.y1 <= figure.bbox.height + 1, text
        for i, j in combinations(range(len(texts)), 2):
            if not (
                turned[i] or turned[j]
            ):  # the bounding box of a turned text is far wider than the text
                assert not boxes[i].padded(-0.5).overlaps(boxes[j].padded(-0.5)), (
                    texts[i],
                    texts[j],
                )


def test_names_of_a_few_neighbours_are_all_shown() -> None:
    figure = rho.paths_figure(SCENES["long names"](), width=SINGLE_COLUMN)
    figure.draw_without_rendering()
    shown = [text for text in figure.axes[0].texts if text.get_visible()]
    assert len(shown) == 6


_WRITE = """
import sys
import drake_rho as rho
from drake_rho.display.plots.figures import write_figures
flight = rho.plan_rho(rho.load_scenario("paper"), replan_every=25)
for file_format in ("png", "pdf", "svg"):
    write_figures(flight, sys.argv[1], file_format=file_format, width=3.5)
"""


@pytest.mark.slow
def test_the_same_drawing_is_the_same_file_in_every_format(tmp_path: Path) -> None:
    """Processes with other hash seeds, on another day, write the same bytes."""
    for name, seed in (("one", "1"), ("other", "2")):
        epoch = {"PYTHONHASHSEED": seed, "SOURCE_DATE_EPOCH": f"{seed}00000000"}
        command = [sys.executable, "-c", _WRITE, str(tmp_path / name)]
        subprocess.run(command, check=True, env=os.environ | epoch)
    names = {path.name for path in (tmp_path / "one").iterdir()}
    assert len(names) == 4 * len(FORMATS)
    for name in names:
        written = (tmp_path / "one" / name).read_bytes()
        assert written == (tmp_path / "other" / name).read_bytes()
        assert b"CreationDate" not in written
        assert b"dc:date" not in written
        assert b"Matplotlib v" not in written


@pytest.mark.slow
def test_pdf_embeds_its_fonts_and_svg_keeps_text(tmp_path: Path) -> None:
    plan = straight(len(NAMES), NAMES)
    for file_format in ("pdf", "svg"):
        paths = write_figures(_flight(plan), tmp_path, file_format=file_format)
        assert {path.suffix for path in paths} == {f".{file_format}"}
    for path in tmp_path.glob("*.pdf"):
        written = path.read_bytes()
        assert written.startswith(b"%PDF")
        assert b"/Type3" not in written
        assert b"/FontFile2" in written
        (box,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ", written)
        assert float(box) == pytest.approx(72 * DOUBLE_COLUMN)
    for path in tmp_path.glob("*.svg"):
        texts = "".join(each for each in ET.parse(path).getroot().itertext())  # noqa: S314  # ours
        for name in NAMES[:-2]:
            assert name in texts, (path, name)
        assert "w" * 12 in texts


def test_a_figure_has_the_requested_width_and_resolution(tmp_path: Path) -> None:
    plan = straight(2)
    for width in (SINGLE_COLUMN, 5.0):
        path = rho.save_figure(rho.velocities_figure(plan, width=width), tmp_path / "v.PNG")
        assert imread(path).shape[1] == int(300 * width)
    for draw in (rho.paths_figure, rho.velocities_figure, rho.accelerations_figure):
        for width in (2.9, 21.0, float("nan")):
            with pytest.raises(ValueError, match=r"width: got .*, expected 3 to 20 inches"):
                draw(plan, width=width)


def test_unknown_formats_are_refused(tmp_path: Path) -> None:
    plan = straight(2)
    for name in ("v.gif", "v", "v.png.exe"):
        with pytest.raises(ValueError, match=r"path: got .*, expected a file ending in one of"):
            rho.save_figure(rho.velocities_figure(plan), tmp_path / name)
    with pytest.raises(ValueError, match="format: got 'gif', expected png, pdf, svg"):
        write_figures(plan, tmp_path / "new", file_format="gif")
    assert list(tmp_path.iterdir()) == []


def test_settings_of_matplotlib_change_nothing(tmp_path: Path) -> None:
    plan = straight(2)
    one = rho.save_figure(rho.velocities_figure(plan), tmp_path / "one.svg").read_bytes()
    with rc_context({"font.size": 30, "lines.linewidth": 9, "svg.fonttype": "path"}):
        other = rho.save_figure(rho.velocities_figure(plan), tmp_path / "other.svg").read_bytes()
    assert one == other


def test_the_last_digits_of_a_plan_change_no_pixel(tmp_path: Path) -> None:
    """The last digits differ between processors; they used to change pixels."""
    plan, rng = rho.plan_convex(rho.load_scenario("paper")), np.random.default_rng(0)
    noise = 1.0 + 1e-14 * rng.uniform(-1.0, 1.0, plan.accelerations.shape)
    other = rho.Plan.from_accelerations(plan.scenario, plan.accelerations * noise)
    assert np.any(other.velocities != plan.velocities)
    for draw in (rho.velocities_figure, rho.accelerations_figure):
        seen, again = (_drawn(draw(each)) for each in (plan, other))
        np.testing.assert_array_equal(seen, again)


def _drawn(figure: Figure) -> np.ndarray:
    """Return the rendered figure, red, green and blue from 0 to 1, shape (rows, columns, 3)."""
    canvas: Any = FigureCanvasAgg(figure)  # matplotlib has no types for it
    canvas.draw()
    pixels: np.ndarray = np.asarray(canvas.buffer_rgba())[:, :, :3] / 255.0
    return pixels


def test_overlapping_curves_are_all_visible() -> None:
    """Three curves with the same velocity: their colours alternate along the line."""
    plan = _between(*([[0, 0, z], [20, 3, z]] for z in (1, 2, 3)))
    figure = rho.velocities_figure(plan)
    for ax in figure.axes:
        for line in ax.lines:
            line.set_marker("none")
    pixels = _drawn(figure)
    top = figure.axes[0].get_window_extent()
    rows = slice(int(pixels.shape[0] - top.y1) + 2, int(pixels.shape[0] - top.y0) - 2)
    counts = [
        int(np.sum(np.abs(pixels[rows] - to_rgb(colour)).max(axis=2) < 0.1))
        for colour in vehicle_colours(3)
    ]
    assert min(counts) > 0.5 * max(counts) > 20


def test_the_end_of_a_path_is_visible_within_its_mark(study: Study) -> None:
    """In Fig. 15 the colour of the last window reaches the goals."""
    figure = draw_figure(15, study)
    image = _drawn(figure)
    ax = figure.axes[0]
    assert isinstance(ax, Axes3D)
    goal = study.scenario.vehicles[0].goal.position
    x, y, _ = proj3d.proj_transform(*goal, ax.get_proj())
    column, row = ax.transData.transform((x, y))
    seen = image[image.shape[0] - int(row) - 1, int(column)]
    last = window_colours(len(study.examples[3].windows))[-1]
    np.testing.assert_allclose(seen, to_rgb(last), atol=0.1)


def test_closest_approaches_are_marked(study: Study) -> None:
    plan = study.examples[1].plan
    (sphere,) = plan.scenario.spheres
    ax = Figure().add_subplot()
    draw_distances(ax, drawn(plan), plan.scenario.bodies[0], radius=sphere.radius)
    *marks, ring = (line for line in ax.lines if len(np.asarray(line.get_xdata())) == 1)
    fine = np.linspace(0.0, plan.scenario.grid.duration, 100_001)
    away = np.linalg.norm(plan.motion().at("position", fine) - sphere.center, axis=2)
    assert [float(np.asarray(mark.get_ydata())[0]) for mark in marks] == pytest.approx(
        list(away.min(axis=1)), abs=1e-3
    )
    least = float(np.asarray(ring.get_ydata())[0])
    assert least == pytest.approx(away.min(), abs=1e-3)
    who = plan.scenario.vehicles[int(np.argmin(away.min(axis=1)))].name
    assert str(ring.get_label()) == (
        f"{least:.4g} m at {float(np.asarray(ring.get_xdata())[0]):.4g} s: {who}"
    )


@pytest.mark.slow
def test_a_scene_in_a_notebook_has_no_empty_margin(study: Study) -> None:
    figure = draw_figure(15, study)
    tight = figure.get_tightbbox(FigureCanvasAgg(figure).get_renderer())  # type: ignore[no-untyped-call]
    assert np.all(tight.size <= figure.get_size_inches() + 0.01)


def test_marks_do_not_merge() -> None:
    assert marks_every(50, DOUBLE_COLUMN) == marks_every(50, SINGLE_COLUMN) == 1
    assert marks_every(5000, SINGLE_COLUMN) * 0.6 * 72 * SINGLE_COLUMN / 5000 >= 2.5


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["plan", "paper", "--figures", "new", "--format", "gif"], "'gif' is not one of"),
        (["results", "x.sqlite", "--figures", "new", "--format", "jpg"], "'jpg' is not one of"),
        (["reproduce", "--figures", "new", "--width", "1"], "width: got 1, expected 3 to 20 in"),
        (["simulate", "courier", "--figures", "new", "--width", "nan"], "width: got nan, expected"),
        (["fly", "paper", "--format", "pdf"], "--format: got pdf without --figures, expected"),
        (["plan", "paper", "--width", "4"], "--width: got 4.0 without --figures, expected"),
    ],
)
def test_invalid_figure_arguments_are_refused_before_work(
    words: list[str],
    complaint: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from drake_rho.cli import commands

    def never(*_: object, **__: object) -> None:
        raise AssertionError("worked before all arguments were checked")

    for module, names in (
        ("commands", ("best_plan", "plan_rho", "run_study", "read_or_load")),
        ("planning", ("best_plan", "plan_convex", "plan_rho", "read")),
        ("simulation", ("read",)),
    ):
        for name in names:
            monkeypatch.setattr(f"drake_rho.cli.{module}.{name}", never)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["drake-rho", *words])
    status = status_of(lambda: commands.app(standalone_mode=False))
    out, error = capsys.readouterr()
    assert (status, out) == (2, "")
    assert complaint in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_command_line_writes_the_requested_format(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from drake_rho.cli import commands

    folder = tmp_path / "new"
    words = ["plan", "paper", "--figures", str(folder), "--format", "svg", "--width", "3.5"]
    monkeypatch.setattr(sys, "argv", ["drake-rho", *words])
    assert status_of(lambda: commands.app(standalone_mode=False)) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert f"paths.svg, distances.svg, velocities.svg, accelerations.svg in {folder}" in told
    widths = {ET.parse(path).getroot().get("width") for path in folder.iterdir()}  # noqa: S314
    assert widths == {"252pt"}
