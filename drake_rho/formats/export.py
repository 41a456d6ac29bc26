"""`export`: write a motion in the file format of another program."""

from __future__ import annotations

from pathlib import Path

from drake_rho.formats.crazyswarm import Crazyswarm
from drake_rho.formats.format import Format
from drake_rho.formats.mavlink import Mavlink
from drake_rho.formats.mcap import Mcap
from drake_rho.formats.px4 import Px4
from drake_rho.formats.qgroundcontrol import QGroundControl
from drake_rho.formats.record import Exported
from drake_rho.formats.skybrush import Skybrush
from drake_rho.formats.skyc import Skyc
from drake_rho.formats.states import Csv, Json
from drake_rho.formats.waypoint_tables import WaypointTables
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.arguments import checked

FORMATS: dict[str, Format] = {
    each.name: each
    for each in (
        *(Csv(), Json(), Crazyswarm(), Skybrush(), Px4(), Skyc(), Mcap()),
        *(QGroundControl(), Mavlink(), WaypointTables()),
    )
}
"""Formats by name."""


@checked
def export(
    flown: Flown,
    path: str | Path,
    *,
    format: str | None = None,
    rate: float | None = None,
    heading: Heading | None = None,
) -> Exported:
    """Write a motion in the format of another program, completely or not at all.

    `docs/export.md` describes the formats.

    Args:
        flown: a plan; a flight, whose motion as flown is written; a simulation, whose true motion
            is written (only with csv, json, skybrush and mcap: the others hold motions to be
            flown); or trajectories for a scenario (only with csv, px4 and mcap).
        path: path of a file with the format's ending (.csv for csv, px4 and waypoints, .json, .zip
            for skybrush, .skyc, .mcap, .plan for qgroundcontrol, .waypoints for mavlink), or of a
            folder, for crazyswarm, skybrush, mcap, and missions and tables of waypoints. An
            existing folder is replaced if it holds only files that are to be written.
        format: csv, json, crazyswarm, skybrush, px4, skyc, mcap, qgroundcontrol, mavlink or
            waypoints; by default the only one with the path's ending.
        rate: samples per second [1/s], up to 1000. If not given, 20, and for json the knots alone.
            Not allowed for formats without samples: crazyswarm, skyc, missions.
        heading: "velocity", an angle from the x axis, anticlockwise [rad], the x, y, z of a point
            to look at [m], or a mapping from names of vehicles to these; along the x axis where
            none is given. px4, skyc and mcap hold any of them, crazyswarm angles.

    Returns:
        A record of the export. If the file does not hold the exact motion (because pieces were
        merged or samples are joined by straight lines), `deviation` bounds the distance from the
        motion, and `spare.keeps_clear` says whether all required distances still hold.

    Raises:
        ValueError: the format, the ending, the rate, the heading or the kind of motion is not
            supported, the path cannot be written to, or the extra `ros` is not installed, for mcap.
        OSError: writing failed.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("courier"))
        >>> written = rho.export(plan, folder / "plan.csv", format="csv", rate=50)
        >>> [file.name for file in written.files]
        ['plan.csv']
    """
    form = check_export(path, format, rate, heading)
    if isinstance(flown, Trajectories) and not form.any_motion:
        able = ", ".join(name for name, each in FORMATS.items() if each.any_motion)
        raise ValueError(f"format: got {form.name} for trajectories, expected one of {able}")
    return form.write(flown, Path(path), rate, heading)


def check_export(
    path: str | Path,
    format: str | None = None,
    rate: float | None = None,
    heading: Heading | None = None,
) -> Format:
    """Return the format with a name, after checking that it can be written to a path.

    Raises:
        ValueError: there is no such format, the format does not support the ending, the rate or
            the heading, no or several formats have the ending if none is named, the path cannot be
            written to, or the extra that the format needs is not installed.
    """
    if format is None:
        format = _of_ending(Path(path))
    if format not in FORMATS:
        raise ValueError(f"format: got {format!r}, expected one of {', '.join(FORMATS)}")
    FORMATS[format].check(Path(path), rate, heading)
    return FORMATS[format]


def _of_ending(path: Path) -> str:
    """Return the name of the only format with a path's ending.

    Raises:
        ValueError: there is none, or there are several.
    """
    found = [name for name, each in FORMATS.items() if path.suffix.lower() in each.endings]
    if len(found) != 1:
        expected = f"one of {', '.join(found or FORMATS)}"
        raise ValueError(f"format: got none for {str(path)!r}, expected {expected}")
    return found[0]
