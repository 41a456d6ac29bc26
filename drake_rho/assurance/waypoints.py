"""Waypoints, judged at their times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.assurance.report import Column
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.records import Scenario


def check_waypoints(scenario: Scenario, motion: Motion) -> Iterator[Column]:
    """The distance of every vehicle from each of its waypoints, at the waypoint's time."""
    vehicles = np.arange(len(scenario.vehicles))
    scale = scenario.fleet.scale("position")
    for number, waypoints in enumerate(scenario.fleet.waypoints, start=1):
        due = waypoints.due
        times = np.where(due, waypoints.times, scenario.grid.start)
        positions = motion.each_at("position", vehicles, times - scenario.grid.start)
        distances = np.linalg.norm(positions - waypoints.positions, axis=1)
        yield Column(
            constraint=f"waypoint {number}",
            parts=[""] * len(vehicles),
            times=times,
            values=distances,
            limits=waypoints.within,
            excess=distances - waypoints.within,
            tolerances=waypoints.tolerances(scale),
            unit="m",
            due=due,
        )
