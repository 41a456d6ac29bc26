"""The command `export`: a kept plan in the format of another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drake_rho.cli import described
from drake_rho.cli.console import tell, working
from drake_rho.exports.export import FORMATS, check_export
from drake_rho.exports.export import export as exported
from drake_rho.motion.files import load


def export(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A file kept by 'plan', 'fly' or 'simulate', or exported as json."
        ),
    ],
    format: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="|".join(FORMATS),
            help="Tables of states, JSON that can be read again, polynomials for Crazyswarm2, "
            "Skybrush's CSV, or setpoints for PX4's offboard mode.",
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="A file (.csv, .json; .zip for skybrush) or, for crazyswarm and skybrush, a "
            "folder.",
        ),
    ],
    rate: Annotated[
        float | None,
        typer.Option(help="Samples a second; 20 if not given, and of json the knots alone."),
    ] = None,
) -> int:
    """Write a plan, flight or simulation in another program's format."""
    check_export(output, format, rate)
    flown = load(file)
    with working("exporting"):
        written = exported(flown, output, format=format, rate=rate)
    return tell(described.exported(written), str(written))
