"""What users call to plan a whole flight: the best plan, the convex method, assignment.

A scenario comes in; a verified `Plan` goes out. A planner says which references the loops of `scp`
begin with, and which of their plans is kept.
"""
