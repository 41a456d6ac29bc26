"""Flights with late plans, lost measurements and obstacles that are uncertain and seen late."""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.clearance import displacement, distances
from benchmarks.flight_closed_loop import VIOLATED
from benchmarks.flown import above, beyond, finer
from benchmarks.late_scenes import scene
from benchmarks.tables import Cell, Goal, Table
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.scenario.fields import FloatArray
from drake_rho.simulation.closed_loop import flown
from drake_rho.simulation.feedback import Feedback

_TAKEN = 20
"""Samples in each step of a contingency."""


@dataclasses.dataclass(frozen=True)
class Late:
    """Result of one flight."""

    number: int
    """number of the scene"""
    vehicles: int
    """number of vehicles"""
    windows: int = 0
    """number of windows; 0 where the first had no plan"""
    declared: int = 0
    """number of windows with a contingency"""
    reasons: int = 0
    """number of windows with the reason why there is none"""
    both: int = 0
    """number of windows with both or neither"""
    flown: int = 0
    """number of windows that flew a contingency"""
    kept: int = 0
    """number of windows that kept the previous plan"""
    without_plan: int = 0
    """number of windows with neither a plan nor a contingency"""
    promised: float = -np.inf
    """largest violation in windows that promise none, as a fraction; negative for a margin"""
    elsewhere: float = -np.inf
    """largest violation in other windows"""
    in_contingencies: float = -np.inf
    """largest violation by a declared contingency with its tube, flown or not"""
    over_tube: float = 0.0
    """largest error over the tube's radius at that time"""
    off_tube: int = 0
    """number of windows that report a vehicle outside of its tube"""
    seconds: tuple[float, ...] = ()
    """wall times of the windows after the first, if none had the fallback [s]"""


def run(flights: int) -> Table:
    """Fly scenes, as many as given, on all cores: ten windows each, about."""
    return table(on_all_cores(late, range(flights), "flights"))


def table(found: list[Late]) -> Table:
    """Return the table of results."""
    flights = [each for each in found if each.windows > 0]
    counts = sorted({each.vehicles for each in flights})
    windows = sum(each.windows for each in flights)
    return Table(
        name="flight_late",
        title="Late plans, lost measurements, and obstacles seen late",
        columns=COLUMNS,
        rows=tuple(_row([each for each in flights if each.vehicles == count]) for count in counts),
        notes=(
            f"{len(flights)} flights, {windows} windows; {len(found) - len(flights)} scenes more "
            f"have no plan at all. {_ABOUT}",
            _LIMITATIONS,
        ),
        goals=(
            Goal(
                "flights that break a limit in a window with a contingency or a valid plan",
                0.0,
                sum(each.promised > VIOLATED for each in flights),
            ),
            Goal(
                "flights with a contingency that breaks a limit somewhere in its tube",
                0.0,
                sum(each.in_contingencies > VIOLATED for each in flights),
            ),
            Goal(
                "windows without a contingency and without a reason",
                0.0,
                sum(each.both for each in flights),
            ),
            Goal("windows off their tube", 0.0, sum(each.off_tube for each in flights)),
            Goal("error over the radius", 1.0 + 1e-6, max(each.over_tube for each in flights)),
        ),
    )


COLUMNS = (
    "vehicles",
    "flights",
    "windows",
    "with_contingency",
    "with_reason",
    "contingencies_flown",
    "kept",
    "neither_plan_nor_contingency",
    "broken",
    "largest_breach",
    "broken_elsewhere",
    "largest_over_tube",
    "median_ms",
    "ms_of_99_percent",
)


def _row(found: list[Late]) -> tuple[Cell, ...]:
    """Return the row of all flights with as many vehicles."""
    seconds = [each for flight in found for each in flight.seconds]
    names = ("windows", "declared", "reasons", "flown", "kept", "without_plan")
    return (
        found[0].vehicles,
        len(found),
        *(sum(getattr(each, name) for each in found) for name in names),
        sum(each.promised > VIOLATED for each in found),
        float(max(each.promised for each in found)),
        sum(each.elsewhere > VIOLATED for each in found),
        float(max(each.over_tube for each in found)),
        1e3 * float(np.median(seconds)) if seconds else None,
        1e3 * float(np.quantile(seconds, 0.99)) if seconds else None,
    )


