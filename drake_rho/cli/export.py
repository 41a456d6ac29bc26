"""The commands `export` and `formats`: plans in the formats of other programs."""

from __future__ import annotations

from typing import Annotated

import typer

from drake_rho.cli.console import answer, plain_table, tell, working
from drake_rho.cli.options import ResultArgument
from drake_rho.cli.sources import load_result
from drake_rho.formats.export import FORMATS, check_export
from drake_rho.formats.export import export as exported
from drake_rho.formats.format import Format
from drake_rho.formats.load import READERS
from drake_rho.motion.headings import Direction, Heading


def export(
    file: ResultArgument,
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="|".join(FORMATS),
            help="By default that of the output's ending, if only one has it. csv: a table of "
            "states; json: a plan that drake-rho can read again; crazyswarm: polynomials for "
            "Crazyswarm2; skybrush: CSV files for Skybrush; px4: setpoints for PX4's offboard "
            "mode; skyc: a compiled show for Skybrush; mcap: a rosbag2 of ROS 2; qgroundcontrol: "
            "a plan of QGroundControl; mavlink: a mission of MAVLink; waypoints: a table of places "
            "and times.",
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="Required. Output: a .csv file for csv, px4 and waypoints, a .json file for json, "
            "a .zip file for skybrush, .skyc, .mcap, .plan for qgroundcontrol, .waypoints for "
            "mavlink; or a folder for crazyswarm, skybrush, mcap, missions and waypoint tables.",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Samples per second; by default 20, and for json the knots only."),
    ] = None,
    heading: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]HEADING",
            help="velocity, an angle from the x axis, anticlockwise, in radians, or a point X,Y,Z "
            "to look at; with NAME=, repeatable, that of one vehicle. Along the x axis by default.",
        ),
    ] = None,
) -> int:
    """Write a plan, flight or simulation in another program's format."""
    if output is None:
        raise ValueError("export: got no --output, expected --output PATH, a file or a folder")
    turned = _heading_of(heading or [])
    check_export(output, format, rate, turned)
    flown = load_result(file)
    with working("exporting"):
        written = exported(flown, output, format=format, rate=rate, heading=turned)
    document = {
        "path": written.path,
        "files": written.files,
        "content": written.words,
        "deviations_m": dict(zip(written.names, written.deviations.tolist(), strict=True)),
        "keeps_clear": written.spare and bool(written.spare.keeps_clear),
    }
    return tell(document, str(written))


def formats() -> int:
    """List the formats that are written and read."""
    table = plain_table("format", "paths", "holds", "headings", "read by", texts=5)
    for name, each in FORMATS.items():
        table.add_row(
            name, ", ".join(_paths(each)), each.content, each.heading, each.read_by or "-"
        )
    only_read = [each for each in READERS if each.name not in FORMATS]
    for reader in only_read:
        table.add_row(reader.name, "(read only)", reader.content, "-", reader.read_by)
    rows: list[dict[str, object]] = [
        {
            "name": name,
            "endings": each.endings,
            "folder": each.folder,
            "rate": each.rated,
            "content": each.content,
            "headings": each.heading,
            "read_by": each.read_by or None,
        }
        for name, each in FORMATS.items()
    ]
    rows += [
        {"name": each.name, "endings": (), "folder": False, "rate": each.rated}
        | {"content": each.content, "headings": "none", "read_by": each.read_by}
        for each in only_read
    ]
    return answer({"formats": rows}, table)


def _paths(format: Format) -> list[str]:
    """Return the kinds of paths that a format is written to."""
    return [*format.endings, *(["folder"] if format.folder else [])]


def _heading_of(words: list[str]) -> Heading | None:
    """Return the heading that options describe: one for all, or one of each named vehicle.

    Raises:
        ValueError: there are several for all vehicles, or for one.
    """
    given = [each.rpartition("=") for each in words]
    names = [name for name, _, _ in given]
    if len(set(names)) < len(names) or ("" in names and len(names) > 1):
        expected = "one, or one NAME=HEADING for each of some vehicles"
        raise ValueError(f"--heading: got {' and '.join(words)}, expected {expected}")
    found = {name: _direction_of(text) for name, _, text in given}
    return found.get("", found or None)


def _direction_of(text: str) -> Direction:
    """Return the direction that a text describes; `check_export` refuses invalid ones."""
    try:
        numbers = [float(each) for each in text.split(",")]
    except ValueError:
        return text  # type: ignore[return-value]  # a word, valid or not
    return numbers[0] if len(numbers) == 1 else numbers
