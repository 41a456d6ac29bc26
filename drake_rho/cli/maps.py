"""The command `map`: content of a map's file."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from drake_rho.cli.checks import check_writable
from drake_rho.cli.console import answer, plain_table, working
from drake_rho.scenario.maps import mesh_files, octomaps, point_clouds, world_xml
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.octomaps import Leaves, read_leaves
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.worlds import World, load_world

_FIGURES = (".png", ".pdf", ".svg")
_KINDS = {"octomap": "an OctoMap", "points": "a point cloud", "mesh": "a mesh", "world": "a world"}
_ENDINGS = dict.fromkeys(
    (*octomaps.ENDINGS, *point_clouds.ENDINGS, *mesh_files.ENDINGS, *world_xml.ENDINGS)
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Mapped:
    """Content of a map's file."""

    file: str
    """path of the file"""
    kind: str
    """kind of the map: octomap, points, mesh or world"""
    lower_m: list[float]
    """least coordinates of the obstacle, x, y and z"""
    upper_m: list[float]
    """greatest coordinates of the obstacle, x, y and z"""
    resolution_m: float | None = None
    """side of the cells; None for a mesh or a world"""
    cells: int | None = None
    """number of cells of the obstacle; None for a mesh or a world"""
    occupied_cells: int | None = None
    """number of occupied cells of an OctoMap; None for other maps"""
    free_cells: int | None = None
    """number of free cells of an OctoMap; None for other maps"""
    unknown_cells: int | None = None
    """number of unobserved cells in an OctoMap's bounding box; None for other maps"""
    triangles: int | None = None
    """number of triangles; None unless it is a mesh"""
    vertices: int | None = None
    """number of vertices; None unless it is a mesh"""
    watertight: bool | None = None
    """true if a mesh has an inside, false if it is a surface; None unless it is a mesh"""
    moved_vertices: int | None = None
    """number of vertices of a mesh that count as one with others next to them; None unless it is a
    mesh"""
    obstacles: list[str] | None = None
    """names and shapes of the obstacles of a world; None for other maps"""
    skipped: list[str] | None = None
    """elements of a world that place no obstacle; None for other maps"""
    parts: int
    """number of convex parts in the planners' cover of the map"""
    beyond_m: float
    """largest distance of these parts from the map; 0 if their union is the map"""
    figure: str | None = None
    """path of the figure; None if none was drawn"""


def map(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help=f"The file of a map: an OctoMap ({', '.join(octomaps.ENDINGS)}), a point cloud "
            f"({', '.join(point_clouds.ENDINGS)}), a mesh ({', '.join(mesh_files.ENDINGS)}) "
            f"or a world ({', '.join(world_xml.ENDINGS)}).",
        ),
    ],
    unknown: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(octomaps.MEANINGS),
            help="Treatment of unobserved cells of an OctoMap; free by default.",
        ),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="Side of the cells of a point cloud, in metres; required for a point cloud."
        ),
    ] = None,
    scale: Annotated[
        float | None, typer.Option(help="Length of the unit of a mesh in metres; 1 by default.")
    ] = None,
    resource_path: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of models that a world refers to by their names; may be repeated.",
        ),
    ] = None,
    figure: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Draw the map to this file (.png, .pdf or .svg)."),
    ] = None,
) -> int:
    """Describe the file of a map, and draw it."""
    check_writable(figure, _FIGURES, "--figure")
    leaves = None
    with working("reading") as work:
        kind = _kind_of(file, unknown, resolution, scale, resource_path)
        if kind == "world":
            if figure is not None:
                raise ValueError(
                    f"--figure: got {figure!r}, expected a map, not the world {file!r}"
                )
            world = _world(file, load_world(file, resource_path=resource_path or ()))
            return answer(world, _table(world))
        if kind == "octomap":
            work("reading the octree")
            leaves = read_leaves(file)
            found: Map = Voxels.from_octomap(file, _meaning(unknown))
        elif kind == "points":
            found = Voxels.from_points(file, _needed(file, resolution))
        else:
            found = Mesh.load(file, 1.0 if scale is None else scale)
        work("covering by convex parts")
        document = _document(file, kind, found, leaves, figure)
    if figure is not None:
        # importing matplotlib takes longer than most commands
        from drake_rho.display.plots.maps import map_figure
        from drake_rho.display.plots.publish import save_figure

        with working("drawing"):
            save_figure(map_figure(found), figure)
    written = [] if figure is None else [f"drawn in {figure}"]
    return answer(document, _table(document), *written)


