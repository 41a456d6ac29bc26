"""Optimality certificates of plans, diagnoses of infeasible scenarios, and minimum-time plans.

`certify` takes a plan and returns a lower bound on the cost of every plan. `diagnose`,
`infeasible_subset` and `plan_minimum_time` take a scenario, or a planner's error, and return a
diagnosis, the conflicting constraints, or the plan of least duration. Planners and the verifier are
called, never changed.
"""
