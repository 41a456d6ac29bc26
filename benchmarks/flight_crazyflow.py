"""Plans flown by simulated Crazyflies, to test the tube and smoothing in another simulator."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.apart import run_apart, version
from benchmarks.race import Skipped
from benchmarks.sampling import least_distance
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

VEHICLES = (10, 30, 60)
"""Numbers of vehicles; the first mission of each is flown."""

DURATION, STEP, RATE = 10.0, 0.2, 100
"""T and h [s], and the rate of references [1/s]."""

MODEL = rho.Disturbance(0.3, share=0.6)
"""Disturbance attributed to the Crazyflies and their controller."""

WIDTHS, TIMES = (0.5, 1.0), (1, 2, 3)
"""Widths of the averages, as parts of a step, and their numbers."""

SMOOTHINGS = tuple(rho.Smoothing(part * STEP, times) for part in WIDTHS for times in TIMES)

AHEAD = 0.02
"""Time by which some references are ahead of the clock, about the lag of the others [s]."""

COLUMNS = (
    "vehicles",
    "plan",
    "index",
    "planning_seconds",
    "tube_m",
    "least_distance_m",
    "fleet_offset_m",
    "largest_off_offset_m",
    "largest_over_tube",
    "lag_ms",
    "largest_off_lag_m",
    "polynomials",
    "exported_pieces",
    "export_deviation_m",
)


@dataclasses.dataclass(frozen=True)
class FlownPlan:
    """Plan that was flown."""

    plan: rho.Plan
    """scenario"""
    seconds: float
    """planning time [s]"""
    least: float
    """least flown distance of any pair, with the separation's downwash [m]"""
    offset: float
    """largest mean error of the fleet at any time [m]"""
    off: float
    """largest error of any vehicle less that mean [m]"""
    over: float | None
    """largest ratio of the same to the tube's radius at that time; None without a tube"""
    lag: float
    """time by which the fleet is behind its references, by least squares [s]"""
    off_lag: float
    """largest error of any vehicle less the mean and less what the lag explains [m]"""

    def row(self, name: str) -> tuple[Cell, ...]:
        """Return the values in the order of `COLUMNS`."""
        scenario = self.plan.scenario
        tube = rho.error_tube(scenario).position_over(scenario.grid.start, scenario.grid.end)
        tells = scenario.disturbance is not None
        return (
            len(scenario.vehicles),
            name,
            self.plan.cost,
            self.seconds,
            float(tube[0]) if tells else None,
            f"{self.least:.4f}",
            self.offset,
            self.off,
            self.over,
            f"{1e3 * self.lag:.1f}",
            self.off_lag,
            len(self.plan.polynomials().instants) - 1,
            *_exported(self.plan),
        )


def run(folder: Path | None = None) -> Table:
    """Plan and fly the first mission of each size in `folder`: plain, with margins, smoothed.

    Raises:
        Skipped: there are no missions, or no environment with Crazyflow.
    """
    paths = [(folder or Path()) / f"random_{count}_1.json" for count in VEHICLES]
    if folder is None or not all(path.exists() for path in paths):
        missions = ", ".join(path.name for path in paths)
        raise Skipped(
            f"no {missions}; they are `missions/empty` of github.com/qwerty35/lsc_planner"
        )
    rows: list[tuple[Cell, ...]] = []
    least, over, plain = [], [], []
    smooth: list[list[float]] = [[] for _ in SMOOTHINGS]
    for path in track(paths, "missions"):
        mission = enlarged_by_margins(path)
        without = fly(mission)
        margins = fly(dataclasses.replace(mission, disturbance=MODEL))
        rows += [without.row("without margins"), margins.row("with margins")]
        plain.append(without.off)
        for smoothing, found in zip(SMOOTHINGS, smooth, strict=True):
            flown = fly(dataclasses.replace(mission, smoothing=smoothing))
            rows.append(flown.row(_named(smoothing)))
            found.append(flown.off)
        for scenario, name in (
            (mission, "without margins"),
            (dataclasses.replace(mission, smoothing=SMOOTHINGS[-1]), _named(SMOOTHINGS[-1])),
        ):
            rows.append(fly(scenario, AHEAD).row(f"{name}, references {1e3 * AHEAD:g} ms ahead"))
        separation = mission.separation
        least.append((0.0 if separation is None else separation.distance) - margins.least)
        over.append(np.inf if margins.over is None else margins.over)
    return Table(
        name="flight_crazyflow",
        title="Plans flown by simulated Crazyflies",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(f"Crazyflow {version('crazyflow')}. {_ABOUT}", _MODEL, _SMOOTH, _LIMITATIONS),
        goals=(
            Goal("separation asked less flown, with margins [m]", 0.0, max(least)),
            Goal("error less the fleet's mean, over the tube", 1.0, max(over)),
            Goal(
                "error less the fleet's mean with the best smoothing, over that without",
                0.5,
                min(map(max, smooth)) / max(plain),
            ),
        ),
    )


def _named(smoothing: rho.Smoothing) -> str:
    """Return the name of a smoothing in the table."""
    return f"smoothed, {smoothing.times} x {smoothing.width:g} s"


