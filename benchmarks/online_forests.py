"""Forests of the LSC planner: twenty vehicles, each for itself, which see the map in flight."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.map_scenes import Tried, beyond_radius
from benchmarks.race import Skipped
from benchmarks.sampling import sample
from benchmarks.stopwatch import Taken
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

FORESTS = range(1, 11)
"""Numbers of the forests."""

STEP, LATENCY, SEEN, LONGEST = 0.25, 0.25, 5.0, 90.0
"""Step of the grid and time allowed for planning a window [s], distance within which cells are seen
[m], and longest flight [s]."""

_LOOK = 0.25
"""Distance after which a vehicle looks around again [m]."""

_TOLERANCE = 1e-6
"""Largest violation that counts as none, in SI units."""

COLUMNS = (
    "forest",
    "least distance of two vehicles beyond the separation [m]",
    "nearest cell beyond the radius [m]",
    "beyond a limit, over its side",
    "arrived",
    "mean travel time [s]",
    "largest travel time [s]",
    "windows of a vehicle",
    "median ms of a window",
    "99 % ms of a window",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One flight."""

    apart: float
    """least distance of two vehicles beyond the separation, by samples [m]"""
    clear: float
    """least distance from a cell beyond the radius, by samples [m]"""
    beyond: float
    """largest violation of a limit, by samples, over its side"""
    travel: FloatArray
    """travel times [s], NaN for vehicles that did not arrive, shape (N,)"""
    seconds: FloatArray
    """wall time of each window [s]"""

    @property
    def holds(self) -> bool:
        """Whether nothing is violated."""
        return min(self.apart, self.clear, -self.beyond) >= -_TOLERANCE


class Eyes:
    """What every vehicle of a mission has seen of a map."""

    def __init__(self, mission: rho.Scenario, voxels: rho.Voxels) -> None:
        self._mission, self._voxels = mission, voxels
        self._centers = voxels.origin + voxels.resolution * (voxels.occupied + 0.5)
        self._known = {name: np.zeros(len(self._centers), dtype=bool) for name in mission.names}
        self._from: dict[str, FloatArray] = {}

    def look(self, name: str, time: float, place: FloatArray) -> rho.Scenario | None:
        """Return the scenario as a vehicle knows it; None without news."""
        before, known = self._from.get(name), self._known[name]
        if before is not None and np.linalg.norm(place - before) < _LOOK:
            return None
        self._from[name] = place
        new = ~known & (np.linalg.norm(self._centers - place, axis=1) < SEEN)
        known |= new
        if not new.any():
            return None
        cells = dataclasses.replace(self._voxels, occupied=self._voxels.occupied[known])
        return dataclasses.replace(self._mission, obstacles=(rho.Obstacle(cells, name="map"),))


def run(folder: Path | None = None) -> Table:
    """Fly the missions in `folder`, on all cores.

    Raises:
        Skipped: no folder is given, or it lacks a mission.
    """
    if folder is None or not (folder / "forest1.bt").is_file():
        raise Skipped("no OctoMaps given; they are those of github.com/qwerty35/lsc_planner")
    laps = on_all_cores(partial(fly, folder), FORESTS, "forests", at_once=1)
    return Table(
        name="online_forests",
        title="Forests of the LSC planner, each vehicle for itself",
        columns=COLUMNS,
        rows=tuple(_row(number, lap) for number, lap in zip(FORESTS, laps, strict=True)),
        notes=(_WORK,),
        goals=(
            Goal("flights with a violation", 0, sum(not lap.holds for lap in laps)),
            Goal(
                "flights in which a vehicle does not arrive",
                0,
                sum(not np.isfinite(lap.travel).all() for lap in laps),
            ),
        ),
    )


def fly(folder: Path, number: int) -> Lap:
    """Return the flight of one mission."""
    name, grid = f"forest{number}", rho.Grid(STEP, 13)
    world = folder / f"{name}.bt"
    mission = rho.load_lsc_mission(folder / f"{name}_20agents.json", grid=grid, world=world)
    voxels = next(each for each in mission.obstacles if isinstance(each, rho.Voxels))
    mission = dataclasses.replace(mission, obstacles=())
    flown = rho.simulate_onboard(
        mission,
        rho.Radio(delay=0.05),
        duration=LONGEST,
        rng=np.random.default_rng([98, number]),
        latency=LATENCY,
        replan_every=0.25,
        solver="daqp",
        sees=Eyes(mission, voxels).look,
    )
    found, separation = sample(flown.plan), mission.separation
    if separation is None:
        raise ValueError("separation: got None, expected that of the mission")
    clear = beyond_radius(Tried(flown.plan, Taken(0.0, 0.0)), voxels)
    seconds = np.concatenate(flown.seconds)
    return Lap(found.least - separation.distance, clear, found.beyond, flown.arrivals, seconds)


def _row(number: int, lap: Lap) -> tuple[Cell, ...]:
    return (
        number,
        float(f"{lap.apart:.2g}"),
        float(f"{lap.clear:.2g}"),
        float(f"{lap.beyond:.2g}"),
        f"{np.isfinite(lap.travel).sum()} of {len(lap.travel)}",
        float(np.nanmean(lap.travel)),
        float(np.nanmax(lap.travel)),
        len(lap.seconds) / len(lap.travel),
        1000.0 * float(np.median(lap.seconds)),
        1000.0 * float(np.quantile(lap.seconds, 0.99)),
    )


_WORK = f"""\
The missions and OctoMaps of qwerty35/lsc_planner, unchanged, with steps of {STEP:g} s and windows
of 3 s. Each vehicle runs one `OnboardPlanner`, and sees the cells within {SEEN:g} m; cells that it
has not seen count as free. Messages are up to 0.05 s late. In simulated time, planning takes up to
{LATENCY:g} s, whatever it takes in truth. Distances are of accelerations integrated anew, sampled
100 times a step. LSC reports 15.5 ms for a vehicle and step, with 60 vehicles."""
