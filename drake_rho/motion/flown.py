"""`Flown`: plans, flights and simulations by what they have in common."""

from __future__ import annotations

from drake_rho.motion.flight import Flight
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation

Flown = Plan | Flight | Simulation
"""Plan, flight or simulation.

Each has a `kind` in words, its `scenario`, the `plan` whose accelerations were planned, with its
`cost` and `statistics`, the `windows` and `sightings` of a receding horizon (none for a plan), the
`flight` (None for a plan) and the `simulation` (None for a plan or a flight).
"""
