"""The commands `export` and `formats`: plans in the formats of other programs."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from drake_rho.cli.checks import options_named
from drake_rho.cli.console import answer, plain_table, tell, working
from drake_rho.cli.headings import HeadingOption, heading_of
from drake_rho.cli.options import (
    MaxAccelerationOption,
    ResultArgument,
    TopicOption,
    TrajectoriesOption,
)
from drake_rho.cli.sources import load_any
from drake_rho.formats.export import FORMATS, check_export
from drake_rho.formats.export import export as exported
from drake_rho.formats.format import Format
from drake_rho.formats.only_read import ONLY_READ

_NAMED = partial(
    options_named, path="--output", format="--format", rate="--rate", heading="--heading"
)


def export(
    file: ResultArgument,
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="FORMAT",
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
    heading: HeadingOption = None,
    scenario: TrajectoriesOption = None,
    max_acceleration: MaxAccelerationOption = None,
    topic: TopicOption = None,
) -> int:
    """Write a result or trajectories in another program's format."""
    if output is None:
        raise ValueError("export: got no --output, expected --output PATH, a file or a folder")
    turned = heading_of(heading)
    with _NAMED():
        check_export(output, format, rate, turned)
    flown = load_any(file, scenario, max_acceleration, topic)
    with working("exporting"), _NAMED():
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
    """List the formats that are written or read."""
    table = plain_table("format", "paths", "holds", "headings", "read by", texts=5)
    for name, each in FORMATS.items():
        table.add_row(
            name, ", ".join(_paths(each)), each.content, each.heading, each.read_by or "-"
        )
    read = plain_table("only read", "paths", "holds", "read by", texts=4)
    for one in ONLY_READ:
        read.add_row(one.name, ", ".join(one.endings), one.content, one.read_by)
    rows = [
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
    return answer({"formats": rows, "only_read": ONLY_READ}, table, "", read)


def _paths(format: Format) -> list[str]:
    """Return the kinds of paths that a format is written to."""
    return [*format.endings, *(["folder"] if format.folder else [])]
