"""The peak of the tube's radius beside the lower bound for any sampled feedback."""

from __future__ import annotations

import numpy as np

import drake_rho as rho
from benchmarks.tables import Cell, Goal, Table

DELAYS = (0, 1, 2)
SAMPLES = (0.5, 0.1, 0.02)
"""Delay d in samples, and sample δ [s]."""

WIND, SECONDS = 1.0, 20.0
"""Wind W [m/s²] and the duration of the flight [s]."""

LIMIT = 10.0
"""Acceleration limit [W], of which the feedback may use a share."""

SHARES = (0.12, 0.15, 0.2, 0.3, 0.5, 1.0)

ENOUGH = 0.5
"""Share for which the goal counts: the default."""

COLUMNS = (
    "delay_samples",
    "share",
    *(f"peak_m_at_{sample:g}_s" for sample in SAMPLES),
    "peak_over_bound",
    "feedback_over_wind",
)


def run() -> Table:
    """Search the gains for every delay, share and sample."""
    rows: list[tuple[Cell, ...]] = []
    free = []
    for delay in DELAYS:
        for share in SHARES:
            tubes = [tube(delay, share, sample) for sample in SAMPLES]
            ratio = max(map(over_bound, tubes))
            feedback = float(tubes[-1].acceleration_over(0.0, SECONDS)[0]) / WIND
            rows.append((delay, share, *map(peak, tubes), ratio, feedback))
            if delay == 0 and share >= ENOUGH:
                free.append(ratio)
    return Table(
        name="flight_radius",
        title="The radius of the tube, with wind alone",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_ABOUT, _LIMITATIONS),
        goals=(
            Goal(f"peak / bound, no delay, share of {ENOUGH:g} of {LIMIT:g} W", 2.05, max(free)),
        ),
    )


def tube(delay: int, share: float, sample: float) -> rho.ErrorTube:
    """Return the tube of one long flight whose acceleration limit is `LIMIT` times the wind."""
    start, goal = rho.State([0, 0, 0]), rho.State([1, 0, 0])
    limits = rho.Limits(max_acceleration=LIMIT * WIND)
    around = rho.Disturbance(WIND, feedback_every=sample, delay=delay, share=share)
    scenario = rho.Scenario(
        "one vehicle",
        rho.Grid.lasting(SECONDS, step=0.5),
        [rho.Vehicle("vehicle", start, goal)],
        limits,
        disturbance=around,
    )
    return rho.error_tube(scenario)


def peak(tube: rho.ErrorTube) -> float:
    """Return the largest radius of the position [m], evaluated ten times a sample."""
    count = 10 * tube.samples + 1
    return float(tube.position(np.linspace(tube.grid.start, tube.grid.end, count)).max())


def over_bound(tube: rho.ErrorTube) -> float:
    """Return the peak over (1 + d)² δ² W / 2, the drift by wind before any feedback can answer."""
    unanswered = (1.0 + tube.disturbance.delay) * tube.sample
    return peak(tube) / (unanswered**2 * tube.disturbance.acceleration / 2.0)


_ABOUT = f"""\
Peaks of ρ_p over {SECONDS:g} s with W = {WIND:g} m/s² and no errors of the estimate, with the
gains that `rho.error_tube` finds within a share of the limit, {LIMIT:g} W. Wind of the last 1 + d
samples is not yet answered by any feedback and drives a vehicle by (1 + d)² δ² W / 2, so no
sampled feedback has a smaller peak; peak over bound is the largest of the three samples. The last
column is the largest feedback at δ = {SAMPLES[-1]:g} s."""

_LIMITATIONS = """\
Limitations. The feedback is linear in the predicted state, so it answers one part of the error at a
time. The bound is that of any feedback, at the samples only."""
