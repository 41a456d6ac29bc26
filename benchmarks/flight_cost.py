"""The cost of margins: index and window times with a disturbance and without."""

from __future__ import annotations

import dataclasses
import statistics

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.fleet_b1 import DURATIONS, STEP
from benchmarks.stopwatch import Stopwatch
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

WIND = 0.2
"""Wind W in Example 4 [m/s²]."""

VEHICLES, DRAWS = 8, 10
"""Number of fleets of B1."""

TUBE = 0.02
"""Radius of the tube of these fleets [m]."""

FEEDBACK = rho.Disturbance(0.0, feedback_every=0.1, share=0.2)
"""Disturbance of these fleets, except for the wind that leads to this radius."""

ROUNDS = 15
"""Rounds in which windows are timed."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """Scenario with a disturbance, and the same without."""

    name: str
    """description"""
    robust: rho.Scenario
    """scenario with a disturbance"""

    @property
    def plain(self) -> rho.Scenario:
        """Scenario without a disturbance."""
        return dataclasses.replace(self.robust, disturbance=None)

    @property
    def tube(self) -> float:
        """Largest radius [m]."""
        grid = self.robust.grid
        return float(rho.error_tube(self.robust).position_over(grid.start, grid.end)[0])


def run() -> Table:
    """Plan with margins and without, and time the windows of both."""
    pairs = [example_4(), *(fleet(seed) for seed in range(DRAWS))]
    indices = [costs(pair) for pair in track(pairs, "plans")]
    ratios = [robust / plain for plain, robust in indices]
    windows = [window_seconds(pair) for pair in track((pairs[0], pairs[1]), "windows")]
    rows: list[tuple[Cell, ...]] = []
    for pair, (plain, robust), ratio in zip(pairs, indices, ratios, strict=True):
        W = 0.0 if pair.robust.disturbance is None else pair.robust.disturbance.acceleration
        rows.append((pair.name, W, pair.tube, plain, robust, f"{ratio:.6f}", *[None] * 4))
    for k, times in enumerate(windows):
        rows[k] = (*rows[k][:6], *(1e3 * times).ravel().tolist())
    slower = max(times[1, 0] / times[0, 0] for times in windows)
    return Table(
        name="flight_cost",
        title="What margins cost",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_ABOUT, _LIMITATIONS),
        goals=(
            Goal(f"index of Example 4, W = {WIND:g} m/s², over that without", 1.001, ratios[0]),
            Goal(
                f"index of {VEHICLES} vehicles, tube of {TUBE:g} m, mean of {DRAWS} draws",
                1.1,
                statistics.fmean(ratios[1:]),
            ),
            Goal(
                "processor time of a window, with margins and verified, over without", 1.5, slower
            ),
        ),
    )


COLUMNS = (
    "scenario",
    "wind_m_s2",
    "tube_m",
    "index_without",
    "index_with",
    "ratio",
    "window_processor_ms_without",
    "window_wall_ms_without",
    "window_processor_ms_with",
    "window_wall_ms_with",
)


def example_4() -> Pair:
    """Return the paper's Example 4 with feedback at every knot."""
    paper = rho.load_scenario("paper")
    return Pair("Example 4", dataclasses.replace(paper, disturbance=rho.Disturbance(WIND)))


def fleet(seed: int) -> Pair:
    """Return a draw of B1 with slack for the tube at starts and goals.

    They are further apart, and further from the walls, than in B1.
    """
    apart = rho.Separation(0.35, downwash=2.0)
    wider = rho.Separation(apart.distance + 2.5 * TUBE, downwash=2.0)
    drawn = rho.random_transitions(
        VEHICLES,
        np.random.default_rng(seed),
        duration=DURATIONS[VEHICLES],
        step=STEP,
        separation=wider,
        name=f"{VEHICLES} vehicles, seed {seed}",
    )
    room = drawn.limits.position or rho.flight_cube(4.0)
    limits = dataclasses.replace(
        drawn.limits, position=rho.Box(room.lower - 2.0 * TUBE, room.upper + 2.0 * TUBE)
    )
    scenario = dataclasses.replace(drawn, limits=limits, separation=apart, disturbance=FEEDBACK)
    W = rho.largest_disturbance(scenario, TUBE)
    around = dataclasses.replace(FEEDBACK, acceleration=W)
    return Pair(drawn.name, dataclasses.replace(scenario, disturbance=around))


def costs(pair: Pair) -> tuple[float, float]:
    """Return the index without margins and with them [m²/s⁴], of the flight or the fleet's plan.

    Raises:
        RuntimeError: a plan violates a constraint.
    """
    found = []
    for scenario in (pair.plain, pair.robust):
        flown = rho.plan_rho(scenario) if scenario.separation is None else rho.plan(scenario)
        if not rho.verify(flown).ok:
            raise RuntimeError(f"{scenario.name}: the plan does not hold")
        found.append(flown.cost)
    return found[0], found[1]


def window_seconds(pair: Pair) -> FloatArray:
    """Return median times of windows after the first [s], shape (2, 2).

    The first row is without margins, the second with them; a row has processor and wall time.

    Both fly as planned, in turn; of each window the least time of all rounds but the first counts.
    """
    each: tuple[list[FloatArray], list[FloatArray]] = ([], [])
    for _ in range(ROUNDS + 1):
        for scenario, times in zip((pair.plain, pair.robust), each, strict=True):
            times.append(_fly(scenario))
    return np.array([np.median(np.min(times[1:], axis=0), axis=0) for times in each])


def _fly(scenario: rho.Scenario) -> FloatArray:
    """Return processor and wall times of windows after the first, as planned [s], (W, 2)."""
    horizon, times = rho.RecedingHorizon(scenario), []
    for knot in horizon.knots:
        states = horizon.planned(knot)
        watch = Stopwatch()
        horizon.step(states, scenario.grid.times[knot])
        times.append(watch.taken().both)
    return np.array(times[1:])


_ABOUT = f"""\
The paper's Example 4 flown by `plan_rho` as planned, with feedback at every knot. Fleets of
{VEHICLES} are draws of `fleet_b1` in its published flight time, by `rho.plan`, with the wind that
leads to a tube of {TUBE:g} m at a feedback of a fifth of the acceleration limit every 0.1 s.
Starts and goals are drawn {2.5 * TUBE:g} m further apart than the separation requires, and the
position box is wider by {2.0 * TUBE:g} m, with a disturbance and without: where vehicles begin or
end closer than the tube allows there is no plan. All plans are verified. Windows are those after
the first, from states to a plan; the median is over windows, each with its least time of {ROUNDS}
rounds."""

_LIMITATIONS = """\
Limitations. Windows are timed where the fleet is as planned, with new tubes."""
