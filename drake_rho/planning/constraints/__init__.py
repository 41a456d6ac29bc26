"""Constraints as rows of half-spaces: normal · quantity(time) >= bound.

The input is a scenario and, for nonconvex constraints, a reference motion. The output is a list of
`Constraint`s, each of which returns the rows that a motion violates. Nothing here depends on
programs or solvers.
"""