def late(number: int) -> Late:
    """Simulate the flight of a number, and evaluate it."""
    drawn = scene(number)
    count = len(drawn.scenario.vehicles)
    try:
        horizon = rho.RecedingHorizon(drawn.scenario, **drawn.horizon)
        simulation = flown(Feedback(horizon), drawn.wind, None)
    except (InfeasibleError, SolverError, OutOfTimeError):
        return Late(number, count)
    windows = simulation.flight.windows
    promised, elsewhere = _violations(drawn.scenario, simulation, horizon.latency)
    stops = [window.contingency for window in windows if window.contingency is not None]
    errors = np.maximum(simulation.errors() - 1e-9, 0.0)
    over = errors / np.maximum(simulation.radii(), 1e-9)[:, None]
    timed = windows[1:] if drawn.horizon["fallback"] is None else ()
    return Late(
        number,
        count,
        len(windows),
        len(stops),
        sum(bool(window.no_contingency) for window in windows),
        sum((window.contingency is None) != bool(window.no_contingency) for window in windows),
        sum(window.stopping for window in windows),
        sum(window.kept for window in windows),
        sum(not _promises_a_plan(window) for window in windows),
        promised,
        elsewhere,
        max((_in_tube(stop) for stop in stops), default=-np.inf),
        float(over.max()),
        sum(bool(window.off_tube) for window in windows),
        tuple(window.statistics.seconds for window in timed),
    )


def _promises_a_plan(window: rho.Window) -> bool:
    """Return whether a window declares a contingency, or flies a plan that violates nothing."""
    return not window.infeasible or window.kept or window.contingency is not None


def _violations(
    scenario: rho.Scenario, simulation: Simulation, latency: int
) -> tuple[float, float]:
    """Return the largest violations in windows that promise none, and in the others.

    Args:
        scenario: as it was before planning, so that it has what becomes known when it does.
        simulation: flight.
        latency: time that planning a window takes, in samples of the feedback.
    """
    around = scenario.disturbance or rho.Disturbance(0.0)
    ahead = latency * around.sample(scenario.grid)
    times, positions, velocities = finer(simulation)
    windows, grid = simulation.flight.windows, scenario.grid
    begins = grid.times[[window.first_knot for window in windows]]
    promising = np.array([_promises_a_plan(window) for window in windows])
    in_force = np.searchsorted(begins, times + 1e-9, side="right") - 1
    commanded = np.searchsorted(begins, simulation.times[:-1] + 1e-9, side="right") - 1
    known_by = begins - ahead * (np.arange(len(begins)) > 0)
    found = []
    for promises in (True, False):
        now, then = promising[in_force] == promises, promising[commanded] == promises
        if not now.any():
            found.append(-np.inf)
            continue
        most = _breach(
            scenario,
            (times[now], positions[now], velocities[now]),
            known_by[in_force[now]],
            np.zeros(int(now.sum())),
        )
        found.append(max(most, _beyond_commands(scenario, simulation.commands[:-1][then])))
    return found[0], found[1]


def _beyond_commands(scenario: rho.Scenario, commands: FloatArray) -> float:
    """Return the largest violation of a limit of the accelerations, shape (M, N, 3)."""
    if len(commands) == 0:
        return -np.inf
    limits = [scenario.limits_of(vehicle) for vehicle in scenario.vehicles]
    return max(
        max(beyond(each.acceleration, a), above(each.max_acceleration, a))
        for each, a in zip(limits, np.moveaxis(commands, 1, 0), strict=True)
    )


