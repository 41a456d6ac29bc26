"""MPC at 20 Hz past three moving balls: every window by several implementations in turn."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.clearance import clearance
from benchmarks.peers import casadi_mpc
from benchmarks.peers.windows import roll_out
from benchmarks.race import collected
from benchmarks.stopwatch import Stopwatch, Taken, median
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

STEPS, WINDOWS = 100, 40
"""Steps of the first window, and number of windows, each of a step less: 80 steps on average."""

SAMPLES = 50
"""Samples of every step."""

KEPT = 1e-4
"""Violation up to which a plan keeps the constraints at the knots [m, m/s or m/s²]."""

EVERY_INSTANT = "this package, every instant"
_AT_KNOTS = "this package, at the knots"
_DEFAULTS = "this package, every instant, with its defaults"

COLUMNS = (
    "implementation",
    "median, processor [ms]",
    "99 %, processor [ms]",
    "largest, processor [ms]",
    "median, wall [ms]",
    "ratio",
    "violated at knots [%]",
    "cost above the least, median [%]",
    "cost above the least, largest [%]",
    "inside a ball at knots [mm]",
    "inside a ball between [mm]",
    "off limits or goal",
)


class Planner(Protocol):
    """Implementation that plans the windows of one flight."""

    def step(self, knot: int, state: FloatArray) -> FloatArray:
        """Return the accelerations of the window that begins at a knot [m/s²], (1, M, 3)."""


@dataclasses.dataclass(frozen=True)
class Lap:
    """One window by one implementation."""

    knot: int
    """knot at which it begins, from 0"""
    taken: Taken
    """time from the measured state to the accelerations"""
    cost: float
    """sum of squared accelerations [m²/s⁴]"""
    inside: tuple[float, float]
    """how far it is inside of a ball at the knots, and at all samples [m]; negative beyond"""
    off: float
    """violation of limits and goal [m, m/s or m/s²]"""

    @property
    def counts(self) -> bool:
        """True if it keeps the constraints at the knots."""
        return max(self.inside[0], self.off) <= KEPT


def scenario() -> rho.Scenario:
    """Return one vehicle that flies 6 m in 5 s, past three balls that cross its way."""
    limits = rho.Limits(
        position=rho.Box([-1, -3, 0.2], [7, 3, 3]),
        velocity=rho.Box([-3] * 3, [3] * 3),
        acceleration=rho.Box([-6] * 3, [6] * 3),
    )
    balls = [
        rho.Obstacle(rho.Sphere([2.0, -1.6, 1.1], 0.5), velocity=[0, 0.9, 0]),
        rho.Obstacle(rho.Sphere([3.3, 2.2, 0.9], 0.5), velocity=[0, -0.8, 0]),
        rho.Obstacle(rho.Sphere([6.5, 0.3, 1.2], 0.4), velocity=[-0.6, -0.05, 0]),
    ]
    vehicle = rho.Vehicle("UAV", rho.State([0, 0, 1]), rho.State([6, 0, 1]), radius=0.2)
    return rho.Scenario("MPC", rho.Grid(0.05, STEPS + 1), [vehicle], limits, balls)


def measured(given: rho.Scenario) -> FloatArray:
    """Return the states from which windows begin, shape (WINDOWS + 1, 6).

    They are near a motion 5 cm beyond the balls, with errors of 2 mm and 1 cm/s.
    """
    (vehicle,) = given.vehicles
    wider = dataclasses.replace(vehicle, radius=vehicle.radius + 0.05)
    motion = rho.plan(dataclasses.replace(given, vehicles=(wider,)))
    states = np.concatenate([motion.positions[0], motion.velocities[0]], axis=1)[: WINDOWS + 1]
    errors = np.random.default_rng(0).normal(size=states.shape)
    return np.asarray(states + errors * [2e-3, 2e-3, 2e-3, 1e-2, 1e-2, 1e-2])


class _ThisPackage:
    """`RecedingHorizon`."""

    def __init__(self, given: rho.Scenario, *, tuned: bool) -> None:
        self._times = given.grid.times
        if tuned:  # the settings of docs/guides/mpc.md
            self._horizon = rho.RecedingHorizon(
                given, replan_every=1, reference=rho.tail_reference, fallback=None, solver="daqp"
            )
        else:
            self._horizon = rho.RecedingHorizon(given, replan_every=1)

    def step(self, knot: int, state: FloatArray) -> FloatArray:
        return self._horizon.step(state[None], self._times[knot]).plan.accelerations


class _CasADi:
    """Windows by one of CasADi's solvers, each from the solution before."""

    def __init__(self, programs: casadi_mpc.Programs) -> None:
        self._programs = programs
        self._last: casadi_mpc.Solution | None = None

    def step(self, knot: int, state: FloatArray) -> FloatArray:
        self._last = self._programs.solve(knot, state, self._last)
        return self._last.accelerations