def enlarged_by_margins(path: Path) -> rho.Scenario:
    """Return a mission with its box wider by the tube, as starts and goals lie at its walls."""
    mission = rho.load_lsc_mission(path, grid=rho.Grid.lasting(DURATION, step=STEP))
    tube = rho.error_tube(dataclasses.replace(mission, disturbance=MODEL))
    wider = float(tube.position_over(mission.grid.start, mission.grid.end)[0])
    room = mission.limits.position
    if room is None:
        return mission
    limits = dataclasses.replace(
        mission.limits, position=rho.Box(room.lower - wider, room.upper + wider)
    )
    return dataclasses.replace(mission, limits=limits)


def fly(scenario: rho.Scenario, ahead: float = 0.0) -> FlownPlan:
    """Plan, let Crazyflies fly the plan, and measure.

    Args:
        scenario: the scenario.
        ahead: time by which references are ahead of the clock, with which they are compared [s].
    """
    began = time.perf_counter()
    plan = rho.plan(scenario)
    seconds = time.perf_counter() - began
    lead = scenario.lead
    count = round((DURATION + 2.0 * lead) * RATE) + 1
    times = scenario.grid.start - lead + np.arange(count) / RATE
    there = plan.at(times)
    given = times[np.minimum(np.arange(count) + round(ahead * RATE), count - 1)]
    given[0] = times[0]  # where vehicles begin
    flown = _flown(times, plan.at(given))
    errors = flown - there.positions
    mean = errors.mean(axis=0)
    off = errors - mean
    largest = np.linalg.norm(off, axis=-1).max(axis=0)
    moving = there.velocities - there.velocities.mean(axis=0)
    lag = -float(np.vdot(off, moving) / np.vdot(moving, moving))
    over = None
    if scenario.disturbance is not None:
        radii = rho.error_tube(scenario).position(times)
        over = float(np.max(largest[1:] / radii[1:]))
    return FlownPlan(
        plan,
        seconds,
        least_distance(np.moveaxis(flown, 0, 1), scenario.separation),
        float(np.linalg.norm(mean, axis=-1).max()),
        float(largest.max()),
        over,
        lag,
        float(np.linalg.norm(off + lag * moving, axis=-1).max()),
    )


def _flown(times: FloatArray, references: rho.Samples) -> FloatArray:
    """Return positions of Crazyflies that are given references at times [m], shape (N, M, 3)."""
    with tempfile.TemporaryDirectory() as folder:
        written, found = Path(folder) / "references.npz", Path(folder) / "flown.npz"
        np.savez(
            written,
            times=times,
            positions=references.positions,
            velocities=references.velocities,
            accelerations=references.accelerations,
        )
        run_apart("crazyflow", "crazyflow_flight.py", written, found)
        with np.load(found) as file:
            return np.asarray(file["positions"], dtype=np.float64)


def _exported(plan: rho.Plan) -> tuple[int, float]:
    """Return the number of pieces of a vehicle's file for Crazyflies, and its deviation [m]."""
    with tempfile.TemporaryDirectory() as folder:
        written = rho.export(plan, Path(folder) / "swarm", format="crazyswarm")
        lines = written.files[0].read_text(encoding="utf-8").splitlines()
    return len(lines) - 1, written.deviation


_ABOUT = f"""\
The first missions of qwerty35/lsc_planner with ten, thirty and sixty vehicles, T = {DURATION:g} s,
h = {STEP:g} s, 0.3 m apart side by side and twice that above each other. Crazyflow simulates
Crazyflies from first principles at 500 Hz, with the Mellinger controller of their firmware at
{RATE} Hz, which tracks position, velocity and acceleration of the plan. The least distance is that
of the flown positions at {RATE} Hz. Most of the error is a height offset common to all vehicles,
whatever they fly. So the fleet's mean error at each time, of which `fleet_offset_m` is the
largest, is subtracted before an error is compared with the tube at that time; it does not affect
the distance of two vehicles."""

_MODEL = f"""\
The model: W = {MODEL.acceleration:g} m/s², corrected every {STEP:g} s, with a feedback of at most
{MODEL.share:g} of the acceleration limit (1 m/s² upwards, 2 m/s² sideways). W covers the first
tenth of a second, before any feedback: there errors without margins grew like those of an
acceleration of up to 0.255 m/s². The resulting radius, 0.02 m, holds the 0.014 m reached later.
The position box is wider by the radius, with and without margins, since starts and goals lie at
its walls."""

_SMOOTH = f"""\
Smoothed plans are flown from their beginning before the first knot to their end after the last,
without disturbance. Crazyflies are behind their references by `lag_ms`, the least-squares fit of
an error of -lag times velocity, both less the fleet's mean; `largest_off_lag_m` is the largest
error that this leaves. In rows with references ahead, a Crazyflie is told the state of the plan
{1e3 * AHEAD:g} ms later than the one with which it is compared; the lag was read off the other
rows. `polynomials` is the number of pieces of a plan, `exported_pieces` and `export_deviation_m`
are those of its files for Crazyswarm2, which may have 31."""

_LIMITATIONS = """\
Limitations. The tube is that of the package's own feedback, while the Crazyflies use that of their
firmware: the tube is a model of their errors, fitted to these very missions, and no proof for
them. One run of each mission, as nothing in the simulation is random. It is a simulation."""
