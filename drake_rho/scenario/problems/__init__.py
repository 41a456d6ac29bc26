"""Generated scenarios: random fleets, worlds, and missions of other planners.

Each function returns a `Scenario` from numbers, a random generator or a mission file.
"""
