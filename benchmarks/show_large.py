"""A thousand vehicles through five formations and back to their own pads."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import drake_rho as rho
from benchmarks.sampling import sample
from benchmarks.show_random import PACKAGES
from benchmarks.show_scenes import APART, SPACING
from benchmarks.stopwatch import Stopwatch
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


def run() -> Table:
    """Plan the show in two processes, and judge it by `rho.verify` and dense samples."""
    shown, watch = show(), Stopwatch()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        plan = rho.plan_show(shown, solver=rho.Daqp(), executor=processes)
    planning = watch.taken()
    watch = Stopwatch()
    report = rho.verify(plan)
    verifying = watch.taken()
    least = sample(plan, SAMPLES).least
    certificate = rho.certify_show(shown, plan)
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
            f"processor time), `rho.verify` took {verifying.processor:.1f} s. The show lasts "
            f"{plan.scenario.grid.duration:g} s; its sum of squared distances is at most "
            f"{100.0 * certificate.gap:.2g} % above the least. Samples: {SAMPLES // 10} a step.",
        ),
        goals=(
            Goal("wall time of planning on two cores [s]", 120.0, planning.wall),
            Goal("checks violated", 0, sum(not each.holds for each in report.checks)),
            Goal(
                "separation less the least sampled distance [m]",
                WITHIN,
                APART.distance - least,
            ),
        ),
        packages=PACKAGES,
    )
