"""Generated scenarios: random fleets and worlds.

Each function returns a `Scenario` from numbers or a random generator.
"""
