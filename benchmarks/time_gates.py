"""Least times through gates with a direction, beside IPOPT on the same grid."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.peers import casadi_gates
from benchmarks.tables import Cell, Goal, Table

EQUAL = 1.001
"""Goal: time over that of IPOPT, largest."""

COLUMNS = (
    "seed",
    "gates",
    "velocity",
    "T [s]",
    "IPOPT from this plan [s]",
    "IPOPT from a slow motion [s]",
    "T / IPOPT's least",
    "verified",
    "seconds",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One race."""

    seed: int
    """seed of the race"""
    scenario: rho.Scenario
    """the race"""
    duration: float
    """least time found [s]"""
    peers: tuple[float, float]
    """times of IPOPT from that plan and from a slow motion [s]"""
    ok: bool
    """whether the plan is verified"""
    seconds: float
    """processor time of the plan [s]"""

    @property
    def ratio(self) -> float:
        """T over the least of IPOPT's times."""
        return self.duration / min(self.peers)

    def row(self) -> tuple[Cell, ...]:
        """Return the values in the order of `COLUMNS`."""
        ways = self.scenario.vehicles[0].waypoints
        kind = type(ways[0].velocity).__name__.replace("ndarray", "value").lower()
        times = (self.duration, *self.peers, self.ratio)
        return (self.seed, len(ways), kind, *times, self.ok, self.seconds)


def run(seeds: int = 20) -> Table:
    """Race through `seeds` draws of gates."""
    laps = [_lap(seed) for seed in track(range(seeds), "gates")]
    return Table(
        name="time_gates",
        title="Least times through gates with a direction, beside IPOPT",
        columns=COLUMNS,
        rows=tuple(each.row() for each in laps),
        notes=(_WORK,),
        goals=(
            Goal("T over the least of IPOPT's, largest", EQUAL, max(each.ratio for each in laps)),
            Goal("draws above it", 0, sum(each.ratio > EQUAL for each in laps)),
            Goal("plans that are not verified", 0, sum(not each.ok for each in laps)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "casadi"),
    )


def _race(seed: int) -> rho.Scenario:
    """Return a race of 40 steps through one to three gates with velocities of one kind."""
    rng = np.random.default_rng([485, seed])
    count = int(rng.integers(1, 4))
    x = np.linspace(0.0, 12.0, count + 2)[1:-1]
    places = np.stack([x, *rng.uniform(-2.0, 2.0, (2, count))], axis=1)
    waypoints = []
    for place in places:
        along = np.array([1.0, 0.0, 0.0]) + rng.normal(0.0, 0.4, 3)
        along /= np.linalg.norm(along)
        speed = float(rng.uniform(2.0, 4.0))
        kinds: list[Any] = [
            rho.Cone([0.0] * 3, along, 0.3),
            speed * along,
            rho.Ball(speed * along, 0.5),
            rho.HalfSpace(-along, -speed),  # at least this fast along
        ]
        waypoints.append(rho.Waypoint(None, place, velocity=kinds[seed % 4]))
    ends = rho.State([0.0, 0.0, 0.0]), rho.State([12.0, 0.0, 0.0])
    racer = rho.Vehicle("racer", *ends, waypoints=waypoints)
    limits = rho.Limits(max_speed=6.0, max_acceleration=8.0)
    return rho.Scenario(f"gates {seed}", rho.Grid(0.1, 41), [racer], limits)


def _lap(seed: int) -> Lap:
    scenario = _race(seed)
    began = time.process_time()
    plan = rho.plan_minimum_time(scenario)
    seconds = time.process_time() - began
    slow = rho.plan(dataclasses.replace(scenario, grid=rho.Grid(0.2, 41)))
    peers = casadi_gates.least_time(plan), casadi_gates.least_time(slow)
    duration = plan.scenario.grid.duration
    return Lap(seed, scenario, duration, peers, rho.verify(plan).ok, seconds)


_WORK = """\
One vehicle, 12 m from rest to rest in 40 steps through one to three points without times, at each
with a velocity in a cone of 0.3 rad, a given velocity, one in a ball of 0.5 m/s, or at least a
speed along a direction; at most 6 m/s and 8 m/s². IPOPT has positions, velocities, accelerations,
the step and the parts of steps as variables. It begins with this plan, and with a plan of 8 s.
Gates that reach the end of their step go on to the next. Its least time of the two counts."""
