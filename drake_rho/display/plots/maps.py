"""Maps drawn on given axes, in space and from above, and the figure of a map alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.obstacle_snapshots import Snapshot
from drake_rho.display.common.style import HIGHEST, LOWEST
from drake_rho.display.plots.axes3d import Area, SceneAxes, fit_scene, frame_scene
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_width
from drake_rho.display.plots.layout import EDGE, add_title, grow
from drake_rho.display.plots.publish import styled
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.voxels import Voxels

_MOST_VECTORS = 2000
"""Largest number of faces of a map that are drawn as vectors."""
_FAINT_MAP = 0.15
"""Opacity of maps at secondary positions."""
_LEFT = 0.5
"""Part of the figure's width for the picture in space."""
_LABELS = 0.5
"""Space for ticks and labels beside and below the view from above [in]."""
_BAR, _BESIDE = 0.1, 0.55
"""Width of the colour bar, and space for its ticks and label [in]."""
_THINNEST = 0.1
"""Least side of the view from above, over the longest side of the map."""
_HIGHEST = 0.62
"""Largest height of the pictures, over the figure's width."""
_INTERVALS = 5
"""Largest number of tick intervals of an axis."""


@styled
def map_figure(solid: Map, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Draw a map in space and, beside it, from above, with a colour bar of heights.

    Args:
        solid: cells or a mesh.
        width: width of the figure [in], see `paths_figure`.

    Raises:
        ValueError: the text would be illegible at the width.
    """
    figure = Figure(figsize=(check_width(width), width))
    shown = Snapshot(solid, solid.center, 1)
    scene = figure.add_subplot(axes_class=SceneAxes)
    frame_scene(scene, solid.center[None], [shown])
    most = _HIGHEST * width
    box = fit_scene(figure, scene, Area(EDGE, 2 * EDGE, _LEFT * width - EDGE, most))
    draw_map(scene, shown)
    left = _LEFT * width + _LABELS
    wide = width - left - _BAR - _BESIDE - EDGE
    sides = np.maximum(solid.extent[:2], _THINNEST * solid.extent.max())
    high = float(np.clip(wide * sides[1] / sides[0], 1.0, most - _LABELS))
    missing = max(0.0, high + _LABELS - box.height) / 2.0
    grow(figure, below=missing, above=missing)
    high = max(high, box.height - _LABELS)
    place = np.array([left, 2 * EDGE + _LABELS, wide, high])
    size = np.tile(figure.get_size_inches(), 2)
    above = figure.add_axes(tuple(place / size))
    draw_from_above(above, shown)
    place[[0, 2]] = width - _BAR - _BESIDE, _BAR
    _add_bar(figure, figure.add_axes(tuple(place / size)), solid)
    grow(figure, above=2 * EDGE)
    add_title(figure, _described(shown))
    return figure


def draw_map(ax: Axes3D, shown: Snapshot) -> Poly3DCollection:
    """Draw a map, coloured by height, opaque unless it is faint.

    In vector graphics, a map with many faces is rasterised.
    """
    faces = shown.faces
    if faces is None:
        raise ValueError(f"shown: got {shown.shape}, expected a map")
    polygons = faces.in_bands()
    colours = faces.colours(polygons.mean(axis=1))
    body = Poly3DCollection(
        shown.center + polygons,
        facecolors=colours,
        edgecolors=colours,
        shade=shown.between is None,
        linewidth=0.0 if shown.faint else 0.3,  # hides seams between faces
        alpha=_FAINT_MAP if shown.faint else None,
        rasterized=len(polygons) > _MOST_VECTORS,
    )
    ax.add_collection3d(body)
    return body


def map_notes(shown: Sequence[Snapshot]) -> list[str]:
    """Return notes that explain how maps are drawn, one line each; none without maps."""
    maps = [(each, each.faces) for each in shown if each.faces is not None]
    if not maps:
        return []
    notes = ["maps: paler the higher; paths behind them are faint"]
    if (between := maps[0][0].between) is not None:
        notes = [
            "seen from above, since maps hide the paths from the side; of maps, only what is at "
            f"the heights of the flights, {between[0]:.2f} to {between[1]:.2f} m"
        ]
    merged = max(faces.merged for _, faces in maps)
    return notes + ([f"maps are drawn in cells of {merged:.2g} m"] if merged > 0.0 else [])


def draw_from_above(ax: Axes, shown: Snapshot) -> PolyCollection:
    """Draw a map seen from above, higher faces over lower ones."""
    faces = shown.faces
    if faces is None:
        raise ValueError(f"shown: got {shown.shape}, expected a map")
    middles = faces.corners.mean(axis=1)
    order = np.argsort(middles[:, 2], kind="stable")
    colours = faces.colours(middles[order])
    body = PolyCollection(
        list((shown.center + faces.corners[order])[..., :2]),
        facecolors=colours,
        edgecolors=colours,  # so that vertical walls are visible as lines
        linewidth=0.3,
        rasterized=len(colours) > _MOST_VECTORS,
    )
    ax.add_collection(body)
    extent = np.maximum(shown.shape.extent[:2], _THINNEST * shown.shape.extent.max())
    lower, upper = shown.center[:2] - 1.04 * extent, shown.center[:2] + 1.04 * extent
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect("equal")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(_INTERVALS, steps=[1, 2, 5, 10]))
    return body


def _add_bar(figure: Figure, ax: Axes, solid: Map) -> None:
    """Draw the colour bar of heights on axes."""
    low, high = solid.center[2] - solid.extent[2], solid.center[2] + solid.extent[2]
    if high <= low:  # a single height has the middle colour
        low, high = low - 0.5, high + 0.5
    colours = LinearSegmentedColormap.from_list("heights", [LOWEST, HIGHEST])
    bar = figure.colorbar(ScalarMappable(Normalize(low, high), colours), cax=ax)
    bar.set_label("z [m]")
    bar.ax.yaxis.set_major_locator(MaxNLocator(_INTERVALS, steps=[1, 2, 5, 10]))


def _described(shown: Snapshot) -> str:
    """Return the title: the file, the number of cells or triangles, and the extent."""
    solid = shown.shape
    words = list[str]()
    if isinstance(solid, Voxels):
        words.append(f"{len(solid.occupied):,} cells of {solid.resolution:g} m")
    elif isinstance(solid, Mesh):
        kind = "watertight mesh" if solid.is_watertight else "surface"
        words.append(f"{kind} of {len(solid.triangles):,} triangles")
    source = getattr(solid, "source", None)
    if source is not None:
        words.insert(0, as_text(brief(Path(source.path).name)))
    words.append(" x ".join(f"{2.0 * side:.3g}" for side in solid.extent) + " m")
    if shown.faces is not None and shown.faces.merged > 0.0:
        words.append(f"drawn in cells of {shown.faces.merged:.2g} m")
    return ", ".join(words)
