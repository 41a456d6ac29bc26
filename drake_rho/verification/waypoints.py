"""Verification of waypoints at their times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.verification.check import Column
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_waypoints(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Verify the distance of every vehicle from each of its waypoints at the waypoint's time."""
    scenario = trajectory.scenario
    vehicles = np.arange(len(scenario.vehicles))
    scale = scenario.fleet.scale("position")
    for number, waypoints in enumerate(scenario.fleet.waypoints, start=1):
        due = waypoints.present
        times = np.where(due, waypoints.times, scenario.grid.start)
        positions = trajectory.each_at(vehicles, times)
        distances = np.linalg.norm(positions - waypoints.positions, axis=1)
        errors = np.zeros(len(vehicles))
        if trajectory.tubes is not None:
            errors = np.where(due, trajectory.tubes.at("position", times), 0.0)
        within = np.where(errors > 0.0, waypoints.within - errors, waypoints.within)
        yield Column(
            kind="waypoints",
            constraint=f"waypoint {number}",
            parts=[""] * len(vehicles),
            times=times,
            values=distances,
            limits=within,
            excess=distances - within,
            tolerances=waypoints.tolerances(scale),
            errors=errors,
            unit="m",
            due=due,
        )
