"""A thousand vehicles through five formations and back to their own pads."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import drake_rho as rho
from benchmarks.sampling import sample
from benchmarks.show_random import PACKAGES
from benchmarks.show_scenes import APART, SPACING
from benchmarks.stopwatch import Stopwatch, Taken
from benchmarks.tables import Goal, Table
from drake_rho.shows.formations import AnyFormation

WITHIN = 1e-6
"""Violation of the separation that counts as rounding [m]."""

SAMPLES = 200
"""Samples of every step, a tenth of which is taken of more than a thousand vehicles."""


def show(side: int = 32) -> rho.Show:
    """Return the show of side² vehicles."""
    forms, count, wide = rho.formations, side**2, SPACING * side
    cube = int(count ** (1 / 3) + 1e-9)
    above = [0.0, 0.0, 20.0 + wide / 2.0]
    formations: dict[str, AnyFormation] = {
        "sphere": forms.Sphere(count, 0.45 * wide, center=above),
        "wall": forms.Grid(
            side, side, spacing=SPACING, center=above, rotation=[1.5707963267948966, 0.0, 0.0]
        ),
        "disc": forms.Grid(side, side, spacing=SPACING, center=above),
        "cube": forms.Grid(cube, cube, cube, spacing=SPACING * 1.15, center=above),
        "ring": forms.Ring(count // 2, SPACING * count / 12.0, center=above),
    }
    return rho.Show(
        f"{count} vehicles",
        forms.Grid(side, side, spacing=2.0),
        [rho.Scene(name, each, hold=3.0) for name, each in formations.items()],
        rho.Limits(max_speed=8.0, max_acceleration=4.0),
        APART,
        take_off=rho.TakeOff(4.0),
    )


@dataclasses.dataclass(frozen=True)
class Judged:
    """Plan of a show, judged by `rho.verify` and dense samples."""

    plan: rho.Plan
    """plan of the whole show"""
    certificate: rho.ShowCertificate
    """bounds of its assignment and of its transitions"""
    violated: int
    """number of violated checks"""
    least: float
    """least distance of two vehicles by samples, with downwash [m]"""
    planning: Taken
    """time of planning in two processes"""
    verifying: Taken
    """time of `rho.verify`"""


def judged(shown: rho.Show) -> Judged:
    """Plan a show in two processes, and judge it."""
    watch = Stopwatch()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        plan = rho.plan_show(shown, solver=rho.Daqp(), executor=processes)
    planning, watch = watch.taken(), Stopwatch()
    violated = sum(not each.holds for each in rho.verify(plan).checks)
    verifying, least = watch.taken(), sample(plan, SAMPLES).least
    return Judged(plan, rho.certify_show(shown, plan), violated, least, planning, verifying)


def run() -> Table:
    """Plan the show of 1024 vehicles, and judge it."""
    shown = show()
    found = judged(shown)
    certificate, planning = found.certificate, found.planning
    rows = tuple(
        (each.scene, each.duration, each.bound, each.any_assignment)
        for each in certificate.transitions
    )
    return Table(
        name="show_large",
        title=f"A show of {shown.name}",
        columns=("transition to", "time [s]", "least of its flights [s]", "of any assignment [s]"),
        rows=rows,
        notes=(
            f"Two processes planned it in {planning.wall:.0f} s ({planning.processor:.0f} s of "
            f"processor time), `rho.verify` took {found.verifying.processor:.1f} s. The show lasts "
            f"{found.plan.scenario.grid.duration:g} s; its sum of squared distances is at most "
            f"{100.0 * certificate.gap:.2g} % above the least. Samples: {SAMPLES // 10} a step.",
        ),
        goals=(
            Goal("wall time of planning on two cores [s]", 120.0, planning.wall),
            Goal("checks violated", 0, found.violated),
            Goal(
                "separation less the least sampled distance [m]",
                WITHIN,
                APART.distance - found.least,
            ),
        ),
        packages=PACKAGES,
    )
