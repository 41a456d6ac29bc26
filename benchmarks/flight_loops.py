"""Windows of random loops at their limits: walls, boxes, pairs and waypoints at the goal."""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.flight_closed_loop import VIOLATED
from benchmarks.flown import violations
from benchmarks.tables import Cell, Goal, Table
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.waypoints import in_order
from drake_rho.simulation.closed_loop import fly

FLIGHTS = 4000
"""Total number of flights: some 20 000 windows, as some scenarios have no plan at all."""

KINDS = ("wall", "room", "pair", "waypoint")
"""Kinds of constraints close to the goal, or to the path just before it."""


@dataclasses.dataclass(frozen=True)
class Loop:
    """Result of one flight."""

    kind: str
    """kind of the constraint close to the goal"""
    windows: int
    """number of windows; 0 where the first had no plan"""
    kept: int
    """number of windows that kept the previous plan"""
    without_plan: int
    """number of windows that had neither that nor a plan of their own"""
    worst: float
    """largest violation of any limit, as a fraction; negative for a margin"""
    missed: float
    """largest distance beyond the ball of a waypoint [m]"""
    verified: bool
    """true if `rho.verify` accepts the flight"""
    over_tube: float
    """largest error over the tube's radius at that time, less 1"""


class Biased:
    """Wind and errors of the estimate in a constant direction, or switching between two.

    Args:
        scenario: bounds of both.
        rng: draws directions, and how often they switch.
    """

    def __init__(self, scenario: rho.Scenario, rng: np.random.Generator) -> None:
        around, count = scenario.disturbance or rho.Disturbance(0.0), len(scenario.vehicles)
        samples, grid = around.samples(scenario.grid), scenario.grid
        self._start, self._sample, self._size = grid.start, around.sample(grid), around.acceleration
        along = rng.choice(3) * np.ones(count, dtype=int)
        self._directions = _units(rng.normal(size=(count, 3)))
        if rng.integers(2):  # along an axis, like the limits that are close
            self._directions = np.eye(3)[along] * rng.choice([-1.0, 1.0], size=(count, 1))
        every = int(rng.integers(1, samples + 1))
        self._signs = np.where((np.arange(samples + 1) // every) % 2, rng.choice([-1.0, 1.0]), 1.0)
        error = rng.choice([-1.0, 1.0]) * self._signs[:samples, None, None] * self._directions
        self.position_errors = around.position_error * error
        self.velocity_errors = around.velocity_error * rng.choice([-1.0, 1.0]) * error
        self.switching_times = self._start + self._sample * np.arange(samples + 1)

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the wind, (N, 3)."""
        return np.asarray(self.over(np.array([time]), len(positions))[0])

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """Return the wind at times on the scenario's clock [s], (M, N, 3)."""
        j = np.floor((times - self._start) / self._sample + 1e-6).astype(int)
        signs = self._signs[np.clip(j, 0, len(self._signs) - 1)]
        return np.asarray(self._size * signs[:, None, None] * self._directions)


def run(flights: int = FLIGHTS) -> Table:
    """Fly all flights on all cores."""
    found = on_all_cores(flown_loop, range(flights), "flights")
    flown = [each for each in found if each.windows > 0]
    return Table(
        name="flight_loops",
        title="Windows of random loops",
        columns=COLUMNS,
        rows=tuple(_row([each for each in flown if each.kind == kind]) for kind in KINDS),
        notes=(
            f"{len(flown)} flights, {sum(each.windows for each in flown)} windows; "
            f"{len(found) - len(flown)} scenarios more have no plan at all. {_ABOUT}",
        ),
        goals=(
            Goal("flights that break a limit", 0.0, sum(_violates(each) for each in flown)),
            Goal("flights that `verify` refuses", 0.0, sum(not each.verified for each in flown)),
            Goal("windows without a plan", 0.0, sum(each.without_plan for each in flown)),
            Goal("error above the radius, over it", 1e-6, max(each.over_tube for each in flown)),
        ),
    )


COLUMNS = (
    "close_at_goal",
    "flights",
    "windows",
    "kept",
    "kept_percent",
    "broken",
    "largest_breach",
    "windows_without_plan",
    "largest_over_tube",
)


def _violates(loop: Loop) -> bool:
    return loop.worst > VIOLATED or loop.missed > VIOLATED


def _row(found: list[Loop]) -> tuple[Cell, ...]:
    windows, kept = (sum(getattr(each, name) for each in found) for name in ("windows", "kept"))
    return (
        found[0].kind,
        len(found),
        windows,
        kept,
        round(100.0 * kept / windows, 1),
        sum(_violates(each) for each in found),
        float(max(each.worst for each in found)),
        sum(each.without_plan for each in found),
        1.0 + float(max(each.over_tube for each in found)),
    )


def flown_loop(number: int) -> Loop:
    """Simulate one flight, drawn by the number."""
    rng = np.random.default_rng(number)
    kind = KINDS[number % len(KINDS)]
    try:
        scenario = scene(kind, rng)
        wind = Biased(scenario, rng) if rng.integers(4) else None
        flown = fly(
            scenario, replan_every=int(rng.integers(1, 5)), wind=wind, rng=np.random.default_rng(1)
        )
    except (InfeasibleError, rho.ScenarioError):
        return Loop(kind, 0, 0, 0, -np.inf, -np.inf, True, 0.0)
    windows = flown.flight.windows
    over = np.maximum(flown.errors() - 1e-9, 0.0) / np.maximum(flown.radii(), 1e-9)[:, None]
    return Loop(
        kind,
        len(windows),
        sum(window.kept for window in windows),
        sum(bool(window.infeasible) and not window.kept for window in windows),
        violations(flown).worst,
        _missed(flown),
        rho.verify(flown).ok,
        float(over.max()) - 1.0,
    )


def scene(kind: str, rng: np.random.Generator) -> rho.Scenario:
    """Return up to three vehicles whose goals are close to a limit, by about their tube there."""
    knots, step = int(rng.integers(7, 18)), float(rng.choice([0.25, 0.5, 1.0]))
    noise = rng.uniform(0.0, 1.0 / 3.0) if rng.integers(4) else 0.0
    room = 10.0 ** rng.uniform(-1.5, 0.0)
    around = rho.Disturbance(
        acceleration=float(rng.choice([0.0, rng.uniform(0.0, 0.3)])),
        position_error=noise * room,
        velocity_error=float(rng.uniform(0.0, 0.05)) * rng.integers(2),
        feedback_every=step / int(rng.choice([1, 2, 5])),
        delay=int(rng.integers(0, 3)),
    )
    way = float(rng.uniform(1.0, 2.0)) * step * (knots - 1) / 2.0
    count = 2 if kind == "pair" else int(rng.integers(1, 4))
    grid = rho.Grid(step, knots, float(rng.choice([0.0, 17.3])))
    limits = rho.Limits(max_acceleration=3.0, max_speed=6.0)
    vehicles, apart = list[rho.Vehicle](), None
    tube = rho.error_tube(
        rho.Scenario(
            "alone",
            grid,
            [rho.Vehicle("v", rho.State(np.zeros(3)), rho.State([way, 0.0, 0.0]))],
            limits=limits,
            disturbance=around,
        )
    )
    radius = float(tube.position_over(grid.start, grid.end)[0])
    room = max(room, radius * rng.uniform(0.9, 1.3))
    obstacles = list[rho.Box]()
    for i in range(count):
        x, y = way, 20.0 * i
        if kind == "pair":
            apart = rho.Separation(0.5, downwash=float(rng.choice([1.0, 2.0])))
            x, y = way * (1 - 2 * i), 0.0
            side = (0.25 + radius * rng.uniform(1.0, 1.3)) * (1 - 2 * i)
            start, goal = [0.0, 4.0 * (1 - 2 * i), 0.0], [way, side, 0.0]
        else:
            start, goal = [0.0, y, 0.0], [x, y, 0.0]
        waypoints = []
        if kind == "waypoint":
            at = grid.start + step * (knots - 1) * float(rng.uniform(0.5, 0.95))
            place = [way * float(rng.uniform(0.6, 1.0)), y + float(rng.normal(0.0, 0.3)), 0.0]
            reach = float(tube.position(at)) * float(rng.uniform(1.0, 1.5)) + 1e-3
            waypoints = [rho.Waypoint(at, place, reach)]
        if kind == "wall":
            obstacles.append(rho.Box([way + room, y - 5.0, -5.0], [way + room + 1.0, y + 5.0, 5.0]))
        vehicles.append(
            rho.Vehicle(f"v{i}", rho.State(start), rho.State(goal), waypoints=waypoints)
        )
    if kind == "room":
        box = rho.Box([-room, -room, -room], [way + room, 20.0 * (count - 1) + room, room])
        limits = dataclasses.replace(limits, position=box)
    return rho.Scenario(
        kind, grid, vehicles, limits, obstacles=obstacles, separation=apart, disturbance=around
    )


def _missed(flown: Simulation) -> float:
    """Return the largest distance outside a waypoint's ball by the record [m]."""
    beyond = -np.inf
    for i, vehicle in enumerate(flown.scenario.vehicles):
        for time, waypoint in in_order(vehicle):
            positions, _ = flown.states([time])
            away = float(np.linalg.norm(positions[i, 0] - waypoint.position))
            beyond = max(beyond, away - waypoint.within)
    return beyond


def _units(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


_ABOUT = f"""\
One to three vehicles whose goals are next to a wall, to the sides of their position box, or to
each other's goals (with spherical separation or downwash), or which pass a waypoint just before.
The distances are 0.9 to 1.3 times the largest radius of the first tube, or more. Errors of the
estimate are up to a third of the distance, delays 0 to 2 samples. In three of four flights the
estimates have their largest error in one direction or switch between two, and so does the wind;
otherwise there is no wind, and errors are drawn from their balls. New windows begin every one to
four steps. Flights are verified by samples of the true motion twice between any two steps of the
simulation (`benchmarks/flown.py`), and at the waypoints' times; more than {VIOLATED:g} of the
scale is a violation. A window is without a plan if it has neither a new one nor the rest of the
previous one."""
