"""`Flown`: a plan, a flight, a simulation or trajectories, with their common interface."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.flight import Flight
from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import Samples
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.times import Clock

Planned = Plan | Flight | Simulation
"""Plan, flight or simulation."""
Flown = Planned | Trajectories
"""Plan, flight, simulation, or trajectories of any planner for a scenario.

Each has a `kind` in words, its `scenario`, the `plan` whose accelerations were planned, with its
`cost` and `statistics`, the `windows` and `sightings` of a receding horizon (none for a plan), the
`flight` (None for a plan) and the `simulation` (None for a plan or a flight). `at` returns states
at times on the scenario's clock, `sampled` at times since the first knot. The plan of trajectories
has their states at the knots.
"""


def sample(flown: Flown, elapsed: FloatArray) -> Samples:
    """Return the states to export at some times since the first knot [s], shape (M,).

    From the end on (the last knot, or later with a smoothing) positions and velocities remain
    constant and accelerations are zero.

    Raises:
        ValueError: a number is so large that it would be rejected when read again.
    """
    scenario = flown.scenario
    end = scenario.grid.elapsed[-1] + scenario.lead
    found = flown.sampled(np.minimum(elapsed, end))
    ended = ~Clock.of(scenario.grid.step).before(elapsed, end)
    accelerations = np.where(ended[:, None], 0.0, found.accelerations)
    vectors = (found.positions, found.velocities, accelerations)
    if not all(np.all(np.abs(each) <= LARGEST) for each in vectors):
        expected = "expected those of a flight"
        raise ValueError(f"{scenario.name}: got states beyond {LARGEST:g}, {expected}")
    times = scenario.grid.start + elapsed
    return dataclasses.replace(found, times=times, accelerations=accelerations)