def run(repetitions: int = 31) -> Table:
    """Plan all windows in every round, each by all implementations in turn."""
    given = scenario()
    at_knots = dataclasses.replace(given, between_knots=False)
    states = measured(given)
    makes: dict[str, Callable[[], Planner]] = {
        EVERY_INSTANT: lambda: _ThisPackage(given, tuned=True),
        _AT_KNOTS: lambda: _ThisPackage(at_knots, tuned=True),
        _DEFAULTS: lambda: _ThisPackage(given, tuned=False),
    }
    missing = list[str]()
    for name, method in casadi_mpc.METHODS.items():
        try:
            programs = casadi_mpc.Programs(given, method, WINDOWS + 1)
        except RuntimeError as error:  # a wheel without this solver
            missing.append(f"CasADi, {name}, is missing: {str(error).splitlines()[-1]}")
            continue
        makes[f"CasADi, {name}"] = lambda programs=programs: _CasADi(programs)  # type: ignore[misc]
    laps = dict[str, list[Lap]]()
    for number in track(range(repetitions + 1), "rounds"):
        flown = _round(given, states, makes)
        if number:
            for name, each in flown.items():
                laps.setdefault(name, []).extend(each)
    return _table(laps, repetitions, missing)


def _round(
    given: rho.Scenario, states: FloatArray, makes: dict[str, Callable[[], Planner]]
) -> dict[str, list[Lap]]:
    """Return the windows after the first, which is planned before the flight."""
    planners = {name: make() for name, make in makes.items()}
    laps: dict[str, list[Lap]] = {name: [] for name in makes}
    with collected():
        for knot, state in enumerate(states):
            for name, planner in planners.items():
                watch = Stopwatch()
                accelerations = planner.step(knot, state)
                taken = watch.taken()
                if knot:
                    laps[name].append(_judged(given, knot, state, accelerations, taken))
    return laps


def _judged(
    given: rho.Scenario,
    knot: int,
    state: FloatArray,
    accelerations: FloatArray,
    taken: Taken,
) -> Lap:
    """Sample a window, integrated anew from its accelerations by code of the benchmarks."""
    h, limits, goal = given.grid.step, given.limits, given.vehicles[0].goal
    p, v = roll_out(h, state[None, :3], state[None, 3:], accelerations)
    s = h / SAMPLES * np.arange(SAMPLES + 1)[:, None, None]
    dense = (p[:, :-1] + s * v[:, :-1] + s**2 / 2 * accelerations).reshape(-1, 1, 3)
    times = (given.grid.times[knot:-1] + s[..., 0]).reshape(-1)
    inner = given.grid.times[knot + 1 : -1]
    off = [np.abs(p[0, -1] - goal.position).max(), np.abs(v[0, -1] - goal.velocity).max()]
    for box, values in (
        (limits.position, p[0, 1:-1]),
        (limits.velocity, v[0, 1:-1]),
        (limits.acceleration, accelerations[0]),
    ):
        assert box is not None  # noqa: S101  # the scenario above has all three
        off.append(np.maximum(box.lower - values, values - box.upper).max())
    return Lap(
        knot,
        taken,
        float(np.sum(accelerations**2)),
        (-clearance(given, inner, p[0, 1:-1, None]), -clearance(given, times, dense)),
        float(max(off)),
    )


