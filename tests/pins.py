"""Plans, flights and least times whose costs, times and reports are pinned.

`python -m tests.pins` writes the file.

A change of the code that does not change behaviour leaves them as they are. The scenarios are
chosen so that the last digits of a computer's arithmetic do not lead to another plan.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import drake_rho as rho
from tests.disturbed import crowded, disturbed
from tests.scenarios import box, fleet, single, through_the_middle
from tests.shapes import Shape

PINS = Path(__file__).with_name("pins.json")

Pinned = rho.Plan | rho.Flight | rho.Simulation

_WALL = rho.Box([4.5, -9.0, -3.0], [5.5, 3.0, 3.0])
_DOOR = (
    rho.Box([4.5, -9.0, -6.0], [5.5, 2.0, 6.0]),
    rho.Box([4.5, 4.0, -6.0], [5.5, 9.0, 6.0]),
)
_CRATE = rho.Box([-1.0, -6.0, -1.0], [1.0, -5.0, 1.0])
_TETRAHEDRON = rho.Polytope([[4.0, 1.0, -2.0], [6.0, 1.0, -2.0], [5.0, 4.0, -2.0], [5.0, 2.0, 2.0]])
_SHAPES: dict[str, Shape] = {
    "sphere": rho.Sphere([5.0, 2.2, -0.9], 1.5),
    "box": rho.Box([4.0, 1.0, -2.0], [6.0, 2.9, 0.1]),
    "ellipsoid": rho.Ellipsoid([5.0, 2.2, -0.9], [2.0, 1.0, 0.8]),
    "cylinder": rho.Cylinder([5.0, 2.2, -1.0], 1.2, 3.0, "z"),
    "endless cylinder": rho.Cylinder([5.0, 2.2, -0.9], 1.2, axis="y"),
    "polytope": _TETRAHEDRON,
}
_LIMITS = {
    "position": rho.Limits(position=rho.Box([-0.1, -0.1, -2.005], [10.1, 4.1, 0.1])),
    "velocity": rho.Limits(velocity=box(1.5)),
    "acceleration": rho.Limits(acceleration=box(0.7)),
    "jerk": rho.Limits(jerk=box(0.6)),
    "max_acceleration": rho.Limits(max_acceleration=0.8),
    "max_speed": rho.Limits(max_speed=1.7),
    "max_thrust": rho.Limits(max_thrust=9.9),
    "max_tilt": rho.Limits(max_tilt=0.07, max_thrust=12.0),
}


def _past(shape: Shape, limits: rho.Limits | None = None) -> rho.Plan:
    """Return the plan of one vehicle past an obstacle, under limits."""
    return rho.plan(single(limits=limits, obstacles=[shape], between_knots=True))


def _moving(known_from: float = 0.0) -> rho.Scenario:
    """Return a scenario with a crossing sphere and a box that moves along a track."""
    sphere = rho.Obstacle(rho.Sphere([2.0, 5.0, -1.0], 1.0), velocity=[0.7, -0.8, 0.0])
    track = rho.Track([0.0, 4.0, 8.0], [[8.0, 0.0, -2.0], [7.0, 3.0, -1.0], [4.0, 5.0, 0.0]])
    crate = rho.Obstacle(rho.Box([-0.5] * 3, [0.5] * 3), track=track, known_from=known_from)
    return single(obstacles=[sphere, crate], between_knots=True)


def _swap(count: int, seed: int, **options: Any) -> rho.Scenario:
    """Return vehicles that swap sides of a circle, displaced so that no two paths cost the same."""
    scenario = through_the_middle(count)
    ends = np.array([[v.start.position, v.goal.position] for v in scenario.vehicles])
    noise = np.random.default_rng(seed).uniform(-0.8, 0.8, ends.shape)
    starts, goals = np.moveaxis(ends + noise, 1, 0)
    return fleet(starts, goals, **options)


def _pairs(count: int, seed: int) -> rho.Scenario:
    """Return pairs that swap places, each in a lane of its own, with space between the lanes."""
    rng = np.random.default_rng(seed)
    lanes = np.repeat(8.0 * np.arange(count // 2), 2)[:, None] * [0.0, 1.0, 0.0]
    side = np.where(np.arange(count) % 2, -5.0, 5.0)[:, None] * [1.0, 0.0, 0.0]
    starts, goals = (
        lanes + sign * side + rng.uniform(-0.4, 0.4, (count, 3)) for sign in (1.0, -1.0)
    )
    return fleet(starts, goals)


def _paper(**changes: Any) -> rho.Scenario:
    return dataclasses.replace(rho.load_scenario("paper"), **changes)


def _past_quickly() -> rho.Scenario:
    """Return one vehicle past a sphere, with limits that bound the least time."""
    limits = rho.Limits(max_speed=3.0, max_acceleration=2.0)
    return single(limits=limits, obstacles=[_SHAPES["sphere"]], between_knots=True)


def _smooth() -> rho.Scenario:
    return dataclasses.replace(_past_quickly(), smoothing=rho.Smoothing(0.4, 2))


def _linked() -> rho.Scenario:
    """Return two vehicles, the second of which stays close to the first for a while."""
    link = rho.KeepIn(
        rho.Sphere([0, 0, 0], 2.5), vehicles="v1", relative_to="v0", active=(2.3, 5.1)
    )
    pair = fleet([[0, 0, 0], [0, 4, 0]], [[10, 4, 0], [10, 8, 0]])
    return dataclasses.replace(pair, requirements=(link,))


def _in_wind(scenario: rho.Scenario, **windows: Any) -> rho.Simulation:
    """Return the flight of a scenario in its worst wind along x, with random estimates."""
    wind = rho.worst_case(scenario, [1.0, 0.0, 0.0], 3.0)
    rng = np.random.default_rng(0)
    return rho.simulate(scenario, wind=wind, rng=rng, replan_every=3, **windows)


CASES: dict[str, Callable[[], Pinned]] = {
    **{f"past a shape: {kind}": partial(_past, shape) for kind, shape in _SHAPES.items()},
    **{
        f"limit: {kind}": partial(_past, _SHAPES["sphere"], limits)
        for kind, limits in _LIMITS.items()
    },
    "past a wall": lambda: rho.plan(single(obstacles=[_WALL], between_knots=True)),
    "through a door": lambda: rho.plan(single(obstacles=_DOOR, between_knots=True)),
    "fleet: through a door": lambda: rho.plan(
        fleet(
            [[0.0, 0.0, 0.0], [0.0, 1.5, 0.2]],
            [[10.0, 0.1, 0.0], [10.0, 1.3, 0.4]],
            obstacles=_DOOR,
            between_knots=True,
        )
    ),
    "forest": lambda: rho.plan(rho.random_field(12, np.random.default_rng(3))),
    "moving": lambda: rho.plan(_moving()),
    "late: planned": lambda: rho.plan(_moving(known_from=3.0)),
    "late: flown": lambda: rho.plan_rho(_moving(known_from=3.0), replan_every=2),
    "waypoints": lambda: rho.plan(
        single(
            obstacles=[_SHAPES["box"]],
            waypoints=[
                rho.Waypoint(3.1, [4.0, 4.0, 0.0]),
                rho.Waypoint(6.0, [8.0, 3.0, 0.0], within=0.5),
            ],
            between_knots=True,
        )
    ),
    "paper: Example 1": lambda: rho.plan_convex(_paper(obstacles=())),
    "paper: Example 2": lambda: rho.plan_convex(_paper()),
    "paper: Example 4": lambda: rho.plan_rho(_paper(), replan_every=5),
    "paper: Example 4 with DAQP": lambda: rho.plan_rho(_paper(), replan_every=5, solver="daqp"),
    "paper: converged": lambda: rho.plan(_paper()),
    "paper: converged with OSQP": lambda: rho.plan(_paper(), solver="osqp"),
    "paper: at every instant": lambda: rho.plan(_paper(between_knots=True)),
    "fleet: 2 coupled": lambda: rho.plan(_swap(2, 2)),
    "fleet: 4 coupled": lambda: rho.plan(_swap(4, 101), coupling="coupled"),
    "fleet: 4 coupled, one linearisation": lambda: rho.plan_convex(
        _swap(4, 101), reference=rho.plan(_swap(4, 101), coupling="decoupled")
    ),
    "fleet: 6 coupled with DAQP": lambda: rho.plan(_pairs(6, 1), solver="daqp"),
    "fleet: 4 with downwash, in a box": lambda: rho.plan(
        _swap(4, 4, separation=rho.Separation(0.7, 2.0), limits=rho.Limits(position=box(6.0)))
    ),
    "fleet: 3 past a sphere": lambda: rho.plan(
        _swap(3, 3, obstacles=[rho.Sphere([0.5, 0.3, 0.2], 1.2)])
    ),
    "fleet: 3 past a moving box": lambda: rho.plan(
        _swap(3, 3, obstacles=[rho.Obstacle(_CRATE, velocity=[0.1, 1.1, 0.0])])
    ),
    "fleet: 6 decoupled": lambda: rho.plan(_pairs(6, 2), coupling="decoupled"),
    "fleet: 12 decoupled": lambda: rho.plan(_pairs(12, 3), coupling="decoupled"),
    "fleet: 12 grouped": lambda: rho.plan(_pairs(12, 4), coupling="grouped"),
    "fleet: 30 grouped": lambda: rho.plan(_pairs(30, 5)),
    "fleet: flown": lambda: rho.plan_rho(_swap(4, 4), replan_every=4),
    "disturbed: 0": lambda: rho.plan(disturbed(0)),
    "disturbed: 1": lambda: rho.plan(disturbed(1)),
    "disturbed: flown 0": lambda: rho.plan_rho(disturbed(0), replan_every=2),
    "disturbed: flown 3": lambda: rho.plan_rho(disturbed(3), replan_every=3),
    "disturbed: crowded": lambda: rho.plan_rho(crowded(1), replan_every=3),
    "flown: contingencies": lambda: rho.plan_rho(
        _moving(known_from=3.0), replan_every=2, contingencies=True
    ),
    "flown: latency": lambda: rho.plan_rho(_moving(known_from=3.0), replan_every=2, latency=0.4),
    "flown: bounded cost": lambda: rho.plan_rho(disturbed(1), replan_every=3, bounded_cost=True),
    "flown: free final time": lambda: rho.plan_rho(
        _past_quickly(), replan_every=4, free_final_time=True
    ),
    "flown: smooth": lambda: rho.plan_rho(_smooth(), replan_every=4),
    "flown: in wind": lambda: _in_wind(disturbed(3)),
    "flown: in wind, with everything": lambda: _in_wind(
        disturbed(4), contingencies=True, latency=0.2, bounded_cost=True
    ),
    "requirement: with a leader": lambda: rho.plan(_linked()),
    "least time: past a sphere": lambda: rho.plan_minimum_time(_past_quickly()),
    "least time: with gates": lambda: rho.plan_minimum_time(
        single(
            limits=rho.Limits(max_speed=3.0, acceleration=box(2.0)),
            waypoints=[rho.Waypoint(None, [4.0, 4.0, 0.0]), rho.Waypoint(None, [8.0, 3.0, -1.0])],
        )
    ),
    "least time: jerk": lambda: rho.plan_minimum_time(
        single(limits=rho.Limits(max_acceleration=2.0, jerk=box(3.0)))
    ),
}
"""Planned cases by name."""


def pin(planned: Pinned) -> dict[str, Any]:
    """Return the pinned values of a plan, a flight or a simulation.

    They are the costs of each vehicle's motion and of each window's plan [m²/s⁴], the time of
    flight [s], and the report: its verdict and its checks by constraint, with their distances
    beyond the limits. At which of two limits a vehicle is equally close depends on the last digits.
    """
    windows = () if planned.flight is None else planned.flight.windows
    report = rho.verify(planned)
    return {
        "costs": [float(np.sum(each**2)) for each in planned.plan.accelerations],
        "windows": [window.plan.cost for window in windows],
        "duration": planned.plan.scenario.grid.duration,
        "ok": report.ok,
        "checks": {
            f"{each.vehicle}: {each.constraint}": each.excess
            for each in report.checks
            if np.isfinite(each.excess)
        },
    }


def read() -> dict[str, dict[str, Any]]:
    """Return the stored pins."""
    kept: dict[str, dict[str, Any]] = json.loads(PINS.read_text())
    return kept


if __name__ == "__main__":
    PINS.write_text(
        json.dumps({name: pin(make()) for name, make in CASES.items()}, indent=1) + "\n"
    )
