"""`export`: a plan in the format of another program."""

from __future__ import annotations

from pathlib import Path

from drake_rho.exports.crazyswarm import Crazyswarm
from drake_rho.exports.format import Format
from drake_rho.exports.px4 import Px4
from drake_rho.exports.record import Exported
from drake_rho.exports.skybrush import Skybrush
from drake_rho.exports.states import Csv, Json
from drake_rho.motion.plan import Flight, Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.arguments import checked

FORMATS: dict[str, Format] = {
    each.name: each for each in (Csv(), Json(), Crazyswarm(), Skybrush(), Px4())
}
"""All formats by their names."""


TREATMENT = {
    "dynamics": "the motion, with its deviation where a format cannot hold it",
    "goals": "the end of the motion",
    "position": "not in the files of other programs; verified before",
    "velocity": "not in the files of other programs; verified before",
    "acceleration": "not in the files of other programs; verified before",
    "jerk": "not in the files of other programs; verified before",
    "max_speed": "not in the files of other programs; verified before",
    "max_acceleration": "not in the files of other programs; verified before",
    "max_thrust": "not in the files of other programs; verified before",
    "max_tilt": "not in the files of other programs; verified before",
    "max_jerk": "not in the files of other programs; verified before",
    "waypoints": "passed by the motion; not marked",
    "obstacles": "not in the files; what is left of the distance is compared with the deviation",
    "moving obstacles": "as obstacles",
    "late obstacles": "as obstacles",
    "active obstacles": "as obstacles, in the interval of time",
    "separation": "what is left of the distance is compared with the deviation",
    "disturbance": "what is left is compared with the deviation beside the errors",
}
"""What exports say of every kind of requirement."""


@checked
def export(
    flown: Plan | Flight | Simulation, path: str | Path, *, format: str, rate: float | None = None
) -> Exported:
    """Write a motion in the format of another program, whole or not at all.

    `docs/export.md` describes the formats.

    Args:
        flown: a plan, a flight, of which what was flown is written, or a simulation, of which the
            true motion is (not for crazyswarm and px4, which hold what is to be flown).
        path: of a file with the format's ending (.csv for csv and px4, .json, .zip for skybrush),
            or of a folder, for crazyswarm and skybrush. A folder that is there is replaced if it
            holds nothing but files that are written.
        format: csv, json, crazyswarm, skybrush or px4.
        rate: samples a second [1/s], up to 1000; 20 if not given, and of json the knots alone. None
            for crazyswarm, which holds polynomials.

    Returns:
        What was written. Where it is not the motion itself (pieces that were merged, straight lines
        between samples) `deviation` is how far it may be off, and `spare.keeps_clear` tells whether
        vehicles keep clear with that.

    Raises:
        ValueError: the format, the ending, the rate or the kind of motion is none that can be
            written so, or there is no place to write to.
        OSError: it cannot be written in the end.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("courier"))
        >>> written = rho.export(plan, folder / "plan.csv", format="csv", rate=50)
        >>> [file.name for file in written.files]
        ['plan.csv']
    """
    return check_export(path, format, rate).write(flown, Path(path), rate)


def check_export(path: str | Path, format: str, rate: float | None = None) -> Format:
    """The format of a name, if it can be written there.

    Raises:
        ValueError: there is no such format, or the ending or the rate is none of it, or there is no
            place to write to.
    """
    if format not in FORMATS:
        raise ValueError(f"format: got {format!r}, expected one of {', '.join(FORMATS)}")
    FORMATS[format].check(Path(path), rate)
    return FORMATS[format]