def _breach(
    scenario: rho.Scenario,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    known_by: FloatArray,
    position_error: FloatArray,
    velocity_error: float | FloatArray = 0.0,
) -> float:
    """Return the largest violation at some times, as a fraction of the scene, a side or a limit.

    At each time, each obstacle is as far towards each vehicle as its errors allow.

    Args:
        scenario: obstacles and limits.
        motion: times (S,), positions and velocities (S, N, 3).
        known_by: obstacles count that become known by this time [s], (S,).
        position_error: radius in which each position may be [m], (S,).
        velocity_error: the same of velocities [m/s], (S,).
    """
    times, positions, velocities = motion
    scale = float(np.ptp(positions, axis=(0, 1)).max()) + 1.0
    radii = np.array([vehicle.radius for vehicle in scenario.vehicles])
    most = -np.inf
    for body in scenario.bodies:
        since = body.known_from if body.seen_at is None else body.seen_at
        uncertain = body.position_error + body.velocity_error * np.maximum(times - since, 0.0)
        kept = radii + (uncertain + position_error)[:, None]
        gap = distances(body.shape, positions - displacement(body, times)[:, None]) - kept
        counts = (body.known_from <= known_by) | (body.known_from == 0.0)
        if counts.any():
            most = max(most, -float(gap[counts].min()) / scale)
    if scenario.separation is not None:
        factors = np.array([1.0, 1.0, scenario.separation.downwash])
        for i in range(1, len(radii)):
            x = positions[:, i, None] - positions[:, :i]
            apart = np.linalg.norm(x / factors, axis=-1).min(axis=1)
            lacking = scenario.separation.distance + 2.0 * position_error - apart
            most = max(most, float(lacking.max()) / scale)
    for i, vehicle in enumerate(scenario.vehicles):
        limits, p = scenario.limits_of(vehicle), positions[:, i]
        if limits.position is not None:
            walls = np.minimum(p - limits.position.lower, limits.position.upper - p).min(axis=1)
            most = max(most, float((position_error - walls).max()) / scale)
        if limits.max_speed is not None:
            speeds = np.linalg.norm(velocities[:, i], axis=1) + velocity_error
            most = max(most, float(speeds.max()) / limits.max_speed - 1.0)
    return most


def _in_tube(stop: rho.Plan) -> float:
    """Return the largest violation of what is known by a contingency with its tube, by samples.

    Two vehicles are taken to be further apart by both radii in metres that downwash does not
    scale, which a factor of 1 makes exact; only such pairs count with another factor.
    """
    scenario = stop.scenario
    grid, tube = scenario.grid, rho.error_tube(scenario)
    parts = np.linspace(0.0, grid.step, _TAKEN + 1)[:-1]
    elapsed = (grid.step * np.arange(grid.knots - 1)[:, None] + parts).reshape(-1)
    k = np.repeat(np.arange(grid.knots - 1), _TAKEN)
    s = np.tile(parts, grid.knots - 1)[:, None]
    p, v, a = (values[:, k] for values in (stop.positions, stop.velocities, stop.accelerations))
    positions = np.moveaxis(p + s * (v + s / 2.0 * a), 0, 1)
    velocities = np.moveaxis(v + s * a, 0, 1)
    times = grid.start + elapsed
    if scenario.separation is not None and scenario.separation.downwash != 1.0:
        scenario = scenario.without_separation()  # not validated: more may be seen later
    return _breach(
        scenario,
        (times, positions, velocities),
        np.full(len(times), grid.start + 1e-9),
        tube.position(times),
        tube.velocity(times),
    )


_ABOUT = f"""\
One to eight vehicles cross a room, some with a position box, among up to three obstacles known from
the start and up to three, or doors, seen late, most of them where a vehicle will be 0.2 to 3 s
later. Spheres, boxes and columns, half of them moving, with position errors of up to 0.15 m and
velocity errors of up to 0.1 m/s. The latency is 0, 0.8 of the time for which a window is flown, or
between them; windows begin every two to six steps of 0.2 or 0.25 s. Delays of 0 to 2 samples, up to
three measurements lost in a row: as many as may be lost and then one that arrives, or at random.
W is 0.05 to 0.4 m/s² and blows at full strength: constant, in a gust, as noise, switching its sign,
as the worst case of the first plan towards an obstacle, or always towards what is nearest. Errors
of the estimates have their full size, at random or along the wind. Planner `plan_convex`; one
flight in 25 with `plan` as its fallback and a time limit of 0.2 s, one in five with bounded costs.
Flights are judged by samples of the true motion, at least twenty in a sample of the feedback. At
each of them every obstacle that the window in force knows is as far towards each vehicle as its
declared errors allow. Obstacles are known to a window from one latency before it. More than
{VIOLATED:g} of the scene's extent, or of a limit, is a violation. Broken: in a window that has a
contingency, or a plan that is its own or the rest of the previous one. Broken elsewhere: in the
other windows, which report that they have neither. Contingencies are also sampled with their whole
tubes, flown or not. Times are wall times of windows without a fallback, contingencies included."""

_LIMITATIONS = """\
Limitations. Samples can miss violations between them. Wind and errors do not anticipate new
windows, but for the chasing wind."""
