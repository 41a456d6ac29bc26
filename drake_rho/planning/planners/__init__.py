"""Planners of a whole flight that users call: the best plan, the convex method, assignment.

A scenario comes in; a verified `Plan` goes out. A planner chooses the first references of the loops
in `scp`, and the best of their plans.
"""
