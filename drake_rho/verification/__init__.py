"""Independent verification of plans, flights and simulations.

A `Plan`, `Flight` or `Simulation` comes in; a `Report` of checks, one for each constraint and
vehicle, goes out. The verifier has its own mathematics: it imports nothing from the planners, and
uses neither their tightening margins nor their close-approach computations.
"""
