"""Scenarios that are made: random fleets, worlds, and missions of other planners.

Numbers, a random generator or a mission file come in; a `Scenario` goes out.
"""
