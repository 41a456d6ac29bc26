"""Adversarial winds of full strength, towards what a vehicle has to avoid."""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from benchmarks.clearance import displacement, distances, nearest
from drake_rho.scenario.fields import BoolArray, FloatArray

LOOKS = 40
"""Sampled instants of a flight at which the nearest obstacles are determined."""

NEAR = 8
"""Sampled instants with the least clearance of a vehicle among which one is drawn for a wind."""


@dataclasses.dataclass(frozen=True, eq=False)
class WorstAtClosest:
    """Wind of `rho.worst_case` for each vehicle, towards what it comes near, at that time."""

    switching_times: FloatArray
    """times at which it changes for any vehicle [s], shape (S,)"""
    winds: FloatArray
    """wind from each switching time on [m/s²], shape (S, N, 3)"""
    position_errors: FloatArray
    """errors of the estimated positions with it [m], shape (J, N, 3)"""
    velocity_errors: FloatArray
    """errors of the estimated velocities with it [m/s], shape (J, N, 3)"""
    lost: BoolArray
    """whether each measurement is lost, shape (J, N)"""

    @classmethod
    def drawn(
        cls, scenario: rho.Scenario, plan: rho.Plan, rng: np.random.Generator
    ) -> WorstAtClosest:
        """Draw a wind against a plan that is tracked from its first knot on.

        Args:
            scenario: obstacles, limits, and the strength of the wind.
            plan: the vehicles' motion.
            rng: draws, for each vehicle, one of the instants with the least clearance.
        """
        grid = scenario.grid
        times = grid.start + rng.uniform(0.0, grid.duration, LOOKS)
        positions = np.moveaxis(plan.motion().at("position", times - grid.start), 0, 1)
        looks = [towards_nearest(scenario, t, p) for t, p in zip(times, positions, strict=True)]
        order = np.argsort([far for _, far in looks], axis=0)[:NEAR]
        cases = []
        for i, near in enumerate(order.T):
            k = int(rng.choice(near))
            cases.append(rho.worst_case(scenario, looks[k][0][i], float(times[k])))
        switches = np.unique(np.concatenate([case.switching_times for case in cases]))
        still = np.zeros((1, 3))
        winds = [[case(t, still, still)[0] for case in cases] for t in switches]
        return cls(
            switches,
            np.array(winds),
            np.stack([case.position_errors for case in cases], axis=1),
            np.stack([case.velocity_errors for case in cases], axis=1),
            np.stack([case.lost for case in cases], axis=1),
        )

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """Return the wind at many times [m/s²], shape (M, N, 3)."""
        k = np.searchsorted(self.switching_times, times + 1e-9, side="right") - 1
        return np.where(k[:, None, None] >= 0, self.winds[k], 0.0)

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the wind at one time, shape (N, 3)."""
        return np.asarray(self.over(np.array([time]), len(positions))[0])


@dataclasses.dataclass(frozen=True, eq=False)
class Chaser:
    """Wind that always blows every vehicle towards whatever is nearest to it."""

    scenario: rho.Scenario
    """obstacles, limits, and the strength of the wind"""
    aside: float = 0.0
    """fraction of the wind that blows in a constant direction instead, from 0 to 1"""
    angle: float = 0.0
    """angle of that direction in the x-y plane [rad]"""

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the wind at one time [m/s²], shape (N, 3)."""
        around = self.scenario.disturbance
        strongest = 0.0 if around is None else around.acceleration
        other = np.array([np.cos(self.angle), np.sin(self.angle), 0.0])
        ways = (1.0 - self.aside) * towards_nearest(self.scenario, time, positions)[0]
        return np.asarray(strongest * unit_vectors(ways + self.aside * other))


def unit_vectors(ways: FloatArray) -> FloatArray:
    """Return vectors (N, 3) scaled to length 1; along x where they are zero."""
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    return np.asarray(np.where(lengths > 1e-12, ways / np.maximum(lengths, 1e-12), np.eye(3)[0]))


def towards_nearest(
    scenario: rho.Scenario, time: float, positions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors to what is nearest to each vehicle, and how far it is beyond the limit.

    Obstacles, the walls of position boxes, and the other vehicles, if there is a separation, count.
    A vehicle with nothing around it gets the direction x.

    Args:
        scenario: obstacles, limits and separation.
        time: on the scenario's clock [s].
        positions: of the vehicles [m], shape (N, 3).

    Returns:
        Directions of shape (N, 3) and distances [m] of shape (N,).
    """
    radii = np.array([vehicle.radius for vehicle in scenario.vehicles])
    best, ways = np.full(len(positions), np.inf), np.tile([1.0, 0.0, 0.0], (len(positions), 1))
    candidates = [_obstacle(each, time, positions, radii) for each in scenario.obstacles]
    candidates += _walls(scenario, positions)
    if scenario.separation is not None:
        candidates.append(_partner(scenario.separation, positions))
    for way, far in candidates:
        nearer = far < best
        best, ways = np.where(nearer, far, best), np.where(nearer[:, None], way, ways)
    return unit_vectors(ways), best


def _obstacle(
    obstacle: object, time: float, positions: FloatArray, radii: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return vectors to an obstacle, and distances beyond the required one."""
    shape, kept, away = obstacle, radii, np.zeros(3)
    if isinstance(obstacle, rho.Obstacle):
        shape, kept = obstacle.shape, radii + obstacle.deviation
        away = displacement(obstacle, np.array([time]))[0]
    if not isinstance(shape, rho.Sphere | rho.Box):
        raise TypeError(f"shape: got {shape}, expected a sphere or a box")
    there = positions - away
    return nearest(shape, there) - there, distances(shape, there) - kept


def _walls(scenario: rho.Scenario, positions: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Return vectors to each wall of the position boxes, and distances."""
    boxes = [scenario.limits_of(vehicle).position for vehicle in scenario.vehicles]
    found = []
    for axis, out in ((axis, out) for axis in range(3) for out in (-1.0, 1.0)):
        sides = [
            np.inf * out if box is None else (box.upper if out > 0.0 else box.lower)[axis]
            for box in boxes
        ]
        far = out * (np.array(sides) - positions[:, axis])
        found.append((np.tile(out * np.eye(3)[axis], (len(positions), 1)), far))
    return found


def _partner(separation: rho.Separation, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return vectors to the nearest other vehicle, and distances beyond the separation."""
    scaled = positions / np.array([1.0, 1.0, separation.downwash])
    far = np.linalg.norm(scaled[:, None] - scaled, axis=-1)
    np.fill_diagonal(far, np.inf)
    other = np.argmin(far, axis=1)
    return positions[other] - positions, far.min(axis=1) - separation.distance
