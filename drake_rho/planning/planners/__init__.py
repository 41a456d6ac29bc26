"""Planners of a whole flight that users call: the best plan, the convex method, assignment.

A scenario comes in; a verified `Plan` goes out. A planner says which references the loops of `scp`
begin with, and which of their plans is kept.
"""
