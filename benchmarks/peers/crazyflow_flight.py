"""`python crazyflow_flight.py REFERENCES FLOWN`: fly references with simulated Crazyflies.

It runs in an environment that has Crazyflow and not this package, and so imports neither the
package nor its benchmarks. Both files are numpy's `.npz` files:

- REFERENCES: `times` [s], shape (M,), a hundred a second; `positions` [m], `velocities` [m/s] and
  `accelerations` [m/s²], shape (N, M, 3).
- FLOWN: `positions` [m], shape (N, M, 3), the true ones at the same times.
"""

from __future__ import annotations

import sys

import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim

RATE, PHYSICS = 100, 500
"""References and steps of the simulation in a second."""


def fly(positions: np.ndarray, velocities: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
    """Return positions of all vehicles, each of which begins on its reference.

    Args:
        positions: positions of the references [m], shape (N, M, 3).
        velocities: velocities of the references [m/s], shape (N, M, 3).
        accelerations: accelerations of the references [m/s²], shape (N, M, 3).

    Returns:
        Positions [m], shape (N, M, 3).
    """
    vehicles, count = positions.shape[:2]
    sim = Sim(n_worlds=1, n_drones=vehicles, control=Control.state, freq=PHYSICS, state_freq=RATE)
    first = sim.data.states.replace(pos=positions[None, :, 0], vel=velocities[None, :, 0])
    sim.data = sim.data.replace(states=first)
    commands = np.zeros((1, vehicles, 16), dtype=np.float32)
    commands[..., 12] = 1.0  # the quaternion (0, 0, 0, 1): yaw 0
    flown = [positions[:, 0]]
    for k in range(count - 1):
        commands[0, :, :9] = np.hstack([positions[:, k], velocities[:, k], accelerations[:, k]])
        sim.state_control(commands)
        sim.step(PHYSICS // RATE)
        flown.append(np.asarray(sim.data.states.pos[0], dtype=np.float64))
    return np.stack(flown, axis=1)


if __name__ == "__main__":
    with np.load(sys.argv[1]) as given:
        if not np.allclose(np.diff(given["times"]), 1.0 / RATE):
            sys.exit(f"times: expected {RATE} a second")
        flown = fly(given["positions"], given["velocities"], given["accelerations"])
    np.savez(sys.argv[2], positions=flown)
