"""The judge of every plan, flight and simulation.

A `Plan`, `Flight` or `Simulation` comes in; a `Report` of checks, one for each constraint and
vehicle, goes out. The mathematics is the judge's own: nothing of the planners is imported, and
nothing of the margins and close approaches that they use.
"""
