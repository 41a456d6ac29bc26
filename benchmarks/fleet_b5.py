"""Twenty vehicles on a circle swap sides, as in OpenSCvx's example of several agents."""

from __future__ import annotations

from rich.console import Console

import drake_rho as rho
from benchmarks.fleets import THIS_PACKAGE
from benchmarks.swaps import ALONE, COLUMNS, METHOD, box, shortest
from benchmarks.tables import Goal, Table

STEPS = 50
"""Knots of the flight, whatever its duration."""

BEGIN = 5.0
"""Longest duration allowed, at which the search begins [s]."""


def scenario() -> rho.Scenario:
    """Return vehicles on a radius of 5 m."""
    limits = rho.Limits(velocity=box(8.0), acceleration=box(5.0))
    apart = rho.Separation(0.25)
    return rho.circle_swap(
        20, radius=5.0, duration=BEGIN, step=BEGIN / STEPS, limits=limits, separation=apart
    )


def run() -> Table:
    """Find the shortest flight, with the separation and without."""
    with Console().status("the shortest flight"):
        alone = shortest(scenario().without_separation())
        found = shortest(scenario())
    return Table(
        name="fleet_b5",
        title="B5: twenty vehicles change sides on a circle of 5 m",
        columns=COLUMNS,
        rows=(found.row(THIS_PACKAGE), alone.row(ALONE)),
        notes=(_WORK, METHOD, _LIMITATIONS),
        goals=(Goal("shortest flight [s]", BEGIN, found.duration if found.kept else None),),
    )


_WORK = f"""\
Antipodal goals, velocity up to 8 m/s and acceleration up to 5 m/s² along each axis, 0.25 m apart,
from rest to rest, at most {BEGIN:g} s; {STEPS} steps. All vehicles start in one plane, which they
may leave."""

_LIMITATIONS = """\
Limitations. OpenSCvx, whose example this is, was not run here, and no figure of it is published. A
single vehicle on an axis needs 2 (10 / 5)^½ = 2.828 s if it may change its acceleration at any
time; here it is constant between knots."""
