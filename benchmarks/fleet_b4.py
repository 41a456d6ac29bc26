"""Ten vehicles on a circle swap sides under a jerk limit."""

from __future__ import annotations

from rich.console import Console

import drake_rho as rho
from benchmarks.fleets import THIS_PACKAGE
from benchmarks.swaps import ALONE, COLUMNS, METHOD, box, published, shortest
from benchmarks.tables import Goal, Table

STEPS = 60
"""Knots of the flight, whatever its duration."""

BEGIN = 4.0
"""Initial duration of the search [s]."""


def scenario() -> rho.Scenario:
    """Return vehicles on a radius of 10 m, with limits and diameter of MADER's benchmark."""
    limits = rho.Limits(velocity=box(10.0), acceleration=box(20.0), jerk=box(30.0))
    apart = rho.Separation(0.25)
    return rho.circle_swap(
        10, radius=10.0, duration=BEGIN, step=BEGIN / STEPS, limits=limits, separation=apart
    )


def run() -> Table:
    """Find the shortest flight, with the separation and without."""
    with Console().status("the shortest flight"):
        alone = shortest(scenario().without_separation())
        found = shortest(scenario())
    return Table(
        name="fleet_b4",
        title="B4: ten vehicles change sides on a circle of 10 m, jerk limited",
        columns=COLUMNS,
        rows=(
            found.row(THIS_PACKAGE),
            alone.row(ALONE),
            published("MADER, published", "7.7", "77 to 97"),
            published("RMADER, published", "9.7 to 10.9", "100"),
            published("EGO-Swarm, published", "5.3 to 5.6", "38 to 53"),
        ),
        notes=(_WORK, METHOD, _END, _LIMITATIONS),
        goals=(Goal("shortest flight [s]", 4.0, found.duration if found.kept else None),),
    )


_WORK = f"""\
The circle swap of mit-acl/rmader and lis-epfl/multi_agent_pkgs: antipodal goals, velocity up to 10
m/s, acceleration up to 20 m/s², jerk up to 30 m/s³ along each axis, spheres of 0.25 m diameter,
from rest to rest; {STEPS} steps. All vehicles start in one plane, which they
may leave."""

_END = """\
The jerk is limited from rest before the start to rest after the goal, as by the published planners.
One vehicle alone that flies along an axis needs 3.155 s with a jerk that may change at any time:
twice 2 (10 / 30)^½ = 1.155 s, and 5.77 m, from rest to 10 m/s or back, and 0.845 s at that speed in
between. Accelerations that are constant in steps need one step less ([Ruckig](time_ruckig.md))."""

_LIMITATIONS = """\
Limitations. The published planners run during the flight, each vehicle for itself, with delayed
communication, and the times are mean travel times. Here the whole flight is planned at once,
beforehand, its accelerations constant from knot to knot, and all vehicles arrive together. So the
times show the possible gain; they are no race."""
