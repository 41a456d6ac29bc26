"""Verification of waypoints at their times."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.verification.check import Column
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_waypoints(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Verify the distance of every vehicle from each of its waypoints at the waypoint's time.

    If the motion jumps at that time, the state after the jump counts. With errors a vehicle is in
    the tubes of both states, and the state closer to the waypoint counts.
    """
    scenario = trajectory.scenario
    vehicles = np.arange(len(scenario.vehicles))
    scale = scenario.fleet.scale("position")
    for waypoints in scenario.fleet.waypoints:
        present = waypoints.present
        times = np.where(present, waypoints.times, scenario.grid.start)
        positions = trajectory.each_at(vehicles, times)
        distances = np.linalg.norm(positions - waypoints.positions, axis=1)
        errors = np.where(present, trajectory.tubes.at("position", times), 0.0)
        if trajectory.has_errors:
            for who, piece in _at_jumps(trajectory, times):
                before = trajectory.ends[0][who, piece] - waypoints.positions[who]
                away, radius = np.linalg.norm(before), trajectory.tubes.before("position", times)
                if away + radius[who] < distances[who] + errors[who]:
                    distances[who], errors[who] = away, radius[who]
        within = np.where(errors > 0.0, waypoints.within - errors, waypoints.within)
        column = Column(
            kind="waypoints",
            constraint=waypoints.called,
            parts=[""] * len(vehicles),
            times=times,
            values=distances,
            limits=within,
            excess=distances - within,
            tolerances=waypoints.tolerances(scale),
            errors=errors,
            unit="m",
            concerned=present & ~waypoints.soft,
        )
        soft = present & waypoints.soft
        if column.concerned.any() or not soft.any():
            yield column
        if soft.any():
            penalties = np.where(soft, waypoints.penalties * scenario.fleet.weights, 0.0)
            yield dataclasses.replace(column, concerned=soft).softened(penalties)


def _at_jumps(trajectory: PiecewiseTrajectory, times: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield vehicles with waypoints at a jump, and the pieces that end there.

    Args:
        trajectory: trajectory of all vehicles.
        times: time of one waypoint of each vehicle, on the scenario's clock [s], shape (N,).
    """
    for piece in trajectory.last_before_jumps.tolist():
        near = trajectory.scenario.grid.clock.same(times, trajectory.times[piece + 1])
        yield from ((vehicle, piece) for vehicle in np.flatnonzero(near).tolist())
