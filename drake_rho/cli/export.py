"""The command `export`: a saved plan in the format of another program."""

from __future__ import annotations

from typing import Annotated

import typer

from drake_rho.cli.console import tell, working
from drake_rho.cli.options import ResultArgument
from drake_rho.cli.sources import load_result
from drake_rho.formats.export import FORMATS, check_export
from drake_rho.formats.export import export as exported


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
            "mode; qgroundcontrol: a plan of QGroundControl; mavlink: a mission of MAVLink; "
            "waypoints: a table of places and times.",
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="Required. Output: a .csv file for csv, px4 and waypoints, a .json file for json, "
            "a .zip file for skybrush, .plan for qgroundcontrol, .waypoints for mavlink; or a "
            "folder for crazyswarm, skybrush, and missions of several vehicles.",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Samples per second; by default 20, and for json the knots only."),
    ] = None,
) -> int:
    """Write a plan, flight or simulation in another program's format."""
    if output is None:
        raise ValueError("export: got no --output, expected --output PATH, a file or a folder")
    check_export(output, format, rate)
    flown = load_result(file)
    with working("exporting"):
        written = exported(flown, output, format=format, rate=rate)
    document = {
        "path": written.path,
        "files": written.files,
        "content": written.words,
        "deviations_m": dict(zip(written.names, written.deviations.tolist(), strict=True)),
        "keeps_clear": written.spare and bool(written.spare.keeps_clear),
    }
    return tell(document, str(written))