def _table(laps: dict[str, list[Lap]], repetitions: int, missing: Sequence[str]) -> Table:
    least = _least(laps)
    medians = {name: median(lap.taken for lap in each) for name, each in laps.items()}
    ours, knots = medians[EVERY_INSTANT], medians[_AT_KNOTS].processor
    ranked = sorted(laps, key=lambda name: medians[name].processor)
    rows = tuple(_row(name, laps[name], least, medians[name], ours) for name in ranked)
    peers = {name: medians[name].processor for name in laps if name.startswith("CasADi")}
    return Table(
        name="mpc",
        title="MPC at 20 Hz, one vehicle, three moving balls, 80 steps on average",
        columns=COLUMNS,
        rows=rows,
        notes=(*missing, _work(repetitions), _TOLERANCES, _LIMITATIONS),
        goals=(
            Goal("at the knots / the fastest peer", 1.0, knots / min(peers.values())),
            Goal("every instant / IPOPT", 1.0, ours.processor / peers["CasADi, IPOPT"]),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "daqp", "casadi"),
    )


def _least(laps: dict[str, list[Lap]]) -> dict[int, float]:
    """Return the least cost of each window at the knots of all that stay outside [m²/s⁴]."""
    least = dict[int, float]()
    for lap in (lap for each in laps.values() for lap in each):
        if lap.counts:
            least[lap.knot] = min(lap.cost, least.get(lap.knot, np.inf))
    return least


def _row(
    name: str, laps: Sequence[Lap], least: dict[int, float], own: Taken, ours: Taken
) -> tuple[Cell, ...]:
    processor = np.array([lap.taken.processor for lap in laps])
    above = [100.0 * (lap.cost / least[lap.knot] - 1.0) for lap in laps]
    return (
        name,
        1e3 * own.processor,
        1e3 * float(np.quantile(processor, 0.99)),
        1e3 * float(processor.max()),
        1e3 * own.wall,
        own.processor / ours.processor,
        100.0 * float(np.mean([not lap.counts for lap in laps])),
        float(np.median(above)),
        float(np.max(above)),
        1e3 * max(lap.inside[0] for lap in laps),
        1e3 * max(lap.inside[1] for lap in laps),
        float(f"{max(lap.off for lap in laps):.1g}"),
    )


def _work(repetitions: int) -> str:
    return f"""\
One vehicle flies 6 m in 5 s, in steps of 0.05 s, past three balls that cross its way at constant
velocities; boxes limit position, velocity and acceleration. Each of {WINDOWS} windows plans from a
measured state to rest at the goal, with the least sum of squared accelerations, over {STEPS - 1}
to {STEPS - WINDOWS} steps. The states are the same for all: near a motion 5 cm beyond the balls,
with random errors of 2 mm and 1 cm/s. Each implementation starts from its own solution of the
window before; the window before the flight does not count. All run in one process, window by
window in turn, {repetitions} times after one round that does not count. A time runs from the
measured state to the accelerations. This package's includes its checks of every constraint; it
plans at every instant or at the knots with the settings of the MPC guide (`tail_reference`, DAQP,
no fallback), and with its defaults (Clarabel, reference without obstacles). The ratio is that of
medians of processor times, to the first of these. Plans are integrated anew from their
accelerations and sampled {SAMPLES} times a step, by code of the benchmarks: how far they are
inside of a ball (negative: beyond), at the knots and at all samples, and beyond the limits or off
the goal [m, m/s or m/s²], at most. A window is violated by more than {KEPT:g}; its least cost is
that of all plans that do not violate it at the knots."""


_TOLERANCES = """\
Peers solve the problem at the knots. IPOPT and Fatrop solve it as it is, to 1e-6, with exact
second derivatives. SQP (`sqpmethod`) linearises distances as this package does, with the Hessian
of the cost; it ends at 1e-6 m and 0.1 m/s² of the gradient, or after five programs, and OSQP's
programs at 1e-3 with a step of 10: at tighter ones it takes seconds. One step with HPIPM is a
real-time iteration. Fatrop, HPIPM, IPOPT and qrqp are those of CasADi's wheel. Fatrop finds the
stages by itself (`structure_detection: auto`), and so does HPIPM."""

_LIMITATIONS = """\
Limitations. One scene. Programs of CasADi are built before, one for each length, which takes 0.1 s
each and is not timed; nothing is compiled to machine code, which would make the evaluation of
their functions faster. IPOPT runs with MUMPS. Interior-point methods gain little from a start;
multipliers are shifted and given to all of them. This package at every instant keeps more
constraints than the others, as the columns on balls show."""