def _kind_of(
    file: str,
    unknown: str | None,
    resolution: float | None,
    scale: float | None,
    resource_path: list[str] | None,
) -> Literal["octomap", "points", "mesh", "world"]:
    """Return the kind of a map by its ending; a PLY file with a resolution is a point cloud.

    Raises:
        ValueError: no kind of map has this ending, or an option is for maps of another kind.
    """
    ending = Path(file).suffix.lower()
    kind: Literal["octomap", "points", "mesh", "world"]
    if ending in octomaps.ENDINGS:
        kind = "octomap"
    elif ending in mesh_files.ENDINGS and (ending != ".ply" or resolution is None):
        kind = "mesh"
    elif ending in point_clouds.ENDINGS:
        kind = "points"
    elif ending in world_xml.ENDINGS:
        kind = "world"
    else:
        raise ValueError(f"{file!r}: got no map, expected a file ending in {', '.join(_ENDINGS)}")
    of_kinds = (
        ("--unknown", unknown, "octomap"),
        ("--scale", scale, "mesh"),
        ("--resolution", resolution, "points"),
        ("--resource-path", ", ".join(resource_path) if resource_path else None, "world"),
    )
    for option, given, of in of_kinds:
        if given is not None and of != kind:
            raise ValueError(f"{option}: got {given}, expected {_KINDS[of]}, not {file!r}")
    return kind


def _meaning(unknown: str | None) -> Literal["free", "occupied"]:
    """Return the treatment of unobserved cells.

    Raises:
        ValueError: the option has another value.
    """
    if unknown in (None, "free"):
        return "free"
    if unknown == "occupied":
        return "occupied"
    raise ValueError(f"--unknown: got {unknown!r}, expected free or occupied")


def _needed(file: str, resolution: float | None) -> float:
    """Return the resolution of a point cloud.

    Raises:
        ValueError: the option is missing.
    """
    if resolution is None:
        expected = "--resolution, the side of the cells that are to hold the points"
        raise ValueError(f"{file!r}: got no --resolution, expected {expected}")
    return resolution


def _document(
    file: str, kind: str, found: Map, leaves: Leaves | None, figure: str | None
) -> Mapped:
    """Return the description of a map."""
    voxels = found if isinstance(found, Voxels) else None
    mesh = found if isinstance(found, Mesh) else None
    return Mapped(
        file=file,
        kind=kind,
        lower_m=(found.center - found.extent).tolist(),
        upper_m=(found.center + found.extent).tolist(),
        resolution_m=None if voxels is None else voxels.resolution,
        cells=None if voxels is None else len(voxels.occupied),
        occupied_cells=None if leaves is None else leaves.occupied,
        free_cells=None if leaves is None else leaves.free,
        unknown_cells=None if leaves is None else leaves.unknown,
        triangles=None if mesh is None else len(mesh.triangles),
        vertices=None if mesh is None else len(mesh.vertices),
        watertight=None if mesh is None else mesh.is_watertight,
        moved_vertices=None if mesh is None else mesh.moved_vertices,
        parts=len(found.cover) if isinstance(found.cover, Parts) else 1,
        beyond_m=found.cover_excess,
        figure=figure,
    )


def _world(file: str, world: World) -> Mapped:
    """Return the description of a world."""
    shapes = [each.shape for each in world]
    covers = [each.cover for each in shapes]
    return Mapped(
        file=file,
        kind="world",
        lower_m=np.min([each.center - each.extent for each in shapes], axis=0).tolist(),
        upper_m=np.max([each.center + each.extent for each in shapes], axis=0).tolist(),
        obstacles=[f"{each.name}: {each.shape}" for each in world],
        skipped=list(world.skipped),
        parts=sum(len(each) if isinstance(each, Parts) else 1 for each in covers),
        beyond_m=max(each.cover_excess if isinstance(each, Map) else 0.0 for each in shapes),
    )


def _table(document: Mapped) -> Table:
    """Return the description as a table of two columns."""
    table = plain_table()
    for name, text in _rows(document).items():
        table.add_row(name, escape(text))
    return table


def _rows(document: Mapped) -> dict[str, str]:
    corners = zip(document.lower_m, document.upper_m, strict=True)
    spans = ", ".join(f"{low:g} to {high:g}" for low, high in corners)
    rows = {"extent": f"{spans} m"}
    if document.cells is not None:
        rows["obstacle"] = f"{document.cells} cells of {document.resolution_m:g} m"
    if document.unknown_cells is not None:
        known = f"{document.occupied_cells} occupied, {document.free_cells} free"
        rows["bounding box"] = f"{known} and {document.unknown_cells} unknown cells"
    if document.triangles is not None:
        kind = "watertight, a solid" if document.watertight else "not watertight, a surface"
        rows["obstacle"] = f"{document.triangles} triangles, {document.vertices} vertices; {kind}"
    if document.moved_vertices:
        rows["rounding"] = f"{document.moved_vertices} vertices count as one with others beside"
    for number, text in enumerate(document.obstacles or (), start=1):
        rows[f"obstacle {number}"] = text
    if document.skipped:
        counts = Counter(text.split()[0] for text in document.skipped)
        rows["skipped"] = ", ".join(f"{number} {kind}" for kind, number in counts.items())
    beyond = f"up to {document.beyond_m:.3g} m beyond the map" if document.beyond_m else "exact"
    rows["cover"] = f"{document.parts} convex part{'s'[: document.parts != 1]}, {beyond}"
    return rows
